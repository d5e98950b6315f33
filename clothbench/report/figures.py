"""The page's figures as plain Plotly dictionaries: data and layout, without colours of text and ground.

One panel per suite, case and metric: the page shows three figures at a time, however many cells there are.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from clothbench.experiment.store import Store, read_table

Rows = Sequence[dict[str, Any]]
# Mid tones: at least 3:1 against a white and a near-black ground, and apart for the colour-blind.
COLOURS = ("#0077bb", "#d55e00", "#009e73", "#b8559a", "#a67c00", "#6a6fd0", "#3a93a5", "#b5523b")
GREY = "#8a8f98"
DASHES = ("solid", "dash", "dot", "dashdot")
POINTS = 250_000  # of all error traces together, which keeps the page below some 10 MB
SPLITS = {"fit": ("fit", "circle"), "held_out": ("held out", "diamond-open")}


def panels(store: Store, rows: Rows) -> list[dict[str, Any]]:
    """What the page's menu offers: per panel {"title", "legend", "errors", "convergence", "traces": {recording: …}}.

    legend: [name, colour, dash] of each cell; the lines and dots of a cell carry its name as `meta`.
    """
    per_trace = int(np.clip(POINTS / max(sum(bool(r["recording"]) for r in rows), 1), 40, 400))
    tables = {key: cell_tables(store.cell(key), per_trace) for key in {r["key"] for r in rows}}
    names = series_names(rows, {key: table["metric"] for key, table in tables.items()})
    out = []
    for suite, case, metric in sorted({(r["suite"], r["case"], r["metric"]) for r in rows if r["recording"]}):
        mine = [r for r in rows if (r["suite"], r["case"], r["metric"]) == (suite, case, metric)]
        keys = sorted({r["key"] for r in mine if r["recording"]}, key=lambda k: names[k])
        styles = {key: style(number, names[key]) for number, key in enumerate(keys)}
        out.append({
            "title": f"{suite} · {case} · {metric}",
            "legend": [[names[k], look["colour"], look["dash"]] for k, look in styles.items()],
            "errors": error_figure(mine, styles),
            "convergence": convergence_figure(metric, styles, tables),
            "traces": trace_figures(metric, mine, styles, tables),
        })  # fmt: skip
    return out


def series_names(rows: Rows, metrics: dict[str, str]) -> dict[str, str]:
    """What each cell is called in a figure: model and optimizer, and what else it takes to tell it from its rivals.

    metrics: which metric each cell was fitted by.
    """
    about = {r["key"]: r for r in rows}
    names = {k: f"{model_name(r)} · {r['optimizer']}" for k, r in about.items()}
    for further in (lambda r: f"fitted by {metrics[r['key']]}", lambda r: f"seed {r['seed']}", lambda r: r["key"][:6]):
        rivals: dict[tuple[str, str, str], set[str]] = {}
        for k, r in about.items():
            rivals.setdefault((r["suite"], r["case"], names[k]), set()).add(further(r))
        names = {
            k: f"{names[k]} · {further(r)}" if len(rivals[r["suite"], r["case"], names[k]]) > 1 else names[k]
            for k, r in about.items()
        }
    return names


def model_name(row: dict[str, Any]) -> str:
    return row["model"] + "".join(f"+{e}" for e in (row["effects"] or "").split(",") if e)


def style(number: int, name: str) -> dict[str, str]:
    dash = DASHES[number // len(COLOURS) % len(DASHES)]
    return {"meta": name, "name": escape(name), "colour": COLOURS[number % len(COLOURS)], "dash": dash}


def cell_tables(folder: Path, points: int) -> dict[str, Any]:
    """History and traces of one cell: {"metric", "unit", "best": (x, y), "traces": {(metric, recording): (t, y)}}."""
    rows = read_table(folder / "rows.parquet").slice(0, 1).to_pylist()[0]  # the metric it was fitted by comes first
    out: dict[str, Any] = {"metric": rows["metric"], "unit": rows["unit"], "best": None, "traces": {}}
    if (path := folder / "history.parquet").is_file():
        out["best"] = best_so_far(read_table(path)["value"].to_numpy().astype(float))
    if (path := folder / "trace.parquet").is_file():
        for (metric, recording), part in read_table(path).to_pandas().groupby(["metric", "recording"], sort=False):
            out["traces"][metric, recording] = thinned(part["time"].to_numpy(), part["value"].to_numpy(float), points)
    return out


def best_so_far(value: np.ndarray) -> tuple[list[int], list[float]]:
    """Evaluations (1, 2, …) at which the best value fell, and that value; the last evaluation closes the curve."""
    lowest = np.fmin.accumulate(value) if len(value) else value
    known = np.flatnonzero(np.isfinite(lowest))
    if not known.size:
        return [], []
    falls = [i for n, i in enumerate(known) if n == 0 or lowest[i] < lowest[known[n - 1]] or i == known[-1]]
    return [int(i) + 1 for i in falls], rounded(lowest[falls])


def thinned(time: np.ndarray, value: np.ndarray, points: int) -> tuple[list[float], list[float | None]]:
    """A trace of at most `points` points, each the mean of a stretch of frames; where nothing was seen, None."""
    stretch = -(-len(time) // points)
    starts = np.arange(0, len(time), stretch)
    seen = np.add.reduceat(np.isfinite(value), starts, dtype=float)
    total = np.add.reduceat(np.nan_to_num(value), starts)
    middle = np.add.reduceat(time, starts) / np.diff([*starts, len(time)])
    return rounded(middle, 5), rounded(np.divide(total, seen, out=np.full(len(starts), np.nan), where=seen > 0))


def rounded(values: Any, digits: int = 4) -> list[Any]:
    return [float(f"{v:.{digits}g}") if np.isfinite(v) else None for v in np.asarray(values, dtype=float)]


def error_figure(rows: Rows, styles: dict[str, dict[str, str]]) -> dict[str, Any]:
    """Error of each recording with its interval: a row per recording, a colour per cell, a shape per split."""
    single = [r for r in rows if r["recording"]]
    names = list(dict.fromkeys(r["recording"] for r in sorted(single, key=lambda r: (r["split"], r["recording"]))))[::-1]
    offset = {k: (0.5 - (n + 0.5) / len(styles)) * 0.7 for n, k in enumerate(styles)}
    data = []
    for key, look in styles.items():
        for split, (word, symbol) in SPLITS.items():
            mine = [r for r in single if r["key"] == key and r["split"] == split and r["value"] is not None]
            if mine:
                data.append(_dots(mine, look, word, symbol, [names.index(r["recording"]) + offset[key] for r in mine]))
    data += _floors(single, names) + _failures(single, names, offset, styles)
    values = [r["value"] for r in single if r["value"]]
    log = bool(values) and max(values) > 30 * min(values)
    unit = single[0]["unit"]
    layout = {
        "height": int(min(max(260, 110 + len(names) * max(22, 11 * len(styles) + 8)), 2600)),
        "xaxis": _axis(f"error [{unit}]", values if log else None),
        "yaxis": {"tickvals": list(range(len(names))), "ticktext": [escape(n) for n in names], "zeroline": False,
                  "range": [-0.6, len(names) - 0.4], "automargin": True, "showgrid": False},
    }  # fmt: skip
    return _figure(data, layout)


def _dots(rows: Rows, look: dict[str, str], split: str, symbol: str, y: list[float]) -> dict[str, Any]:
    value = np.array([r["value"] for r in rows])
    low, high = (np.array([r[n] if r[n] is not None else r["value"] for r in rows], dtype=float) for n in ("low", "high"))
    return {
        "type": "scatter", "mode": "markers", "x": rounded(value), "y": y, "meta": look["meta"],
        "marker": {"color": look["colour"], "symbol": symbol, "size": 9, "line": {"width": 2, "color": look["colour"]}},
        "error_x": {"type": "data", "symmetric": False, "array": rounded(high - value), "arrayminus": rounded(value - low),
                    "color": look["colour"], "thickness": 1.6, "width": 3},
        "customdata": [[r["low"], r["high"], escape(r["recording"])] for r in rows],
        "hovertemplate": f"%{{customdata[2]}}<br>{look['name']} · {split}<br>"
                         f"%{{x}} {rows[0]['unit']} (%{{customdata[0]:.3g}} … %{{customdata[1]:.3g}})<extra></extra>",
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
    return [{"type": "scatter", "mode": "lines", "x": x, "y": y, "line": {"color": GREY, "width": 3},
             "hovertemplate": f"noise floor %{{x}} {rows[0]['unit']}<extra></extra>"}]  # fmt: skip


def _failures(rows: Rows, names: list[str], offset: dict[str, float], styles: dict[str, dict[str, str]]) -> list[dict[str, Any]]:
    """What has no number stands at the left with its status, so that it is missed by no one."""
    bad = [r for r in rows if r["value"] is None]
    if not bad:
        return []
    known = [r["value"] for r in rows if r["value"]]
    left = min(known) if known and max(known) > 30 * min(known) else 0
    return [{
        "type": "scatter", "mode": "markers+text", "x": [left] * len(bad),
        "y": [names.index(r["recording"]) + offset[r["key"]] for r in bad], "text": [f" {r['status']}" for r in bad],
        "textposition": "middle right", "marker": {"symbol": "x", "size": 9, "color": [styles[r["key"]]["colour"] for r in bad]},
        "hovertext": [f"{styles[r['key']]['name']}: {escape(r['reason'] or r['status'])}" for r in bad], "hoverinfo": "text",
    }]  # fmt: skip


def convergence_figure(metric: str, styles: dict[str, dict[str, str]], tables: dict[str, Any]) -> dict[str, Any] | None:
    """Best value of the fit recordings over evaluations; None for a metric that no cell was fitted by."""
    data, unit = [], ""
    for key, look in styles.items():
        table = tables[key]
        if table["metric"] == metric and table["best"] and table["best"][0]:
            x, y = table["best"]
            data.append(_line(x, y, look, table["unit"], "evaluation %{x}") | {"mode": "lines+markers", "marker": {"size": 4}})
            data[-1]["line"]["shape"], unit = "hv", table["unit"]
    if not data:
        return None
    ends = [v for line in data for v in line["y"]]
    log = min(ends) > 0 and max(ends) > 8 * min(ends)
    y = _axis(f"best error so far [{unit}]", ends if log else None)
    return _figure(data, {"height": 380, "xaxis": _axis("evaluations"), "yaxis": y})


def trace_figures(metric: str, rows: Rows, styles: dict[str, dict[str, str]], tables: dict[str, Any]) -> dict[str, Any]:
    """Error over time, one figure per recording."""
    out = {}
    for name, row in {r["recording"]: r for r in rows if r["recording"]}.items():
        data = []
        for key, look in styles.items():
            if trace := tables[key]["traces"].get((metric, name)):
                data.append(_line(*trace, look, row["unit"], "%{x} s"))
        if data:
            if row["floor"]:
                ends = [data[0]["x"][0], data[0]["x"][-1]]
                floor = {"meta": "", "name": "noise floor", "colour": GREY, "dash": "solid"}
                data.append(_line(ends, rounded([row["floor"]] * 2), floor, row["unit"], "%{x} s"))
            split = SPLITS.get(row["split"] or "", (row["split"], ""))[0]
            layout = {"height": 380, "xaxis": _axis("time [s]"), "yaxis": _axis(f"error [{row['unit']}]") | {"rangemode": "tozero"}}
            out[f"{name} ({split})"] = _figure(data, layout)
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
    decades = range(math.floor(math.log10(min(logarithmic))), math.ceil(math.log10(max(logarithmic))) + 1)
    ticks = [digit * 10.0**decade for decade in decades for digit in (1, 2, 5)]
    text = [f"{tick:g}" for tick in ticks]
    return {"title": {"text": f"{title}, log scale"}, "type": "log", "tickvals": ticks, "ticktext": text, "zeroline": False}


def _figure(data: list[dict[str, Any]], layout: dict[str, Any]) -> dict[str, Any]:
    return {"data": data, "layout": {**layout, "margin": {"l": 64, "r": 16, "t": 28, "b": 48}}}
