"""What the terminal and `--json` show of a history."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from rich.markup import escape
from rich.table import Table

from clothbench.display.terminal import console
from clothbench.engine.tables import finite
from clothbench.history.entries import Entry
from clothbench.history.series import Change, Series

MOST = 60  # lines of a table in the terminal


def document(entries: Sequence[Entry], series: Sequence[Series]) -> dict[str, Any]:
    """{"entries": […], "series": […]}: of each series its points and changes, by the number of the entry."""
    about = [{"commit": e.commit, "date": e.date, "subject": e.subject, "machine": e.machine} for e in entries]
    return {"entries": about, "series": [_of_series(one) for one in series]}


def _of_series(one: Series) -> dict[str, Any]:
    out = {key: asdict(one)[key] for key in ("kind", "about", "unit", "reference", "noise", "points")}
    changes = [{**asdict(c), "half": None if c.half is None else finite(c.half)} for c in one.changes]
    return {**out, "changes": changes}


def print_history(entries: Sequence[Entry], series: Sequence[Series]) -> None:
    """The changes, the newest first, then where every series stands."""
    out = console()
    changes = changes_of(series)
    if changes:
        table = Table(title="what changed, beyond the noise", title_justify="left")
        for name in ("commit", "date", "", "series", "before", "after", "change"):
            table.add_column(
                name, overflow="fold", justify="right" if name in ("before", "after", "change") else "left"
            )
        for one, change in changes[:MOST]:
            entry = entries[change.entry]
            colour = "red" if change.verdict == "worse" else "green"
            table.add_row(
                entry.short, entry.date[:10], f"[{colour}]{change.verdict}[/]", escape(one.label),
                value(change.before, one.unit), value(change.after, one.unit) or escape(change.reason), share(change),
            )  # fmt: skip
        out.print(table)
        if len(changes) > MOST:
            print(f"and {len(changes) - MOST} more: --json, or the page (--page FILE)")
    out.print(_standing(series))
    if len(series) > MOST:
        print(f"and {len(series) - MOST} more: --json, or the page (--page FILE)")
    print(conclusion(entries, series))


def _standing(series: Sequence[Series]) -> Table:
    table = Table(title="where every series stands", title_justify="left")
    for name in ("", "series", "commits", "first", "last", "95 % interval", "changes"):
        table.add_column(name, overflow="fold", justify="left" if name in ("", "series") else "right")
    for one in series[:MOST]:
        first, last = one.points[0], one.points[-1]
        table.add_row(
            one.kind, escape(one.label), str(len(one.points)), value(first.value, one.unit),
            value(last.value, one.unit) or escape(last.reason), interval(one), str(len(one.changes) or ""),
        )  # fmt: skip
    return table


def changes_of(series: Sequence[Series]) -> list[tuple[Series, Change]]:
    """All changes of all series, the newest first; of one entry what got worse before what got better."""
    found = [(one, change) for one in series for change in one.changes]
    return sorted(found, key=lambda pair: (-pair[1].entry, pair[1].verdict != "worse"))


def conclusion(entries: Sequence[Entry], series: Sequence[Series]) -> str:
    """How many changes there are in how much, and what cannot be told."""
    changes = [change for _, change in changes_of(series)]
    worse = sum(change.verdict == "worse" for change in changes)
    errors, speeds = (sum(one.kind == kind for one in series) for kind in ("error", "speed"))
    said = (
        f"{len({e.commit for e in entries})} commits, {errors} series of errors, {speeds} of speed: "
        f"{worse} changes for the worse, {len(changes) - worse} for the better"
    )
    unknown = sum(entry.machine is None for entry in entries)
    return f"{said}; {unknown} entries state no machine: no speeds of theirs" if unknown else said


def value(number: float | None, unit: str) -> str:
    return "" if number is None else f"{number:.4g} {unit}".strip()


def interval(one: Series) -> str:
    """Of the last point."""
    last = one.points[-1]
    if last.value is None or last.half is None:
        return ""
    return f"± {last.half:.2g}"


def share(change: Change) -> str:
    return "" if change.percent is None else f"{change.percent:+.1f} %"
