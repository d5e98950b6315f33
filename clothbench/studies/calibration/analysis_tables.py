"""The analyses of finished fits as tables in the terminal: transfer, variability, repeats, sensitivity, confusion."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from rich.markup import escape as escaped
from rich.table import Table

from clothbench.display.html import group
from clothbench.studies.calibration.ranking import cell_names
from clothbench.studies.calibration.transfer import Confusion, Transfer, confusions, transfers

Rows = Sequence[dict[str, Any]]
MUCH = 100.0  # %: beyond it a parameter is not determined, and the number says no more


def escape(said: str | None) -> str:
    """A text of a table as it is, and no markup; what an older version did not say is left open."""
    return escaped(said or "")


def analyses(rows: Rows, tables: dict[str, Rows]) -> list[Any]:
    """Every table for which there is something; nothing otherwise."""
    about = cell_names(rows)
    moved = transfers(rows, tables["starts"])
    shown: list[Any] = [transfer_table(moved)] if moved else []
    shown += [confusion_table(c) for c in confusions(tables["confusion"], rows, tables["starts"])]
    for name, make in (
        ("variability", variability_table),
        ("repeats", repeats_table),
        ("sensitivity", sensitivity_table),
    ):
        if tables[name]:
            shown.append(make(tables[name], about))
    return shown + [escape(reason) for reason in missing(tables, about)]


MISSING = {"map": "no map of the error", "confusion": "not held against other fabrics"}
NO_BARS = {"variability": "no variability", "sensitivity": "no sensitivity"}


def missing(tables: dict[str, Rows], about: dict[str, str], words: Mapping[str, str] = MISSING) -> list[str]:
    """Why some cells have no map of the error, or were not held against other fabrics, one line each. words: table →
    what its rows with a reason lack, and of which parameter where they speak of one.
    """
    failed = [(said, r) for name, said in words.items() for r in tables[name] if r.get("reason")]
    return [
        f"{about[r['key']]}: {said}{f' of {name}' if (name := r.get('name')) else ''}: {r['reason']}"
        for said, r in failed
    ]


def transfer_table(moved: Sequence[Transfer]) -> Table:
    """Start → optimised error, the same parameters on the other recordings, and which fit is chosen."""
    table = _table("trial by trial: error at the start, optimised, and on the other trials", "fitted to")
    for name in ("start", "optimised", "elsewhere", "E1 + E2"):
        table.add_column(name, justify="right", overflow="fold")
    for way in dict.fromkeys(t.way for t in moved):
        table.add_row(f"[bold]{escape(way)}[/] [dim]errors in {escape(unit_of(moved, way))}[/]")
        for t in (t for t in moved if t.way == way):
            others = [f"{name.rpartition('-')[2]} {_number(e)}" for name, e in t.errors.items() if name != t.case]
            mark = " ✓" if t.chosen else "  "
            texts = (
                f"  {t.case}",
                _number(t.start),
                _number(t.errors[t.case]),
                ", ".join(others),
                _number(t.total) + mark,
            )
            table.add_row(*(escape(x) for x in texts), style="bold" if t.chosen else "")
        table.add_section()
    table.caption = "✓: least E1 + E2 of its group, chosen"
    return table


def unit_of(moved: Sequence[Transfer], way: str) -> str:
    """Of the errors of one way to fit; another metric has another."""
    return next(t.unit for t in moved if t.way == way)


def confusion_table(c: Confusion) -> Table:
    """Rows: recorded fabrics; columns: whose parameters; the nearest is marked."""
    table = _table(escape(f"which fabric is it? {c.way}, error [{c.unit}]"), "recorded")
    for fabric in c.fabrics:
        table.add_column(f"as {escape(fabric)}", justify="right")
    for recorded in c.fabrics:
        nearest = c.nearest(recorded)
        cells = [_number(c.error[s].get(recorded)) + (" ◂" if s == nearest else "  ") for s in c.fabrics]
        table.add_row(escape(recorded), *cells)
    table.caption = (
        f"mean over the trials that all have; ◂ nearest simulation: its own fabric for {c.right} of {len(c.fabrics)}"
    )
    return table


def variability_table(rows: Rows, about: dict[str, str]) -> Table:
    """By how much each parameter has to change to change the error by 1 %."""
    table = _table("variability: change of the parameter that changes the error by 1 %", "parameter")
    for name in ("value", "unit", "variability"):
        table.add_column(name, justify="right", no_wrap=True)
    for key, mine in _by_key(rows):
        table.add_row(f"[bold]{escape(about[key])}[/]")
        for r in mine:
            if r["name"] is None:
                table.add_row(f"  {escape(r['reason'])}")
                continue
            said = percent(r["percent"]) if r["percent"] is not None else r["reason"]
            table.add_row(
                *(escape(x) for x in (f"  {r['name']} ({r['symbol']})", _number(r["value"]), r["unit"], said))
            )
        table.add_section()
    return table


def repeats_table(rows: Rows, about: dict[str, str]) -> Table:
    """Spread of fits from starts within ±5 % (standard deviation over mean)."""
    table = _table("repeated fits from starts within ±5 %", "parameter")
    for name in ("start", "fits", "spread"):
        table.add_column(name, justify="right", overflow="fold")
    for key, mine in _by_key(rows):
        table.add_row(f"[bold]{escape(about[key])}[/]")
        if mine[0]["reason"]:
            table.add_row(f"  {escape(mine[0]['reason'])}")
            continue
        for name in dict.fromkeys(r["name"] for r in mine):
            each = [r for r in mine if r["name"] == name]
            values = [r["value"] for r in each]
            label = f"  {name} [{each[0]['unit']}]"
            table.add_row(*(escape(x) for x in (label, _number(each[0]["start"]), "  ".join(map(_number, values)),
                                                percent(spread(values)))))  # fmt: skip
        errors = {r["repeat"]: r["error"] for r in mine}
        table.add_row(escape(f"  error [{mine[0]['error_unit']}]"), _number(mine[0]["error_start"]),
                      "  ".join(map(_number, errors.values())), percent(spread(list(errors.values()))))  # fmt: skip
        table.add_section()
    return table


def sensitivity_table(rows: Rows, about: dict[str, str]) -> Table:
    """What the error depends on over the whole range of each parameter."""
    table = _table("sensitivity over the whole ranges: Morris μ* and σ, Sobol S1 and ST", "parameter")
    for name in ("main (μ*, S1)", "with others (σ, ST)"):
        table.add_column(name, justify="right", no_wrap=True)
    for key, mine in _by_key(rows):
        for method in dict.fromkeys(r["method"] for r in mine):
            some = [r for r in mine if r["method"] == method]
            lost = f", {some[0]['lost']} lost" if some[0]["lost"] else ""
            size = f" [dim]({method}, {some[0]['evaluations']} evaluations{lost})[/]" if method else ""
            table.add_row(f"[bold]{escape(about[key])}[/]{size}")
            for r in some:
                if r["reason"]:
                    table.add_row(f"  {r['name'] or 'all'}: {escape(r['reason'])}")
                    continue
                pair = (_with_half(r["main"], r["main_half"]), _with_half(r["total"], r["total_half"]))
                table.add_row(f"  {escape(r['name'])} ({escape(r['symbol'])})", *pair)
        table.add_section()
    return table


def percent(value: float | None) -> str:
    if value is None or math.isnan(value):
        return "–"
    return f"> {MUCH:g} %" if value > MUCH else f"{value:.3g} %"


def spread(values: Sequence[float | None]) -> float | None:
    """Standard deviation over mean [%]; None if a value is missing."""
    known = [v for v in values if v is not None]
    if len(known) < 2 or len(known) < len(values):
        return None
    mean = sum(known) / len(known)
    variance = sum((v - mean) ** 2 for v in known) / (len(known) - 1)
    return 100 * math.sqrt(variance) / abs(mean) if mean else math.inf


def _table(title: str, first: str) -> Table:
    table = Table(title=title, title_justify="left", title_style="bold")
    table.add_column(first, overflow="fold")
    return table


def _by_key(rows: Rows) -> list[tuple[str, list[dict[str, Any]]]]:
    order = dict.fromkeys(r["key"] for r in sorted(rows, key=lambda r: r["case"] or ""))
    found = group(rows, lambda r: r["key"])
    return [(key, found[key]) for key in order]


def _number(value: float | None) -> str:
    return "–" if value is None or not math.isfinite(value) else f"{value:.4g}"


def _with_half(value: float | None, half: float | None) -> str:
    return _number(value) + (f" ± {half:.2g}" if half is not None else "")
