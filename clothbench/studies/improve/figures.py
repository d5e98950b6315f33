"""Figures of `clothbench improve` as plain Plotly dictionaries, from the rows of its tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

from clothbench.core.statistics import repeated
from clothbench.display.html import group
from clothbench.display.plotly import COLOURS, GREY, rounded, thinned

Rows = Sequence[dict[str, Any]]
Figure = dict[str, Any]
Limits = Sequence[tuple[str, float]]  # what an error cannot be told from: words and size, in the error's unit
BEFORE, AFTER = {"name": "before", "colour": COLOURS[1]}, {"name": "after", "colour": COLOURS[0]}
ONLY = {"name": "calibrated", "colour": COLOURS[1]}
PLACEBO = {"name": "with a sham effect on top", "colour": COLOURS[3]}
LIMIT_DASHES = ("solid", "dot")  # of noise, and of noise and mesh together
MEASURED = {"name": "measured", "colour": COLOURS[2]}
POINTS = 400  # of one curve
SPLIT_WORDS = {"fit": "fit", "held_out": "held out"}
MAP_SIZE = 230  # px, about what the longer side of the cloth gets on the map


def series(changed: bool) -> list[tuple[str, dict[str, str]]]:
    """(column, look) of each curve; where nothing was named there is one only."""
    return [("before", BEFORE), ("after", AFTER)] if changed else [("before", ONLY)]


def limit_looks(limits: Limits) -> list[tuple[float, dict[str, str]]]:
    """(size, look) of each line that stands for what an error cannot be told from."""
    dashes = zip(limits, LIMIT_DASHES, strict=False)
    return [(value, {"name": name, "colour": GREY, "dash": dash}) for (name, value), dash in dashes]


def limit_lines(x: Any, limits: Limits, unit: str) -> list[Figure]:
    """Level lines from the first to the last x."""
    return [curve([x[0], x[-1]], [v] * 2, look, f"%{{y}} {unit}") for v, look in limit_looks(limits)]


def error_figure(errors: Rows, total: Mapping[str, Any], limits: Limits, changed: bool) -> Figure:
    """Each recording's error before and after, joined by a line; above them what the recordings of a split have
    together, with the placebo; upright lines at the limits. total: errors of the verdict, with their unit.
    """
    unit = total["unit"]
    lines: list[tuple[str, float, float, str]] = []
    for split, word in SPLIT_WORDS.items():  # from below: the held-out recordings stand on top
        mine = [r for r in reversed(errors) if r["split"] == split]
        lines += [(label(r), r["before"], r["after"], split) for r in mine]
        if len(mine) > 1:
            lines.append((f"<b>all {word}</b>", total[split]["before"], total[split]["after"], split))
    names = [name for name, *_ in lines]
    data = []
    if changed:
        x = [v for _, a, b, _ in lines for v in (a, b, None)]
        y = [v for k in range(len(lines)) for v in (k, k, None)]
        data.append(curve(x, y, {"name": "", "colour": GREY}, hover=None, width=1.5))
    for column, (_, look) in enumerate(series(changed), 1):
        marks = curve([line[column] for line in lines], list(range(len(lines))), look, f"%{{x}} {unit}", mode="markers")
        marks["marker"] |= {"size": 11, "symbol": ["circle" if s == "fit" else "diamond" for *_, s in lines]}
        data.append(marks)
    if placebo := total["held_out"].get("placebo"):
        row = max(k for k, line in enumerate(lines) if line[3] == "held_out")
        mark = curve([placebo["after"]], [row], PLACEBO, f"{escape(placebo['name'])}: %{{x}} {unit}", "markers")
        mark["marker"] |= {"size": 12, "symbol": "x-thin", "line": {"width": 3, "color": PLACEBO["colour"]}}
        data.append(mark)
    ends = [-0.5, len(lines) - 0.5]
    data += [curve([v] * 2, ends, look, f"%{{x}} {unit}", width=3) for v, look in limit_looks(limits)]
    y_axis = {"tickvals": list(range(len(names))), "ticktext": names, "automargin": True, "showgrid": False,
              "range": [-0.6, len(names) - 0.4]}  # fmt: skip
    return figure(data, f"error, rms [{unit}]", y_axis, height=int(np.clip(90 + 30 * len(names), 200, 1600)))


def frame_figures(frames: Rows, limits: Limits, changed: bool) -> dict[str, list[Figure]]:
    """Error over time of each recording."""
    out = {}
    for name, mine in by_recording(frames).items():
        time = np.array([r["time"] for r in mine])
        data = []
        for column, look in series(changed):
            x, y = thinned(time, np.array([np.nan if r[column] is None else r[column] for r in mine]), POINTS)
            data.append(curve(x, y, look, f"%{{y}} {mine[0]['unit']} at %{{x}} s"))
        data += limit_lines(time, limits, mine[0]["unit"])
        out[name] = [figure(data, "time [s]", {"title": {"text": f"error, rms [{mine[0]['unit']}]"}}, height=330)]
    return out


def map_figures(nodes: Rows, changed: bool) -> dict[str, list[Figure]]:
    """The cloth, laid flat, with every node coloured by its error: all recordings together, then each."""
    views = {}
    together = group(nodes, lambda r: (round(r["u"], 6), round(r["v"], 6)))
    recordings = {r["recording"] for r in nodes}
    if len(recordings) > 1 and all(len(rows) == len(recordings) for rows in together.values()):
        views["all recordings"] = [pooled(rows) for rows in together.values()]
    views |= by_recording(nodes)
    out = {}
    for name, rows in views.items():
        columns = series(changed)
        top = max([r[c] for r in rows for c, _ in columns if r[c] is not None], default=1.0)
        out[name] = [cloth(rows, column, look["name"], top) for column, look in columns]
    return out


def cloth(rows: Rows, column: str, word: str, top: float) -> Figure:
    """One map; v points down as on the hanging cloth."""
    known = [r for r in rows if r[column] is not None]
    u, v = ([1e3 * r[n] for r in known] for n in ("u", "v"))
    unit = rows[0]["unit"]
    across, down = (float(np.ptp(x)) if x else 1.0 for x in (u, v))
    pitch = (max(across, 1e-9) * max(down, 1e-9) / max(len(known), 1)) ** 0.5
    size = MAP_SIZE * pitch / max(across, down, 1e-9)
    bar = {"title": {"text": unit}, "thickness": 12, "outlinewidth": 0}
    marks = {
        "type": "scatter", "mode": "markers", "x": rounded(u), "y": rounded(v), "meta": word,
        "marker": {
            "color": rounded([r[column] for r in known], 3), "colorscale": "Viridis", "cmin": 0, "cmax": top,
            "symbol": "square", "size": float(np.clip(0.95 * size, 5, 60)), "colorbar": bar,
        },
        "hovertemplate": f"%{{marker.color}} {unit} at u = %{{x}} mm, v = %{{y}} mm<extra>{word}</extra>",
    }  # fmt: skip
    pad = 0.7 * pitch
    y_axis = {"title": {"text": "v, down [mm]"}, "scaleanchor": "x", "constrain": "domain", "showgrid": False,
              "range": [max(v, default=0.0) + pad, min(v, default=0.0) - pad]}  # fmt: skip
    out = figure([marks], "u, along the warp [mm]", y_axis, height=390)
    x_range = [min(u, default=0.0) - pad, max(u, default=0.0) + pad]
    out["layout"]["xaxis"] |= {"showgrid": False, "constrain": "domain", "range": x_range}
    out["layout"] |= {"title": {"text": word, "x": 0.5, "font": {"size": 14}}}
    out["layout"]["margin"] |= {"t": 40}
    return out


def direction_figures(portrait: Rows, changed: bool) -> dict[str, list[Figure]]:
    """The residual along the sheet's normal, warp and weft: of each split together, then of each recording."""
    views: dict[str, Rows] = {}
    for split, word in SPLIT_WORDS.items():
        mine = [r for r in portrait if r["split"] == split]
        if len({r["recording"] for r in mine}) > 1:
            views[f"all {word}"] = mine
    views |= by_recording(portrait)
    return {name: [directions(rows, changed)] for name, rows in views.items()}


def directions(rows: Rows, changed: bool) -> Figure:
    data, unit = [], rows[0]["unit"]
    for fit, look in series(changed):
        mine = [r for r in rows if r["fit"] == fit]
        known = {n: [r[n] ** 2 for r in mine if r[n] is not None] for n in ("normal", "warp", "weft")}
        y = [float(np.sqrt(np.mean(squares))) if squares else np.nan for squares in known.values()]
        data.append({
            "type": "bar", "x": ["normal", "warp", "weft"], "y": rounded(y), "meta": look["name"],
            "text": [f"{v:.2f}" if np.isfinite(v) else "" for v in y], "textposition": "outside", "cliponaxis": False,
            "marker": {"color": look["colour"]}, "hovertemplate": f"{look['name']}: %{{y}} {unit}<extra></extra>",
        })  # fmt: skip
    return figure(data, "direction", {"title": {"text": f"rms of the component [{unit}]"}}, height=320)


def against_figures(bins: Rows, limits: Limits, changed: bool) -> list[Figure]:
    """Error against speed, acceleration and height, all recordings together."""
    out = []
    for name, mine in group(bins, lambda r: r["against"]).items():
        places = group(mine, lambda r: (r["low"], r["high"]))
        joined = [(low, high, pooled(rows)) for (low, high), rows in places.items()]
        joined = [(low, high, row) for low, high, row in sorted(joined, key=lambda j: j[0]) if row["coordinates"]]
        if not joined:
            continue
        x = [(low + high) / 2 for low, high, _ in joined]
        data = []
        for column, look in series(changed):
            y = [row[column] for *_, row in joined]
            data.append(curve(x, y, look, f"%{{y}} {mine[0]['unit']} at %{{x}} {mine[0]['against_unit']}",
                              "lines+markers"))  # fmt: skip
        data += limit_lines(x, limits, mine[0]["unit"])
        title = f"{name} [{mine[0]['against_unit']}]"
        out.append(figure(data, title, {"title": {"text": f"error, rms [{mine[0]['unit']}]"}}, height=270))
    return out


def curve_figures(curves: Rows, changed: bool) -> dict[str, list[Figure]]:
    """Force over stretch of each recording: what was measured, and the model."""
    out = {}
    for name, rows in by_recording(curves).items():
        x, unit = [r["stretch"] for r in rows], rows[0]["unit"]
        data = [curve(x, [r["force"] for r in rows], MEASURED, f"%{{y}} {unit} at %{{x}}", "markers")]
        data += [curve(x, [r[c] for r in rows], look, f"%{{y}} {unit} at %{{x}}") for c, look in series(changed)]
        view = figure(data, "stretch: length over the unloaded length", {"title": {"text": f"force [{unit}]"}}, 420)
        view["layout"]["xaxis"] |= {"rangemode": "normal"}
        out[name] = [view]
    return out


def not_moved(mine: Rows) -> np.ndarray:
    """Which of the values of one parameter, fitted to single recordings, a search never left."""
    return repeated(np.array([r["value"] for r in mine]), mine[0]["joint"])


def drift_figures(drift: Rows) -> dict[str, list[Figure]]:
    """Each parameter as fitted to single recordings, beside the joint value and its interval."""
    out = {}
    for name, mine in group(drift, lambda r: r["name"]).items():
        first, ends = mine[0], [-0.5, len(mine) - 0.5]
        data = []
        if first["low"] is not None and first["high"] is not None:
            band = curve([first["low"], first["high"], first["high"], first["low"]], [ends[0], ends[0], *ends[1:] * 2],
                         BEFORE, None, width=0)  # fmt: skip
            data.append({**band, "fill": "toself", "fillcolor": "rgba(213,94,0,0.15)", "hoverinfo": "skip"})
        unit = "" if first["unit"] == "1" else f" {first['unit']}"
        data.append(curve([first["joint"]] * 2, ends, BEFORE, f"all together: %{{x}}{unit}"))
        marks = curve([r["value"] for r in mine], list(range(len(mine))), AFTER, f"alone: %{{x}}{unit}", "markers")
        looks = zip(mine, not_moved(mine), strict=True)
        symbols = ["diamond" if r["outside"] else "circle-open" if still else "circle" for r, still in looks]
        marks["marker"] |= {"size": 10, "symbol": symbols}
        data.append({**marks, "meta": "alone"})
        y_axis = {"tickvals": list(range(len(mine))), "ticktext": [escape(r["recording"]) for r in mine],
                  "automargin": True, "showgrid": False, "range": ends}  # fmt: skip
        title = f"{escape(first['symbol'])} ({escape(name)})" + (f" [{first['unit']}]" if unit else "")
        height = int(np.clip(90 + 26 * len(mine), 200, 1200))
        view = figure(data, title, y_axis, height=height)
        view["layout"]["xaxis"] |= padded([first, *mine], first["scale"] == "log")
        out[name] = [view]
    return out


def padded(rows: Rows, log: bool) -> dict[str, Any]:
    """An axis that ends a little beyond all values and the joint interval."""
    ends = [r[n] for r in rows for n in ("value", "joint", "low", "high") if r[n] is not None]
    scaled = np.log10([v for v in ends if v > 0]) if log else np.array(ends)
    pad = 0.06 * float(np.ptp(scaled)) or 0.1
    span = [float(scaled.min() - pad), float(scaled.max() + pad)]
    return {"type": "log" if log else "linear", "range": span, "rangemode": "normal"}


def kernel_figure(kernel: Rows) -> Figure:
    """The kernel of the missing force over lag, with the spread between recordings as a band."""
    x = [r["lag"] for r in kernel]
    band = curve(x + x[::-1], [r["high"] for r in kernel] + [r["low"] for r in reversed(kernel)], AFTER, None, width=0)
    line = curve(x, [r["value"] for r in kernel], AFTER, "%{y} kg/(m²·s) after %{x} s", "lines+markers")
    filled = {**band, "fill": "toself", "fillcolor": "rgba(0,119,187,0.18)", "hoverinfo": "skip"}
    y_axis = {"title": {"text": "K [kg/(m²·s)]"}, "rangemode": "normal", "zeroline": True}
    return figure([filled, {**line, "meta": "kernel"}], "lag [s]", y_axis, height=300)


WITH_WORDS = 1.8  # length of an axis over that of its longest bar, so that words beside it have room on a phone


def stage_figure(stages: Rows) -> Figure:
    """Seconds by stage, the first above; beside each bar seconds and evaluations, for which there is room."""
    rows = list(reversed(stages))
    text = [f"{r['wall_s']:.1f} s, {r['evaluations']}" for r in rows]
    bars = {
        "type": "bar", "orientation": "h", "x": rounded([r["wall_s"] for r in rows]), "text": text, "meta": "stages",
        "y": [escape(r["stage"]) for r in rows], "marker": {"color": COLOURS[6]}, "textposition": "outside",
        "hovertemplate": "%{y}: %{text} evaluations<extra></extra>", "cliponaxis": False,
    }  # fmt: skip
    y_axis = {"automargin": True, "showgrid": False, "type": "category"}
    shown = figure([bars], "wall time [s]", y_axis, height=int(np.clip(90 + 30 * len(rows), 180, 900)))
    shown["layout"]["xaxis"]["range"] = [0.0, WITH_WORDS * max([r["wall_s"] for r in rows] + [1e-3])]
    return shown


def pooled(rows: Rows) -> dict[str, Any]:
    """Several rows of a table as one: squares weighted by their numbers of coordinates."""
    out = {**rows[0], "coordinates": sum(r["coordinates"] for r in rows)}
    for column in ("before", "after"):
        known = [r for r in rows if r[column] is not None]
        count = sum(r["coordinates"] for r in known)
        out[column] = (sum(r["coordinates"] * r[column] ** 2 for r in known) / count) ** 0.5 if count else None
    return out


def by_recording(rows: Rows) -> dict[str, list[dict[str, Any]]]:
    """Rows by "name (split)", held-out recordings first: they decide."""
    found = group(rows, label)
    return dict(sorted(found.items(), key=lambda item: item[1][0]["split"] == "fit"))


def label(row: dict[str, Any]) -> str:
    return f"{escape(row['recording'])} ({SPLIT_WORDS.get(row['split'], row['split'])})"


def curve(x: Any, y: Any, look: dict[str, str], hover: str | None, mode: str = "lines", width: float = 2) -> Figure:
    """A line or marks; `meta` is what the legend switches it off by."""
    out = {
        "type": "scatter", "mode": mode, "x": with_gaps(x), "y": with_gaps(y), "meta": look["name"],
        "line": {"color": look["colour"], "width": width, "dash": look.get("dash", "solid")},
        "marker": {"color": look["colour"], "size": 7},
    }  # fmt: skip
    if hover is None:
        return {**out, "hoverinfo": "skip"}
    return {**out, "hovertemplate": f"{hover}<extra>{look['name']}</extra>"}


def with_gaps(values: Any) -> list[float | None]:
    return rounded([np.nan if v is None else v for v in values], 5)


def figure(data: list[Figure], x_title: str, y_axis: dict[str, Any], height: int) -> Figure:
    x_axis = {"title": {"text": x_title}, "zeroline": False, "rangemode": "tozero"}
    y_axis = {"zeroline": False, "rangemode": "tozero", **y_axis}
    margin = {"l": 64, "r": 16, "t": 16, "b": 48}
    return {"data": data, "layout": {"height": height, "xaxis": x_axis, "yaxis": y_axis, "margin": margin}}
