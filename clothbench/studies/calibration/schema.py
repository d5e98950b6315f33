"""Columns of the tables of a calibration beside its rows. Errors are in the row's `unit`, `key` is the cell's."""

from __future__ import annotations

import pyarrow as pa

_text, _number, _whole = pa.string(), pa.float64(), pa.int64()

# Best values with intervals. start: where the search set out from; truth: what stand-in recordings state; lower, upper:
# the range that was searched, on a "linear" or "log" scale; condition: of the fit, the same in each of its rows, null
# where the metric has no residuals.
PARAMETER = {
    "name": _text, "symbol": _text, "unit": _text, "value": _number, "low": _number, "high": _number,
    "at_bound": pa.bool_(), "start": _number, "truth": _number, "lower": _number,
    "upper": _number, "scale": _text, "meaning": _text, "condition": _number, "key": _text,
}  # fmt: skip
# The cell itself as JSON: with it a twin of its fit is made (`clothbench export`).
QUESTION = {"question": _text, "key": _text}
# The error of every evaluation; with objectives and parameters in columns of their own names beside it.
HISTORY = {"value": _number}
# Error of every recording, frame by frame.
TRACE = {"recording": _text, "split": _text, "metric": _text, "time": _number, "value": _number, "unit": _text}
FILMS = "films"  # folder of a cell with films: recordings beside what was made of them
FRAMES = "frames"  # folder of a cell with frames of a video, tracked and fitted
DRAPES = "drapes"  # folder of a cell with outlines of drapes, captured and simulated
PICTURES = "tracker"  # folder of a cell with what its tracker made of one frame
LEAST_BLOCKS = 4  # samples of an analysis `sobol` below which nothing is said of the variance
# What a paper says of a metric; `unit`: of that figure, which need not be the run's.
PUBLISHED = {"metric": _text, "name": _text, "value": _number, "unit": _text, "key": _text}
# Error of each fitted recording where the search set out from, and at its result.
START = {
    "case": _text, "recording": _text, "metric": _text, "unit": _text, "start": _number, "value": _number, "key": _text,
}  # fmt: skip
# percent: the change of the parameter that changes the error by 1 % (infinite where no change does).
VARIABILITY = {
    "case": _text, "name": _text, "symbol": _text, "unit": _text, "value": _number, "percent": _number,
    "slope": _number, "curvature": _number, "reason": _text, "key": _text,
}  # fmt: skip
# One row for each perturbation behind it. change: of the parameter, relative; error: in `unit`.
PERTURBATION = {"case": _text, "name": _text, "change": _number, "error": _number, "unit": _text, "key": _text}
# repeat 0 is the fit itself. start, value: of the parameter, in `unit`; error_*: in `error_unit`.
REPEAT = {
    "case": _text, "repeat": _whole, "name": _text, "symbol": _text, "unit": _text, "start": _number, "value": _number,
    "error_start": _number, "error": _number, "error_unit": _text, "reason": _text, "key": _text,
}  # fmt: skip
# morris: main = μ*, total = σ of the elementary effects, in the error's unit over the whole scaled range;
# sobol: main = S1, total = ST, shares of the error's variance. half: of the 95 % intervals.
SENSITIVITY = {
    "case": _text, "method": _text, "name": _text, "symbol": _text, "unit": _text, "main": _number,
    "main_half": _number, "total": _number, "total_half": _number, "evaluations": _whole, "lost": _whole,
    "reason": _text, "key": _text,
}  # fmt: skip
MAP = {
    "case": _text, "x_name": _text, "x_unit": _text, "y_name": _text, "y_unit": _text, "x": _number, "y": _number,
    "error": _number, "unit": _text, "reason": _text, "key": _text,
}  # fmt: skip
# What the parameters of `case` make of `recording`, of whatever fabric.
CONFUSION = {
    "case": _text, "fabric": _text, "recording": _text, "recorded_fabric": _text, "trial": _text, "value": _number,
    "metric": _text, "unit": _text, "reason": _text, "key": _text,
}  # fmt: skip
# Objectives of each evaluation that no other beats in all: distance in `unit`, and in spreads between recordings of the
# same cloth; chosen: the one that is the fit.
FRONT = {
    "evaluation": _whole, "value": _number, "chosen": pa.bool_(), "objective": _text, "unit": _text,
    "distance": _number, "spreads": _number, "key": _text,
}  # fmt: skip
ANALYSIS_TABLES = {
    "starts": START, "variability": VARIABILITY, "perturbations": PERTURBATION, "repeats": REPEAT,
    "sensitivity": SENSITIVITY, "map": MAP, "confusion": CONFUSION,
}  # fmt: skip
TABLES = {
    "parameters": PARAMETER,
    "question": QUESTION,
    "trace": TRACE,
    "published": PUBLISHED,
    "front": FRONT,
    **ANALYSIS_TABLES,
}
