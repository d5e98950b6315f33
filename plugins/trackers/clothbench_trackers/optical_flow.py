"""`optical_flow`: the same graph, followed by pyramidal Lucas-Kanade flow from frame to frame, as one would without
SIFT. A node that is lost stays lost: flow has nothing to know it again by.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from clothbench import ClothbenchError, ColourVideo, Observation
from clothbench_trackers import picture_graph as graphs
from clothbench_trackers.options import check_mesh, check_metres


class OpticalFlow:
    """mesh: cells along (u, v); window: cells along the side of the patch that is followed; back: px, how near a node
    has to come back to where it was when it is followed backwards; grips, sigma: as of `sift_graph`.
    """

    name = "optical_flow"
    version = 4
    kinds = frozenset({"video"})

    def __init__(
        self, mesh: Sequence[int] = (20, 10), window: float = 1.0, back: float = 1.0, grips: str = "corners",
        sigma: float | None = None,
    ):  # fmt: skip
        for word, value, low, high in (("window", window, 0.2, 4.0), ("back", back, 0.05, 20.0)):
            if not isinstance(value, int | float) or not low <= value <= high:
                raise ClothbenchError(f"optical_flow: {word} is {value!r}, expected {low:g} to {high:g}")
        check_metres(self.name, "sigma", sigma)
        self.mesh, self.grips = check_mesh(self.name, mesh, 2), graphs.check_grips(self.name, grips)
        self.window, self.back, self.sigma = float(window), float(back), sigma

    def track(self, source: ColourVideo | Path) -> Observation:
        """The nodes of a recording of kind "video", or of its file."""
        video = graphs.video_of(source, self.name)
        frames = video.frames()
        first = next(frames)
        graph = graphs.graph_of(video, self.mesh, first)
        patch = max(5, int(self.window * graph.spacing) | 1)
        nodes = graphs.Follower(first, graph.nodes, patch, self.back)
        marks = graphs.follower_of_marks(video, graph, first) if self.grips == "marks" else None
        there = nodes.step(first)  # plain places show at once
        pixel, seen, followed = [nodes.pixel], [there], [marks.pixel if marks else np.zeros((0, 2))]
        for frame in frames:
            there = there & nodes.step(frame)
            pixel.append(nodes.pixel)
            seen.append(there)
            if marks is not None:
                followed.append(marks.found_in(frame))
        where, visible = np.array(pixel, dtype=float), np.array(seen)
        path = np.array(followed, dtype=float) if marks is not None else None
        held = graphs.held_path(video, graph, self.grips, where, visible, path)
        return graphs.observed(video, graph, where, visible, visible.astype(float), held, self.sigma)

    def pictures(self, source: ColourVideo, frame: int, seen: Observation) -> dict[str, np.ndarray]:
        """The first frame and this one with the graph over them."""
        return graphs.pictures_of(source, self.mesh, frame, seen)
