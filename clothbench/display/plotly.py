"""What all figures share: colours, and numbers as a page can hold them."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

# Mid tones: at least 3:1 against a white and a near-black ground, and apart for the colour-blind.
COLOURS = ("#0077bb", "#d55e00", "#009e73", "#b8559a", "#a67c00", "#6a6fd0", "#3a93a5", "#b5523b")
GREY = "#8a8f98"
CLOSE = 5.0  # times the least of an axis's values, from which on the greatest leaves room for 1, 2 and 5
ALIKE = 1.001  # times it, up to which all may be drawn as one value, of so many digits
LEGEND = {"showlegend": True, "legend": {"orientation": "h", "yanchor": "bottom", "y": 1}}  # above a figure
VIRIDIS = ("#440154", "#3b528b", "#21918c", "#5ec962", "#fde725")  # five points of the scale, from low to high


def thinned(time: np.ndarray, value: np.ndarray, points: int) -> tuple[list[float], list[float | None]]:
    """A trace of at most `points` points: means of stretches of frames; None where nothing was seen."""
    stretch = -(-len(time) // points)
    starts = np.arange(0, len(time), stretch)
    seen = np.add.reduceat(np.isfinite(value), starts, dtype=float)
    total = np.add.reduceat(np.nan_to_num(value), starts)
    middle = np.add.reduceat(time, starts) / np.diff([*starts, len(time)])
    mean = np.divide(total, seen, out=np.full(len(starts), np.nan), where=seen > 0)
    return rounded(middle, 5), rounded(mean)


def log_axis(values: Iterable[float]) -> dict[str, Any]:
    """A logarithmic axis with ticks at 1, 2 and 5 of each decade around some values above 0: plotly's own say of ticks
    within a decade only their first digit. Where values lie close plotly has ticks as on a linear axis, in full; around
    a single one its axis is two decades long.
    """
    known = [v for v in values if np.isfinite(v) and v > 0] or [1.0]
    axis: dict[str, Any] = {"type": "log", "zeroline": False}
    if ALIKE * min(known) < max(known) < CLOSE * min(known):
        return axis
    decades = range(math.floor(math.log10(min(known))), math.ceil(math.log10(max(known))) + 1)
    ticks = [digit * 10.0**decade for decade in decades for digit in (1, 2, 5)]
    return axis | {"tickvals": ticks, "ticktext": [f"{tick:g}" for tick in ticks]}


def rounded(values: Any, digits: int = 4) -> list[Any]:
    return [float(f"{v:.{digits}g}") if np.isfinite(v) else None for v in np.asarray(values, dtype=float)]
