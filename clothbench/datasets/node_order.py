"""Number a measured square lattice alike in all frames: rows downwards, columns along the width."""

from __future__ import annotations

import numpy as np


def symmetries(frame: np.ndarray) -> list[np.ndarray]:
    """The eight ways to number a square lattice (n, n, ...): transposed or not, each axis either way."""
    out = []
    for grid in (frame, frame.swapaxes(0, 1)):
        out += [grid, grid[::-1], grid[:, ::-1], grid[::-1, ::-1]]
    return out


def upright_score(grid: np.ndarray, right: np.ndarray) -> float:
    """How well columns run along `right` (3,) and rows run down, for a lattice (n, n, 3) in m."""
    along = np.nanmean(grid[:, -1] - grid[:, 0], axis=0) @ right
    down = -np.nanmean(grid[-1] - grid[0], axis=0)[2]
    return float(np.nan_to_num(along) + np.nan_to_num(down))


def put_in_order(frames: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, int]:
    """Lattices (T, n, n, 3) with rows going down and columns along the cloth's width; how many were numbered
    unlike the first.

    The first frame is decided by `right` (3,), the direction of the upper edge at rest, and by gravity.
    Later ones take the numbering nearest to the frame before: between frames (0.1 s) no corner gets half-way
    to another one, while "largest z on top" fails as soon as the cloth rolls by 45°.
    """
    ordered, ways_taken = np.empty_like(frames), []
    before: np.ndarray | None = None
    for t, frame in enumerate(frames):
        ways = symmetries(frame)
        if before is None:
            best = int(np.argmax([upright_score(way, right) for way in ways]))
        else:
            best = int(np.argmin([_distance(way, before) for way in ways]))
        ordered[t] = ways[best]
        ways_taken.append(best)
        if np.isfinite(frame).all(axis=-1).mean() > 0.5:
            before = np.where(np.isfinite(ordered[t]), ordered[t], np.nan if before is None else before)
    return ordered, sum(way != ways_taken[0] for way in ways_taken)


def _distance(grid: np.ndarray, before: np.ndarray) -> float:
    squares = ((grid - before) ** 2).sum(axis=-1)
    return float(np.nanmean(squares)) if np.isfinite(squares).any() else 0.0
