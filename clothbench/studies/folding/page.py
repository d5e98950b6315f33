"""The page's section on folds: the table of fabrics, and figures of estimates, steps and paths."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

from clothbench.core.folding import circular_path, triangular_path
from clothbench.display.html import group, pill, table, text
from clothbench.display.parameters import parameters
from clothbench.display.plotly import COLOURS, GREY, log_axis, rounded
from clothbench.display.section import Section, drawing
from clothbench.engine.study import Results
from clothbench.studies.folding.answer import answer_of
from clothbench.studies.folding.tables import called, has_interval, inside, told_by, with_settings

Rows = Sequence[dict[str, Any]]
INTRO = """<p class="soft">A strip is lifted step by step; after each step its stiffness is estimated from a laser
profile, and the next step follows the estimate. The reference comes from fold heights that were measured by hand, its
range from two standard deviations of these.</p>"""
PATHS = (
    "Where the gripper was sent, between the triangular and the circular path (grey); dotted in the same colour, where "
    "it would have been sent for the reference, in the band of its ± 2σ."
)


def sections(results: Results) -> list[Section]:
    """Everything about folds, and the parameters of the last steps."""
    rows, steps = results.rows, results.table("fold")
    fitted = "<h3>Parameters</h3>" + parameters(rows, results.table("parameters"))
    return [fold_section(rows, steps), Section(fitted)]


def fold_section(rows: Rows, steps: Rows) -> Section:
    suites = ", ".join(sorted({r["suite"] for r in rows}))
    body = f"<h2>{text(suites)}: estimated while folding</h2>{INTRO}{fabrics(rows, steps)}"
    if not steps:
        return Section(body)
    found = ""
    for suite, mine in sorted(group(rows, lambda r: r["suite"]).items()):
        keys = {r["key"] for r in mine}
        found += answer_of(suite, [s for s in steps if s["key"] in keys], mine)
    names = called(rows)
    shown = (
        (last_figure(steps, names), "Reference with its ± 2σ (grey), and the last step's estimate with its interval."),
        (step_figure(steps, names), "The estimate after every step over the reference."),
        (path_figure(steps, names), PATHS),
    )
    figures = "".join(
        f'<figure><figcaption>{text(words)}</figcaption><div id="fold-{n}"></div></figure>'
        for n, (_, words) in enumerate(shown)
    )
    html = f"{found}{body}{figures}"
    return Section(html, {"folds": [figure for figure, _ in shown]}, drawing("folds", "fold-"))


def fabrics(rows: Rows, steps: Rows) -> str:
    """The table: fabric, what else tells cells apart, reference, its range, the estimate of each step, friction."""
    count, rows = max((s["step"] for s in steps), default=0), with_settings(rows)
    about = {"fabric": "case", "model": "model", "optimizer": "optimizer"} | told_by(rows)
    head = [*about, "reference", "± 2σ", *map(str, range(1, count + 1)), "95 % interval", "sheet", "friction",
            "estimation", "status"]  # fmt: skip
    body = []
    for key in dict.fromkeys(r["key"] for r in rows):
        row, mine = next(r for r in rows if r["key"] == key), [s for s in steps if s["key"] == key]
        names = [text(row[n]) for n in about.values()]
        if not mine:
            body.append([*names, *[""] * (count + 6), pill(row) + f"<br><small>{text(row['reason'])}</small>"])
            continue
        last = mine[-1]
        told = [f"{s['value']:.3g}" for s in mine]
        if row["status"] == "ok":  # where a time limit stopped it, it is no last step
            told[-1] = f"<b>{told[-1]}</b>" + ("" if inside(last) else " outside")
        known = [f"{last['reference']:.2g}", f"{last['reference_low']:.2g} … {last['reference_high']:.2g}"]
        ends = f"{last['low']:.3g} … {last['high']:.3g}" if has_interval(last) else "no interval"
        sure = [ends, f"{last['sheet']:.3g}"]
        effort = [f"{max(s['friction'] for s in mine):.2f}", f"{sum(s['wall_s'] for s in mine):.1f} s", pill(row)]
        body.append([*names, *known, *told, *[""] * (count - len(told)), *sure, *effort])
    return table(head, body, numeric=set(range(len(about), len(about) + count + 6)))


def last_figure(steps: Rows, called: Mapping[str, str]) -> dict[str, Any]:
    """Estimates of the last step beside the references. called: what cells are called, by key."""
    last = list({s["key"]: s for s in steps}.values())
    names = [escape(called[s["key"]]) for s in last]
    data = []
    for value, ends, colour, symbol, side, word in (
        ("reference", ("reference_low", "reference_high"), GREY, "cross", 0.12, "reference"),
        ("value", ("low", "high"), COLOURS[0], "circle", -0.12, "estimate"),
    ):
        middle, low, high = (np.array([s[n] for s in last], dtype=float) for n in (value, *ends))
        data.append({
            "type": "scatter", "mode": "markers", "y": [n + side for n in range(len(last))], "x": rounded(middle),
            "marker": {"color": colour, "symbol": symbol, "size": 9}, "text": names,
            "error_x": {"type": "data", "symmetric": False, "array": rounded(np.nan_to_num(high - middle)),
                        "arrayminus": rounded(np.nan_to_num(middle - low)), "color": colour},
            "hovertemplate": f"%{{text}}, {word}: %{{x:.3g}}<extra></extra>",
        })  # fmt: skip
    known = [s[n] for s in last for n in ("reference", "reference_low", "reference_high", "value", "low", "high")]
    known = [value for value in known if value is not None]
    y = {"tickvals": list(range(len(last))), "ticktext": names, "automargin": True, "zeroline": False}
    return _figure(data, 120 + 34 * len(last), {"title": {"text": "η_b [m⁻⁴ s²]"}, **log_axis(known)}, y)


def step_figure(steps: Rows, names: Mapping[str, str]) -> dict[str, Any]:
    """Estimate over reference, step by step."""
    data = []
    for n, key in enumerate(dict.fromkeys(s["key"] for s in steps)):
        mine = [s for s in steps if s["key"] == key]
        ratio = np.array([s["value"] / s["reference"] for s in mine])
        data.append(_line([s["step"] for s in mine], rounded(ratio), n, names[key], "%{y:.2f} at step %{x}"))
    y = {"title": {"text": "estimate over reference"}, **log_axis(s["value"] / s["reference"] for s in steps)}
    return _figure(data, 380, {"title": {"text": "step"}, "zeroline": False, "dtick": 1}, y, legend=True)


def path_figure(steps: Rows, names: Mapping[str, str]) -> dict[str, Any]:
    """The gripper's path of every fold between the two geometrical ones, those of every length of strip, and beside
    those of its reference, as in figure 9 of Petrík et al.
    """
    data = []
    lengths = group(steps, lambda s: float(s["length"]))
    for length, some in sorted(lengths.items()):
        height = np.linspace(0.0, min(max(s["z"] for s in some), length / 2), 60)  # as high as either path goes
        for path, dash, name in ((triangular_path, "dash", "triangular"), (circular_path, "dot", "circular")):
            told = f"{name}, {length:g} m" if len(lengths) > 1 else name
            data.append({"type": "scatter", "mode": "lines", "x": rounded(path(length, height)), "y": rounded(height),
                         "line": {"color": GREY, "dash": dash, "width": 2}, "name": told})  # fmt: skip
    folds = list(group(steps, lambda s: s["key"]).items())
    for n, (key, mine) in enumerate(folds):
        data += _reference(mine, n, key, escape(names[key]))
    for n, (key, mine) in enumerate(folds):
        x, z = ([mine[0]["length"], *(s["x"] for s in mine)], [0.0, *(s["z"] for s in mine)])
        line = _line(rounded(x), rounded(z), n, names[key], "x %{x:.3f} m, z %{y:.3f} m")
        data.append({**line, "legendgroup": key})
    y = {"title": {"text": "z [m]"}, "scaleanchor": "x", "zeroline": False}
    return _figure(data, 520, {"title": {"text": "x [m]"}, "zeroline": False}, y, legend=True)


def _reference(steps: Rows, number: int, key: str, name: str) -> list[dict[str, Any]]:
    """Where the gripper would have been sent for what a fold's fabric is known by, and for the ends of its range; shown
    and hidden with the fold. Nothing where no step has it: older versions kept none.
    """
    columns = ("reference_x", "reference_x_low", "reference_x_high")
    known = [s for s in steps if all(s.get(column) is not None for column in columns)]
    if not known:
        return []
    middle, low, high = (rounded([known[0]["length"], *(s[column] for s in known)]) for column in columns)
    z = rounded([0.0, *(s["z"] for s in known)])
    line = {"color": COLOURS[number % len(COLOURS)], "dash": "dot", "width": 2}
    drawn = {"type": "scatter", "mode": "lines", "legendgroup": key, "showlegend": False, "hoverinfo": "skip"}
    band = {"x": [*low, *high[::-1]], "y": [*z, *z[::-1]], "fill": "toself", "opacity": 0.3, "name": f"{name}, ± 2σ"}
    return [
        {**drawn, **band, "line": {**line, "width": 0}},
        {**drawn, "x": middle, "y": z, "line": line, "name": f"{name}, reference"},
    ]


def _line(x: Sequence[Any], y: Sequence[Any], number: int, name: str, hover: str) -> dict[str, Any]:
    return {
        "type": "scatter", "mode": "lines+markers", "x": x, "y": y, "name": escape(name),
        "line": {"color": COLOURS[number % len(COLOURS)], "dash": "solid" if number < len(COLOURS) else "dash"},
        "hovertemplate": f"{escape(name)}: {hover}<extra></extra>",
    }  # fmt: skip


def _figure(data: list[dict[str, Any]], height: int, x: dict, y: dict, legend: bool = False) -> dict[str, Any]:
    layout = {"height": height, "xaxis": x, "yaxis": y, "showlegend": legend}
    return {"data": data, "layout": {**layout, "margin": {"l": 64, "r": 16, "t": 28, "b": 48}}}
