"""How the metrics on images look at a rollout: through the camera of the recording, or through one put up for them."""

from __future__ import annotations

import math
import weakref
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from clothbench import (
    Camera,
    ClothbenchError,
    Observation,
    Projector,
    Rollout,
    Surface,
    View,
    angle_map,
    fold_mask,
    for_each,
    silhouettes,
    striped,
    surface_of,
)

REFINE = 4  # cells of a lattice are drawn as so many in each direction
STRIPE = 6.0  # px from stripe to stripe, where the filters answer best
STEEP = 0.7  # how far a projector stands above the camera, over its distance
CHUNK = 8  # frames of one task: buffers stay in the cache


@dataclass(frozen=True, eq=False)
class Sight:
    """What was seen, and the surface that simulated nodes are drawn with.

    nodes: (T, N) bool, of which nodes a frame is drawn, or None for all: where the view itself was drawn from tracked
    nodes, what was not tracked is missing from both pictures.
    """

    view: View
    surface: Surface
    nodes: np.ndarray | None

    @property
    def frames(self) -> np.ndarray:
        """(T,) bool, where there is anything to compare."""
        return self.view.silhouette.any(axis=(1, 2))

    def shown(self, position: np.ndarray, frames: slice) -> np.ndarray:
        """Nodes (T, N, 3) m of some frames, not a number where none is drawn."""
        shown = position[frames]
        return shown if self.nodes is None else np.where(self.nodes[frames][..., None], shown, np.nan)

    def outlines(self, position: np.ndarray, frames: slice) -> np.ndarray:
        """Silhouettes (t, H, W) of nodes (T, N, 3) m in some frames."""
        return silhouettes(self.view.camera, self.surface, self.shown(position, frames))

    def stripes(self, position: np.ndarray, frames: slice) -> tuple[np.ndarray, np.ndarray]:
        """Angles and silhouettes (t, H, W) of nodes (T, N, 3) m in some frames."""
        view = self.view
        if view.projector is None:
            raise ClothbenchError("fold: the view has no projector; give recordings with stripes, or tracker=markers")
        image, silhouette = striped(view.camera, view.projector, self.surface, self.shown(position, frames))
        return np.stack([angle_map(i, view.blur) for i in image]), silhouette


def require_number(metric: str, name: str, value: float) -> None:
    """Refuse an option of a metric that is no finite number, 0 or above."""
    if not isinstance(value, int | float) or isinstance(value, bool) or not (math.isfinite(value) and value >= 0):
        raise ClothbenchError(f"{metric}: {name} is {value!r}, expected a number, 0 or above")


class Sights:
    """The sight of each observation, made when it is first asked for and kept as long as the observation is."""

    def __init__(self, metric: str, pixels: int, blur: float, threshold: float):
        if not isinstance(pixels, int) or isinstance(pixels, bool) or pixels < 32:
            raise ClothbenchError(f"{metric}: pixels is {pixels!r}, expected a whole number, at least 32")
        for name, value in (("blur", blur), ("threshold", threshold)):
            require_number(metric, name, value)
        self.pixels, self.blur, self.threshold = pixels, blur, threshold
        self._known: weakref.WeakKeyDictionary[Observation, Sight] = weakref.WeakKeyDictionary()

    def of(self, observation: Observation) -> Sight:
        if observation not in self._known:
            self._known[observation] = self._make(observation)
        return self._known[observation]

    def _make(self, observation: Observation) -> Sight:
        if observation.view is not None:
            return Sight(observation.view, surface_of(observation.material, REFINE, observation.size), None)
        surface, shape = surface_of(observation.material), observation.visible.shape[:1]
        if not spread(observation.position[observation.visible]):
            camera = Camera.looking_at(np.array([0.0, -1.0, 0.0]), np.zeros(3), (self.pixels, self.pixels), 1.0)
            return Sight(View(camera, np.zeros((*shape, self.pixels, self.pixels), bool)), surface, observation.visible)
        camera, projector = rig(observation.position[observation.visible], self.pixels, observation.sight)
        empty = np.zeros((*shape, *camera.size[::-1]), bool)
        blank = Sight(View(camera, empty, projector, blur=self.blur), surface, observation.visible)
        angle, silhouette = blank.stripes(np.nan_to_num(observation.position), slice(None))
        fold = np.stack([fold_mask(a, s, self.threshold) for a, s in zip(angle, silhouette, strict=True)])
        view = View(camera, silhouette, projector, angle, fold, self.blur, self.threshold)
        return Sight(view, surface, observation.visible)


def spread(points: np.ndarray) -> bool:
    """Whether points (n, 3) m lie apart at all: a single place is nothing that a camera could be put up before."""
    return len(points) > 0 and float(np.ptp(points, axis=0).max()) > 0


def rig(points: np.ndarray, pixels: int, sight: Camera | None = None) -> tuple[Camera, Projector]:
    """A camera that faces where the points (n, 3) m spread least and sees them all, and a projector above it.

    sight: the camera that saw the points in its picture; from elsewhere nothing is known of them.
    """
    points = points[np.lexsort(points.T)]  # the same bits whatever order they come in
    low, high = points.min(axis=0), points.max(axis=0)
    target, across = (low + high) / 2, 1.3 * float(np.max(high - low))
    away = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][-1]
    away = -away * np.sign(away[np.argmax(np.abs(away))])
    up = np.array([0.0, 0.0, 1.0] if abs(away[2]) < 0.8 else [0.0, 1.0, 0.0])
    camera = Camera.looking_at(target + 3 * across * away, target, (pixels, pixels), across, tuple(up))
    if sight is not None:
        away, camera = -sight.rotation[2], shrunk(sight, pixels)
    lens = Camera.looking_at(target + 3 * across * (away + STEEP * up), target, (1000, 1000), 2 * across, tuple(up))
    return camera, Projector(lens, STRIPE / pixels * 500 / np.hypot(1.0, STEEP))


def shrunk(camera: Camera, pixels: int) -> Camera:
    """The same camera with a picture of `pixels` along its longer side, and no distortion."""
    share = pixels / max(camera.size)
    matrix = camera.matrix.copy()
    matrix[:2] *= share
    matrix[:2, 2] += (share - 1) / 2  # a pixel's place is its middle
    width, height = (max(1, round(share * side)) for side in camera.size)
    return Camera((width, height), matrix, camera.rotation, camera.translation)


def compared(sight: Sight, rollout: Rollout, compare: Callable[[int, slice], None]) -> np.ndarray:
    """Call `compare(member, frames)` for all members that can be drawn, some frames at a time, on all threads.

    Gives (B,) bool: the members with a position that is not a number where there was something to compare.
    """
    position, frames = rollout.position, sight.frames
    needed = frames[:, None] & (sight.nodes if sight.nodes is not None else np.ones(position.shape[1:3], bool))
    unknown = needed[..., None] & ~np.isfinite(position)
    lost = np.asarray(unknown.any(axis=(1, 2, 3)))
    starts = range(0, len(frames), CHUNK)
    tasks = [(b, slice(t, min(t + CHUNK, len(frames)))) for b in np.flatnonzero(~lost) for t in starts]
    for_each(lambda task: compare(*task), tasks)
    return lost


def farthest(sight: Sight) -> float:
    """The diagonal [px] of the picture: nothing in it lies farther from anything else."""
    return float(np.hypot(*sight.view.camera.size))


def apart(one: np.ndarray, other: np.ndarray) -> float:
    """Mean distance [px] from each pixel of two sets (H, W) bool to the nearest of the other set, each set with the
    same say; NaN where one of them is empty.
    """
    import cv2

    if not (one.any() and other.any()):
        return math.nan
    way = [
        cv2.distanceTransform((~there).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[here].mean()
        for here, there in ((one, other), (other, one))
    ]
    return float(np.mean(way))
