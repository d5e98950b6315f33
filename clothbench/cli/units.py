"""`clothbench units`: what a simulator's parameters are documented to be, beside what mechanics finds."""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
from collections.abc import Sequence
from typing import Any

from rich.markup import escape
from rich.table import Table

from clothbench.core.errors import ClothbenchError
from clothbench.core.optional import StatesUnits, absent
from clothbench.core.twin import UNITS
from clothbench.display.terminal import console
from clothbench.plugins.discovery import catalogue
from clothbench.studies.mechanics.units import measured


def unit_rows(name: str, settings: Sequence[str] = ()) -> list[dict[str, Any]]:
    """One row for each quantity, mesh and density of a model with options, "solver=vbd"; of a target of export that
    does not run here one for each quantity.
    """
    plugins = catalogue()
    if name not in plugins.names("models") and name in plugins.names("exporters"):
        if settings:
            raise ClothbenchError(
                f"found {settings[0]!r}, and {name!r} is a target of export without options; leave it out"
            )
        return stated_rows(name)
    factory = plugins.load("models", name)
    if reason := absent(factory):
        raise ClothbenchError(f"model {name!r}: {reason}")
    options = dict(_option(word) for word in settings)
    if "resolution" in options:
        raise ClothbenchError(
            f"found resolution={options['resolution']}, and `units` has meshes of its own; leave it out"
        )
    rows = []
    for one in measured(lambda: plugins.make("models", name, **options)):
        row = dataclasses.asdict(one)
        if one.documented is not None and not math.isfinite(one.documented):
            row["documented"] = None
            row["reason"] = one.reason or ("infinite: no ratio" if math.isinf(one.documented) else "")
        row["factor"] = one.found / row["documented"] if one.found and row["documented"] else None
        row["translation"] = one.found / one.asked if one.found else None
        rows.append({"model": name, **row})
    return rows


def stated_rows(name: str) -> list[dict[str, Any]]:
    """What is documented of a target of export, and why it was not measured."""
    target = catalogue().load("exporters", name)
    if not isinstance(target, StatesUnits):
        raise ClothbenchError(f"{name!r} has no units of its own: what it writes says them")
    blank = dict.fromkeys(("along", "density", "asked", "documented", "found", "factor", "translation"))
    return [
        {"model": name, "quantity": quantity, "unit": UNITS.get(quantity, "1"), "formula": formula,
         "source": target.documentation, "reason": target.unmeasured, **blank}
        for quantity, formula in target.units.items()
    ]  # fmt: skip


def _option(word: str) -> tuple[str, Any]:
    name, sign, value = word.partition("=")
    if not sign:
        raise ClothbenchError(f"found {word!r}, expected OPTION=VALUE of the model")
    try:
        return name, json.loads(value)
    except json.JSONDecodeError:
        return name, value


def print_units(name: str, rows: list[dict[str, Any]]) -> None:
    """A line for each quantity and mesh, the densities side by side."""
    if all(row["along"] is None for row in rows):
        print_stated(name, rows)
        return
    densities = sorted({row["density"] for row in rows})
    table = Table(title=f"{name}: measured over documented, and over what export asks for", title_justify="left")
    for column in ("quantity", "documented", "nodes"):
        table.add_column(column, overflow="fold")
    for what, density in itertools.product(("documented", "asked"), densities):
        table.add_column(f"÷ {what}\n{density:g} kg/m²", justify="right", no_wrap=True)
    for (quantity, along), group in itertools.groupby(rows, key=lambda row: (row["quantity"], row["along"])):
        mine = list(group)
        cells = [_number(row[part]) for part in ("factor", "translation") for row in mine]
        told = [mine[0]["formula"], "" if mine[0]["factor"] else mine[0]["reason"]]
        about = "; ".join(filter(None, told))
        table.add_row(f"{quantity} [{mine[0]['unit']}]".replace("[", "\\["), escape(about), str(along), *cells)
    console().print(table)
    print_sources(rows)


def print_stated(name: str, rows: list[dict[str, Any]]) -> None:
    """What is documented, line by line, and why it was not measured."""
    table = Table(title=f"{name}: as documented", title_justify="left")
    for column in ("quantity", "documented"):
        table.add_column(column, overflow="fold")
    for row in rows:
        table.add_row(escape(f"{row['quantity']} [{row['unit']}]"), escape(row["formula"]))
    console().print(table)
    for reason in dict.fromkeys(row["reason"] for row in rows):
        print(reason)
    print_sources(rows)


def print_sources(rows: list[dict[str, Any]]) -> None:
    for source in dict.fromkeys(row["source"] for row in rows if row["source"]):
        print(f"documented in: {source}")


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.3g}"
