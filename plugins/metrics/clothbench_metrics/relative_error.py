"""`relative_error`: how far the sheet is from where it was seen, in percent of how large it is (Coltraro)."""

from __future__ import annotations

import math

import numpy as np

from clothbench import Observation, Rollout, Score
from clothbench_metrics.node_error import differences


class RelativeError:
    """e_i = 100 ‖φ_i − ϕ_i‖ / ‖ϕ_i‖ per frame i, averaged over the frames; fitted through L = Σ ‖φ − ϕ‖²
    (Coltraro, Experimental Validation of an Inextensible Cloth Model).

    The paper's norm of the positions depends on where the origin lies. Here positions are taken from the centre of
    what was seen in each frame, so that moving the camera does not change the error.
    """

    name = "relative_error"
    version = 1
    unit = "%"

    def __call__(self, observation: Observation, rollout: Rollout) -> Score:
        away, seen = differences(observation, rollout)
        square = np.where(seen[..., None], away**2, 0.0).sum(axis=(-2, -1))
        frames = sizes(observation) > 0
        with np.errstate(divide="ignore", invalid="ignore"):
            per_frame = np.where(frames, 100 * np.sqrt(square) / sizes(observation), np.nan)
        residual = away[:, seen]
        value = per_frame[:, frames].mean(axis=1) if frames.any() else np.full(len(away), np.nan)
        return Score(value, self.unit, per_frame, None, residual.reshape(len(residual), -1))

    def floor(self, observation: Observation) -> float:
        """√(3 n σ²)/‖ϕ‖ of a frame with n nodes seen, averaged over the frames."""
        count = observation.visible.sum(axis=1)
        frames = sizes(observation) > 0
        if not frames.any():
            return math.nan
        return float(
            np.mean(100 * math.sqrt(3) * observation.sigma * np.sqrt(count[frames]) / sizes(observation)[frames])
        )


def sizes(observation: Observation) -> np.ndarray:
    """‖ϕ‖ (T,) m of each frame, from the centre of the nodes seen."""
    seen = observation.visible[..., None]
    position = np.nan_to_num(observation.position)
    centre = (position * seen).sum(axis=1) / np.maximum(seen.sum(axis=1), 1)
    return np.sqrt((((position - centre[:, None]) * seen) ** 2).sum(axis=(1, 2)))
