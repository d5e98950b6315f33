"""Folds as a table in the terminal: each fabric's estimate, step by step, beside what it is known by."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from rich.markup import escape
from rich.table import Table

from clothbench.display.names import differing
from clothbench.engine.study import Results

Rows = Sequence[dict[str, Any]]
# What cells of one fabric may differ in: the column of a row, and how it is said.
TOLD = {
    "model": ("model", "{}"), "optimizer": ("optimizer", "{}"), "metric": ("objective", "on {}"),
    "effects": ("effects", "with {}"), "seed": ("seed", "seed {}"), "settings": ("settings", "{}"),
}  # fmt: skip


def show(results: Results) -> list[Any]:
    """One table per suite, and what its folds say together."""
    out: list[Any] = []
    steps = results.table("fold")
    for suite in sorted({r["suite"] for r in results.rows}):
        mine = [r for r in results.rows if r["suite"] == suite]
        keys = {r["key"] for r in mine}
        lifted = [s for s in steps if s["key"] in keys]
        out += [fold_table(suite, mine, lifted), *([summary(lifted, mine)] if lifted else [])]
    return out


def told_by(rows: Rows) -> dict[str, str]:
    """Columns that say what a cell is beside its fabric, and by which name rows have that: those in which they differ
    (`with_settings`).
    """
    return {word: name for word, (name, _) in TOLD.items() if len({str(r.get(name)) for r in rows}) > 1}


def with_settings(rows: Rows) -> list[dict[str, Any]]:
    """The rows, of whose settings only those are left in which they differ."""
    told = differing(rows)
    return [{**r, "settings": told[r["key"]]} for r in rows]


def called(rows: Rows) -> dict[str, str]:
    """What to call each cell, by its key: its fabric, and what tells it from the others: "denim · ga · seed 1"."""
    rows = with_settings(rows)
    words = [TOLD[word] for word in told_by(rows)]
    return {
        r["key"]: " · ".join(
            [r["case"], *(said.format(r[name]) for name, said in words if r.get(name) not in (None, ""))]
        )
        for r in rows
    }


def fold_table(suite: str, rows: Rows, steps: Rows) -> Table:
    """One line per cell, by what tells it from others: reference with its ±2σ, the estimate of every step, the last
    one's interval, friction.
    """
    table = Table(title=f"{escape(suite)}: estimate at every step", title_justify="left", title_style="bold")
    table.add_column("fabric", overflow="fold")
    for name in ("reference", "± 2σ"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("steps", overflow="fold")
    table.add_column("last", justify="right", no_wrap=True)
    table.add_column("friction", justify="right", no_wrap=True)
    for key, name in called(rows).items():
        mine = [s for s in steps if s["key"] == key]
        row = next(r for r in rows if r["key"] == key)
        table.add_row(*(escape(t) for t in (name, *(_line(row, mine) if mine else _failed(row)))))
    return table


def _line(row: dict[str, Any], steps: Rows) -> list[str]:
    first, last = steps[0], steps[-1]
    between = f"{first['reference_low']:.2g} … {first['reference_high']:.2g}"
    told = " ".join(f"{s['value']:.2g}" for s in steps)
    late = f" {row['status']}" if row["status"] != "ok" else ""
    mark = late or ("" if inside(last) else " outside")
    friction = f"{max(s['friction'] for s in steps):.2f}" + (" slips" if any(s["slips"] for s in steps) else "")
    return [f"{first['reference']:.2g}", between, told, f"{last['value']:.3g}{mark}", friction]


def _failed(row: dict[str, Any]) -> list[str]:
    return ["", "", row["status"], "", ""]


def inside(step: dict[str, Any]) -> bool:
    """Whether an estimate lies within two standard deviations of what the fabric is known by."""
    return step["reference_low"] <= step["value"] <= step["reference_high"]


def asked(steps: Rows, rows: Rows = ()) -> dict[str, dict[str, Any]]:
    """A row of every fold that was asked for, by its key: all but those of models that fold no strips. Without rows of
    the leaderboard, of every fold that has steps.
    """
    return {r["key"]: r for r in rows or steps if r.get("status") != "skipped"}


def last_steps(steps: Rows, cells: Mapping[str, dict[str, Any]]) -> list[dict[str, Any]]:
    """The last step of every fold that came to its end: what a time limit stopped has none."""
    last = {s["key"]: s for s in steps}
    return [last[key] for key, row in cells.items() if key in last and row.get("status", "ok") == "ok"]


def has_interval(step: dict[str, Any]) -> bool:
    return all(step[end] is not None and math.isfinite(step[end]) for end in ("low", "high"))


def summary(steps: Rows, rows: Rows = ()) -> str:
    """How many fabrics end within their ±2σ, and the friction that no step exceeds, in a line."""
    cells = asked(steps, rows)
    last = last_steps(steps, cells)
    slowest = max(sum(s["wall_s"] for s in steps if s["key"] == key) for key in {s["key"] for s in steps})
    return (
        f"within ± 2σ at the last step: {sum(map(inside, last))} of {len(cells)}; largest friction needed "
        f"{max(s['friction'] for s in steps):.2f}; estimation takes {slowest:.1f} s a fold at most"
    )
