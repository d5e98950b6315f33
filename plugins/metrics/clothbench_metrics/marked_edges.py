"""`marked_edges`: do lines that are marked on the cloth lie where they were seen?"""

from __future__ import annotations

import math

import numpy as np

from clothbench import Observation, Rollout, Score
from clothbench_metrics.node_error import check_shape
from clothbench_metrics.sight import Sight, Sights, apart, compared, farthest

ALIGNED = 1e-6  # m, by which points of one row may differ
HOLE = 1.5  # of the usual spacing, from which on something is missing between two points


class MarkedEdges:
    """The mean over the frames of how far the lines between neighbouring nodes lie apart in the picture, from each
    pixel of either set of lines to the nearest of the other (chamfer distance, Barrow et al. 1977): information from
    internal edges marked on the fabric, which Bhat et al. 2003 tried before the folds (section 9).

    Where the lines were is known from the tracked nodes; they are drawn through the camera of the observation's view,
    or, without one, on an image `pixels` wide. A line is drawn where both of its ends were tracked, on the far side of
    a fold too; without tracked nodes there is no value. A rollout whose lines have left the picture is the picture's
    diagonal away.
    """

    name = "marked_edges"
    version = 2
    unit = "px"

    def __init__(self, pixels: int = 96):
        self.sights = Sights(self.name, pixels, blur=2.0, threshold=0.006)

    def __call__(self, observation: Observation, rollout: Rollout) -> Score:
        check_shape(observation, rollout)
        sight, lines = self.sights.of(observation), neighbours(observation.material)
        there = observation.visible[:, lines].all(axis=2)  # (T, L)
        frames = there.any(axis=1) & sight.frames
        per_frame = np.full((len(rollout), len(frames)), np.nan)
        seen = {int(t): self._drawn(sight, lines[there[t]], observation.position[t]) for t in np.flatnonzero(frames)}
        for t, drawn in seen.items():
            frames[t] = drawn.any()

        def compare(b: int, some: slice) -> None:
            for t in range(len(frames))[some]:
                if frames[t]:
                    drawn = self._drawn(sight, lines[there[t]], rollout.position[b, t])
                    per_frame[b, t] = apart(drawn, seen[t]) if drawn.any() else farthest(sight)

        lost = compared(sight, rollout, compare)
        mean = per_frame[:, frames].mean(axis=1) if frames.any() else np.full(len(rollout), np.nan)
        return Score(np.where(lost, np.nan, mean), self.unit, per_frame)

    def _drawn(self, sight: Sight, lines: np.ndarray, position: np.ndarray) -> np.ndarray:
        """The lines (L, 2) between nodes (N, 3) m in the picture (H, W)."""
        import cv2

        camera, used = sight.view.camera, np.unique(lines)
        image = np.zeros(camera.size[::-1], np.uint8)
        at = np.full((len(position), 2), np.nan)
        at[used] = camera.project(position[used])[0]
        ends = at[lines]
        ends = np.round(16 * ends[np.isfinite(ends).all(axis=(1, 2))]).astype(np.int32)  # in sixteenths of a pixel
        cv2.polylines(image, list(ends), False, 1, 1, cv2.LINE_8, 4)
        return image > 0

    def floor(self, observation: Observation) -> float:
        """Not known: what noise does to a line depends on the camera's focus."""
        return math.nan


def neighbours(material: np.ndarray) -> np.ndarray:
    """Pairs (L, 2) of neighbouring points of a lattice (N, 2) m, along its rows and columns. Where points are missing,
    those on either side of the hole are no neighbours.
    """
    out = []
    for along, across in ((0, 1), (1, 0)):
        order = np.argsort(material[:, across], kind="stable")
        row = np.empty(len(material), int)
        row[order] = np.cumsum(np.diff(material[order, across], prepend=-np.inf) > ALIGNED)
        order = np.lexsort((material[:, along], row))
        step = np.diff(material[order, along])
        same = np.diff(row[order]) == 0
        near = same & (step < HOLE * np.median(step[same])) if same.any() else same
        out.append(np.stack([order[:-1], order[1:]], axis=1)[near])
    return np.concatenate(out)
