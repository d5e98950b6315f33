"""What trackers of a colour video share: the graph of the first frame, the grips, and an observation in the picture.

The graph is that of "Cloth mechanical parameter estimation and simulation for optimized robotic manipulation", section
4: the template is found in the first frame, in which the cloth is held straight, and parted into equal cells; a node is
the centre of each.
"""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clothbench import (
    ClothbenchError,
    ColourVideo,
    FirstView,
    Found,
    GripPath,
    Keypoints,
    Observation,
    check_grip_gap,
    find_template,
    first_view,
    read_video,
    to_template,
)
from clothbench_trackers.depth_mesh import trembling
from clothbench_trackers.depth_pictures import with_mesh

CORNER_CELLS = 6.0  # from a corner to the nodes that say where it is
LEAST_NODES = 6  # of them, below which a corner is not known in a frame
SMOOTH = 7  # frames over which a grip's path is smoothed by a parabola: hands do not shake at 10 Hz
LOOSE = 0.06  # of the width, by which hands in the first frame may be nearer or farther than it
SPAN = 0.9  # of the frames, from the first in which a grip is seen to the last: beyond, nobody knows where it is
GRIPS = ("corners", "marks")
GRAPH = (40, 90, 220)
ALIKE = 0.8  # correlation of a lost point's patch with the first frame's, from which on it is found again
TEXTURE = 1e-3  # least eigenvalue of the gradients' matrix, per pixel and (grey/255)²: below it, a patch is plain


@dataclass(frozen=True, eq=False)
class Graph:
    """mesh: cells along (u, v); material: (N, 2) m, their centres, row by row from the top; centre: (N, 2) px of the
    template; cell: (2,) px of the template; keypoints: the template's; found: where it is in the first frame; view: the
    same in space.
    """

    mesh: tuple[int, int]
    material: np.ndarray
    centre: np.ndarray
    cell: np.ndarray
    keypoints: Keypoints
    found: Found
    view: FirstView

    @property
    def nodes(self) -> np.ndarray:
        """(N, 2) px, in the first frame."""
        return self.found(self.centre)

    @property
    def slopes(self) -> np.ndarray:
        """(N, 2, 2), px of the first frame for each px of the template to the right and down."""
        return np.stack(
            [self.found(self.centre + step / 2) - self.found(self.centre - step / 2) for step in np.eye(2)], -1
        )

    @property
    def spacing(self) -> float:
        """Of the nodes in the first frame, px."""
        sides = np.linalg.norm(self.slopes * self.cell, axis=1)
        return float(sides.mean())


def check_grips(who: str, grips: str) -> str:
    if not isinstance(grips, str) or (grips not in GRIPS and ":" not in grips):
        raise ClothbenchError(f"{who}: grips is {grips!r}, expected corners, marks, or module:function")
    return grips


def video_of(source: Any, who: str) -> ColourVideo:
    """A video, read if it is a file's name."""
    if isinstance(source, ColourVideo):
        return source
    if isinstance(source, str | Path):
        return read_video(source)
    raise ClothbenchError(f"{who}: found {type(source).__name__}, expected a recording of kind 'video'")


def graph_of(video: ColourVideo, mesh: tuple[int, int], first: np.ndarray) -> Graph:
    """The graph in the first frame (H, W, 3); of a cloth that does not show, four marks say where it is."""
    shape, size = video.template.shape[:2], np.array([video.cloth_width, video.cloth_height])
    keypoints = Keypoints.of(video.template)
    try:
        found = find_template(keypoints, Keypoints.of(first), shape, video.path or video.name)
    except ClothbenchError:
        found = _marked(video, size)
        if found is None:
            raise
    view = first_view(found, shape, size, (first.shape[1], first.shape[0]), video.camera, video.world == "camera")
    cell = np.array(shape[::-1]) / mesh
    u, v = ((np.arange(n) + 0.5) / n * length for n, length in zip(mesh, size, strict=True))
    material = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    return Graph(mesh, material, to_template(material, size, shape), cell, keypoints, found, view)


def _marked(video: ColourVideo, size: np.ndarray) -> Found | None:
    import cv2

    if video.marks is None or len(video.marks.material) < 4:
        return None
    there = to_template(video.marks.material, size, video.template.shape[:2])
    homography, _ = cv2.findHomography(there, video.marks.pixel)
    return None if homography is None else Found(homography, np.zeros((0, 2), dtype=int))


def observed(
    video: ColourVideo, graph: Graph, pixel: np.ndarray, seen: np.ndarray, confidence: np.ndarray,
    held: np.ndarray | None, sigma: float | None,
) -> Observation:  # fmt: skip
    """Nodes at pixels (T, N, 2), seen (T, N) or not, as an observation in the picture, held at pixels (T, G, 2),
    which are lifted to metres on the plane in which the first frame shows the cloth. sigma: m, or None: as the video
    states it, else judged.
    """
    graph = with_distance(video, graph, held)
    grips = None if held is None else GripPath.while_known(video.time, held_material(video), graph.view.lifted(held))
    position = graph.view.lifted(np.where(seen[..., None], pixel, np.nan))
    if sigma is None and not np.isnan(video.noise_sigma):
        sigma = video.noise_sigma
    if sigma is None:  # across the line of sight alone: along it, all nodes lie on one plane
        flat = (position - graph.view.origin) @ np.stack([graph.view.along, graph.view.down], axis=1)
        sigma = trembling(video.time, flat)
    return Observation(
        video.time, position, seen, sigma, graph.material, eye=graph.view.camera.place, sight=graph.view.camera,
        confidence=confidence, grips=grips,
    )  # fmt: skip


def held_material(video: ColourVideo) -> np.ndarray:
    """Material points (G, 2) m that are held: the two that are marked, or the upper corners."""
    if video.marks is not None:
        return video.marks.material[:2]
    return np.array([[0.0, 0.0], [video.cloth_width, 0.0]])


def held_path(
    video: ColourVideo, graph: Graph, how: str, pixel: np.ndarray, seen: np.ndarray, followed: np.ndarray | None
) -> np.ndarray | None:
    """Where the cloth is held (T, G, 2) px, NaN before it was first seen and after the last time; None where a robot
    has told, or where nothing was seen. how: "corners", where the graph (T, N, 2) px goes on to; "marks", points of the
    first frame `followed` (T, G, 2) px; or "module:function", asked frame by frame.
    """
    if video.grips is not None or not seen.any():
        return None
    material = held_material(video)
    if how == "corners":
        path = np.stack([corner_path(graph, point, pixel, seen) for point in material], axis=1)
    elif how == "marks":
        assert followed is not None
        path = followed
    else:
        path = asked(how, video, len(material))
    for g in range(len(material)):
        there = np.isfinite(path[:, g]).all(axis=1)
        if there.sum() < 2:
            u, v = material[g]
            raise ClothbenchError(
                f"{video.path or video.name}: found the point held at u = {u:g} m, v = {v:g} m in {there.sum()} "
                "frames; mark it in the first frame, or state the grips"
            )
        first, last = np.flatnonzero(there)[[0, -1]]
        if (last - first + 1) / len(there) < SPAN:
            u, v = material[g]
            raise ClothbenchError(
                f"{video.path or video.name}: found the point held at u = {u:g} m, v = {v:g} m from frame {first} to "
                f"{last} of {len(there)}, expected {SPAN:.0%} of them; cut the video there, or state the grips"
            )
        u, v = material[g]
        what = f"the point held at u = {u:g} m, v = {v:g} m"
        check_grip_gap(video.time, np.flatnonzero(there), what, str(video.path or video.name))
        for c in range(2):
            path[first : last + 1, g, c] = np.interp(video.time[first : last + 1], video.time[there], path[there, g, c])
        if last + 1 - first >= SMOOTH:
            from scipy.signal import savgol_filter

            path[first : last + 1, g] = savgol_filter(path[first : last + 1, g], SMOOTH, 2, axis=0)
    return path


def with_distance(video: ColourVideo, graph: Graph, held: np.ndarray | None) -> Graph:
    """The graph seen from where the two hands are as far apart in the first frame of both as the cloth between them is
    long: it is held straight then and slightly stretched, while its middle hangs through and looks smaller than it is.
    """
    if held is None or video.world == "camera" or held.shape[1] != 2:
        return graph
    first = held[np.isfinite(held).all(axis=(1, 2))][0]
    apart, wide = (float(np.linalg.norm(b - a)) for a, b in (graph.view.lifted(first), held_material(video)))
    if not abs(wide / apart - 1) < LOOSE:  # these are no hands that stretch it
        return graph
    camera = graph.view.camera
    nearer = dataclasses.replace(camera, translation=camera.translation * wide / apart)
    return dataclasses.replace(graph, view=dataclasses.replace(graph.view, camera=nearer))


def corner_path(graph: Graph, point: np.ndarray, pixel: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """A material point (2,) m in every frame (T, 2) px, which hands cover: a plane through the nodes near it that are
    seen, the nearer the heavier; NaN where too few are.
    """
    cell = np.ptp(graph.material, axis=0) / (np.array(graph.mesh) - 1)
    apart = (graph.material - point) / cell
    away = np.linalg.norm(apart, axis=1)
    near = np.flatnonzero(away < CORNER_CELLS)
    terms = np.concatenate([np.ones((len(near), 1)), apart[near]], axis=1)
    weight = 1 / (0.5 + away[near])
    out = np.full((len(pixel), 2), np.nan)
    for t in range(len(pixel)):
        there = seen[t, near]
        if there.sum() >= LEAST_NODES:
            w = weight[there, None]
            out[t] = np.linalg.lstsq(w * terms[there], w * pixel[t, near[there]], rcond=None)[0][0]
    return out


def asked(how: str, video: ColourVideo, count: int) -> np.ndarray:
    """What a detector of somebody else's says: `module:function` is called with each frame (H, W, 3) uint8, red first,
    and gives pixels (G, 2), NaN for a hand that it does not find.
    """
    module, _, name = how.partition(":")
    try:
        detector: Callable[[np.ndarray], Any] = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError) as fault:
        raise ClothbenchError(f"grips={how}: found no such function ({fault}); expected module:function") from fault
    out = np.array([np.asarray(detector(frame), dtype=float) for frame in video.frames()])
    if out.shape != (len(video.time), count, 2):
        raise ClothbenchError(f"grips={how}: found pixels of shape {out.shape[1:]}, expected ({count}, 2)")
    return out


class Follower:
    """Points of the first frame followed from frame to frame by pyramidal Lucas-Kanade flow, to a fraction of a
    pixel.
    """

    def __init__(self, first: np.ndarray, pixel: np.ndarray, window: int, miss: float = 1.0):
        self.last, self.pixel = _grey(first), np.asarray(pixel, dtype=np.float32)
        self.window, self.miss = (window, window), miss
        self.first, self.lost = (self.last, self.pixel), np.zeros(len(self.pixel), bool)

    def step(self, frame: np.ndarray) -> np.ndarray:
        """Whether each point was found in the next frame, (N,) bool: there and back again within `miss` px, with some
        texture to hold on to. `pixel` is moved to where it is now; a point that was lost goes with those around it.
        """
        import cv2

        grey = _grey(frame)
        options: dict[str, Any] = {"winSize": self.window, "maxLevel": 3, "minEigThreshold": TEXTURE}
        flow: Any = cv2.calcOpticalFlowPyrLK
        there, ok, _ = flow(self.last, grey, self.pixel[:, None], None, **options)
        back, again, _ = flow(grey, self.last, there, None, **options)
        miss = np.linalg.norm(back[:, 0] - self.pixel, axis=1)
        found = (ok.ravel() == 1) & (again.ravel() == 1) & (miss < self.miss)
        move = there[:, 0] - self.pixel
        if found.any():
            move[~found] = np.median(move[found], axis=0)
        else:
            move[:] = 0
        self.pixel, self.last = self.pixel + move, grey
        return found

    def found_in(self, frame: np.ndarray) -> np.ndarray:
        """Where the points are in the next frame (N, 2) px, NaN for one that was not found: where it would be by those
        around it serves to look for it again, and is no measurement. One that was lost is found again where it looks as
        in the first frame; flow alone would go on with whatever hid it.
        """
        before = self.pixel
        found = self.step(frame)
        again = found & self.lost
        surely = found & ~self.lost
        move = np.median((self.pixel - before)[surely], axis=0) if surely.any() else 0.0
        for k in np.flatnonzero(again).tolist():  # where flow takes it, or else where those around it do
            guesses = self.pixel[k], before[k] + move
            places = [there for guess in guesses if (there := self._again(_grey(frame), k, guess)) is not None]
            found[k] = bool(places)
            self.pixel[k] = places[0] if places else guesses[1]
        self.lost = ~found
        return np.where(found[:, None], self.pixel, np.nan)

    def _again(self, grey: np.ndarray, k: int, guess: np.ndarray) -> np.ndarray | None:
        """Where flow from the first frame straight to this one (H, W), from a guess (2,) px on, takes point number k
        (2,) px; None where it does not look as it did.
        """
        import cv2

        (first, pixel), begin = self.first, np.array(guess, dtype=np.float32).reshape(1, 1, 2)
        flow: Any = cv2.calcOpticalFlowPyrLK
        place = pixel[k : k + 1, None]
        near: dict[str, Any] = {"winSize": self.window, "maxLevel": 1, "flags": cv2.OPTFLOW_USE_INITIAL_FLOW}
        there = flow(first, grey, place, begin, **near)[0][0, 0]
        looks = [
            cv2.getRectSubPix(picture, self.window, (float(at[0]), float(at[1]))).astype(float)
            for picture, at in ((first, pixel[k]), (grey, there))
        ]
        before, now = (look - look.mean() for look in looks)
        alike = float((before * now).sum()) / max(float(np.sqrt((before**2).sum() * (now**2).sum())), 1e-9)
        return there if alike > ALIKE else None


def _grey(frame: np.ndarray) -> np.ndarray:
    import cv2

    return cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY)


def follower_of_marks(video: ColourVideo, graph: Graph, first: np.ndarray) -> Follower | None:
    """The held points of the first frame, ready to be followed; None where a robot has told."""
    if video.grips is not None:
        return None
    if video.marks is not None:
        pixel = video.marks.pixel[:2]
    else:
        size, shape = np.array([video.cloth_width, video.cloth_height]), video.template.shape[:2]
        pixel = graph.found(to_template(held_material(video), size, shape))
    return Follower(first, pixel, max(7, int(graph.spacing) | 1))


def pictures_of(video: ColourVideo, mesh: tuple[int, int], frame: int, seen: Observation) -> dict[str, np.ndarray]:
    """The first frame and another with the graph over them, by name."""
    assert seen.sight is not None
    shown = {"first frame": 0, "graph": frame}
    place, _ = seen.sight.project(np.nan_to_num(seen.position))
    kept = {k: picture for k, picture in enumerate(video.frames()) if k in shown.values()}
    return {name: drawn(kept[k], mesh, place[k], seen.visible[k]) for name, k in shown.items()}


def drawn(frame: np.ndarray, mesh: tuple[int, int], pixel: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """The graph (N, 2) px over a frame (H, W, 3): lines between neighbours that are seen, a dot for each node."""
    import cv2

    out = with_mesh(frame, mesh, np.nan_to_num(pixel), seen, GRAPH)
    for x, y in pixel[seen]:
        cv2.circle(out, (round(float(x)), round(float(y))), 3, GRAPH, -1, cv2.LINE_AA)
    return out
