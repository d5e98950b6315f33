"""`node_error`: how far the nodes are from where they were seen, on average."""

from __future__ import annotations

import math

import numpy as np

from clothbench import ClothbenchError, Observation, Rollout, Score, check_choice

UNITS = {"mm": 1e3, "cm": 1e2, "m": 1.0, "px": math.nan}  # to a metre; of pixels the camera tells


class NodeError:
    """Mean over frames and nodes of ‖r − w‖, over what was seen only (the mpe of
    "Cloth mechanical parameter estimation and simulation for optimized robotic manipulation", section 5.2).

    The paper averages each node over time first, then over the nodes; so does this. Points that were seen in a picture
    are compared in it, with the rollout projected: in metres at the distance of the cloth, or in pixels.
    unit: "mm", "cm" (the paper's), "m" or "px".
    """

    name = "node_error"
    version = 2

    def __init__(self, unit: str = "mm"):
        check_choice(self.name, "unit", unit, UNITS)
        self.unit = unit

    def __call__(self, observation: Observation, rollout: Rollout) -> Score:
        away, seen = differences(observation, rollout)
        if self.unit == "px":
            away = in_pixels(observation, rollout)
        scale = 1.0 if self.unit == "px" else UNITS[self.unit]
        distance = np.where(seen, scale * np.linalg.norm(away, axis=-1), 0.0)
        per_node = mean_over(distance, seen, axis=1)
        watched = seen.any(axis=0)
        residual = away[:, seen]
        return Score(
            value=per_node[:, watched].mean(axis=1) if watched.any() else np.full(len(away), np.nan),
            unit=self.unit,
            per_frame=mean_over(distance, seen, axis=2),
            per_node=per_node,
            residual=flat_rows(residual),
        )

    def floor(self, observation: Observation) -> float:
        """E‖e‖ of isotropic Gaussian noise with σ per coordinate: σ √(8/π) (mean of the Maxwell distribution), in a
        picture σ √(π/2) (Rayleigh's).
        """
        mean = math.sqrt(8 / math.pi) if observation.coordinates == 3 else math.sqrt(math.pi / 2)
        if not observation.visible.any():
            return math.nan
        if self.unit != "px":
            return mean * observation.sigma * UNITS[self.unit]
        pixels = 1 / np.maximum(observation.pixel_size()[observation.visible], 1e-12)  # to a metre, where it was seen
        return mean * observation.sigma * float(np.mean(pixels))


def differences(observation: Observation, rollout: Rollout) -> tuple[np.ndarray, np.ndarray]:
    """Simulated minus seen (B, T, N, C) m in the C coordinates that were measured, and where that can be said (T, N);
    not a number where a rollout stopped.
    """
    check_shape(observation, rollout)
    return observation.differences(rollout.position), observation.visible


def in_pixels(observation: Observation, rollout: Rollout) -> np.ndarray:
    """Simulated minus seen (B, T, N, 2) in the pixels of the camera that saw the points, its lens included."""
    if observation.sight is None:
        raise ClothbenchError("px: the recording has no picture, only places in space; take mm, cm or m")
    seen, there = (observation.sight.project(p)[0] for p in (np.nan_to_num(observation.position), rollout.position))
    return there - seen


def check_shape(observation: Observation, rollout: Rollout) -> None:
    """Refuse a rollout of other frames or points than were observed, and points without identity."""
    if observation.cloud:
        raise ClothbenchError("metric: found points without identity; take one that reads clouds, as chamfer")
    if rollout.position.shape[1:] != observation.position.shape:
        raise ClothbenchError(
            f"metric: found a rollout of {rollout.position.shape[1:]}, "
            f"expected {observation.position.shape} as observed"
        )


def flat_rows(values: np.ndarray) -> np.ndarray:
    """Values (B, …) with one row for each member (B, R), of no member, too."""
    return values.reshape(len(values), math.prod(values.shape[1:]))


def mean_over(values: np.ndarray, seen: np.ndarray, axis: int) -> np.ndarray:
    """Mean of values (B, T, N) over one axis where `seen` (T, N); NaN where nothing was."""
    count = seen.sum(axis=axis - 1)
    return np.where(count > 0, values.sum(axis=axis) / np.maximum(count, 1), np.nan)
