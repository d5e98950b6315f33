"""`sift_graph`: a printed cloth before one colour camera, followed by SIFT keypoints, cell by cell.

The method of "Cloth mechanical parameter estimation and simulation for optimized robotic manipulation", section 4.
Each cell of the template looks for its keypoints in a window around where its node was last, from the first frame on,
which the homography alone would do in the paper. There (`place="literal"`) the best correspondence says where the node
is now, and without one it stays where it was, and does not count. Here it is where those correspondences that agree
have it; a node without goes with its neighbours, and does not count either.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from clothbench import ClothbenchError, ColourVideo, Keypoints, Observation, apart, check_choice, for_each
from clothbench_trackers import picture_graph as graphs
from clothbench_trackers.options import check_mesh, check_metres

PLACES = ("offset", "literal")
AT_ONCE = 4  # frames whose keypoints are looked for side by side
LIKE = 0.6  # apart of two descriptors at most that show the same: in a window with few others, the ratio says little
SECONDED = 2  # correspondences of a cell that have to agree, or what is found may be anything
AGREE = 0.2  # cells, within which they do
ASTRAY = 0.35  # cells, by which a node may leave those around it


class SiftGraph:
    """mesh: cells along (u, v); window: cells along its side, 1 to 2 in the paper; place: "literal", the node is
    where the keypoint is, as in the paper, or "offset", the keypoint's offset from the cell's centre is kept, as the
    cloth around has it; ratio: Lowe's, of the best to the second best in the window; grips: "corners", "marks" or a
    detector's "module:function", unless the recording states them; sigma: m, of a coordinate, None: as the recording
    states it, else judged from how nodes tremble.
    """

    name = "sift_graph"
    version = 5
    kinds = frozenset({"video"})

    def __init__(
        self, mesh: Sequence[int] = (20, 10), window: float = 2.0, place: str = "offset", ratio: float = 0.8,
        grips: str = "corners", sigma: float | None = None,
    ):  # fmt: skip
        check_choice(self.name, "place", place, PLACES)
        for word, value, low, high in (("window", window, 1.0, 4.0), ("ratio", ratio, 0.1, 1.0)):
            if not isinstance(value, int | float) or not low <= value <= high:
                raise ClothbenchError(f"sift_graph: {word} is {value!r}, expected {low:g} to {high:g}")
        check_metres(self.name, "sigma", sigma)
        self.mesh, self.grips = check_mesh(self.name, mesh, 2), graphs.check_grips(self.name, grips)
        self.window, self.place, self.ratio, self.sigma = float(window), place, float(ratio), sigma

    def track(self, source: ColourVideo | Path) -> Observation:
        """The nodes of a recording of kind "video", or of its file."""
        video = graphs.video_of(source, self.name)
        frames = video.frames()
        first = next(frames)
        graph = graphs.graph_of(video, self.mesh, first)
        search = Search(graph, self.window, self.ratio, self.place)
        marks = graphs.follower_of_marks(video, graph, first) if self.grips == "marks" else None
        pixel, seen, confidence, followed = [], [], [], []
        for frame, keypoints in _with_keypoints(first, frames, search):
            one, there, sure = search.step(keypoints)
            pixel.append(one)
            seen.append(there)
            confidence.append(sure)
            if marks is not None:
                followed.append(marks.found_in(frame))
        path = np.array(followed, dtype=float) if followed else None
        where, there = np.array(pixel), np.array(seen)
        held = graphs.held_path(video, graph, self.grips, where, there, path)
        return graphs.observed(video, graph, where, there, np.array(confidence), held, self.sigma)

    def pictures(self, source: ColourVideo, frame: int, seen: Observation) -> dict[str, np.ndarray]:
        """The template with its keypoints, and the first frame and this one with the graph over them."""
        import cv2

        template = np.ascontiguousarray(source.template).copy()
        for x, y in Keypoints.of(source.template).place:
            cv2.circle(template, (round(x), round(y)), 2, (220, 60, 40), -1, cv2.LINE_AA)
        return {"template": template, **graphs.pictures_of(source, self.mesh, frame, seen)}


def _with_keypoints(
    first: np.ndarray, frames: Iterator[np.ndarray], search: Search
) -> Iterator[tuple[np.ndarray, Keypoints]]:
    """Every frame with its keypoints around the nodes, those of some frames looked for side by side."""
    block = [first]
    while block:
        found = _keypoints(block, search.around(first.shape[:2]))
        yield from zip(block, found, strict=True)
        block = list(itertools.islice(frames, AT_ONCE))


def _keypoints(frames: list[np.ndarray], around: tuple[int, int, int, int]) -> list[Keypoints]:
    top, bottom, left, right = around
    found: list[Any] = [None] * len(frames)

    def one(k: int) -> None:
        inside = Keypoints.of(frames[k][top:bottom, left:right])
        found[k] = Keypoints(inside.place + np.array([left, top]), inside.descriptor)

    for_each(one, range(len(frames)))
    return found


class Search:
    """Where each node of a graph was last, and the step to the next frame."""

    def __init__(self, graph: graphs.Graph, window: float, ratio: float, place: str):
        self.graph, self.ratio, self.place = graph, ratio, place
        self.pixel, self.slope = graph.nodes, graph.slopes
        self.spacing = graph.spacing
        self.reach = window * self.spacing / 2
        own = graph.keypoints.place
        self.cells = [np.flatnonzero((np.abs(own - c) <= graph.cell / 2).all(axis=1)) for c in graph.centre]

    def around(self, shape: tuple[int, int]) -> tuple[int, int, int, int]:
        """Rows and columns of a frame (H, W) in which the next frames may show the cloth."""
        margin = (AT_ONCE + 1) * self.reach  # a step for each of these frames, and the window around the last place
        low = np.maximum(np.floor(self.pixel.min(axis=0) - margin), 0).astype(int)
        high = np.minimum(np.ceil(self.pixel.max(axis=0) + margin).astype(int), shape[::-1])
        return low[1], high[1], low[0], high[0]

    def step(self, frame: Keypoints) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The nodes' places (N, 2) px in the next frame, which of them were seen (N,), and how surely (N,), 0 to 1."""
        from scipy.spatial import cKDTree

        count = len(self.pixel)
        new, seen, sure = self.pixel.copy(), np.zeros(count, bool), np.zeros(count)
        near = cKDTree(frame.place).query_ball_point(self.pixel, self.reach, p=np.inf) if len(frame.place) else []
        for n, window in enumerate(near):
            own = self.cells[n]
            if len(window) < 2 or not len(own):
                continue
            there = np.array(window)
            away = apart(self.graph.keypoints.descriptor[own], frame.descriptor[there])
            two = np.argpartition(away, 1, axis=1)[:, :2]
            pair = np.take_along_axis(away, two, axis=1)
            best, second = pair.min(axis=1), pair.max(axis=1)
            good = (best < self.ratio * second) & (best < LIKE)
            if not good.any():
                continue
            k = int(np.argmin(np.where(good, best, np.inf)))
            keypoint = frame.place[there[np.take_along_axis(two, pair.argmin(axis=1)[:, None], axis=1)[:, 0]]]
            if self.place == "literal":
                new[n], seen[n] = keypoint[k], True
            else:
                votes = keypoint + (self.graph.centre[n] - self.graph.keypoints.place[own]) @ self.slope[n].T
                alike = good & (np.linalg.norm(votes - votes[k], axis=1) <= AGREE * self.spacing)
                new[n], seen[n] = np.mean(votes[alike], axis=0), alike.sum() >= SECONDED
            sure[n] = 1 - best[k] / second[k]
        if self.place == "offset":
            new, seen = self._with_neighbours(new, seen)
        self.pixel = new
        return new.copy(), seen, np.where(seen, sure, 0.0)

    def _with_neighbours(self, new: np.ndarray, seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A node that leaves those around it is not believed; one that is not seen goes with them, to be looked for
        there. The slopes are those of the graph as it is now.
        """
        nu, nv = self.graph.mesh
        move = np.where(seen[:, None], new - self.pixel, np.nan).reshape(nv, nu, 2)
        padded = np.pad(move, ((1, 1), (1, 1), (0, 0)), constant_values=np.nan)
        around = np.stack([padded[i : i + nv, j : j + nu] for i in range(3) for j in range(3)])
        known = np.isfinite(around[..., 0]).any(axis=0).ravel()
        usual = np.zeros((len(new), 2))
        usual[known] = np.nanmedian(around.reshape(9, -1, 2)[:, known], axis=0)
        seen = seen & (np.linalg.norm(new - self.pixel - usual, axis=1) <= ASTRAY * self.spacing)
        new = np.where(seen[:, None], new, self.pixel + usual)
        graph = new.reshape(nv, nu, 2)
        across, down = (np.gradient(graph, axis=1 - c) / self.graph.cell[c] for c in (0, 1))
        self.slope = np.stack([across, down], axis=-1).reshape(-1, 2, 2)
        return new, seen
