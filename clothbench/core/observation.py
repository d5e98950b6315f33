"""The observation: what a tracker made of a recording, ready to be compared with a rollout."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clothbench.core.brief import brief
from clothbench.core.camera import Camera, View
from clothbench.core.drape import Outlines
from clothbench.core.errors import ClothbenchError


@dataclass(frozen=True, eq=False)
class GripPath:
    """Where the cloth was held over time. time: (K,) s; material: (G, 2) m; position: (K, G, 3) m."""

    time: np.ndarray
    material: np.ndarray
    position: np.ndarray

    __repr__ = brief

    @classmethod
    def while_known(cls, time: np.ndarray, material: np.ndarray, position: np.ndarray) -> GripPath:
        """The path over those of the stamps (T,) s at which all places (T, G, 3) m are numbers."""
        known = np.isfinite(position).all(axis=(1, 2))
        return cls(np.array(time)[known], material, position[known])


def confidence_fault(confidence: np.ndarray, visible: np.ndarray) -> str | None:
    """What is wrong with confidences (T, N) of points of which these were seen; None if nothing is. Of one that was not
    seen there may be none (NaN).
    """
    bad = np.argwhere(~((confidence >= 0) & (confidence <= 1)) & (visible | ~np.isnan(confidence)))
    if not bad.size:
        return None
    t, n = bad[0]
    return f"found {confidence[t, n]:g} at frame {t}, node {n}, expected 0 to 1 (NaN only where nothing was seen)"


def _truths(visible: Any) -> np.ndarray:
    """What was measured as bool: numbers would be taken for those of frames."""
    array = np.array(visible)
    if not np.isin(array, (0, 1)).all():
        raise ClothbenchError(f"observation: found visible of {array.dtype} beside 0 and 1, expected true or false")
    return array.astype(bool)


@dataclass(frozen=True, eq=False)
class Observation:
    """Tracked material points. Arrays are read-only.

    time: (T,) s; position: (T, N, 3) m, NaN where not known; visible: (T, N) bool, what was measured (a tracker may
    fill a gap with a position, but that stays invisible and never counts); sigma: m, standard deviation
    of one coordinate (NaN = not known); material: (N, 2) m; view: what was made of a camera's images, or None; eye:
    (3,) m, where the camera stood, or None; confidence: (T, N), 0 to 1, how sure the tracker is, or None;
    grips: where the tracker found the cloth to be held, if it looks for that; outlines: of drapes, where that is what
    was seen: then frames are captures, each a drape of its own, `time` counts them, and no point is visible; size:
    (width, height) m of the cloth, which may reach beyond its outermost points, or None.

    cloud: whether the points have no identity. Then their order in a frame means nothing, `material` (M, 2) m are the
    points of the sheet that are simulated to be compared with them, of whatever number, and only metrics that take
    nothing from which point is which can compare them.

    sight: the one camera that saw the points, where nothing else tells how far away they were. A position then is any
    place on the line of sight, and what it says is across that line only: two coordinates, not three.
    """

    time: np.ndarray
    position: np.ndarray
    visible: np.ndarray
    sigma: float
    material: np.ndarray
    view: View | None = None
    eye: np.ndarray | None = None
    sight: Camera | None = None
    confidence: np.ndarray | None = None
    grips: GripPath | None = None
    outlines: Outlines | None = None
    size: tuple[float, float] | None = None
    cloud: bool = False

    __repr__ = brief

    def __post_init__(self) -> None:
        for name in ("time", "position", "visible", "material", "confidence"):
            if (value := getattr(self, name)) is not None:
                array = _truths(value) if name == "visible" else np.array(value, dtype=float)
                array.flags.writeable = False
                object.__setattr__(self, name, array)
        frames, nodes = self.visible.shape
        if (
            self.position.shape != (frames, nodes, 3)
            or self.time.shape != (frames,)
            or self.material.shape != (len(self.material) if self.cloud else nodes, 2)
        ):
            raise ClothbenchError(
                f"observation: found position {self.position.shape}, time {self.time.shape}, "
                f"material {self.material.shape}, "
                f"visible {self.visible.shape}, expected (T, N, 3), (T,), (N, 2), (T, N)"
            )
        if self.view is not None and len(self.view.silhouette) != frames:
            raise ClothbenchError(f"observation: found a view of {len(self.view.silhouette)} frames, expected {frames}")
        if self.confidence is not None and self.confidence.shape != (frames, nodes):
            raise ClothbenchError(f"observation: found confidence {self.confidence.shape}, expected {(frames, nodes)}")
        if self.confidence is not None and (fault := confidence_fault(self.confidence, self.visible)):
            raise ClothbenchError(f"observation: confidence: {fault}")
        if not np.isfinite(self.position[self.visible]).all():
            raise ClothbenchError("observation: found a visible node whose position is not finite")

    @property
    def coordinates(self) -> int:
        """How many coordinates of a point were measured: 3, or 2 in a picture."""
        return 3 if self.sight is None else 2

    def in_space(self, difference: np.ndarray) -> np.ndarray:
        """Differences in the coordinates that were measured (..., C) m, in the world's (..., 3) m."""
        return difference if self.sight is None else difference @ self.sight.rotation[:2]

    def in_measured(self, difference: np.ndarray) -> np.ndarray:
        """Differences in the world's coordinates (..., 3) m, in those that were measured (..., C) m."""
        return difference if self.sight is None else difference @ self.sight.rotation[:2].T

    def differences(self, position: np.ndarray) -> np.ndarray:
        """Positions (..., T, N, 3) m minus the seen ones, in the coordinates that were measured: (..., T, N, C) m.

        In a picture: to the right and down, at the distance at which the seen position lies, so that a pixel is as many
        metres for every point beside it.
        """
        if self.cloud:
            raise ClothbenchError(
                "observation: found points without identity, of which none has a place of its own in a rollout; take a "
                "metric of kind 'points', as chamfer"
            )
        if self.sight is None:
            return position - np.nan_to_num(self.position)
        seen, there = self.sight.in_view(np.nan_to_num(self.position)), self.sight.in_view(position)
        with np.errstate(divide="ignore", invalid="ignore"):
            flat = np.where(there[..., 2:] > 0, there[..., :2] / there[..., 2:], np.nan)
            return seen[..., 2:] * flat - seen[..., :2]

    def pixel_size(self) -> np.ndarray:
        """How large a pixel is where the points were seen (T, N) m."""
        if self.sight is None:
            raise ClothbenchError("px: the recording has no picture, only places in space; take mm, cm or m")
        focal = np.sqrt(self.sight.matrix[0, 0] * self.sight.matrix[1, 1])
        return self.sight.in_view(np.nan_to_num(self.position))[..., 2] / focal
