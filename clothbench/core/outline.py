"""Outlines of cloth that is no rectangle: simple polygons in the flat sheet's own coordinates."""

from __future__ import annotations

import numpy as np

from clothbench.core.errors import ClothbenchError

CORNERS = 360  # of the polygon that stands for a disc, whose area is 0.005 % below the disc's


def disc_outline(radius: float, corners: int = CORNERS) -> np.ndarray:
    """A disc that touches the four sides of its sheet, (corners, 2) m: its middle is at (radius, radius)."""
    turn = 2 * np.pi * np.arange(corners) / corners
    return radius * (1 + np.stack([np.cos(turn), np.sin(turn)], axis=1))


def signed_area(outline: np.ndarray) -> float:
    """Area of a polygon (M, 2) m, below 0 where its corners run clockwise [m²]."""
    x, y = outline.T
    return float(0.5 * (x * np.roll(y, -1) - np.roll(x, -1) * y).sum())


def checked_outline(outline: np.ndarray, width: float, height: float) -> np.ndarray:
    """The outline (M, 2) m, counter-clockwise, or a line that says why it is none of a sheet of that size [m]."""
    outline = np.array(outline, dtype=float)
    if outline.ndim != 2 or outline.shape[1] != 2 or len(outline) < 3 or not np.isfinite(outline).all():
        raise ClothbenchError(
            f"outline: found an array of shape {outline.shape}, expected at least three corners (u, v) [m], finite"
        )
    slack = 1e-9 * max(width, height)
    if outline.min() < -slack or (outline > np.array([width, height]) + slack).any():
        raise ClothbenchError(
            f"outline: corners reach from {outline.min(axis=0)} to {outline.max(axis=0)} m, expected them within the "
            f"sheet of {width:g} × {height:g} m"
        )
    if crossing := _crossing(outline):
        raise ClothbenchError(f"outline: sides {crossing[0]} and {crossing[1]} cross, expected a simple polygon")
    area = signed_area(outline)
    if abs(area) < 1e-6 * width * height:
        raise ClothbenchError(f"outline: encloses {abs(area):g} m², expected a polygon with an area")
    if touching := _touching(outline, slack):
        raise ClothbenchError(
            f"outline: corner {touching[0]} lies on side {touching[1]}, expected a simple polygon that touches itself "
            "nowhere, each corner stated once; take the corner out, or move it"
        )
    return outline if area > 0 else outline[::-1].copy()


def first_off(outline: np.ndarray, points: np.ndarray, slack: np.ndarray) -> int | None:
    """Number of the first of some points (N, 2) m that lies outside the outline (M, 2) m and farther from it than
    `slack` (2,) m along u and v; None if there is none.
    """
    for k in np.flatnonzero(~within(outline, points)):
        if _apart(outline / slack, points[k : k + 1] / slack).min() > 1:
            return int(k)
    return None


def _apart(outline: np.ndarray, points: np.ndarray) -> np.ndarray:
    """How far points (N, 2) m are from each side of an outline (M, 2) m, (M, N) m."""
    side = np.roll(outline, -1, axis=0) - outline
    to = points[None] - outline[:, None]  # from the begin of each side to each point, (side, point, 2)
    along = (to * side[:, None]).sum(axis=-1) / np.maximum((side**2).sum(axis=-1), 1e-300)[:, None]
    return np.linalg.norm(to - np.clip(along, 0.0, 1.0)[..., None] * side[:, None], axis=-1)


def _touching(outline: np.ndarray, slack: float) -> tuple[int, int] | None:
    """The first corner that lies within `slack` m of a side that does not end in it, and that side; None of a simple
    polygon.
    """
    away = _apart(outline, outline).T
    corner = np.arange(len(outline))
    away[corner, corner] = away[corner, corner - 1] = np.inf
    found = np.argwhere(away <= slack)
    return (int(found[0, 0]), int(found[0, 1])) if len(found) else None


def _crossing(outline: np.ndarray) -> tuple[int, int] | None:
    """The first two sides that cross each other properly; None of a simple polygon."""
    start, end = outline, np.roll(outline, -1, axis=0)

    def side_of(a: np.ndarray, b: np.ndarray, p: np.ndarray) -> np.ndarray:
        """On which side of lines a → b (M, 2) points p (K, 2) lie, (M, K)."""
        along, to = b - a, p[None] - a[:, None]
        return np.sign(along[:, :1] * to[:, :, 1] - along[:, 1:] * to[:, :, 0])

    cut = side_of(start, end, start) * side_of(start, end, end) < 0
    found = np.argwhere(cut & cut.T)
    return (int(found[0, 0]), int(found[0, 1])) if len(found) else None


def covered(outline: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """How much of each box between lines at u (K,) and v (L,) m lies within the outline (M, 2): (L − 1, K − 1) m².

    Exact: the area of what lies left of a and below b is −∮ min(y, b) dx along the outline as far as x < a, a sum over
    its sides; boxes are differences of such quadrants.
    """
    (x0, y0), (x1, y1) = outline.T, np.roll(outline, -1, axis=0).T
    steep = np.divide(y1 - y0, x1 - x0, out=np.zeros_like(x0), where=x1 != x0)
    quadrant = np.empty((len(v), len(u)))
    for k, a in enumerate(u):
        begin, end = np.minimum(x0, a), np.minimum(x1, a)
        low, high = y0 + steep * (begin - x0), y0 + steep * (end - x0)
        quadrant[:, k] = -((end - begin) * _mean_of_least(low, high, v[:, None])).sum(axis=1)
    return np.maximum(np.diff(np.diff(quadrant, axis=0), axis=1), 0.0)


def _mean_of_least(low: np.ndarray, high: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The mean of min(y, b) while y goes evenly from `low` to `high` (M,), for each b (L, 1)."""
    p, q = low - b, high - b
    over_p, over_q, run = np.maximum(p, 0.0), np.maximum(q, 0.0), p - q
    even = np.abs(run) < 1e-12
    above = np.where(even, (over_p + over_q) / 2, (over_p**2 - over_q**2) / (2 * np.where(even, 1.0, run)))
    return (low + high) / 2 - above


def within(outline: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Which points (N, 2) m lie within the outline, (N,) bool, by the parity of the sides to their right."""
    (x0, y0), (x1, y1) = outline.T, np.roll(outline, -1, axis=0).T
    x, y = points[:, :1], points[:, 1:]
    spans = (y0 <= y) != (y1 <= y)
    at = x0 + (y - y0) * np.divide(x1 - x0, y1 - y0, out=np.zeros_like(x0), where=y1 != y0)
    return (spans & (x < at)).sum(axis=1) % 2 == 1
