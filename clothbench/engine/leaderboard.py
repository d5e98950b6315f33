"""Rows of the leaderboard: their columns and order, how they are printed, and how they are read from a file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pyarrow as pa

from clothbench.core.errors import ClothbenchError
from clothbench.core.files import parsed_json
from clothbench.engine.tables import as_declared, finite

_text, _number, _whole = pa.string(), pa.float64(), pa.int64()

LISTED = "rows as `clothbench leaderboard --json` prints them"
ANEW = "write the file anew with clothbench leaderboard --json"
# The rows of `leaderboard --json`, in this order; what does not apply is null.
ROW = {
    "suite": _text, "case": _text, "recording": _text, "split": _text, "model": _text, "effects": _text,
    "optimizer": _text, "metric": _text, "value": _number, "unit": _text, "low": _number, "high": _number,
    "floor": _number, "reference": _number, "status": _text, "reason": _text, "evaluations": _whole,
    "wall_s": _number, "seed": _whole, "key": _text,
}  # fmt: skip
# What else a row carries: the study that it is of (null in rows of earlier versions), the metric that was minimised,
# how long a search was allowed, what all other settings were (a hash, the same for all cases of one run), and the
# system it was computed on.
SYSTEM = {
    "study": _text,
    "objective": _text, "budget": _whole, "settings": _text, "clothbench": _text, "plugins": _text,
    "python": _text, "numpy": _text, "numba": _text, "platform": _text,
    "cpu": _text, "cores": _whole, "threads": _whole, "finished": _text,
}  # fmt: skip
ROWS = {**ROW, **SYSTEM}
ABOUT = ("suite", "case", "model")
# What a cell asks beside its cases and recordings, as its rows have it.
QUESTION = ("study", "suite", "model", "effects", "optimizer", "objective", "budget", "settings", "seed")
NUMBERS = tuple(name for name, of in ROW.items() if of is _number)
BEYOND = 1e100  # in any unit; sums of squares of less are numbers still
FINISHED = ("ok", "diverged", "timeout", "skipped")  # an error is tried again, these are not


def finished(rows: Sequence[Mapping[str, Any]]) -> bool:
    """Whether these are the rows of a finished cell."""
    return len(rows) > 0 and all(row["status"] in FINISHED for row in rows)


def row_order(row: dict[str, Any]) -> tuple[Any, ...]:
    """Sort key: suite, case, model …; within a cell the fit before the held-out split, totals after recordings. Cells
    that are called the same come by their seed, then by their key.
    """
    names = ("suite", "case", "model", "effects", "optimizer", "metric", "split")
    place = (*(row[n] or "" for n in names), "0" if row["recording"] else "1", row["recording"] or "")
    return (*place, -1 if row["seed"] is None else row["seed"], row["key"] or "")


def leaderboard_row(row: dict[str, Any]) -> dict[str, Any]:
    """A row as `leaderboard --json` prints it: its keys only, null for what is no finite number."""
    values = ((name, row.get(name)) for name in ROW)
    return {name: finite(value) if isinstance(value, float) else value for name, value in values}


def rows_in(text: str, where: object) -> list[dict[str, Any]]:
    """Rows in the text of a file that `leaderboard --json` wrote; where: what a fault calls it."""
    return require_rows(parsed_json(text, str(where), LISTED), where)


def require_rows(rows: Any, where: object) -> list[dict[str, Any]]:
    """Rows with all columns of a leaderboard; what is no list of them is refused."""
    if not isinstance(rows, list) or not all(
        isinstance(r, dict) and {"suite", "status", "value"} <= set(r) for r in rows
    ):
        raise ClothbenchError(f"{where}: found something else than a list of rows, expected {LISTED}")
    try:
        table = pa.Table.from_pylist(
            [{name: row.get(name) for name in ROW} for row in rows], pa.schema(list(ROW.items()))
        )
    except (pa.ArrowException, TypeError, ValueError, OverflowError) as fault:
        said = (str(fault).splitlines() or [type(fault).__name__])[0]
        raise ClothbenchError(f"{where}: found a value of another type ({said}), expected {LISTED}") from None
    return as_declared(table, ROW, ("status",), str(where), ANEW).to_pylist()
