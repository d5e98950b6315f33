"""Searches beside each other: the table in the terminal, and the page's section with their way to the least error."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from rich.markup import escape
from rich.table import Table

from clothbench.display.html import table, text
from clothbench.display.plotly import COLOURS, LEGEND, rounded
from clothbench.display.section import Section
from clothbench.engine.study import Results
from clothbench.studies.calibration.searches import WORST, Contest, Interval, Search, contests

HEAD = ("search", "seeds", "least error", "hypervolume", "reached", "evaluations", "lost")
NOTE = f"""<p class="soft">The same question to several optimizers, each with several seeds: mean of the least error
over seeds with its 95 % interval; share of the box of objectives up to {WORST:g} spreads that the front covers
(hypervolume, higher is better); in how many runs the error that three quarters of all runs came to was reached, and
the median of how many evaluations that took. Line: median over seeds of the least error so far; band: its
quartiles.</p>"""
SCRIPT = """
const contests = JSON.parse(document.getElementById("contests").textContent);
const drawContests = () => contests.forEach((figure, n) => draw("contest-" + n, figure));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawContests);
drawContests();
"""


def contest_tables(results: Results) -> list[Table]:
    """A table in the terminal for each question."""
    out = []
    for contest in contests(results):
        title = f"searches beside each other: {title_of(contest)}"
        shown = Table(title=escape(title), title_justify="left", title_style="bold")
        for name in HEAD:
            shown.add_column(name, justify="left" if name == "search" else "right", overflow="fold")
        for search in contest.searches:
            shown.add_row(*(escape(cell) for cell in cells(search)))
        shown.caption = caption(contest)
        out.append(shown)
    return out


def searches_section(results: Results) -> Section | None:
    """A table and a figure for each question; None where no optimizers can be compared."""
    found = contests(results)
    if not found:
        return None
    parts = [
        f"<h3>{text(title_of(c))}</h3>"
        f"{table(HEAD, [[text(x) for x in cells(s)] for s in c.searches], set(range(1, len(HEAD))))}"
        f'<p class="soft">{text(caption(c))}</p><figure><div id="contest-{n}"></div></figure>'
        for n, c in enumerate(found)
    ]
    body = f"<h2>Searches beside each other</h2>{NOTE}{''.join(parts)}"
    return Section(body, {"contests": [figure(c) for c in found]}, SCRIPT)


def title_of(contest: Contest) -> str:
    budget = f"{contest.budget} evaluations" if contest.budget else ""
    return " · ".join(filter(None, (contest.case, contest.model, contest.metric, budget)))


def caption(contest: Contest) -> str:
    goal = f"{contest.goal:.3g} {contest.unit}"
    mesh = ", on the finer mesh, with evaluations on both" if contest.finer else ""
    told = f"least error in {contest.unit}{mesh}; reached: {goal}, which three quarters of all runs came to"
    if contest.left_out:
        told += f"; without {', '.join(contest.left_out)}, of which a run failed or ended by the clock"
    return told


def cells(search: Search) -> Sequence[str]:
    """What is said of one search, in the order of `HEAD`."""
    took = f"{search.evaluations:.0f}" if np.isfinite(search.evaluations) else f"> {search.best.shape[1]}"
    volume = interval(search.volume) if search.volume is not None else "–"
    reached = f"{search.reached} of {search.seeds}"
    return (search.optimizer, str(search.seeds), interval(search.error), volume, reached, took, f"{search.lost:.0%}")


def interval(found: Interval) -> str:
    value, low, high = found
    return f"{value:.3g} ({low:.3g} … {high:.3g})" if np.isfinite(value) else "not in all runs"


def figure(contest: Contest) -> dict[str, Any]:
    """Least error so far over evaluations: median and quartiles over seeds, a colour for each search."""
    data: list[dict[str, Any]] = []
    for n, search in enumerate(contest.searches):
        colour, known = COLOURS[n % len(COLOURS)], np.where(np.isnan(search.best), np.inf, search.best)
        low, middle, high = map(rounded, np.quantile(known, (0.25, 0.5, 0.75), axis=0, method="nearest"))
        x = list(range(1, len(middle) + 1))
        band = {"type": "scatter", "mode": "lines", "x": x, "line": {"width": 0, "color": colour}, "hoverinfo": "skip",
                "showlegend": False}  # fmt: skip
        data += [band | {"y": low}, band | {"y": high, "fill": "tonexty", "opacity": 0.25}]
        data.append({"type": "scatter", "mode": "lines", "x": x, "y": middle, "name": search.optimizer,
                     "line": {"color": colour, "width": 2}})  # fmt: skip
    axes = {"xaxis": {"title": {"text": "evaluations"}}, "yaxis": {"title": {"text": f"least error [{contest.unit}]"}}}
    return {"data": data, "layout": axes | LEGEND | {"height": 320, "margin": {"l": 56, "r": 16, "t": 16, "b": 44}}}
