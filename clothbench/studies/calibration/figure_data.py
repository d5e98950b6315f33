"""What the figures draw, read from the store: curves thinned to what a page can hold, and names for cells."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from clothbench.display.names import model_name
from clothbench.display.plotly import rounded, thinned
from clothbench.engine.leaderboard import ROWS
from clothbench.engine.tables import read_table
from clothbench.studies.calibration.schema import HISTORY, PUBLISHED, TRACE

Rows = Sequence[dict[str, Any]]


def series_names(rows: Rows, metrics: dict[str, str]) -> dict[str, str]:
    """What each cell is called in a figure: model, optimizer, and what else tells it from its rivals.

    metrics: which metric each cell was fitted by.
    """
    about = {r["key"]: r for r in rows}
    names = {k: f"{model_name(r)} · {r['optimizer']}" for k, r in about.items()}
    marks = (
        lambda r: f"fitted by {metrics[r['key']]}",
        lambda r: f"seed {r['seed']}",
        lambda r: r.get("told") or "",
        lambda r: r["key"][:6],
    )
    for further in marks:
        rivals: dict[tuple[str, str, str], set[str]] = {}
        for k, r in about.items():
            rivals.setdefault((r["suite"], r["case"], names[k]), set()).add(further(r))
        names = {
            k: f"{names[k]} · {further(r)}".removesuffix(" · ")
            if len(rivals[r["suite"], r["case"], names[k]]) > 1
            else names[k]
            for k, r in about.items()
        }
    return names


def cell_tables(folder: Path, points: int) -> dict[str, Any]:
    """One cell's curves: {"metric", "unit", "best": (x, y), "traces": {(metric, recording): (t, y)},
    "published": {metric: {name: (value, unit)}}}.
    """
    first = read_table(folder / "rows.parquet", ROWS).slice(0, 1).to_pylist()[0]  # of the metric it was fitted by
    out: dict[str, Any] = {
        "metric": first["metric"],
        "unit": first["unit"],
        "best": None,
        "traces": {},
        "published": {},
    }
    if (path := folder / "published.parquet").is_file():
        for line in read_table(path, PUBLISHED).to_pylist():
            out["published"].setdefault(line["metric"], {})[line["name"]] = (line["value"], line["unit"])
    if (path := folder / "history.parquet").is_file():
        out["best"] = best_so_far(read_table(path, HISTORY)["value"].to_numpy().astype(float))
    if (path := folder / "trace.parquet").is_file():
        frames = read_table(path, TRACE).to_pandas()
        for name, part in frames.groupby(["metric", "recording"], sort=False):
            out["traces"][name] = thinned(part["time"].to_numpy(float), part["value"].to_numpy(float), points)
    return out


def best_so_far(value: np.ndarray) -> tuple[list[int], list[float]]:
    """Evaluations (1, 2, …) at which the best value fell, and that value; the last one closes the curve."""
    lowest = np.fmin.accumulate(value) if len(value) else value
    known = np.flatnonzero(np.isfinite(lowest))
    if not known.size:
        return [], []
    falls = [i for n, i in enumerate(known) if n == 0 or lowest[i] < lowest[known[n - 1]] or i == known[-1]]
    return [int(i) + 1 for i in falls], rounded(lowest[falls])
