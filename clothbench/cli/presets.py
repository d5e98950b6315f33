"""`clothbench presets`: what measured fabrics are like, each number with its spread and source."""

from __future__ import annotations

import dataclasses
from typing import Any

from rich.markup import escape
from rich.table import Table

from clothbench.display.terminal import console
from clothbench.reference.presets import Preset, preset, presets

SHOWN = {
    "areal_density": "kg/m²", "bending_warp": "N·m", "bending_weft": "N·m", "stretch": "N/m", "shear": "N/m",
    "drape_coefficient": "%", "folds": "1",
}  # fmt: skip


def preset_rows(name: str | None) -> list[dict[str, Any]]:
    """One row for each class and quantity."""
    return [
        {"preset": one.name, "about": one.about, "quantity": quantity, **dataclasses.asdict(number)}
        for one in ([preset(name)] if name else presets().values())
        for quantity, number in one.numbers.items()
    ]


def print_presets(name: str | None) -> None:
    """All classes side by side, or one with its sources."""
    if name:
        print_one(preset(name))
        return
    table = Table(title="fabrics: value (range); clothbench presets NAME says where from", title_justify="left")
    table.add_column("class", no_wrap=True)
    for quantity, unit in SHOWN.items():
        table.add_column(f"{quantity.replace('_', ' ')}\n{unit}", justify="right")
    for one in presets().values():
        cells = [one.numbers.get(q) for q in SHOWN]
        table.add_row(one.name, *("–" if n is None else f"{n.value:.3g}\n({n.low:.3g} … {n.high:.3g})" for n in cells))
    console().print(table)


def print_one(one: Preset) -> None:
    table = Table(title=f"{one.name}: {one.about}", title_justify="left", title_style="bold")
    for column in ("quantity", "value", "range", "unit", "source"):
        table.add_column(column, justify="right" if column == "value" else "left", overflow="fold")
    for quantity, n in one.numbers.items():
        words = (quantity.replace("_", " "), f"{n.value:.3g}", f"{n.low:.3g} … {n.high:.3g}", n.unit, n.source)
        table.add_row(*map(escape, words))
    console().print(table)
