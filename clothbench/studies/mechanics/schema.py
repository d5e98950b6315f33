"""Columns of the table of simulations: mesh, step, value beside its reference, order of convergence up to it."""

from __future__ import annotations

import pyarrow as pa

_text, _number, _whole = pa.string(), pa.float64(), pa.int64()

LEVEL = {
    "case": _text, "model": _text, "metric": _text, "unit": _text, "along": _whole, "nodes": _whole, "size": _number,
    "step_scale": _number, "load": _number, "load_name": _text, "value": _number, "reference": _number,
    "error": _number, "relative": _number, "order": _number, "status": _text, "reason": _text, "steps": _whole,
    "wall_s": _number, "key": _text,
}  # fmt: skip

TABLES = {"validation": LEVEL}
