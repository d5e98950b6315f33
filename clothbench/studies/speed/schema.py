"""Columns of the table of speeds: one row for each measurement and each peer that it is held against."""

from __future__ import annotations

import pyarrow as pa

_text, _number, _whole = pa.string(), pa.float64(), pa.int64()

# ratio: of the speeds per core, model over peer; step_s, error_m: where models are timed at equal error.
SPEED = {
    "model": _text, "kind": _text, "nodes": _whole, "threads": _whole, "batch": _whole, "node_steps_per_s": _number,
    "realtime_factor": _number, "peer": _text, "ratio": _number, "precision": _text, "options": _text, "version": _text,
    "note": _text, "step_s": _number, "error_m": _number, "key": _text,
}  # fmt: skip
TABLES = {"speeds": SPEED}
