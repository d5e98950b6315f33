"""`fold_count`: are there as many folds as were filmed, whenever and wherever they come?"""

from __future__ import annotations

import math

import numpy as np

from clothbench import ClothbenchError, Observation, Rollout, Score, fold_mask, turned
from clothbench_metrics.node_error import check_shape
from clothbench_metrics.sight import Sights, compared


class FoldCount:
    """By how many folds the mean over all frames differs from what was filmed: a statistical metric as Bhat et al. 2003
    propose for garments whose start is not known (section 9), blind to where and when a fold appears.

    Hills and valleys count alike: each is a connected part of the picture, of at least `least` of the silhouette, in
    which the stripes turn (Bhat et al., eq. 4) one way from left to right, as fast as the view's threshold says, with
    which the film was looked at. pixels, blur, threshold: as of `fold`, of a view that states none. Per frame it gives
    by how many folds there are too many (below 0: too few); the value is the size of their mean. Where a rollout is
    out of the picture in a frame that was filmed there is none: it would be as good as a flat sheet.
    """

    name = "fold_count"
    version = 3
    unit = "folds"

    def __init__(self, least: float = 0.003, pixels: int = 96, blur: float = 2.0, threshold: float = 0.006):
        if not isinstance(least, int | float) or isinstance(least, bool) or not 0 <= least < 1:
            raise ClothbenchError(f"fold_count: least is {least!r}, expected a share of the silhouette, 0 … 1")
        self.least = float(least)
        self.sights = Sights(self.name, pixels, blur, threshold)

    def __call__(self, observation: Observation, rollout: Rollout) -> Score:
        check_shape(observation, rollout)
        sight = self.sights.of(observation)
        view, frames = sight.view, sight.frames
        count = np.full((len(rollout), len(frames)), np.nan)
        if not frames.any():
            return Score(np.full(len(rollout), np.nan), self.unit, count)
        if view.angle is None or view.fold is None:
            raise ClothbenchError("fold_count: the view has no folds; track the recording with tracker=stripes")
        filmed = zip(view.angle, view.fold, view.silhouette, strict=True)
        seen = np.array([self._count(*one) for one in filmed], dtype=float)
        threshold = view.threshold if math.isfinite(view.threshold) else self.sights.threshold

        def compare(b: int, some: slice) -> None:
            for t, (angle, shape) in enumerate(zip(*sight.stripes(rollout.position[b], some), strict=True), some.start):
                if frames[t] and (shape.any() or not view.silhouette[t].any()):  # cloth out of sight has no count
                    count[b, t] = self._count(angle, fold_mask(angle, shape, threshold), shape)

        lost = compared(sight, rollout, compare)
        mean = np.abs(count[:, frames].mean(axis=1) - seen[frames].mean())
        return Score(np.where(lost, np.nan, mean), self.unit, count - seen)

    def _count(self, angle: np.ndarray, fold: np.ndarray, shape: np.ndarray) -> int:
        """How many folds a picture (H, W) has, from the stripes' orientation and where it changes fast."""
        import cv2

        turn, least = np.zeros(angle.shape), max(1.0, self.least * np.count_nonzero(shape))
        turn[:, 1:-1] = turned(angle[:, 2:] - angle[:, :-2])
        total = 0
        for way in (fold & (turn > 0), fold & (turn < 0)):
            _, _, stats, _ = cv2.connectedComponentsWithStats(way.astype(np.uint8), connectivity=4)
            total += int(np.count_nonzero(stats[1:, cv2.CC_STAT_AREA] >= least))
        return total

    def floor(self, observation: Observation) -> float:
        """Not known, as in `fold`."""
        return math.nan
