"""Columns of the table of steps: the pose, the estimate beside the fabric's reference, friction, errors.

reference_x: m, x of the gripper at the same z for the reference; reference_x_low, reference_x_high: for the ends of its
range, `reference_low` and `reference_high`.
"""

from __future__ import annotations

import pyarrow as pa

_text, _number, _whole = pa.string(), pa.float64(), pa.int64()

FOLD = {
    "case": _text, "model": _text, "optimizer": _text, "parameter": _text, "step": _whole, "value": _number,
    "low": _number, "high": _number, "reference": _number, "reference_low": _number, "reference_high": _number,
    "reference_x": _number, "reference_x_low": _number, "reference_x_high": _number, "sheet": _number,
    "length": _number, "x": _number, "z": _number, "slope": _number, "off": _number, "friction": _number,
    "slips": pa.bool_(), "profile": _number, "tracker_error": _number, "sigma": _number, "evaluations": _whole,
    "wall_s": _number, "key": _text,
}  # fmt: skip

TABLES = {"fold": FOLD}
