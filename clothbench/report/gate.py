"""`clothbench compare`: is NEW worse than BASE, beyond what their noise allows?"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from rich.markup import escape
from rich.table import Table

from clothbench.display.terminal import console
from clothbench.engine.judgement import IDENTITY, Key, Row, has_number, identity, judge, other_unit, spread
from clothbench.engine.tables import finite

Rows = Sequence[dict[str, Any]]


def compare_rows(base: Rows, new: Rows) -> dict[str, Any]:
    """Verdict over the rows both have: {"passed", "compared", "worse", "better", "missing", "added"}.

    A row is worse if it lost its number, if its unit is another, or if its error grew by more than 5 % of its value and
    a fifth of the joint half-width of both 95 % intervals, √(h_base² + h_new²), h_new ≤ h_base. Where a row has a
    reference, its error is how far its value is from that; there a thousandth of the reference (of 1 in the row's unit,
    where it is 0) does not count. A row of BASE that NEW lacks is missing, and fails the gate as well: leaving out a
    test is no way to pass it. A cell that failed as a whole has lost each row that the other side has of it. What has
    no number on either side counts as not compared; where nothing is compared, the gate fails.
    """
    verdict: dict[str, Any] = {"compared": 0, "worse": [], "better": [], "missing": [], "added": 0}
    for mine, theirs in _pairs(base, new):
        _compare_cells(mine, theirs, verdict)
    verdict["passed"] = not verdict["worse"] and not verdict["missing"] and verdict["compared"] > 0
    return verdict


def _pairs(base: Rows, new: Rows) -> Iterator[tuple[Rows, Rows]]:
    """The rows of each cell of BASE beside those of the same cell of NEW, and last all others.

    The same is what has the same key; else, since a plugin of another version changes that, the only cell on either
    side with rows about the same, or of several such (of other budgets) the only one with as many evaluations.
    """
    before, after = _by_cell(base), _by_cell(new)
    for names in _key, _about, _effort:
        old, young = _alike(before, names), _alike(after, names)
        for same, keys in old.items():
            if len(keys) == len(young.get(same, ())) == 1:
                yield before.pop(keys[0]), after.pop(young[same][0])
    yield [row for rows in before.values() for row in rows], [row for rows in after.values() for row in rows]


def _by_cell(rows: Rows) -> dict[Any, Rows]:
    """Rows by the key of their cell; those without one are of one."""
    out: dict[Any, list[dict[str, Any]]] = {}
    for row in rows:
        out.setdefault(row.get("key"), []).append(row)
    return {**out}


def _alike(cells: Mapping[Any, Rows], names: Callable[[Rows], Any]) -> dict[Any, list[Any]]:
    """Keys of cells by what they are told by."""
    out: dict[Any, list[Any]] = {}
    for key, rows in cells.items():
        out.setdefault(names(rows), []).append(key)
    return out


def _key(rows: Rows) -> Any:
    return rows[0].get("key")


def _about(rows: Rows) -> frozenset[Key]:
    return frozenset(map(identity, rows))


def _effort(rows: Rows) -> tuple[frozenset[Key], Any]:
    return _about(rows), rows[0].get("evaluations")


def _compare_cells(base: Rows, new: Rows, verdict: dict[str, Any]) -> None:
    """Add to the verdict what comes of rows of BASE and those of NEW that may be about the same."""
    counts = [Counter(map(identity, rows)) for rows in (base, new)]
    before, after = dict[Key, Row](), dict[Key, Row]()
    for found, rows in ((before, base), (after, new)):
        for one in rows:
            found.setdefault(identity(one), one)
    for about, times in counts[0].items():
        if times == 1 and counts[1][about] <= 1:
            continue
        why = f"several cells are about this ({times} of BASE, {counts[1][about]} of NEW), none with one key"
        verdict["missing"].append(_change(before.pop(about), None, why if after.pop(about, None) else MISSING))
    theirs = spread(after, before.items())
    for row in spread(before, after.items()).values():
        other = theirs.pop(identity(row), None)
        if other is None:
            verdict["missing"].append(_change(row, None, MISSING))
            continue
        verdict["compared"] += has_number(row) or has_number(other)
        if side := judge(row, other):
            own = "" if other["status"] == "ok" else other.get("reason")  # how a search ended well is no reason
            verdict[side].append(_change(row, other, other_unit(row, other) or own or ""))
    verdict["added"] += len(theirs)


MISSING = "no such row in NEW"


def _change(base: Row, new: Row | None, reason: str) -> dict[str, Any]:
    about = {name: base.get(name) for name in IDENTITY}
    return {
        **about,
        "unit": base.get("unit") or (new or {}).get("unit"),
        "new_unit": (new or {}).get("unit") or base.get("unit"),
        "base": finite(base["value"]),
        "new": finite(new["value"]) if new else None,
        "base_status": base["status"],
        "status": new["status"] if new else "missing",
        "reason": reason,
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
        print("no row is in both and has a number: nothing was compared")
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
                f"{r[n]:.4g} {r[unit] or ''}" if r[n] is not None else r[status]
                for n, unit, status in (("base", "unit", "base_status"), ("new", "new_unit", "status"))
            )
            out.append((side, label, base, new, r["reason"]))
    return out


def _conclusion(verdict: dict[str, Any]) -> str:
    word = "passed" if verdict["passed"] else "failed"
    return (
        f"gate {word}: {verdict['compared']} rows compared, {len(verdict['worse'])} worse, "
        f"{len(verdict['missing'])} missing, {len(verdict['better'])} better, {verdict['added']} only in NEW"
    )
