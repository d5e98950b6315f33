"""The page's section on trial-by-trial fits and their analyses: tables, bars, maps, and which fabric is nearest."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from clothbench.display.html import group, table, text
from clothbench.display.plotly import COLOURS
from clothbench.display.section import Section, later
from clothbench.display.templates import rendered
from clothbench.studies.calibration.analysis_tables import MISSING, MUCH, NO_BARS, missing, percent, spread, unit_of
from clothbench.studies.calibration.matrix import HOTTEST
from clothbench.studies.calibration.ranking import cell_names
from clothbench.studies.calibration.transfer import Confusion, Transfer, confusions, transfers
from clothbench.studies.calibration.words import listed

Rows = Sequence[dict[str, Any]]
MANY = 6  # figures of one kind that all are shown at once
VARIABILITY = f"""By how many percent a parameter has to change to change the error by 1 %. Low: well determined. Tall:
not determined; what would take more than {MUCH:g} % is drawn as that."""
SENSITIVITY = {
    "morris": """How much the error depends on each parameter over its whole range. μ*: mean size of its elementary
effects, tall is important; σ: how much they differ from place to place, tall means curved, or bound up with others.
Whisker of μ*: its 95 % interval; of σ none is known.""",
    "sobol": """Shares of the error's variance over the whole ranges. S1: by this parameter alone; ST: with all that it
is bound up with. Near 0: the data say nothing about it. Whiskers: 95 % intervals.""",
}
MAP = """The error over the ranges of two parameters, the others at their best; dark is low. A dark valley that runs
across the map is a combination that the data do not tell apart."""
SCRIPT = """
const analyses = JSON.parse(document.getElementById("analyses").textContent);
const drawAnalyses = () => analyses.forEach((figure, n) => draw("analysis-" + n, figure));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawAnalyses);
drawAnalyses();
"""


def analysis_section(rows: Rows, tables: dict[str, Rows]) -> Section | None:
    """Everything about transfer and analyses; None where there is nothing."""
    about, moved = cell_names(rows), transfers(rows, tables["starts"])
    matrices = confusions(tables["confusion"], rows, tables["starts"])
    parts = ["<h2>Which fabric is it?</h2>"] if matrices else []
    parts += [confusion(c, title=len(matrices) > 1) for c in matrices]
    parts += [f"<h2>Trial by trial</h2>{transfer(moved)}"] if moved else []
    parts += [repeats(tables["repeats"], about)] if tables["repeats"] else []
    shown = variability_figures(tables["variability"], about)
    units = {r["key"]: r["unit"] for r in rows if r["metric"] == r["objective"] and r["unit"]}
    shown += sensitivity_figures(tables["sensitivity"], about, units) + map_figures(tables["map"], about)
    parts += [f'<p class="soft">{text(reason)}</p>' for reason in missing(tables, about, MISSING | NO_BARS)]
    if not parts and not shown:
        return None
    numbered = [{**one, "number": n} for n, one in enumerate(shown)]
    kinds = group(numbered, lambda one: one["title"].partition(":")[0])
    parts += [figures_of(some) for some in kinds.values()]
    if not moved:
        parts.insert(len(matrices) + bool(matrices), "<h2>What else was asked of the fits</h2>")
    html = "".join(parts)
    return Section(html, {"analyses": [one["figure"] for one in shown]}, SCRIPT) if shown else Section(html)


def figures_of(some: Rows) -> str:
    """Figures of one kind: what they show is said once, and of many all but the first are folded away."""
    drawn = [
        f"<h3>{text(one['title'])}</h3><figure>{noted(one.get('note', ''))}"
        f'<div id="analysis-{one["number"]}"></div></figure>'
        for one in some
    ]
    about = f'<p class="soft">{text(some[0]["about"])}</p>'
    first, _, rest = drawn[0].partition("<figure>")
    drawn[0] = f"{first}{about}<figure>{rest}"
    if len(drawn) <= MANY:
        return "".join(drawn)
    kind = text(some[0]["title"].partition(":")[0])
    folded = f"<details><summary>{kind} of {len(drawn) - 1} more fits</summary>{''.join(drawn[1:])}</details>"
    return drawn[0] + folded


def noted(said: str) -> str:
    return f"<figcaption>{text(said)}</figcaption>" if said else ""


def transfer(moved: Sequence[Transfer]) -> str:
    body: list[list[str]] = []
    for way in dict.fromkeys(t.way for t in moved):
        body.append([text(f"{way} [{unit_of(moved, way)}]")])
        for t in (t for t in moved if t.way == way):
            others = ", ".join(f"{text(n.rpartition('/')[2])} {_number(e)}" for n, e in t.errors.items() if n != t.case)
            total = f"<b>{_number(t.total)} ✓</b>" if t.chosen else _number(t.total)
            body.append([text(t.case), _number(t.start), _number(t.errors[t.case]), others, total])
    head = ["fitted to", "start", "optimised", "the same parameters elsewhere", "E1 + E2"]
    note = (
        '<p class="soft">Error where the search set out from, at its result, and what that result makes of recordings '
    )
    note += "it never saw. ✓: the fit with the least sum over the trials of its group.</p>"
    return note + later(table(head, body, numeric={1, 2, 4}))


def confusion(c: Confusion, title: bool) -> str:
    """A heat map: a line for each recorded fabric, a column for each fabric's parameters; with a title, if wanted."""
    lines = []
    for recorded in c.fabrics:
        errors = [c.error[s].get(recorded) for s in c.fabrics]
        least = min((e for e in errors if e is not None), default=0.0)
        lines.append((recorded, [(_number(e), heat(e, least), e == least) for e in errors]))
    return rendered(Path(__file__).parent, "confusion.html", found=c, lines=lines, title=title)


def heat(error: float | None, least: float) -> float:
    """Share [%] of the heat's colour: none at the least error of a line, all of it from four times that on."""
    if not error or not least:
        return 0.0
    return round(min(math.log2(error / least) / 2, 1.0) * HOTTEST, 1)


def repeats(rows: Rows, about: dict[str, str]) -> str:
    body: list[list[str]] = []
    for key in dict.fromkeys(r["key"] for r in rows if not r["reason"]):
        mine = [r for r in rows if r["key"] == key]
        body.append([text(about[key])])
        for name in dict.fromkeys(r["name"] for r in mine):
            values = [r["value"] for r in mine if r["name"] == name]
            first = next(r for r in mine if r["name"] == name)
            fits = ", ".join(map(_number, values))
            body.append(
                [f"{text(name)} [{text(first['unit'])}]", _number(first["start"]), fits, text(percent(spread(values)))]
            )
        errors = list({r["repeat"]: r["error"] for r in mine}.values())
        fits, unit = ", ".join(map(_number, errors)), text(mine[0]["error_unit"])
        body.append([f"error [{unit}]", _number(mine[0]["error_start"]), fits, text(percent(spread(errors)))])
    head = ["parameter", "start", "fits from starts within ±5 %", "spread"]
    body += [[text(f"{about[r['key']]}: {r['reason']}")] for r in rows if r["reason"]]
    return "<h3>Repeated fits</h3>" + table(head, body, numeric={1, 3}) if body else ""


def variability_figures(rows: Rows, about: dict[str, str]) -> list[dict[str, Any]]:
    """Bars per cell: the change that changes the error by 1 %; low is well determined, tall is not (figure 11)."""
    out = []
    for key in dict.fromkeys(r["key"] for r in rows):
        mine = [r for r in rows if r["key"] == key and r["percent"] is not None]
        if mine:
            heights = [min(r["percent"], MUCH) for r in mine]
            said = {"text": [percent(r["percent"]) for r in mine], "hovertemplate": "%{x}: %{text}<extra></extra>"}
            look = {"type": "bar", "marker": {"color": COLOURS[0]}}
            bars = {**look, "x": [r["name"] for r in mine], "y": heights, **said}
            layout = _layout("", "change [%]", 360)
            out.append({"title": f"Variability: {about[key]}", "about": VARIABILITY,
                        "figure": {"data": [bars], "layout": layout}})  # fmt: skip
    return out


def sensitivity_figures(rows: Rows, about: dict[str, str], units: Mapping[str, str]) -> list[dict[str, Any]]:
    """Bars per cell and method; once of cells for which they are the same, as whoever searched has no part in it.
    units: of the error, by the key of a cell.
    """
    found: dict[tuple[Any, ...], list[str]] = {}
    known = [r for r in rows if r["main"] is not None]
    for (key, method), mine in group(known, lambda r: (r["key"], r["method"])).items():
        bars = tuple(tuple(r[n] for n in ("name", "main", "main_half", "total", "total_half")) for r in mine)
        found.setdefault((method, units.get(key, ""), bars), []).append(key)
    out = []
    for (method, unit, bars), keys in found.items():
        others = f" (and {len(keys) - 1} more of the same)" if len(keys) > 1 else ""
        title = f"Sensitivity ({method}): {about[keys[0]]}{others}"
        figure = bars_of(method, unit, bars)
        out.append({"title": title, "about": SENSITIVITY[method], "figure": figure, "note": too_few(method, bars)})
    return out


def bars_of(method: str, unit: str, bars: Sequence[tuple[Any, ...]]) -> dict[str, Any]:
    """Two bars for each parameter, with whiskers where half widths are known. bars: (name, main, half, total, half)."""
    words, names = ("μ*", "σ") if method == "morris" else ("S1", "ST"), [bar[0] for bar in bars]
    data = []
    for word, colour, at in zip(words, COLOURS, (1, 3), strict=False):
        drawn = {"type": "bar", "x": names, "y": [bar[at] for bar in bars], "marker": {"color": colour},
                 "hovertemplate": f"{word} of %{{x}}: %{{y:.3g}}<extra></extra>"}  # fmt: skip
        halves = [bar[at + 1] for bar in bars]
        if any(half is not None for half in halves):
            drawn["error_y"] = {"type": "data", "array": halves}
        data.append(drawn)
    measured = f" [{unit}]" if method == "morris" and unit else ""
    layout = _layout("", f"{words[0]} (first bar), {words[1]}{measured}", 360)
    return {"data": data, "layout": {**layout, "barmode": "group"}}


def too_few(method: str, bars: Sequence[tuple[Any, ...]]) -> str:
    """A word on shares that cannot be, by more than their half widths; "" where there are none."""
    if method != "sobol":
        return ""

    def cannot_be(share: float | None, half: float | None) -> bool:
        return share is not None and (share + (half or 0.0) < 0 or share - (half or 0.0) > 1)

    beyond = [name for name, *shares in bars if cannot_be(*shares[:2]) or cannot_be(*shares[2:])]
    said = "a share below 0 or above 1 by more than its interval, which cannot be: there are too few samples"
    return f"{listed(beyond)}: {said} (analysis.sobol.samples)." if beyond else ""


def map_figures(rows: Rows, about: dict[str, str]) -> list[dict[str, Any]]:
    """The error over two parameters, dark is low (figure 3)."""
    out = []
    for key in dict.fromkeys(r["key"] for r in rows if not r["reason"]):
        mine = [r for r in rows if r["key"] == key]
        x, y = (sorted({r[n] for r in mine}) for n in ("x", "y"))
        at = {(r["x"], r["y"]): r["error"] for r in mine}
        first, scale = mine[0], {"title": {"text": f"error [{mine[0]['unit']}]"}}
        drawn = {"type": "heatmap", "x": x, "y": y, "z": [[at[a, b] for a in x] for b in y], "colorscale": "Greys",
                 "reversescale": True, "colorbar": scale}  # fmt: skip
        layout = _layout(f"{first['x_name']} [{first['x_unit']}]", f"{first['y_name']} [{first['y_unit']}]", 460)
        for axis, values in (("xaxis", x), ("yaxis", y)):
            if min(values) > 0 and max(values) > 30 * min(values):
                layout[axis] |= {"type": "log"}
        out.append({"title": f"Error over two parameters: {about[key]}", "about": MAP,
                    "figure": {"data": [drawn], "layout": layout}})  # fmt: skip
    return out


def _layout(across: str, up: str, height: int) -> dict[str, Any]:
    axes = {
        "xaxis": {"title": {"text": across}, "zeroline": False, "automargin": True},
        "yaxis": {"title": {"text": up}, "zeroline": False},
    }
    return {**axes, "height": height, "margin": {"l": 72, "r": 16, "t": 28, "b": 56}}


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.4g}"
