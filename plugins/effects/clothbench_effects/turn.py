"""Rotation of points about an axis, and the middle of all that was seen, for effects that turn or scale."""

import numpy as np


def turned(position: np.ndarray, centre: np.ndarray, axis: np.ndarray, angle: float) -> np.ndarray:
    """Points (..., 3) m turned by `angle` rad about `axis`, unit, through `centre`; both broadcast (Rodrigues).

    About an axis of zeros nothing turns.
    """
    arm = position - centre
    axis = np.broadcast_to(axis, arm.shape)
    across = np.cross(axis, arm)
    return position + np.sin(angle) * across + (1.0 - np.cos(angle)) * np.cross(axis, across)


def middle(position: np.ndarray) -> np.ndarray:
    """Centroid (3,) m of all positions (T, N, 3) m that are finite: a run that diverged has others."""
    finite = np.isfinite(position).all(axis=-1)
    return position[finite].mean(axis=0) if finite.any() else np.zeros(3)
