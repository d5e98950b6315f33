"""`profile`: how far measured points that have no identity are from the simulated surface."""

from __future__ import annotations

import math

import numpy as np

from clothbench import Observation, Rollout, Score


class Profile:
    """J = ½ Σ d(z, S)² over the measured points z, d the distance to the nearest of the points by which the simulated
    surface S is given; summed in each frame, averaged over the frames (Petrík et al., Automatic Material Properties
    Estimation for the Physics-Based Robotic Garment Folding, eq. 7 and 8). The surface has to be given finely: where
    its points are h apart, each measured one adds up to h²/24.
    """

    name = "profile"
    version = 1
    unit = "m^2"

    def __call__(self, observation: Observation, rollout: Rollout) -> Score:
        members, frames, seen = len(rollout), len(observation.time), observation.visible
        watched = np.flatnonzero(seen.any(axis=1))
        per_frame = np.full((members, frames), np.nan)
        away = []
        for b in range(members):
            found = [nearest(rollout.position[b, t], observation.position[t, seen[t]]) for t in watched]
            per_frame[b, watched] = [float((d**2).sum()) / 2 for d in found]
            away.append(np.concatenate(found).ravel() if found else np.zeros(0))
        value = per_frame[:, watched].mean(axis=1) if watched.size else np.full(members, np.nan)
        return Score(value, self.unit, per_frame, None, np.array(away))

    def floor(self, observation: Observation) -> float:
        """Not known: noise along the surface does not count, and which way the surface lies is the rollout's affair."""
        return math.nan


def nearest(surface: np.ndarray, points: np.ndarray) -> np.ndarray:
    """From points (N, 3) m to the nearest of surface (M, 3) m, (N, 3); not a number where the surface is not whole.

    Points that nobody placed may stand far away, but one that is not a number has spoilt the simulation.
    """
    from scipy.spatial import cKDTree

    if not np.isfinite(surface).all():
        return np.full_like(points, np.nan)
    return surface[cKDTree(surface).query(points)[1]] - points
