"""Folding paths as a table in the terminal: how far each fabric lands from where it should, by path and model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rich.markup import escape
from rich.table import Table

from clothbench.display.names import differing
from clothbench.engine.study import Results

Rows = Sequence[dict[str, Any]]


def show(results: Results) -> list[Any]:
    """One table per suite."""
    return [path_table(s, lines(results, s)) for s in sorted({r["suite"] for r in results.rows})]


def lines(results: Results, suite: str) -> list[dict[str, Any]]:
    """One record for each cell of a suite: what it was about, its values by metric, its status."""
    out: dict[str, dict[str, Any]] = {}
    mine = [r for r in results.rows if r["suite"] == suite]
    settings = differing(mine)
    for row in mine:
        fabric, _, way = row["case"].rpartition(", ")
        line = out.setdefault(row["key"], {
            "key": row["key"], "fabric": fabric, "way": way, "model": row["model"], "status": row["status"],
            "reason": row["reason"], "desk": None, "settings": settings[row["key"]],
        })  # fmt: skip
        line[row["metric"]] = row["value"]
        if row["metric"] == "friction":
            line["desk"], line["reason"] = row["reference"], row["reason"]
    return list(out.values())


def path_table(suite: str, found: Rows) -> Table:
    table = Table(title=f"{escape(suite)}: where the edge lands", title_justify="left", title_style="bold")
    about = told_by(found)
    for name in about:
        table.add_column(name, overflow="fold")
    for name in ("landing error", "slip", "friction needed"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("", overflow="fold")
    for line in found:
        cells = (*(line[n] for n in about.values()), *values(line), line["reason"] or "")
        table.add_row(*map(escape, cells))
    return table


def told_by(found: Rows) -> dict[str, str]:
    """Columns that say what a record is about, and by which name it has that: settings where they differ."""
    about = {"fabric": "fabric", "path": "way", "model": "model"}
    return about | ({"settings": "settings"} if any(x["settings"] for x in found) else {})


def values(line: dict[str, Any]) -> list[str]:
    """Landing error, slip and friction needed in words; the status where there are none."""
    if line["status"] != "ok":
        return [line["status"], "", ""]
    friction = line.get("friction")
    return [f"{line['landing_error']:.2f} mm", f"{line['slip']:.2f} mm", "" if friction is None else f"{friction:.2f}"]
