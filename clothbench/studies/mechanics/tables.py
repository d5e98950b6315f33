"""Models against mechanics as a table in the terminal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from rich.markup import escape
from rich.table import Table

from clothbench.display.html import group
from clothbench.display.names import differing
from clothbench.engine.study import Results
from clothbench.studies.mechanics.cell import MESHES_WORD
from clothbench.studies.mechanics.checks import CHECKS

Rows = Sequence[dict[str, Any]]


def show(results: Results) -> list[Any]:
    """One table per suite."""
    levels = results.table("validation")
    return [
        validation_table(suite, [r for r in results.rows if r["suite"] == suite], levels)
        for suite in sorted({r["suite"] for r in results.rows})
    ]


def called(rows: Rows, meshes: bool = False) -> Callable[[dict[str, Any]], str]:
    """What to call a row's model: with what cells of it differ in, "baraff_witkin, integrator=bdf2"; with their meshes
    if asked for, as where each cell stands by itself.
    """
    several = {
        about for about, mine in group(rows, lambda r: (r["model"], r["case"])).items()
        if len({r["effects"] for r in mine}) > 1
    }  # fmt: skip
    told: dict[str, str] = {}
    for mine in group(rows, lambda r: r["model"]).values():
        told |= differing(mine if meshes else [{**r, "settings": " ".join(_parted(r)[1])} for r in mine])

    def name(row: dict[str, Any]) -> str:
        effects = f"with {row['effects']}" if (row["model"], row["case"]) in several else ""
        return ", ".join(filter(None, (row["model"], told[row["key"]], effects)))

    return name


def finest(rows: Rows, levels: Rows = ()) -> list[dict[str, Any]]:
    """Of rows that are about one model, set alike, in one test, that of the cell with the finest mesh; of several such
    the last. levels: where rows of an earlier version do not say on which meshes they are.
    """
    name, seen = called(rows), group(levels, lambda v: v["key"])

    def mesh(row: dict[str, Any]) -> tuple[list[int], str]:
        sizes = _parted(row)[0] or {v["along"] for v in seen.get(row["key"], ())}
        return sorted(sizes, reverse=True), row.get("finished") or ""

    return [max(mine, key=mesh) for mine in group(rows, lambda r: (name(r), r["case"])).values()]


def _parted(row: dict[str, Any]) -> tuple[list[int], list[str]]:
    """A row's settings: numbers of nodes, and all other words."""
    words = (row.get("settings") or "").split()
    meshes = [w.removeprefix(f"{MESHES_WORD}=") for w in words if w.startswith(f"{MESHES_WORD}=")]
    others = [w for w in words if not w.startswith(f"{MESHES_WORD}=")]
    return [int(n) for told in meshes for n in told.split(",")], others


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
    """One line per cell and test: value beside reference, error, observed order of convergence over the meshes."""
    table = Table(
        title=f"{escape(suite)}: models against references, finest mesh", title_justify="left", title_style="bold"
    )
    for name in ("model", "case"):
        table.add_column(name, overflow="fold")
    for name in ("value", "reference", "unit", "error %", "order"):
        table.add_column(name, justify="left" if name == "unit" else "right", no_wrap=True)
    table.add_column("status", no_wrap=True)
    orders = observed_orders(levels)
    for name, mine in group(rows, called(rows, meshes=True)).items():
        for row in mine:
            table.add_row(*(escape(t) for t in _line(name, row, orders)))
        table.add_section()
    return table


def _line(name: str, row: dict[str, Any], orders: dict[str, float]) -> list[str]:
    order = orders.get(row["key"]) if row["metric"] != "order" else row["value"]
    error = relative_error(row)
    numbers = ["" if row[n] is None else f"{row[n]:.5g}" for n in ("value", "reference")]
    return [
        name, row["case"], *numbers, row["unit"] or "", "" if error is None else f"{error:+.3g}",
        "" if order is None else f"{order:.2f}", row["status"],
    ]  # fmt: skip
