"""Calibrations as tables in the terminal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from rich.markup import escape
from rich.table import Table

from clothbench.display.html import group
from clothbench.display.names import recording_of
from clothbench.engine.study import Results
from clothbench.studies.calibration.analysis_tables import analyses
from clothbench.studies.calibration.asked import with_settings
from clothbench.studies.calibration.leaderboard import ended
from clothbench.studies.calibration.ranking import cell_names, marks_of, once, way_of
from clothbench.studies.calibration.schema import ANALYSIS_TABLES
from clothbench.studies.calibration.searches_page import contest_tables
from clothbench.studies.calibration.words import size

Rows = Sequence[dict[str, Any]]
MANY = 24  # recordings in one cell beyond which only the totals are printed
MOST = 500  # cells in one table of the terminal
NARROWEST = 12  # characters of what a row is about, whatever the terminal leaves to its numbers


def show(results: Results) -> list[Any]:
    """One table per suite: error with its interval beside the noise floor; then what was fitted, with units; then what
    else was asked of the fits.
    """
    out: list[Any] = []
    results = with_settings(results)
    parameters = results.table("parameters")
    for suite in sorted({r["suite"] for r in results.rows}):
        mine = [r for r in results.rows if r["suite"] == suite]
        keys = {r["key"] for r in mine}
        out += [error_table(suite, mine), *overall(mine)]
        if fitted := [p for p in parameters if p["key"] in keys]:
            out.append(parameter_table(mine, fitted))
        if front := [f for f in results.table("front") if f["key"] in keys]:
            out.append(front_table(mine, front))
    out += contest_tables(results)
    return out + analyses(results.rows, {name: results.table(name) for name in ANALYSIS_TABLES})


def error_table(suite: str, rows: Rows) -> Table:
    """Errors beside their floor. What a row is about stands in one column, so that the table fits 80 characters."""
    table = Table(title=f"{escape(suite)}: error, 95 % interval", title_justify="left", title_style="bold")
    table.add_column("recording", overflow="fold", min_width=NARROWEST)
    for name in ("error", "interval", "floor"):
        table.add_column(name, justify="right", no_wrap=True)
    cells, names = list(group(rows, lambda r: r["key"]).values()), cell_names(rows)
    crowded = max((sum(bool(r["recording"]) for r in mine) for mine in cells), default=0) > MANY
    for mine in cells[:MOST]:
        how = f"; {escape(why)}" if (why := ended(mine)) else ""
        effort = f" [dim]({mine[0]['evaluations']} evaluations, {mine[0]['wall_s'] or 0.0:.1f} s{how})[/]"
        known = mine[0]["evaluations"] is not None  # of what others handed in it is not
        table.add_row(f"[bold]{escape(names[mine[0]['key']])}[/]{effort if known else ''}")
        for row in mine:
            # Single recordings by the metric that was minimised; by the others the totals say enough.
            single = row["metric"] == row["objective"] and not (crowded and row["split"] == "fit")
            if not row["recording"] or single:
                table.add_row(*_cells(row), style="" if row["recording"] else "bold")
        table.add_section()
    if crowded:
        table.caption = "single fit recordings: clothbench leaderboard --json"
    if len(cells) > MOST:
        table.caption = f"{MOST} of {len(cells)} cells; all of them: clothbench leaderboard --json"
    return table


def overall(rows: Rows) -> list[str]:
    """Where a suite has several cases: the mean held-out error over all their recordings, for each way to fit them and
    each seed; of how many of the way's cases it is, where a fit came to no number. A recording that was held out in
    several cases counts once, as on the page.
    """
    way, marks, place, out = way_of(rows), marks_of(rows), recording_of(rows), list[str]()
    judged = {r["case"] for r in rows if r["split"] == "held_out" and r["recording"]}
    for mine in group(rows, lambda r: (way(r), r["objective"])).values():
        cases = {r["case"] for r in mine if r["case"] in judged or r["status"] != "ok"}
        for some in group(mine, lambda r: r["seed"]).values():
            held = [r for r in some if r["split"] == "held_out" and r["recording"] and r["metric"] == r["objective"]]
            held = once(held)
            known = {case: found for case, found in group(held, lambda r: r["case"]).items() if _numbers(found)}
            if len(cases) < 2 or not known or len({r["unit"] for found in known.values() for r in found}) > 1:
                continue  # nor is there a mean of millimetres and centimetres
            judgements = group([r for found in known.values() for r in found], place)
            values = [sum(r["value"] for r in each) / len(each) for each in judgements.values()]
            of = f"all {len(cases)} cases" if len(known) == len(cases) else f"{len(known)} of {len(cases)} cases"
            error = f"{size(sum(values) / len(values))} {held[0]['unit']}"
            what = f"{' · '.join([_called(held[0]), *marks(held[0])])}, seed {held[0]['seed']}"
            out.append(escape(f"held out, {of}: {error} over {len(values)} recordings ({what})"))
    return out


def _numbers(rows: Rows) -> bool:
    return all(r["value"] is not None for r in rows)


def _called(row: dict[str, Any]) -> str:
    """A way in full, but for what tells it from others of its kind."""
    model = " + ".join([row["model"], *filter(None, (row["effects"] or "").split(","))])
    return " · ".join([model, row["optimizer"], row["metric"]])


def _cells(row: dict[str, Any]) -> list[str]:
    split = {"held_out": "held out"}.get(row["split"] or "", row["split"] or "")
    short = row["recording"].removeprefix(row["case"]).lstrip("-/") if row["recording"] else f"all, {row['metric']}"
    name = short or row["recording"]
    if row["value"] is None:
        error, interval = row["status"], ""
    else:
        error, interval = f"{size(row['value'])} {row['unit']}", _interval(row["low"], row["high"])
    floor = f"{size(row['floor'])} {row['unit']}" if row["floor"] is not None else ""
    return [escape(text) for text in (f"  {split}: {name}" if split else "  no result", error, interval, floor)]


def _interval(low: float | None, high: float | None, said: Callable[[float], str] = size) -> str:
    return f"{said(low)} … {said(high)}" if low is not None and high is not None else ""


def parameter_table(rows: Rows, parameters: Rows) -> Table:
    """Best values with intervals; a value on its bound is marked, since the bound chose it and not the data."""
    table = Table(title="parameters, 95 % interval", title_justify="left", title_style="bold")
    table.add_column("parameter", overflow="fold", min_width=NARROWEST)
    stated = any(p.get("truth") is not None for p in parameters)
    for name in ("value", "interval", *(("truth",) if stated else ())):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    names = cell_names(rows)
    cells = group(parameters, lambda p: p["key"])
    for key, mine in list(cells.items())[:MOST]:
        table.add_row(f"[bold]{escape(names[key])}[/]")
        for p in mine:
            value = f"{p['value']:.4g}" if p["value"] is not None else ""
            mark = " at its bound" if p["at_bound"] else ""
            known = (f"{p['truth']:.3g}" if p.get("truth") is not None else "",) if stated else ()
            texts = (f"  {p['name']} ({p['symbol']})", value, _interval(p["low"], p["high"], "{:.3g}".format), *known,
                     (p["unit"] or "") + mark)  # fmt: skip
            table.add_row(*(escape(t) for t in texts))
        table.add_section()
    if len(cells) > MOST:
        table.caption = f"{MOST} of {len(cells)} cells"
    return table


def front_table(rows: Rows, front: Rows) -> Table:
    """What was reached in each of several objectives: by the fit, and at best by any evaluation on the front."""
    title = "several objectives: the fit, and the least of each on the front"
    table = Table(title=title, title_justify="left", title_style="bold")
    table.add_column("objective", overflow="fold", min_width=NARROWEST)
    for name in ("fit", "in spreads", "least", "in spreads"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    names = cell_names(rows)
    for key, mine in group(front, lambda f: f["key"]).items():
        count = len({f["evaluation"] for f in mine})
        table.add_row(f"[bold]{escape(names[key])}[/], {count} on the front")
        for objective, fit, least in fit_and_least(mine):
            numbers = (fit["distance"], fit["spreads"], least["distance"], least["spreads"])
            table.add_row(escape(f"  {objective}"), *(f"{n:.3g}" for n in numbers), escape(fit["unit"] or ""))
        table.add_section()
    return table


def by_objective(front: Rows) -> dict[str, Rows]:
    """The rows of one cell's front for each objective, evaluations in one order."""
    ordered = sorted(front, key=lambda f: f["evaluation"])
    names = dict.fromkeys(f["objective"] for f in front)
    return {name: [f for f in ordered if f["objective"] == name] for name in names}


def fit_and_least(front: Rows) -> list[tuple[str, dict[str, Any], dict[str, Any]]]:
    """Of one cell's front: each objective, its row of the fit, and the row with the least of it. Nothing of a front
    that the fit is not on, as in results from before it was chosen from there.
    """
    return [
        (objective, next(f for f in some if f["chosen"]), min(some, key=lambda f: f["distance"]))
        for objective, some in by_objective(front).items()
        if any(f["chosen"] for f in some)
    ]
