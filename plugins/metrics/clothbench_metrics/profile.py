"""`profile`: how far measured points that have no identity are from the simulated surface."""

from __future__ import annotations

import math

import numpy as np

from clothbench import ClothbenchError, Observation, Rollout, Score


class Profile:
    """J = ½ Σ d(z, S)² over the measured points z, d the distance to the simulated surface S; summed in each frame,
    averaged over the frames (Petrík et al., Automatic Material Properties Estimation for the Physics-Based Robotic
    Garment Folding, eq. 7 and 8).

    S is given by points. The paper takes the nearest of a fine grid; here the two nearest are joined by a straight
    line if they are no further apart than `join` [m]: with the nearest alone, a surface that slides along itself would
    seem to resist.
    """

    name = "profile"
    version = 1
    unit = "m^2"

    def __init__(self, join: float = 2e-3):
        if not isinstance(join, int | float) or isinstance(join, bool) or not 0 <= join < math.inf:
            raise ClothbenchError(f"profile: join is {join!r}, expected metres, 0 or above")
        self.join = float(join)

    def __call__(self, observation: Observation, rollout: Rollout) -> Score:
        if observation.sight is not None:
            raise ClothbenchError("profile: the points were seen in a picture, which has no depth; take node_error")
        members, frames, seen = len(rollout), len(observation.time), observation.visible
        watched = np.flatnonzero(seen.any(axis=1))
        per_frame = np.full((members, frames), np.nan)
        away = []
        for b in range(members):
            found = [nearest(rollout.position[b, t], observation.position[t, seen[t]], self.join) for t in watched]
            per_frame[b, watched] = [float((d**2).sum()) / 2 for d in found]
            away.append(np.concatenate(found).ravel() if found else np.zeros(0))
        value = per_frame[:, watched].mean(axis=1) if watched.size else np.full(members, np.nan)
        return Score(value, self.unit, per_frame, None, np.array(away))

    def floor(self, observation: Observation) -> float:
        """Not known: noise along the surface does not count, and which way the surface lies is the rollout's affair."""
        return math.nan


def nearest(surface: np.ndarray, points: np.ndarray, join: float) -> np.ndarray:
    """From points (N, 3) m to the nearest of a surface given by points (M, 3) m, (N, 3).

    Not a number where the surface is not whole: a point that is not a number has spoilt the simulation.
    """
    from scipy.spatial import cKDTree

    if not np.isfinite(surface).all():
        return np.full_like(points, np.nan)
    _, index = cKDTree(surface).query(points, k=min(2, len(surface)))
    index = index.reshape(len(points), -1)
    first, along = surface[index[:, 0]], surface[index[:, -1]] - surface[index[:, 0]]
    square = (along**2).sum(axis=1)
    joined = (square > 0) & (square <= join**2)
    share = ((points - first) * along).sum(axis=1) / np.where(joined, square, 1.0)
    return first + np.where(joined, np.clip(share, 0.0, 1.0), 0.0)[:, None] * along - points
