"""`silhouette`: how much of the outline is in the wrong place."""

from __future__ import annotations

import math

import numpy as np

from clothbench import Observation, Rollout, Score, check_choice
from clothbench_metrics.node_error import check_shape
from clothbench_metrics.sight import Sights, apart, compared, farthest

QUANTITIES = {"mismatch": "px", "iou": "%", "edge_distance": "px"}


class Silhouette:
    """The mean over the frames of the pixels in which the silhouettes differ (Bhat et al. 2003, eq. 6), or of what both
    share over what either covers, as 100 (1 − intersection over union), so that lower is better; or how far their
    edges lie apart, from each pixel of either to the nearest of the other (chamfer distance, Barrow et al. 1977), and
    the picture's diagonal where the rollout has left it.

    quantity: "mismatch" [px], "iou" [%] or "edge_distance" [px]. As in `fold`, the observation's view says what was
    seen; without one, tracked nodes are drawn on an image `pixels` wide.
    """

    name = "silhouette"
    version = 2

    def __init__(self, quantity: str = "mismatch", pixels: int = 96):
        check_choice(self.name, "quantity", quantity, QUANTITIES)
        self.quantity, self.unit = quantity, QUANTITIES[quantity]
        self.sights = Sights(self.name, pixels, blur=2.0, threshold=0.006)

    def __call__(self, observation: Observation, rollout: Rollout) -> Score:
        check_shape(observation, rollout)
        sight = self.sights.of(observation)
        seen, per_frame = sight.view.silhouette, np.full((len(rollout), len(observation.time)), np.nan)
        if not sight.frames.any():
            return Score(np.full(len(rollout), np.nan), self.unit, per_frame)

        def compare(b: int, some: slice) -> None:
            shape, there = sight.outlines(rollout.position[b], some), sight.frames[some]
            if self.quantity == "edge_distance":
                distance = np.array([apart(edge_of(a), edge_of(b)) for a, b in zip(shape, seen[some], strict=True)])
                gone = ~shape.any(axis=(1, 2))
                per_frame[b, some] = np.where(there, np.where(gone, farthest(sight), distance), np.nan)
                return
            wrong = np.count_nonzero(shape != seen[some], axis=(1, 2))
            either = np.count_nonzero(shape | seen[some], axis=(1, 2))
            value = wrong if self.quantity == "mismatch" else 100 * wrong / np.maximum(either, 1)
            per_frame[b, some] = np.where(there, value, np.nan)

        lost = compared(sight, rollout, compare)
        mean = per_frame[:, sight.frames].mean(axis=1)
        return Score(np.where(lost, np.nan, mean), self.unit, per_frame)

    def floor(self, observation: Observation) -> float:
        """Not known: what noise does to an outline depends on its length and on the camera's focus."""
        return math.nan


def edge_of(shape: np.ndarray) -> np.ndarray:
    """The pixels (H, W) bool of a silhouette that have one outside it for a neighbour."""
    import cv2

    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    inside = cv2.erode(shape.astype(np.uint8), cross, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return shape & (inside == 0)
