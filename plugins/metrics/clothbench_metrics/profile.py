"""`profile`: how far measured points that have no identity are from the simulated surface."""

from __future__ import annotations

import math

import numpy as np

from clothbench import ClothbenchError, Observation, Rollout, Score


class Profile:
    """J = ½ Σ d(z, S)² over the measured points z, d the distance to the simulated surface S; summed in each frame,
    averaged over the frames (Petrík et al., Automatic Material Properties Estimation for the Physics-Based Robotic
    Garment Folding, eq. 7 and 8).

    S is given by points, in order along the sheet. The paper takes the nearest of a fine grid; here straight lines join
    it to the points before and after it, unless they are further apart than `join` [m]: with the nearest alone, a
    surface that slides along itself would seem to resist. What comes near in space only, as the layer of a fold does on
    another, is not joined; of a surface that is coarser than `join`, the points alone count.
    """

    name = "profile"
    version = 2
    unit = "m^2"

    def __init__(self, join: float = 2e-3):
        if not isinstance(join, int | float) or isinstance(join, bool) or not 0 <= join < math.inf:
            raise ClothbenchError(f"profile: join is {join!r}, expected metres, 0 or above")
        self.join = float(join)

    def __call__(self, observation: Observation, rollout: Rollout) -> Score:
        if observation.sight is not None:
            raise ClothbenchError("profile: the points were seen in a picture, which has no depth; take node_error")
        members, frames, seen = len(rollout), len(observation.time), observation.visible
        if rollout.position.shape[1] != frames:
            raise ClothbenchError(
                f"profile: found a rollout of {rollout.position.shape[1]} frames, expected {frames} as observed"
            )
        watched = np.flatnonzero(seen.any(axis=1))
        per_frame = np.full((members, frames), np.nan)
        away = []
        for b in range(members):
            found = [nearest(rollout.position[b, t], observation.position[t, seen[t]], self.join) for t in watched]
            per_frame[b, watched] = [float((d**2).sum()) / 2 for d in found]
            away.append(np.concatenate(found).ravel() if found else np.zeros(0))
        value = per_frame[:, watched].mean(axis=1) if watched.size else np.full(members, np.nan)
        return Score(value, self.unit, per_frame, None, np.array(away).reshape(members, -1 if members else 0))

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
    _, index = cKDTree(surface).query(points)
    beside = (np.clip(index + k, 0, len(surface) - 1) for k in (-1, 1))
    before, after = (_to_segment(surface[index], surface[number], points, join) for number in beside)
    return np.where((np.square(before).sum(axis=1) <= np.square(after).sum(axis=1))[:, None], before, after)


def _to_segment(first: np.ndarray, second: np.ndarray, points: np.ndarray, join: float) -> np.ndarray:
    """From points (N, 3) m to the segments between two points (N, 3) m each, or to the first where these are further
    apart than `join` m, (N, 3).
    """
    along = second - first
    square = (along**2).sum(axis=1)
    joined = (square > 0) & (square <= join**2)
    share = ((points - first) * along).sum(axis=1) / np.where(joined, square, 1.0)
    return first + np.where(joined, np.clip(share, 0.0, 1.0), 0.0)[:, None] * along - points
