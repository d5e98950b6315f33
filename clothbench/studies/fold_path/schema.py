"""Columns of the tables of folding paths: the hand's places with what they took, and shapes of the cloth on the way."""

from __future__ import annotations

import pyarrow as pa

_text, _number, _whole = pa.string(), pa.float64(), pa.int64()
_about = {"case": _text, "fabric": _text, "way": _text, "model": _text}

# needed: friction that keeps the cloth where it lay flat, as if the desk had it; slip: m, of the edge that is not held.
PATH = {
    **_about, "phase": _whole, "step": _whole, "x": _number, "z": _number, "slope": _number, "needed": _number,
    "slip": _number, "key": _text,
}  # fmt: skip
SHAPES = {**_about, "frame": _whole, "x": _number, "z": _number, "key": _text}
TABLES = {"fold_path": PATH, "fold_shapes": SHAPES}
