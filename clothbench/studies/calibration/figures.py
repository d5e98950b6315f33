"""The page's figures as plain Plotly dictionaries: data and layout, without colours of text and ground.

One panel per suite, case and metric: the page shows three figures at a time, however many cells there are.
"""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np

from clothbench.display.plotly import COLOURS, GREY, log_axis, rounded
from clothbench.engine.store import Store
from clothbench.studies.calibration.figure_data import cell_tables, series_names
from clothbench.studies.calibration.words import case_name

Rows = Sequence[dict[str, Any]]
DASHES = ("solid", "dash", "dot", "dashdot")
POINTS = 250_000  # of all error traces together, which keeps the page below some 10 MB
SPLITS = {"fit": ("fit", "circle"), "held_out": ("held out", "diamond-open")}


def panels(store: Store, rows: Rows) -> list[dict[str, Any]]:
    """What the page's menu offers: {"title", "case", "metric", "legend", "errors", "convergence", "traces"} per panel.

    traces: figures by recording; legend: [name, colour, dash] per cell, whose lines carry its name as `meta`.
    """
    rows = [r for r in rows if r["recording"] and r["split"] and r["metric"]]  # no run leaves one of the others out
    per_trace = int(np.clip(POINTS / max(len(rows), 1), 40, 400))
    tables = {key: cell_tables(store.cell(key), per_trace) for key in {r["key"] for r in rows}}
    names = series_names(rows, {key: table["metric"] for key, table in tables.items()})
    out, called = [], case_name(rows)
    for suite, case, metric in sorted({(r["suite"], r["case"], r["metric"]) for r in rows}):
        mine = [r for r in rows if (r["suite"], r["case"], r["metric"]) == (suite, case, metric)]
        keys = sorted({r["key"] for r in mine}, key=lambda k: names[k])
        styles = {key: style(number, names[key]) for number, key in enumerate(keys)}
        out.append({
            "title": f"{suite} · {case} · {metric}", "case": called(suite, case), "metric": metric,
            "legend": [[names[k], look["colour"], look["dash"]] for k, look in styles.items()],
            "errors": error_figure(mine, styles),
            "convergence": convergence_figure(metric, styles, tables),
            "traces": trace_figures(metric, mine, styles, tables),
        })  # fmt: skip
    return out


def style(number: int, name: str) -> dict[str, str]:
    dash = DASHES[number // len(COLOURS) % len(DASHES)]
    return {"meta": name, "name": escape(name), "colour": COLOURS[number % len(COLOURS)], "dash": dash}


def error_figure(rows: Rows, styles: dict[str, dict[str, str]]) -> dict[str, Any]:
    """Error of each recording with its interval: a line per recording, a colour per cell."""
    single = sorted(rows, key=lambda r: (r["split"], r["recording"]))
    names = list(dict.fromkeys(r["recording"] for r in single))[::-1]
    values = [r["value"] for r in single if r["value"]]
    log = bool(values) and max(values) > 30 * min(values) > 0
    data = _floors(single, names)
    for number, (key, look) in enumerate(styles.items()):
        up = (0.5 - (number + 0.5) / len(styles)) * 0.7
        for kind, mine in _kinds([r for r in single if r["key"] == key]).items():
            y = [names.index(r["recording"]) + up for r in mine]
            if kind in SPLITS:
                data.append(_dots(mine, look, kind, y))
            else:
                data.append(_failures(mine, look, y, min(values) if log else 0.0))
    line = max(24, 11 * len(styles) + 8)  # px per recording
    layout = {
        "height": int(np.clip(110 + len(names) * line, 240, 2600)),
        "xaxis": _axis(f"error [{single[0]['unit']}]", values if log else None),
        "yaxis": {
            "tickvals": list(range(len(names))), "ticktext": [escape(n) for n in names], "zeroline": False,
            "range": [-0.6, len(names) - 0.4], "automargin": True, "showgrid": False,
        },
    }  # fmt: skip
    return _figure(data, layout)


def _kinds(rows: Rows) -> dict[str, list[dict[str, Any]]]:
    """Rows by split; those without a number apart from them, as "failed"."""
    out: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        out.setdefault("failed" if row["value"] is None else row["split"], []).append(row)
    return out


def _dots(rows: Rows, look: dict[str, str], split: str, y: list[float]) -> dict[str, Any]:
    word, symbol = SPLITS[split]
    value = np.array([r["value"] for r in rows], dtype=float)
    low, high = (np.array([r["value"] if r[n] is None else r[n] for r in rows], dtype=float) for n in ("low", "high"))
    names = [escape(r["recording"]) for r in rows]
    line = {"width": 2, "color": look["colour"]}
    hover = "%{customdata[2]}<br>%{x} " + (rows[0]["unit"] or "") + " (%{customdata[0]:.3g} … %{customdata[1]:.3g})"
    return {
        "type": "scatter", "mode": "markers", "x": rounded(value), "y": y, "meta": look["meta"],
        "marker": {"color": look["colour"], "symbol": symbol, "size": 9, "line": line},
        "error_x": {
            "type": "data", "symmetric": False, "array": rounded(high - value),
            "arrayminus": rounded(value - low), "color": look["colour"], "thickness": 1.6, "width": 3,
        },
        "customdata": [[*pair, name] for *pair, name in zip(rounded(low), rounded(high), names, strict=True)],
        "hovertemplate": f"{look['name']} · {word}<br>{hover}<extra></extra>",
    }  # fmt: skip


def _floors(rows: Rows, names: list[str]) -> list[dict[str, Any]]:
    """A short upright line per recording where the noise alone would put a perfect model."""
    floor = {r["recording"]: r["floor"] for r in rows if r["floor"]}
    if not floor:
        return []
    x, y = [], []
    for name, value in floor.items():
        x += [*rounded([value, value]), None]
        y += [names.index(name) - 0.42, names.index(name) + 0.42, None]
    hover = f"noise floor %{{x}} {rows[0]['unit']}<extra></extra>"
    line = {"color": GREY, "width": 3}
    return [{"type": "scatter", "mode": "lines", "x": x, "y": y, "line": line, "hovertemplate": hover}]


def _failures(rows: Rows, look: dict[str, str], y: list[float], left: float) -> dict[str, Any]:
    """What has no number stands at the left with its status, so that nobody misses it."""
    return {
        "type": "scatter", "mode": "markers+text", "x": [left] * len(rows), "y": y, "meta": look["meta"],
        "text": [f"  {r['status']}" for r in rows], "textposition": "middle right", "cliponaxis": False,
        "marker": {"symbol": "x", "size": 9, "color": look["colour"]}, "hoverinfo": "text",
        "hovertext": [f"{look['name']}: {escape(r['reason'] or r['status'])}" for r in rows],
    }  # fmt: skip


def convergence_figure(metric: str, styles: dict[str, dict[str, str]], tables: dict[str, Any]) -> dict[str, Any] | None:
    """Best value of the fit recordings over evaluations; None for a metric that no cell was fitted by."""
    data, unit = [], ""
    for key, look in styles.items():
        table = tables[key]
        if table["metric"] == metric and table["best"] and table["best"][0]:
            x, y = table["best"]
            line, unit = _line(x, y, look, table["unit"], "evaluation %{x}"), table["unit"]
            line["line"]["shape"] = "hv"
            data.append({**line, "mode": "lines+markers", "marker": {"size": 4}})
    if not data:
        return None
    ends = [v for line in data for v in line["y"]]
    log = min(ends) > 0 and max(ends) > 8 * min(ends)
    y = _axis(f"best error so far [{unit}]", ends if log else None)
    return _figure(data, {"height": 380, "xaxis": _axis("evaluations"), "yaxis": y})


def trace_figures(metric: str, rows: Rows, styles: dict[str, dict[str, str]], tables: dict[str, Any]) -> dict[str, Any]:
    """Error over time, one figure per recording."""
    out = {}
    for name, row in {r["recording"]: r for r in rows}.items():
        data = []
        for key, look in styles.items():
            if trace := tables[key]["traces"].get((metric, name)):
                time, value = trace
                data.append(_line(time, value, look, row["unit"], "%{x} s"))
        if not data:
            continue
        if row["floor"]:
            ends, floor = [data[0]["x"][0], data[0]["x"][-1]], rounded([row["floor"]] * 2)
            look = {"meta": "", "name": "noise floor", "colour": GREY, "dash": "solid"}
            data.append(_line(ends, floor, look, row["unit"], "%{x} s"))
        figures = {i for k in styles for i in tables[k]["published"].get(metric, {}).items()}
        for at, (said, value) in enumerate(
            sorted((name, value) for name, (value, unit) in figures if unit == row["unit"])
        ):
            ends, dash = [data[0]["x"][0], data[0]["x"][-1]], DASHES[1 + at % 3]
            look = {"meta": "", "name": escape(said), "colour": GREY, "dash": dash}
            data.append(_line(ends, [value] * 2, look, row["unit"], "%{x} s"))
        layout = {"height": 380, "xaxis": _axis("time [s]"), "yaxis": _axis(f"error [{row['unit']}]")}
        out[f"{name} ({row['split'].replace('_', ' ')})"] = _figure(data, layout)
    return out


def _line(x: list[Any], y: list[Any], look: dict[str, str], unit: str, at: str) -> dict[str, Any]:
    return {
        "type": "scatter", "mode": "lines", "x": x, "y": y, "meta": look["meta"],
        "line": {"color": look["colour"], "dash": look["dash"], "width": 2},
        "hovertemplate": f"{look['name']}<br>%{{y}} {unit} at {at}<extra></extra>",
    }  # fmt: skip


def _axis(title: str, logarithmic: Sequence[float] | None = None) -> dict[str, Any]:
    """A linear axis from zero, or a logarithmic one with ticks at 1, 2, 5 around the values given."""
    if logarithmic is None:
        return {"title": {"text": title}, "rangemode": "tozero", "zeroline": False}
    return {"title": {"text": f"{title}, log scale"}, **log_axis(logarithmic)}


def _figure(data: list[dict[str, Any]], layout: dict[str, Any]) -> dict[str, Any]:
    return {"data": data, "layout": {**layout, "margin": {"l": 64, "r": 16, "t": 28, "b": 48}}}
