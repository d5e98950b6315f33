"""`fold`: do the folds lie where they were filmed? (Bhat et al. 2003, eq. 4–9)"""

from __future__ import annotations

import math

import numpy as np

from clothbench import ClothbenchError, Observation, Rollout, Score, turned
from clothbench.modelling import kernel
from clothbench_metrics.node_error import check_shape, flat_rows
from clothbench_metrics.sight import Sights, compared, require_number

BLOCK = 8  # px; residuals are pooled over squares of this side, or they would be a million


class Fold:
    """Per frame, Σ M (θ_real − θ_sim)² over the pixels both silhouettes share + α · mismatched pixels of the
    silhouettes; the mean over the frames ("error per frame" of the paper's table 3).

    Angles are compared modulo π [rad], so the unit is a pixel. M marks the folds that were seen. The observation's view
    (tracker `stripes`) says what was seen; without one, tracked nodes are drawn as if a camera had faced them, and the
    rollout likewise. The residuals are both terms pooled over squares of 8 px, signed, so that least squares and
    intervals can follow them. alpha: α (the paper's 0.1). Without a view: pixels: the image's width; blur [px] and
    threshold [rad/px]: as of `stripes`.
    """

    name = "fold"
    version = 2
    unit = "px"

    def __init__(self, alpha: float = 0.1, pixels: int = 96, blur: float = 2.0, threshold: float = 0.006):
        require_number(self.name, "alpha", alpha)
        if alpha == 0:  # a rollout out of the picture shares no pixel with the film, and would be perfect
            raise ClothbenchError("fold: alpha is 0, expected a number above 0; the silhouettes have to count")
        self.alpha, self.sights = float(alpha), Sights(self.name, pixels, blur, threshold)

    def __call__(self, observation: Observation, rollout: Rollout) -> Score:
        check_shape(observation, rollout)
        sight = self.sights.of(observation)
        view, members = sight.view, len(rollout)
        frames, height, width = view.silhouette.shape
        blocks = (-(-height // BLOCK), -(-width // BLOCK))
        per_frame = np.full((members, frames), np.nan)
        residual = np.zeros((members, frames, 2, *blocks))
        nothing = np.full(members, np.nan)
        if not sight.frames.any():
            return Score(nothing, self.unit, per_frame)
        if view.angle is None or view.fold is None:
            raise ClothbenchError("fold: the view has no angle map; track the recording with tracker=stripes")
        angle, fold, weight = view.angle, view.fold, math.sqrt(self.alpha)

        def compare(b: int, some: slice) -> None:
            drawn = zip(*sight.stripes(rollout.position[b], some), strict=True)
            for t, (found, shape) in enumerate(drawn, some.start):
                away = turned(found - angle[t])
                folded, outside = pooled(away, fold[t], shape, view.silhouette[t], residual[b, t])
                residual[b, t, 1] *= weight
                if sight.frames[t]:
                    per_frame[b, t] = folded + self.alpha * outside

        lost = compared(sight, rollout, compare)
        residual[lost] = np.nan
        mean = per_frame[:, sight.frames].mean(axis=1)
        counted = flat_rows(residual[:, sight.frames])
        return Score(np.where(lost, np.nan, mean), self.unit, per_frame, None, counted)

    def floor(self, observation: Observation) -> float:
        """Not known: what the camera's noise does to an angle depends on the stripes' contrast at every pixel."""
        return math.nan


@kernel
def pooled(away, fold, shape, seen, out):
    """Σ M away² over shared pixels, and mismatched pixels; out (2, h, w): signed sums per square over √(its pixels)."""
    folded, outside = 0.0, 0
    for y in range(away.shape[0]):
        for x in range(away.shape[1]):
            if shape[y, x] != seen[y, x]:
                outside += 1
                out[1, y // BLOCK, x // BLOCK] += (1.0 if shape[y, x] else -1.0) / BLOCK
            elif fold[y, x] and shape[y, x]:
                folded += away[y, x] ** 2
                out[0, y // BLOCK, x // BLOCK] += away[y, x] / BLOCK
    return folded, outside
