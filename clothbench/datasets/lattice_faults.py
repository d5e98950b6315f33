"""Faults that no cloth could show: single nodes that jumped, whole sheets that are torn."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import maximum_filter

# In spacings: a fold of one spacing's radius lifts a node by half a spacing above its neighbours' mean.
JUMP = 0.6
TORN = 1.6


def jumped(frames: np.ndarray) -> np.ndarray:
    """Nodes (T, n, n) bool that stand out from their neighbours by more than `JUMP` spacings.

    Inside, against the mean of the four neighbours; on the outline, of the two along it; at a corner, against
    the parallelogram of the three next to it, with twice the room, for contours are rounded there.
    """
    expected = np.full_like(frames, np.nan)
    expected[:, 1:-1, 1:-1] = (frames[:, 1:-1, :-2] + frames[:, 1:-1, 2:]) / 4
    expected[:, 1:-1, 1:-1] += (frames[:, :-2, 1:-1] + frames[:, 2:, 1:-1]) / 4
    for edge in (0, -1):
        expected[:, edge, 1:-1] = (frames[:, edge, :-2] + frames[:, edge, 2:]) / 2
        expected[:, 1:-1, edge] = (frames[:, :-2, edge] + frames[:, 2:, edge]) / 2
    room = np.full(frames.shape[1:3], JUMP)
    for i, j in ((0, 1), (-1, -2)):
        for k, m in ((0, 1), (-1, -2)):
            expected[:, i, k] = frames[:, i, m] + frames[:, j, k] - frames[:, j, m]
            room[i, k] = 2 * JUMP
    spacing = np.nanmedian(np.linalg.norm(np.diff(frames, axis=1), axis=-1))
    miss = np.nan_to_num(np.linalg.norm(frames - expected, axis=-1))
    # A node that jumped makes its neighbours look odd as well: the worst one around is the one to blame.
    return (miss > room * spacing) & (miss >= maximum_filter(miss, size=(1, 3, 3)))


def torn(frames: np.ndarray, side: float) -> np.ndarray:
    """Which lattices (T, n, n, 3) have half a row or more of edges longer than cloth allows.

    `TORN` spacings leave room for a corner that slipped a sixth of a side, which stretches labels as much.
    """
    n = frames.shape[1]
    down = np.linalg.norm(np.diff(frames, axis=1), axis=-1).reshape(len(frames), -1)
    across = np.linalg.norm(np.diff(frames, axis=2), axis=-1).reshape(len(frames), -1)
    long = np.concatenate([down, across], axis=1) > TORN * side / (n - 1)
    return 2 * long.sum(axis=1) >= n
