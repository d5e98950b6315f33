"""`relative_error`: how far the sheet is from where it was seen, in percent of how large it is (Coltraro)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from clothbench import ClothbenchError, Observation, Rollout, Score, check_choice
from clothbench_metrics.node_error import differences, flat_rows, mean_over

ORIGINS = ("centre", "camera")
QUANTITIES = {"percent": "%", "squares": "m^2"}


class RelativeError:
    """e_i = 100 ‖φ_i − ϕ_i‖ / ‖ϕ_i‖ per frame i, averaged over the frames, the first included
    (Coltraro, Experimental Validation of an Inextensible Cloth Model, equation 3).

    Searches by residuals (`least_squares`) minimise L = Σ ‖φ − ϕ‖² (equation 2) whatever the quantity; those by values,
    which the paper's is one of, the mean of e_i, or L with quantity "squares" [m²]. That is the part of each frame,
    averaged over the frames in which something was seen, so that long recordings have no more say than short ones; of
    one recording it is least where the sum is. Its map has the mean square distance of each node.

    In percent, a frame has the same weight and its own size ‖ϕ_i‖ however few nodes were seen in it: of few neighbours
    that is small, and their e_i large. The map then has 100 √n_i ‖φ − ϕ‖ / ‖ϕ_i‖ of one node, averaged over the frames
    in which it was seen: its distance in percent of the root mean square distance from the origin of the n_i nodes that
    were seen. In a frame, e_i is the root mean square of that over the nodes.

    The paper's norm of the positions depends on where the origin lies, which it does not say. origin: "centre", of what
    was seen in each frame, so that moving the camera does not change the error; "camera", from which the same error is
    fewer percent the farther away it stands; or three numbers, a point [m]. Squares do not depend on it.
    quantity: "percent" [%] or "squares" [m²].
    """

    name = "relative_error"
    version = 1

    def __init__(self, origin: str | Sequence[float] = "centre", quantity: str = "percent"):
        check_choice("relative_error", "quantity", quantity, QUANTITIES)
        self.quantity, self.unit = quantity, QUANTITIES[quantity]
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
        if self.quantity == "squares":
            return self._squares(square.sum(axis=-1), seen, away[:, seen])
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

    def _squares(self, square: np.ndarray, seen: np.ndarray, residual: np.ndarray) -> Score:
        """Of squared distances (B, T, N) m², 0 where nothing was seen (T, N)."""
        watched = seen.any(axis=1)
        per_frame = np.where(watched, square.sum(axis=-1), np.nan)
        value = per_frame[:, watched].mean(axis=1) if watched.any() else np.full(len(square), np.nan)
        return Score(value, self.unit, per_frame, mean_over(square, seen, axis=1), flat_rows(residual))

    def floor(self, observation: Observation) -> float:
        """√(C n σ²)/‖ϕ‖ of a frame with n nodes seen in C coordinates, or C n σ² m², averaged over the frames."""
        if self.quantity == "squares":
            seen = observation.visible.sum(axis=1)
            watched = seen[seen > 0]
            return (
                float(observation.coordinates * np.mean(watched) * observation.sigma**2) if len(watched) else math.nan
            )
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


class RelativeErrorSquares(RelativeError):
    """Its squares under a name of their own, so that a search can minimise L and the report still have e_i."""

    name = "relative_error_squares"

    def __init__(self) -> None:
        super().__init__(quantity="squares")


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
