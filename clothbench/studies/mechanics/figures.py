"""Figures of models against mechanics: curves over their references, and errors over the mesh. Plotly dictionaries."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np

from clothbench.display.plotly import COLOURS, GREY, rounded
from clothbench.reference.fabrics import FABRICS
from clothbench.reference.mechanics import drop_over_reach, eta_of_fold, fold_coefficients

Levels = Sequence[dict[str, Any]]
ALONG = "nodes along the strip"


def colours(levels: Levels) -> dict[str, str]:
    """A colour for each model."""
    return {m: COLOURS[n % len(COLOURS)] for n, m in enumerate(sorted({v["model"] for v in levels}))}


def validation_figures(levels: Levels) -> list[dict[str, Any]]:
    """What the page shows: {"title", "caption", "figure"} each; a test that nobody could do is left out."""
    whole = [v for v in levels if v["step_scale"] == 1.0 and v["value"] is not None]
    look = colours(levels)
    found = [_cantilever(whole, look), _folds(whole, look)]
    found += [_over_mesh(whole, look, *about) for about in (
        ("swing_period", "Swing of a hanging sheet", "Period on each mesh; grey: ω₁ = (2.4048/2) √(g/L)."),
        ("added_mass", "The same with air carried along", "Period on each mesh; grey: ω₁/√(1 + m_a/ρ)."),
        ("terminal_speed", "Terminal speed", "Speed of the fall with drag; grey: √(2ρg/(ρ_air C_N))."),
        ("catenary", "Strip between two supports", "Sag of the middle; grey: the elastic catenary."),
    )]  # fmt: skip
    return [f for f in found if f is not None]


def error_figures(levels: Levels) -> dict[str, dict[str, Any]]:
    """Test → |error| over the mesh, both axes logarithmic; a dotted line falls with the square of the cell size."""
    look, out = colours(levels), {}
    for case in dict.fromkeys(v["case"] for v in levels):
        mine = [v for v in levels if v["case"] == case and v["step_scale"] == 1.0 and v["error"]]
        if len({v["along"] for v in mine}) < 2:
            continue
        size = "relative" if all(v["relative"] is not None for v in mine) else "error"
        data, factor = [], 100 if size == "relative" else 1
        for name, load in dict.fromkeys((v["model"], v["load"]) for v in mine):
            part = [v for v in mine if (v["model"], v["load"]) == (name, load)]
            what = escape(name) + (f", {escape(part[0]['load_name'])} = {load:.3g}" if load is not None else "")
            error = [factor * abs(v[size]) for v in part]
            data.append(_line([v["along"] for v in part], error, name, look[name], f"{what}<br>%{{y}} % at %{{x}}"))
        along = np.array(sorted({v["along"] for v in mine}), dtype=float)
        top = max(factor * abs(v[size]) for v in mine)
        data.append(_line(along, top * (along[0] / along) ** 2, "", GREY, "second order", dash="dot", mode="lines"))
        out[case] = _figure(data, _log(ALONG, along), _log("error [%]"))
    return out


def _cantilever(levels: Levels, look: dict[str, str]) -> dict[str, Any] | None:
    mine = _finest([v for v in levels if v["case"] == "cantilever"])
    if not mine:
        return None
    load = np.geomspace(5e-3, 2e4, 60)
    curve = _line(load, [drop_over_reach(g) for g in load], "", GREY, "heavy elastica: %{y} at Γ = %{x}", mode="lines")
    data = [curve]
    for name in dict.fromkeys(v["model"] for v in mine):
        part = [v for v in mine if v["model"] == name]
        x, y = [v["load"] for v in part], [v["value"] for v in part]
        data.append(_line(x, y, name, look[name], f"{escape(name)}<br>%{{y}} at Γ = %{{x}}", mode="markers"))
    figure = _figure(data, _log("Γ = ρgL³/D"), _log("H/W"))
    return _entry("Cantilever at any load", "Drop over reach on the finest mesh; grey: the heavy elastica.", figure)


def _folds(levels: Levels, look: dict[str, str]) -> dict[str, Any] | None:
    mine = _finest([v for v in levels if v["case"] in ("free_fold", "fold_table")])
    if not mine:
        return None
    height = fold_coefficients()[0]
    units = np.array([0.012, 0.036])
    data = [_line(1e3 * units, 1e3 * height * units, "", GREY, "exact: %{y} mm at %{x} mm", mode="lines")]
    paper = 1e3 * np.array([(1 / (9.81 * f.eta)) ** (1 / 3) for f in FABRICS])
    marks = _line(paper, [1e3 * f.height for f in FABRICS], "", GREY, "%{text}<br>%{y} mm at %{x} mm", mode="markers")
    marks["text"] = [f"{f.name}, paper; exact η_b {eta_of_fold(f.height, height):.3g}" for f in FABRICS]
    marks["marker"]["symbol"] = "cross-thin-open"
    data.append(marks)
    for name in dict.fromkeys(v["model"] for v in mine):
        part = [v for v in mine if v["model"] == name]
        x, y = [1e3 * v["load"] for v in part], [1e3 * v["value"] for v in part]
        data.append(_line(x, y, name, look[name], f"{escape(name)}<br>%{{y}} mm at %{{x}} mm", mode="markers"))
    caption = "Height on the finest mesh; grey line: 0.9066 (D/ρg)^⅓; grey crosses: measured heights of ten fabrics at "
    caption += "the η_b that their paper gives them."
    axes = {"title": {"text": "(D/ρg)^⅓ [mm]"}}, {"title": {"text": "height of the fold [mm]"}}
    return _entry("Free fold", caption, _figure(data, *axes))


def _over_mesh(levels: Levels, look: dict[str, str], case: str, title: str, caption: str) -> dict[str, Any] | None:
    mine = [v for v in levels if v["case"] == case]
    if not mine:
        return None
    along, unit = sorted({v["along"] for v in mine}), mine[0]["unit"]
    exact = [mine[0]["reference"]] * 2
    data = [_line([along[0] / 1.1, along[-1] * 1.1], exact, "", GREY, f"exact: %{{y}} {unit}", mode="lines")]
    for name in dict.fromkeys(v["model"] for v in mine):
        part = [v for v in mine if v["model"] == name]
        x, y = [v["along"] for v in part], [v["value"] for v in part]
        data.append(_line(x, y, name, look[name], f"{escape(name)}<br>%{{y}} {unit} with %{{x}} nodes"))
    quantity = f"{mine[0]['metric'].replace('_', ' ')} [{unit}]"
    return _entry(title, caption, _figure(data, _log(ALONG, along), {"title": {"text": quantity}}))


def _finest(levels: Levels) -> list[dict[str, Any]]:
    """The levels of each cell, load by load, on the finest mesh that gave a number."""
    top: dict[tuple[str, float | None], int] = {}
    for v in levels:
        top[v["key"], v["load"]] = max(v["along"], top.get((v["key"], v["load"]), 0))
    return [v for v in levels if v["along"] == top[v["key"], v["load"]]]


def _entry(title: str, caption: str, figure: dict[str, Any]) -> dict[str, Any]:
    return {"title": title, "caption": caption, "figure": figure}


def _line(x, y, meta: str, colour: str, hover: str, *, dash: str = "solid", mode: str = "lines+markers"):
    return {
        "type": "scatter", "mode": mode, "x": rounded(x, 6), "y": rounded(y, 6), "meta": meta,
        "line": {"color": colour, "dash": dash, "width": 2}, "marker": {"color": colour, "size": 9},
        "hovertemplate": f"{hover}<extra></extra>",
    }  # fmt: skip


def _log(title: str, ticks: Sequence[float] | np.ndarray | None = None) -> dict[str, Any]:
    axis: dict[str, Any] = {"title": {"text": f"{title}, log scale"}, "type": "log"}
    if ticks is not None:
        axis |= {"tickvals": [float(t) for t in ticks], "ticktext": [f"{t:g}" for t in ticks]}
    return axis


def _figure(data: list[dict[str, Any]], x: dict[str, Any], y: dict[str, Any]) -> dict[str, Any]:
    layout = {"height": 380, "xaxis": {"zeroline": False, **x}, "yaxis": {"zeroline": False, **y}}
    return {"data": data, "layout": {**layout, "margin": {"l": 72, "r": 16, "t": 28, "b": 48}}}
