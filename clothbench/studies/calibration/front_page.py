"""The page's section on fronts: what a fit of several objectives could have been, all at once and in pairs."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Any

from clothbench.display.html import table, text
from clothbench.display.plotly import COLOURS, GREY, rounded
from clothbench.display.section import Section
from clothbench.engine.study import Results
from clothbench.studies.calibration.ranking import cell_names
from clothbench.studies.calibration.tables import by_objective, fit_and_least

Rows = Sequence[dict[str, Any]]
NOTE = """<p class="soft">Every evaluation that no other beats in all objectives, a line each, in spreads between
recordings of the same cloth: 1 is as far as one is from the next. The fit, chosen from them, is drawn thick.</p>"""
SCRIPT = """
const fronts = JSON.parse(document.getElementById("fronts").textContent);
const drawFronts = () => fronts.forEach((figure, n) => draw("front-" + n, figure));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawFronts);
document.querySelectorAll("details").forEach((part) => part.addEventListener("toggle", drawFronts));
drawFronts();
"""
MARGIN = {"l": 56, "r": 16, "t": 16, "b": 44}


def front_section(results: Results) -> Section | None:
    """A table, parallel coordinates and pairs for each cell that has a front; None where none has."""
    about, rows = cell_names(results.rows), results.table("front")
    figures: list[dict[str, Any]] = []
    parts = []
    for key in sorted({f["key"] for f in rows} & set(about)):
        mine = [f for f in rows if f["key"] == key]
        shown = [parallel(mine), *pairs(mine)]
        places = [f'<div id="front-{len(figures) + n}"></div>' for n in range(len(shown))]
        parts.append(
            f"<h3>{text(about[key])}</h3>{least_table(mine)}<figure>{places[0]}</figure>"
            f"<details><summary>in pairs</summary>{''.join(f'<figure>{p}</figure>' for p in places[1:])}</details>"
        )
        figures += shown
    return Section(f"<h2>Fronts</h2>{NOTE}{''.join(parts)}", {"fronts": figures}, SCRIPT) if parts else None


def least_table(front: Rows) -> str:
    """Of one cell: what the fit reached in each objective, and the least on the front."""
    body = []
    for objective, fit, least in fit_and_least(front):
        numbers = [f"{n:.3g}" for n in (fit["distance"], fit["spreads"], least["distance"], least["spreads"])]
        body.append([text(objective), *numbers, text(fit["unit"])])
    return table(["objective", "fit", "in spreads", "least", "in spreads", "unit"], body, numeric={1, 2, 3, 4})


def parallel(front: Rows) -> dict[str, Any]:
    """Parallel coordinates: a line for each evaluation over the objectives, in spreads."""
    columns = by_objective(front)
    data: list[dict[str, Any]] = []
    for n, first in enumerate(next(iter(columns.values()))):
        y = rounded([some[n]["spreads"] for some in columns.values()])
        look = {"color": COLOURS[1], "width": 4} if first["chosen"] else {"color": GREY, "width": 1}
        hover = f"evaluation {first['evaluation']}: %{{y}} spreads<extra></extra>"
        data.append(
            {"type": "scatter", "mode": "lines", "x": list(columns), "y": y, "line": look, "hovertemplate": hover}
        )
    data.sort(key=lambda line: line["line"]["width"])
    axes: dict[str, Any] = {
        "xaxis": {"type": "category", "range": [-0.5, len(columns) - 0.5], "automargin": True},
        "yaxis": {"title": {"text": "distance [spreads]"}, "rangemode": "tozero"},
    }
    return {"data": data, "layout": axes | {"height": 320, "margin": MARGIN}}


def pairs(front: Rows) -> list[dict[str, Any]]:
    """A scatter of the front for each two objectives, in their own units."""
    out = []
    for (x_name, xs), (y_name, ys) in combinations(by_objective(front).items(), 2):
        chosen = [f["chosen"] for f in xs]
        look = {"color": [COLOURS[1] if c else GREY for c in chosen], "size": [12 if c else 7 for c in chosen]}
        hover = [f"evaluation {f['evaluation']}" for f in xs]
        dots = {
            "type": "scatter", "mode": "markers", "x": rounded([f["distance"] for f in xs]),
            "y": rounded([f["distance"] for f in ys]), "marker": look, "text": hover,
        }  # fmt: skip
        axes: dict[str, Any] = {
            side: {"title": {"text": f"{name} [{some[0]['unit']}]"}, "rangemode": "tozero"}
            for side, name, some in (("xaxis", x_name, xs), ("yaxis", y_name, ys))
        }
        out.append({"data": [dots], "layout": axes | {"height": 280, "margin": MARGIN}})
    return out
