"""`relative_error`: how far the sheet is from where it was seen, in percent of how large it is (Coltraro)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from clothbench import ClothbenchError, Observation, Rollout, Score
from clothbench_metrics.node_error import differences, flat_rows, mean_over

ORIGINS = ("centre", "camera")


class RelativeError:
    """e_i = 100 ‖φ_i − ϕ_i‖ / ‖ϕ_i‖ per frame i, averaged over the frames, the first included
    (Coltraro, Experimental Validation of an Inextensible Cloth Model, equation 3).

    Searches by residuals (`least_squares`) minimise L = Σ ‖φ − ϕ‖² (equation 2); those by values, which the paper's is
    one of, the mean of e_i. A frame has the same weight and its own size ‖ϕ_i‖ however few nodes were seen in it: of a
    few neighbours that is small, and their e_i large.

    The map has 100 √n_i ‖φ − ϕ‖ / ‖ϕ_i‖ of one node, averaged over the frames in which it was seen: its distance in
    percent of the root mean square distance of the n_i nodes seen from the origin. In a frame, e_i is the root mean
    square of that over the nodes.

    The paper's norm of the positions depends on where the origin lies, which it does not say. origin: "centre", of what
    was seen in each frame, so that moving the camera does not change the error; "camera", from which the same error is
    fewer percent the farther away it stands; or three numbers, a point [m].
    """

    name = "relative_error"
    version = 1
    unit = "%"

    def __init__(self, origin: str | Sequence[float] = "centre"):
        try:
            self.origin = origin if isinstance(origin, str) else np.asarray(origin, dtype=float)
        except (TypeError, ValueError):  # of words, or uneven
            self.origin = ""
        if isinstance(self.origin, str):
            known = self.origin in ORIGINS
        else:
            known = self.origin.shape == (3,) and bool(np.isfinite(self.origin).all())
        if not known:
            raise ClothbenchError(
                f"relative_error: origin is {origin!r}, expected {' or '.join(ORIGINS)}, or [x, y, z] in metres"
            )

    def __call__(self, observation: Observation, rollout: Rollout) -> Score:
        away, seen = differences(observation, rollout)
        square = np.where(seen[..., None], away**2, 0.0)
        size = sizes(observation, self.origin)
        frames = size > 0
        with np.errstate(divide="ignore", invalid="ignore"):
            per_frame = np.where(frames, 100 * np.sqrt(square.sum(axis=(-2, -1))) / size, np.nan)
            share = 100 * np.sqrt(square.sum(axis=-1) * seen.sum(axis=1)[:, None]) / size[:, None]
        known = seen & frames[:, None]
        per_node = mean_over(np.where(known, share, 0.0), known, axis=1)
        residual = away[:, seen]
        value = per_frame[:, frames].mean(axis=1) if frames.any() else np.full(len(away), np.nan)
        return Score(value, self.unit, per_frame, per_node, flat_rows(residual))

    def floor(self, observation: Observation) -> float:
        """√(C n σ²)/‖ϕ‖ of a frame with n nodes seen in C coordinates, averaged over the frames."""
        count, size = observation.visible.sum(axis=1), sizes(observation, self.origin)
        frames = size > 0
        if not frames.any():
            return math.nan
        return float(
            np.mean(
                100 * math.sqrt(observation.coordinates) * observation.sigma * np.sqrt(count[frames]) / size[frames]
            )
        )


class RelativeErrorFromCamera(RelativeError):
    """The same with its origin in the camera, as the paper's figures are small if they were taken so."""

    name = "relative_error_from_camera"

    def __init__(self) -> None:
        super().__init__("camera")


def sizes(observation: Observation, origin: str | np.ndarray = "centre") -> np.ndarray:
    """‖ϕ‖ (T,) m of each frame, from the centre of the nodes seen, from the camera, or from a point (3,) m."""
    seen = observation.visible[..., None]
    position = np.nan_to_num(observation.position)
    centre = (position * seen).sum(axis=1) / np.maximum(seen.sum(axis=1), 1)
    if not isinstance(origin, str):
        centre = np.broadcast_to(origin, centre.shape)
    elif origin == "camera":
        if observation.eye is None:
            raise ClothbenchError(
                "relative_error: origin is 'camera', and the recording does not say where it stood; take 'centre'"
            )
        centre = np.broadcast_to(observation.eye, centre.shape)
    return np.sqrt((((position - centre[:, None]) * seen) ** 2).sum(axis=(1, 2)))
