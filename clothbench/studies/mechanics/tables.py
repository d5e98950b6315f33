"""Models against mechanics as a table in the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rich.markup import escape
from rich.table import Table

from clothbench.engine.study import Results
from clothbench.studies.mechanics.checks import CHECKS

Rows = Sequence[dict[str, Any]]


def show(results: Results) -> list[Any]:
    """One table per suite."""
    levels = results.table("validation")
    return [
        validation_table(suite, [r for r in results.rows if r["suite"] == suite], levels)
        for suite in sorted({r["suite"] for r in results.rows})
    ]


def relative_error(row: dict[str, Any]) -> float | None:
    """(value − reference)/reference [%]; where the reference is 0, the value, which is in % itself."""
    if row["value"] is None or row["reference"] is None:
        return None
    if row["reference"] == 0:
        return row["value"]
    return 100 * (row["value"] - row["reference"]) / row["reference"]


def observed_orders(levels: Rows) -> dict[str, float]:
    """Order of convergence over the meshes of each cell, as seen on its finest, where one is seen there; of one with
    several loads, at that which stands in the leaderboard.
    """
    shown = {check.name: check.headline for check in CHECKS}
    plain = [v for v in levels if v["step_scale"] == 1.0 and v["load"] == shown.get(v["case"])]
    finest = {v["key"]: v["order"] for v in plain}  # levels come from the coarsest mesh to the finest
    return {key: order for key, order in finest.items() if order is not None}


def validation_table(suite: str, rows: Rows, levels: Rows) -> Table:
    """One line per model and test: value beside reference, error, observed order of convergence over the meshes."""
    table = Table(
        title=f"{escape(suite)}: models against references, finest mesh", title_justify="left", title_style="bold"
    )
    for name in ("model", "case"):
        table.add_column(name, overflow="fold")
    for name in ("value", "reference", "unit", "error %", "order"):
        table.add_column(name, justify="left" if name == "unit" else "right", no_wrap=True)
    table.add_column("status", no_wrap=True)
    orders = observed_orders(levels)
    for model in dict.fromkeys(r["model"] for r in rows):
        for row in (r for r in rows if r["model"] == model):
            table.add_row(*(escape(t) for t in _line(row, orders)))
        table.add_section()
    return table


def _line(row: dict[str, Any], orders: dict[str, float]) -> list[str]:
    order = orders.get(row["key"]) if row["metric"] != "order" else row["value"]
    error = relative_error(row)
    numbers = ["" if row[n] is None else f"{row[n]:.5g}" for n in ("value", "reference")]
    return [
        row["model"], row["case"], *numbers, row["unit"] or "", "" if error is None else f"{error:+.3g}",
        "" if order is None else f"{order:.2f}", row["status"],
    ]  # fmt: skip
