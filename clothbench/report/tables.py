"""Results as tables in the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

Rows = Sequence[dict[str, Any]]
CELL = ("suite", "case", "model", "effects", "optimizer", "seed")
MANY = 24  # recordings in one cell beyond which only the totals are printed


def console() -> Console:
    """Standard output; wide enough for a table where it is no terminal."""
    out = Console(highlight=False)
    return out if out.is_terminal else Console(highlight=False, width=200, color_system=None)


def print_leaderboard(rows: Rows, parameters: Rows) -> None:
    """One table per suite: error with its interval beside the noise floor; then what was fitted, with units."""
    out = console()
    for suite in sorted({r["suite"] for r in rows}):
        mine = [r for r in rows if r["suite"] == suite]
        out.print(error_table(suite, mine))
        for line in overall(mine):
            out.print(line)
        keys = {r["key"] for r in mine}
        fitted = [p for p in parameters if p["key"] in keys]
        if fitted:
            out.print(parameter_table(mine, fitted))
    for row in failures(rows):
        out.print(f"[red]{row['status']}[/]: {escape(_label(row))}: {escape(row['reason'] or '')}")


def error_table(suite: str, rows: Rows) -> Table:
    table = Table(title=f"{suite}: error, 95 % interval", title_justify="left", title_style="bold")
    for name in ("case", "model", "optimizer", "metric", "split", "recording"):
        table.add_column(name, overflow="fold")
    for name in ("error", "interval", "noise floor", "evaluations", "wall time"):
        table.add_column(name, justify="right", no_wrap=True)
    crowded = (
        max((sum(r["key"] == k and bool(r["recording"]) for r in rows) for k in {r["key"] for r in rows}), default=0)
        > MANY
    )
    for row in rows:
        # Single recordings by the metric that was minimised; by the others the totals say enough.
        if not row["recording"] or (row["metric"] == row["objective"] and not (crowded and row["split"] == "fit")):
            table.add_row(*_cells(row), style="bold" if not row["recording"] else "", end_section=not row["recording"])
    if crowded:
        table.caption = "single fit recordings: clothbench leaderboard --json"
    return table


def overall(rows: Rows) -> list[str]:
    """Where a suite has several cases: the mean held-out error over all their recordings, for each way to fit them."""
    groups: dict[tuple[str, ...], list[dict[str, Any]]] = {}
    for row in rows:
        if row["recording"] and row["split"] == "held_out" and row["metric"] == row["objective"]:
            key = (row["model"], row["effects"] or "", row["optimizer"], row["metric"], str(row["seed"]))
            groups.setdefault(key, []).append(row)
    out = []
    for (model, effects, optimizer, metric, seed), mine in groups.items():
        cases = {r["case"] for r in mine}
        if len(cases) > 1 and all(r["value"] is not None for r in mine):
            mean = sum(r["value"] for r in mine) / len(mine)
            name = " + ".join([model, *(e for e in effects.split(",") if e)])
            what = f"{escape(name)} · {escape(optimizer)} · {escape(metric)}, seed {seed}"
            out.append(
                f"held out, all {len(cases)} cases: {mean:.2f} {mine[0]['unit']} over {len(mine)} recordings ({what})"
            )
    return out


def _cells(row: dict[str, Any]) -> list[str]:
    model = row["model"] + "".join(f"\n+ {e}" for e in (row["effects"] or "").split(",") if e)
    if row["value"] is None:
        error, interval = row["status"], ""
    else:
        error, interval = f"{row['value']:.2f} {row['unit']}", _interval(row["low"], row["high"])
    floor = f"{row['floor']:.2f} {row['unit']}" if row["floor"] is not None else ""
    last = (str(row["evaluations"]), f"{row['wall_s']:.1f} s") if not row["recording"] else ("", "")
    model = model if not row["recording"] else row["model"]
    names = (row["case"], model, row["optimizer"], row["metric"], row["split"] or "", row["recording"] or "all")
    return [escape(str(text)) for text in (*names, error, interval, floor, *last)]


def _interval(low: float | None, high: float | None, digits: str = ".2f") -> str:
    return f"{low:{digits}} … {high:{digits}}" if low is not None and high is not None else ""


def parameter_table(rows: Rows, parameters: Rows) -> Table:
    """Best values with intervals; a value on its bound is marked, since the bound chose it and not the data."""
    table = Table(title="parameters, 95 % interval", title_justify="left", title_style="bold")
    for name in ("case", "model", "optimizer", "metric", "parameter"):
        table.add_column(name, overflow="fold")
    for name in ("value", "interval", "unit", ""):
        table.add_column(name, justify="left" if name == "unit" else "right", no_wrap=True)
    about = {r["key"]: r for r in rows}
    last = None
    for p in parameters:
        row = about[p["key"]]
        names = (row["case"], row["model"], row["optimizer"], row["objective"]) if p["key"] != last else ("",) * 4
        if last is not None and p["key"] != last:
            table.add_section()
        value = f"{p['value']:.4g}" if p["value"] is not None else ""
        interval = _interval(p["low"], p["high"], ".3g")
        mark = "at its bound" if p["at_bound"] else ""
        table.add_row(
            *(escape(str(t)) for t in (*names, f"{p['name']} ({p['symbol']})", value, interval, p["unit"], mark))
        )
        last = p["key"]
    return table


def failures(rows: Rows) -> list[dict[str, Any]]:
    """One row for each cell that did not end well."""
    seen: dict[str, dict[str, Any]] = {}
    for row in rows:
        if row["status"] != "ok":
            seen.setdefault(row["key"], row)
    return list(seen.values())


def _label(row: dict[str, Any]) -> str:
    parts = (row["case"], row["model"], row["optimizer"], row["metric"], row["recording"])
    return " · ".join(p for p in parts if p)
