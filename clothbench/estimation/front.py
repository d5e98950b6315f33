"""Several objectives at once: which parameter sets are on the front, and which of them is chosen."""

from __future__ import annotations

import numpy as np

CHOICES = ("nearest", "knee")


def on_front(objectives: np.ndarray) -> np.ndarray:
    """Which of the rows (E, M), lower is better, no other row is at least as good in all and better in one: (E,) bool.

    Rows that are not finite are never on it; of equal rows all are.
    """
    known = np.flatnonzero(np.isfinite(objectives).all(axis=1))
    rows, of_rows = np.unique(objectives[known], axis=0, return_inverse=True)  # by the first objective, then the next
    best = np.zeros(len(rows), dtype=bool)
    for k, row in enumerate(rows):  # only rows before this one can be better, and of these only those on the front
        best[k] = not (rows[:k][best[:k]] <= row).all(axis=1).any()
    out = np.zeros(len(objectives), dtype=bool)
    out[known] = best[of_rows.ravel()]
    return out


def chosen(objectives: np.ndarray, value: np.ndarray, choice: str) -> int:
    """The number of the row that is taken for the best, of objectives (E, M) with scalarised value (E,).

    "nearest": the least value on the front (off it one may have less still: the mean over recordings of a root mean
    square does not follow from the mean objectives); "knee": the row of the front with the least sum of its objectives,
    each counted from its least (0) to its greatest (1) on the front: of two the one that lies farthest below the line
    through the extremes (Das 1999, On characterizing the "knee" of the Pareto curve; of more the plane through theirs
    may be another); where they all have one extreme, the nearest.
    """
    finite = np.where(np.isfinite(value), value, np.inf)
    front = np.flatnonzero(on_front(objectives))
    if not len(front):
        return int(finite.argmin())
    if choice == "nearest" or len(front) < 2:
        return int(front[finite[front].argmin()])
    rows = objectives[front]
    least, span = rows.min(axis=0), np.ptp(rows, axis=0)
    share = np.divide(rows - least, span, out=np.zeros_like(rows), where=span > 0)
    return int(front[share.sum(axis=1).argmin()])
