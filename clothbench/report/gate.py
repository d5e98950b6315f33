"""`clothbench compare`: is NEW worse than BASE, beyond what their noise allows?"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

from rich.markup import escape
from rich.table import Table

from clothbench.display.terminal import console
from clothbench.engine.judgement import IDENTITY, Row, identity, judge, named, spread
from clothbench.engine.store import finite

Rows = Sequence[dict[str, Any]]


def compare_rows(base: Rows, new: Rows) -> dict[str, Any]:
    """Verdict over the rows both have: {"passed", "compared", "worse", "better", "missing", "added"}.

    A row is worse if it lost its number, or if its error grew by more than 5 % of its value and a fifth of the joint
    half-width of both 95 % intervals, √(h_base² + h_new²). Where a row has a reference, its error is how far its value
    is from that; there a thousandth of the reference (of 1 in the row's unit, where it is 0) does not count. A row of
    BASE that NEW lacks is missing, and fails the gate as well: leaving out a test is no way to pass it. A cell that
    failed as a whole has lost each row that the other side has of it.
    """
    # Of several cells about the same (other budgets or options) the one that the other side has, too, counts.
    after = named(new, Counter({identity(r, "key") for r in base}))
    before = named(base, Counter({identity(r, "key") for r in new}))
    theirs = spread(after, before.items())
    verdict: dict[str, Any] = {"compared": 0, "worse": [], "better": [], "missing": []}
    for row in spread(before, after.items()).values():
        other = theirs.pop(identity(row), None)
        if other is None:
            verdict["missing"].append(_change(row, None))
            continue
        verdict["compared"] += 1
        if side := judge(row, other):
            verdict[side].append(_change(row, other))
    verdict["added"] = len(theirs)
    verdict["passed"] = not verdict["worse"] and not verdict["missing"] and verdict["compared"] > 0
    return verdict


def _change(base: Row, new: Row | None) -> dict[str, Any]:
    about = {name: base.get(name) for name in IDENTITY}
    return {
        **about,
        "unit": base.get("unit") or (new or {}).get("unit"),
        "base": finite(base["value"]),
        "new": finite(new["value"]) if new else None,
        "base_status": base["status"],
        "status": new["status"] if new else "missing",
        "reason": (new.get("reason") or "") if new else "no such row in NEW",
    }


COLUMNS = ("", "row", "base", "new", "reason")


def print_gate(verdict: dict[str, Any]) -> None:
    if changes := _changes(verdict):
        table = Table()
        for name in COLUMNS:
            table.add_column(name, overflow="fold")
        for change in changes:
            table.add_row(*map(escape, change))
        console().print(table)
    if not verdict["compared"]:
        print("no row is in both: nothing was compared")
    print(_conclusion(verdict))


def markdown(verdict: dict[str, Any], most: int = 100) -> str:
    """The same for a comment on a pull request: the conclusion, then at most so many rows, the worst first."""
    changes = _changes(verdict)
    lines = [f"**{_conclusion(verdict)}**"]
    if changes:
        lines += ["", f"| {' | '.join(COLUMNS)} |", "|---|---|---:|---:|---|"]
        lines += [f"| {' | '.join(map(_plain, change))} |" for change in changes[:most]]
    if len(changes) > most:
        lines += ["", f"and {len(changes) - most} more: `clothbench compare BASE NEW`"]
    return "\n".join(lines) + "\n"


def _plain(text: str) -> str:
    """Text for a cell of a Markdown table. It may come from anybody's plugin: no markup, no link, no mention in it."""
    shown = " ".join(text.split()).replace("`", "'").replace("|", "\\|")
    return f"`{shown}`" if shown else ""


def _changes(verdict: dict[str, Any]) -> list[tuple[str, ...]]:
    """What is missing, worse and better, by `COLUMNS`."""
    out: list[tuple[str, ...]] = []
    for side in ("missing", "worse", "better"):
        for r in verdict[side]:
            label = " · ".join(str(r[n]) for n in IDENTITY if r[n] not in (None, ""))
            base, new = (
                f"{r[n]:.4g} {r['unit'] or ''}" if r[n] is not None else r[status]
                for n, status in (("base", "base_status"), ("new", "status"))
            )
            out.append((side, label, base, new, r["reason"]))
    return out


def _conclusion(verdict: dict[str, Any]) -> str:
    word = "passed" if verdict["passed"] else "failed"
    return (
        f"gate {word}: {verdict['compared']} rows compared, {len(verdict['worse'])} worse, "
        f"{len(verdict['missing'])} missing, {len(verdict['better'])} better, {verdict['added']} only in NEW"
    )
