"""Whether one row is worse than another of the same question, or better, beyond what their noise allows."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeVar

from clothbench.core.statistics import uncut_half

Row = Mapping[str, Any]
AnyRow = TypeVar("AnyRow", bound=Row)
Key = tuple[Any, ...]
# What a row is about, whenever and wherever it was computed.
IDENTITY = ("suite", "case", "recording", "split", "model", "effects", "optimizer", "metric", "seed")
# Share of a value that is never a change: another processor or library rounds otherwise, folding cloth amplifies that,
# and a search then ends a little elsewhere. An interval over frames knows nothing of it.
SLACK = 0.05
# Share of their joint interval that two runs of one question may differ by, beyond the slack: an interval says what
# other frames would say, and the two share theirs, and the seed. Between two machines the 240 errors of the gate differ
# by 0.36 of it at most, slack included; with another seed, one of ten differs by more than all of it.
RERUN = 0.2
SMALL = 1e-3  # share of a reference below which a distance from it does not count


def identity(row: Row) -> Key:
    return tuple(row.get(name) or None for name in IDENTITY)


def of_cells(rows: Iterable[Row]) -> dict[Any, frozenset[Key]]:
    """What the rows of each cell are about, by its key: the same, whatever the key, where it is of the same recordings.
    Rows without a key are of one cell.
    """
    out: dict[Any, set[Key]] = {}
    for row in rows:
        out.setdefault(row.get("key"), set()).add(identity(row))
    return {key: frozenset(about) for key, about in out.items()}


def cells_in(rows: Iterable[Row]) -> set[tuple[Any, ...]]:
    """What `named` counts of each row: what it is about, with the key of its cell, and with what the cell is about."""
    about = of_cells(rows := list(rows))
    return {(identity(row), found) for row in rows for found in (row.get("key"), about[row.get("key")])}


def named(rows: Sequence[AnyRow], elsewhere: Counter[tuple[Any, ...]]) -> dict[Key, AnyRow]:
    """Rows by what they are about. Of several (cells of other recordings, budgets or options) the one counts whose cell
    is found `elsewhere` most often (by its key, or where that is of another version by what it is about), so that
    results are compared with those of the same cell.
    """
    about, out = of_cells(rows), dict[Key, AnyRow]()

    def found(row: Row) -> tuple[int, int, list[str]]:  # the last decides where all are found as often
        mine = about[row.get("key")]
        return elsewhere[identity(row), row.get("key")], elsewhere[identity(row), mine], sorted(map(repr, mine))

    for row in rows:
        kept = out.get(identity(row))
        if kept is None or found(row) >= found(kept):
            out[identity(row)] = row
    return out


def spread(rows: Mapping[Key, Row], known: Iterable[tuple[Key, Row]]) -> dict[Key, Row]:
    """Rows by what they are about, where a cell that failed as a whole has a row at each of the `known` rows of it.

    Such a cell has one row for all, without recording and split, and with the one metric that it was to be fitted to:
    by its identity alone it would be of another question than every number that the cell has elsewhere. Those of its
    key are meant, whatever their metric; where the key is another (another version, say), those of its metric. Where
    none is known the one row stays.
    """
    of_cell: dict[Any, list[Key]] = {}
    for key, row in known:
        if not failed_whole(row):
            for cell in (row.get("key"), _cell(key)):
                of_cell.setdefault(cell, []).append(key)
    out: dict[Key, Row] = {}
    failures = {key: row for key, row in rows.items() if failed_whole(row)}
    out.update((key, row) for key, row in rows.items() if key not in failures)
    for key, row in failures.items():
        of_key = of_cell.get(row["key"]) if row.get("key") else None
        for place in of_key or of_cell.get(_cell(key), [key]):
            about = dict(zip(IDENTITY, place, strict=True))
            out.setdefault(place, {**row, **{name: about[name] for name in ("recording", "split", "metric")}})
    return out


def failed_whole(row: Row) -> bool:
    """Whether a row stands for all of a cell that has no number."""
    return not has_number(row) and not row.get("recording") and not row.get("split")


def _cell(key: Key) -> Key:
    """What a cell is about, by the identity of one of its rows."""
    return tuple(value for name, value in zip(IDENTITY, key, strict=True) if name not in ("recording", "split"))


def judge(base: Row, new: Row) -> str | None:
    """ "worse", "better", or None where the change is within the noise.

    A new interval counts as no wider than the old one: what errs more has a wider one, and would excuse itself by it.
    """
    had, has = has_number(base), has_number(new)
    if not (had and has):
        return "worse" if had and not has else "better" if has and not had else None
    if other_unit(base, new):
        return "worse"
    before, after = error(base), error(new)
    allowed = RERUN * math.hypot(half(base), min(half(base), half(new))) + slack(base)
    change = after - before
    return "worse" if change > allowed else "better" if change < -allowed else None


def other_unit(base: Row, new: Row) -> str:
    """How the new row's unit differs from the old one's; "" where it does not, or where one states none."""
    had, has = base.get("unit"), new.get("unit")
    return f"found a number in {has}, expected {had} as in BASE" if had and has and had != has else ""


def has_number(row: Row) -> bool:
    return isinstance(row["value"], int | float) and math.isfinite(row["value"])


def error(row: Row) -> float:
    """What is better the lower it is: the value, or its distance from the reference where there is one."""
    reference = row.get("reference")
    return row["value"] if reference is None else abs(row["value"] - reference)


def half(row: Row) -> float:
    """Half the width of a row's interval, of the side that is not cut at 0; 0 where it has none."""
    if row.get("low") is None or row.get("high") is None:
        return 0.0
    return uncut_half(row["value"], row["low"], row["high"])


def slack(row: Row) -> float:
    """What the error of a row may differ by and be the same, in the row's unit."""
    return SLACK * abs(error(row)) + slack_at(row.get("reference"))


def slack_at(reference: float | None) -> float:
    """What a distance from a reference may differ by whatever it is; 0 where there is none."""
    return 0.0 if reference is None else SMALL * (abs(reference) or 1.0)
