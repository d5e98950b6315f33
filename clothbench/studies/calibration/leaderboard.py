"""The page's table of all numbers of a suite, and the errors of single recordings behind it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from clothbench.display.html import group, pill, table, text
from clothbench.display.names import model_name
from clothbench.display.section import later
from clothbench.studies.calibration.estimates import contained
from clothbench.studies.calibration.words import size

Rows = Sequence[dict[str, Any]]
Column = tuple[str, Callable[[Any], str], bool]  # heading, HTML of a cell, whether it is a number
FEW = 5  # recordings below which a mean is said with its least and largest instead of an interval


def leaderboard(rows: Rows) -> str:
    """A line for each cell and metric, within a case from the lowest held-out error up; then single recordings."""
    lines = []
    for _, mine in sorted(group(rows, lambda r: (r["case"], r["metric"] or "")).items()):
        lines += sorted(group(mine, lambda r: r["key"]).values(), key=_rank)
    columns: list[Column] = [
        ("case", lambda c: text(c[0]["case"]), False),
        ("metric", lambda c: text(c[0]["metric"]), False),
        *(column for column in (*NAMES, SETTINGS) if _tells(rows, column)),
        ("fit", lambda c: _error(c, "fit"), True),
        ("fit, from … to", lambda c: spread(c, "fit"), True),
        ("held out", lambda c: _error(c, "held_out"), True),
        ("held out, from … to", lambda c: spread(c, "held_out"), True),
        ("floor", lambda c: floor(_shown(c)), True),
        ("unit", lambda c: text(c[0]["unit"]), False),
        ("evaluations", lambda c: text(c[0]["evaluations"]), True),
        ("search ended", lambda c: text(ended(c)), False),
        ("time [s]", lambda c: "" if c[0]["wall_s"] is None else f"{c[0]['wall_s']:.1f}", True),
        ("status", lambda c: _status(next((r for r in c if r["status"] != "ok"), c[0])), False),
        ("cell", lambda c: f"<code>{text(c[0]['key'][:8])}</code>", False),
    ]
    if all(r["status"] == "ok" for r in rows):
        columns = [c for c in columns if c[0] != "status"]
    if not any(map(ended, lines)):
        columns = [c for c in columns if c[0] != "search ended"]
    return later(_filled(columns, lines)) + single_recordings([r for r in rows if r["recording"]])


NAMES: tuple[Column, ...] = (
    ("model", lambda c: text(model_name(c[0])), False),
    ("optimizer", lambda c: text(c[0]["optimizer"]), False),
    ("fitted by", lambda c: text(c[0]["objective"]), False),
    ("seed", lambda c: text(c[0]["seed"]), True),
)


SETTINGS: Column = ("settings", lambda c: text(c[0].get("told") or ""), False)


def _tells(rows: Rows, column: Column) -> bool:
    """Whether a column says something: what is the same in every line is said once, above the table."""
    return len({column[1]([r]) for r in rows}) > 1


def same_in_all(rows: Rows) -> str:
    """What all cells have in common, in words."""
    said = {name: make([rows[0]]) for name, make, _ in NAMES if not _tells(rows, (name, make, False))}
    return ", ".join(f"{name} {value}" for name, value in said.items() if value)


def _filled(columns: Sequence[Column], lines: Sequence[Any]) -> str:
    body = [[make(line) for _, make, _ in columns] for line in lines]
    return table([head for head, _, _ in columns], body, {i for i, c in enumerate(columns) if c[2]})


def _rank(cell: Rows) -> tuple[bool, float, str]:
    """Sort key of one cell's rows: held-out error, else fit error, else last."""
    total = _shown(cell)
    value = None if total is None else total["value"]
    return value is None, value or 0.0, cell[0]["key"]


def _shown(cell: Rows) -> dict[str, Any] | None:
    """The mean by which a cell is judged: over what was held out, else over what was fitted."""
    totals = {r["split"]: r for r in cell if not r["recording"]}
    return totals.get("held_out", totals.get("fit"))


def _error(cell: Rows, split: str) -> str:
    total = next((r for r in cell if r["split"] == split and not r["recording"]), None)
    return "–" if total is None else size(total["value"])


def spread(cell: Rows, split: str) -> str:
    """How sure a mean is: its 95 % interval; of few recordings from where to where they go; of one its own."""
    single = [r for r in cell if r["split"] == split and r["recording"] and r["value"] is not None]
    if len(single) == 1:
        return interval(single[0])
    if 1 < len(single) < FEW:
        values = [r["value"] for r in single]
        return f'{size(min(values))} … {size(max(values))} <span class="soft">{len(values)} recordings</span>'
    return "".join(interval(r) for r in cell if r["split"] == split and not r["recording"])


def interval(row: dict[str, Any]) -> str:
    low, high = contained(row["value"], row["low"], row["high"])
    return "" if low is None or high is None else f"{size(low)} … {size(high)}"


def ended(cell: Rows) -> str:
    """Why the search of a cell ended that went well; "" where that is not known, as of what others handed in."""
    return next((r["reason"] for r in cell if r["status"] == "ok" and r["value"] is not None and r["reason"]), "")


def _status(row: dict[str, Any]) -> str:
    """Nothing where all went well."""
    return "" if row["status"] == "ok" else f"{pill(row)} {text(row['reason'])}"


def single_recordings(rows: Rows) -> str:
    """The errors that the means are made of, folded away."""
    if not rows:
        return ""
    columns: list[Column] = [
        ("case", lambda r: text(r["case"]), False),
        ("metric", lambda r: text(r["metric"]), False),
        *((head, _of_row(make), number) for head, make, number in NAMES if _tells(rows, (head, make, number))),
        ("recording", lambda r: text(r["recording"]), False),
        ("split", lambda r: text((r["split"] or "").replace("_", " ")), False),
        ("error", lambda r: size(r["value"]), True),
        ("95 % interval", interval, True),
        ("floor", floor, True),
        ("unit", lambda r: text(r["unit"]), False),
        ("status", _status, False),
    ]
    if all(r["status"] == "ok" for r in rows):
        columns = columns[:-1]
    summary = f"{len(rows)} errors of single recordings"
    return f"<details><summary>{summary}</summary>{later(_filled(columns, rows))}</details>"


def _of_row(make: Callable[[Any], str]) -> Callable[[Any], str]:
    return lambda row: make([row])


def floor(row: dict[str, Any] | None) -> str:
    return size(row["floor"]) if row is not None and row["floor"] is not None else ""
