"""Columns of the tables that `clothbench improve` writes; errors are rms over coordinates, in `unit`."""

from __future__ import annotations

import pyarrow as pa

_text, _number, _whole, _flag = pa.string(), pa.float64(), pa.int64(), pa.bool_()

# Every candidate of every round. share: of the residual only it could explain; gain: in `unit` (mm², of
# curves N²), by which the mean square fell when all was refitted (null where it was not); selected: rounds with one
# recording left out, of `of`.
CANDIDATE = {
    "round": _whole, "name": _text, "place": _text, "summary": _text, "share": _number, "p_value": _number,
    "gain": _number, "unit": _text, "selected": _whole, "of": _whole, "why_not": _text, "named": _flag,
}  # fmt: skip
# fit: "before" (the calibrated model) or "after" (with what was named).
PARAMETER = {
    "fit": _text, "name": _text, "symbol": _text, "unit": _text, "value": _number, "low": _number, "high": _number,
    "at_bound": _flag, "meaning": _text,
}  # fmt: skip
ERROR = {
    "recording": _text, "split": _text, "unit": _text, "before": _number, "after": _number, "floor": _number,
}  # fmt: skip
# next_frame: correlation of the residual in one frame with the next, 0 for noise.
PORTRAIT = {
    "recording": _text, "split": _text, "fit": _text, "rms": _number, "normal": _number, "warp": _number,
    "weft": _number, "next_frame": _number, "unit": _text,
}  # fmt: skip
# against: speed, acceleration or height, between `low` and `high` of `against_unit`.
BIN = {
    "recording": _text, "split": _text, "against": _text, "against_unit": _text, "low": _number, "high": _number,
    "coordinates": _whole, "before": _number, "after": _number, "unit": _text,
}  # fmt: skip
FRAME = {
    "recording": _text, "split": _text, "time": _number, "coordinates": _whole, "before": _number, "after": _number,
    "unit": _text,
}  # fmt: skip
# u, v: m, material coordinates.
NODE = {
    "recording": _text, "split": _text, "u": _number, "v": _number, "coordinates": _whole, "before": _number,
    "after": _number, "unit": _text,
}  # fmt: skip
# Of force-extension curves: force N at each stretch as measured, and of the model before and after.
CURVE = {
    "recording": _text, "split": _text, "stretch": _number, "force": _number, "before": _number, "after": _number,
    "unit": _text,
}  # fmt: skip
# Of drapes: each quantity of each specimen in `unit`, as measured and of the model; spread: between specimens.
DRAPE = {
    "recording": _text, "split": _text, "side": _text, "quantity": _text, "measured": _number, "spread": _number,
    "before": _number, "after": _number, "unit": _text,
}  # fmt: skip
# How much captures of drapes look like each other: mean correlation of their outlines, and by chance as much.
CAPTURES = {"pairs": _text, "number": _whole, "correlation": _number, "p_value": _number}
# What drapes say without any model: means over specimens of what symmetry forbids, with their 95 % intervals.
ASYMMETRY = {
    "split": _text, "contrast": _text, "mean": _number, "low": _number, "high": _number, "unit": _text,
    "p_value": _number, "number": _whole,
}  # fmt: skip
STAGE = {"stage": _text, "wall_s": _number, "evaluations": _whole}
# value: fitted to this recording alone; joint, low, high: fitted to all together, with its 95 % interval; outside:
# whether it stands out of the spread of those fitted alone whose searches moved.
DRIFT = {
    "recording": _text, "name": _text, "symbol": _text, "unit": _text, "scale": _text, "value": _number,
    "at_bound": _flag, "joint": _number, "low": _number, "high": _number, "outside": _flag,
}  # fmt: skip

# Where and when more is left than elsewhere. kind: "where" or "when"; ratio: of the rms there to that of all.
WHEREABOUTS = {
    "kind": _text, "part": _text, "rms": _number, "unit": _text, "ratio": _number, "p_value": _number,
}  # fmt: skip
# The kernel over lag of the force that is missing, told without a model: kg/(m²·s) with the spread between
# recordings (low, high).
KERNEL = {"lag": _number, "value": _number, "low": _number, "high": _number}

IMPROVE_TABLES = {
    "candidates": CANDIDATE, "parameters": PARAMETER, "errors": ERROR, "portrait": PORTRAIT, "against": BIN,
    "frames": FRAME, "nodes": NODE, "curves": CURVE, "drapes": DRAPE, "captures": CAPTURES, "asymmetries": ASYMMETRY,
    "stages": STAGE, "drift": DRIFT, "whereabouts": WHEREABOUTS, "kernel": KERNEL,
}  # fmt: skip
