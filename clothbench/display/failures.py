"""Cells that did not end well, whatever they were of."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

from clothbench.display.names import model_name

Rows = Sequence[dict[str, Any]]
BADNESS = {"skipped": 0, "timeout": 1, "diverged": 2}  # an error, or a word that is not known, is worse than all


def failures(rows: Rows) -> list[dict[str, Any]]:
    """One row for each cell that did not end well: the first of its worst status, which no lesser one may hide."""
    seen: dict[str, dict[str, Any]] = {}
    for row in rows:
        if row["status"] != "ok":
            known = seen.get(row["key"], row)
            seen[row["key"]] = max(known, row, key=lambda r: BADNESS.get(r["status"], 3))
    return list(seen.values())


def places(rows: Rows) -> list[str]:
    """What to call each of the rows of `failures`, "linen · mass_spring · ga · node_error · linen-1": with seed, budget
    and settings where cells would else be called the same.
    """
    called = [_place(row) for row in rows]
    times = Counter(called)
    return [
        name if times[name] == 1 else " · ".join([name, *_marks(row)]) for name, row in zip(called, rows, strict=True)
    ]


def _place(row: dict[str, Any]) -> str:
    model = model_name(row) if row["model"] else None
    parts = (row["case"], model, row["optimizer"], row["metric"], row["recording"])
    return " · ".join(p for p in parts if p)


def _marks(row: dict[str, Any]) -> list[str]:
    return [f"{name} {row[name]}" for name in ("seed", "budget", "settings") if row.get(name) is not None]
