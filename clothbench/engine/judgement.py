"""Whether one row is worse than another of the same question, or better, beyond what their noise allows."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

Row = Mapping[str, Any]
AnyRow = TypeVar("AnyRow", bound=Row)
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


def identity(row: Row, *more: str) -> tuple[Any, ...]:
    return tuple(row.get(name) or None for name in (*IDENTITY, *more))


def named(rows: Sequence[AnyRow], elsewhere: Counter[tuple[Any, ...]]) -> dict[tuple[Any, ...], AnyRow]:
    """Rows by what they are about. Of several (cells with other budgets or options) the one counts whose identity and
    cell key are found `elsewhere` most often, so that results are compared with those of the same cell.
    """
    out: dict[tuple[Any, ...], AnyRow] = {}
    for row in rows:
        kept = out.get(identity(row))
        if kept is None or elsewhere[identity(row, "key")] >= elsewhere[identity(kept, "key")]:
            out[identity(row)] = row
    return out


def judge(base: Row, new: Row) -> str | None:
    """ "worse", "better", or None where the change is within the noise."""
    had, has = has_number(base), has_number(new)
    if not (had and has):
        return "worse" if had and not has else "better" if has and not had else None
    before, after = error(base), error(new)
    allowed = RERUN * math.hypot(half(base), half(new)) + slack(base)
    change = after - before
    return "worse" if change > allowed else "better" if change < -allowed else None


def has_number(row: Row) -> bool:
    return isinstance(row["value"], int | float) and math.isfinite(row["value"])


def error(row: Row) -> float:
    """What is better the lower it is: the value, or its distance from the reference where there is one."""
    reference = row.get("reference")
    return row["value"] if reference is None else abs(row["value"] - reference)


def half(row: Row) -> float:
    """Half the width of a row's interval; 0 where it has none."""
    if row.get("low") is None or row.get("high") is None:
        return 0.0
    return (row["high"] - row["low"]) / 2


def slack(row: Row) -> float:
    """What the error of a row may differ by and be the same, in the row's unit."""
    return SLACK * abs(error(row)) + slack_at(row.get("reference"))


def slack_at(reference: float | None) -> float:
    """What a distance from a reference may differ by whatever it is; 0 where there is none."""
    return 0.0 if reference is None else SMALL * (abs(reference) or 1.0)
