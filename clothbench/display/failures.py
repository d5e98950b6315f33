"""Cells that did not end well, whatever they were of."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rich.markup import escape

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


def failure_line(row: dict[str, Any]) -> str:
    """A cell that failed, and why, for the terminal."""
    return f"[red]{row['status']}[/]: {escape(_label(row))}: {escape(row['reason'] or '')}"


def _label(row: dict[str, Any]) -> str:
    model = model_name(row) if row["model"] else None
    parts = (row["case"], model, row["optimizer"], row["metric"], row["recording"])
    return " · ".join(p for p in parts if p)
