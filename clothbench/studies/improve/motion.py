"""How a sheet was seen to move: positions, velocities and accelerations, whenever its frames came.

Frames may come unevenly, and not all of the sheet is in each. So each node's coordinates become a smoothing spline of
fifth degree (penalised third derivative, on the basis of Eilers and Marx 1996, Flexible smoothing with B-splines and
penalties, Stat. Sci. 11), and so does the line of the grips. All that follows is derivatives of these: what the
spline takes off the acceleration it then takes off the weight's lever as well, and a balance of them still holds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clothbench.core.observation import Observation
from clothbench.core.scene import Scene

DEGREE = 5
FASTEST = 5.0  # Hz, of motion that is kept of frames that come fast enough
RESOLVED = 0.3  # of the rate of frames, that they resolve
KNOTS = 4.0  # per period of the fastest motion that is kept
GAP = 1.5  # periods of that motion between two frames, across which nothing is told
ENDS = 0.75  # of that period, at either end of a recording and of a gap, where a spline hangs on too little
SAMPLED = 1 / 30  # s, of the times at which motion is told, unless frames come faster
LEAST_FRAMES = 20  # of a recording
LEAST_COUNTED = 1.0  # s of motion that have to be told
LEAST_COVERED = 0.9  # of the sheet, that lies between nodes seen in most frames
LEAST_SEEN = 0.5  # of the frames, in which a node has to be seen; and of the nodes, in a frame that is counted
NEIGHBOURS = 6  # nodes of the same frame, by which one is bridged that was not seen for long
LEAST_ACROSS = 0.1  # of a force, that has to be across the line of the grips, for it to be told from its torque
STRAIGHT = 0.02  # of the length of the line of the grips, by which one may lie beside it


@dataclass(frozen=True, eq=False)
class Motion:
    """A sheet as it was seen to move, and how much of it each node stands for.

    time: (T,) s; x, v, a: (T, N, 3) m, m/s, m/s²; normal: (T, N, 3); line: (T, 3), along the grips; lever: (T, N, 3) m,
    how a node moves by one radian about it; area: (N,) m²; along: (N, 2), place on the sheet, 0 to 1 from left to right
    and from the upper edge to the lower; width: m; density: kg/m²; gravity: (3,) m/s²; noise: m, σ of a coordinate;
    rate: 1/s, of the frames; fastest: Hz, motion that is kept; counted: (T,), times that are neither in nor next to a
    gap between frames that saw enough.
    """

    time: np.ndarray
    x: np.ndarray
    v: np.ndarray
    a: np.ndarray
    normal: np.ndarray
    line: np.ndarray
    lever: np.ndarray
    area: np.ndarray
    along: np.ndarray
    width: float
    density: float
    gravity: np.ndarray
    noise: float
    rate: float
    fastest: float
    counted: np.ndarray

    def torque(self, force: np.ndarray) -> np.ndarray:
        """(T,) N·m about the line of the grips, of forces per area (T, N, 3) N/m²."""
        return np.einsum("tnc,tnc,n->t", force, self.lever, self.area)

    def sees(self, force: np.ndarray) -> bool:
        """Whether forces per area (T, N, 3) are not all but along the line of the grips, where they make no torque."""
        across = force - np.einsum("tnc,tc->tn", force, self.line)[..., None] * self.line[:, None]
        return bool(np.linalg.norm(across) >= LEAST_ACROSS * np.linalg.norm(force))

    @property
    def missing(self) -> np.ndarray:
        """(T,) N·m: what must act from outside, inertia less weight."""
        return self.torque(self.density * (self.a - self.gravity))

    @property
    def missing_sigma(self) -> float:
        """N·m, of `missing`, from the noise of the nodes: white noise through the second derivative of a smoothing
        spline, whose response to a frequency f is 1/(1 + (f/fastest)⁶).
        """
        acceleration = self.noise * np.sqrt(2 * (2 * np.pi) ** 4 * self.fastest**5 * np.pi / 18 / self.rate)
        share = np.square(self.lever).sum(axis=2) @ np.square(self.area)
        return float(self.density * acceleration * np.sqrt(share.mean()))

    @property
    def lower_edge(self) -> np.ndarray:
        """(N,) 1/m: of the nodes of the lowest row, the length of the edge that each stands for, over its area."""
        low = self.along[:, 1] >= self.along[:, 1].max() - 1e-6
        order = np.argsort(self.along[low, 0])
        at = self.along[low, 0][order] * self.width
        ends = np.concatenate([[0.0], (at[1:] + at[:-1]) / 2, [self.width]])
        out = np.zeros(len(self.area))
        out[np.flatnonzero(low)[order]] = np.diff(ends)
        return out / self.area

    @property
    def along_normal(self) -> np.ndarray:
        """(T, N) m/s: velocity along the normal."""
        return np.einsum("tnc,tnc->tn", self.v, self.normal)


def motion_of(observation: Observation, scene: Scene, noise: float) -> Motion | None:
    """The motion between the first and the last frame, less what the ends of splines are worth; None where a balance of
    it would say nothing: grips on no line, too few frames, nodes in a picture or on too little of the sheet, other
    contacts. noise: m, σ of a coordinate.
    """
    from scipy.spatial import Delaunay

    # A frame in which nothing was seen is none, whether a recording has it or not.
    some = observation.visible.any(axis=1)
    time = observation.time[some]
    if observation.sight is not None or scene.obstacles or len(time) < LEAST_FRAMES or scene.outline is not None:
        return None
    if (line := line_of_grips(scene, time)) is None:
        return None
    step = float(np.median(np.diff(time)))
    fastest = min(FASTEST, RESOLVED / step)
    seen = np.where(observation.visible[some, :, None], observation.position[some], np.nan)
    seen = bridged(with_grips(seen, observation.material, scene, time), observation.material, time, GAP / fastest / 3)
    often = np.asarray(np.isfinite(seen[..., 0]).mean(axis=0) >= LEAST_SEEN)
    seen, material = seen[:, often], observation.material[often]
    enough = time[np.isfinite(seen[..., 0]).mean(axis=1) >= LEAST_SEEN]
    if len(enough) < LEAST_FRAMES:
        return None
    at = np.arange(enough[0] + ENDS / fastest, enough[-1] - ENDS / fastest, min(step, SAMPLED))
    counted = ~in_gaps(enough, at, GAP / fastest, ENDS / fastest)
    if counted.sum() * min(step, SAMPLED) < LEAST_COUNTED or len(material) < 3:
        return None
    if np.linalg.matrix_rank(material - material[0]) < 2:
        return None
    triangles = oriented(material, Delaunay(material).simplices)
    if signed_area(material, triangles).sum() < LEAST_COVERED * scene.width * scene.height:
        return None
    x, v, a = smoothed(time, seen, at, fastest)
    middle, direction = (smoothed(time, each[:, None], at, fastest)[0][:, 0] for each in line)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return Motion(
        time=at, x=x, v=v, a=a, normal=normals(x, triangles), line=direction,
        lever=np.cross(direction[:, None], x - middle[:, None]), area=shares(material, triangles, scene),
        along=material / [scene.width, scene.height], width=scene.width, density=scene.areal_density,
        gravity=np.array(scene.gravity), noise=noise, rate=1 / step, fastest=fastest, counted=counted,
    )  # fmt: skip


def smoothed(time: np.ndarray, seen: np.ndarray, at: np.ndarray, fastest: float) -> list[np.ndarray]:
    """Positions (T, N, C) m with NaN where a node was not seen → position, velocity and acceleration at `at` (S,) s,
    each (S, N, C); motion of more than `fastest` Hz is smoothed away.
    """
    from scipy.interpolate import BSpline
    from scipy.sparse import diags_array
    from scipy.sparse.linalg import splu

    spacing = 1 / KNOTS / fastest
    cells = max(DEGREE + 1, int(np.ceil((time[-1] - time[0]) / spacing)))
    inner, width = np.linspace(time[0], time[-1], cells + 1, retstep=True)
    outer = width * np.arange(1, DEGREE + 1)
    knots = np.concatenate([time[0] - outer[::-1], inner, time[-1] + outer])
    basis = BSpline.design_matrix(time, knots, DEGREE)
    # The third derivative is a spline of second degree; products of its basis, whose knots are 1 apart, are whole
    # numbers over 120. To count its coefficients alone would smooth fast motion away twice over.
    count = basis.shape[1]
    third = diags_array([-1.0, 3.0, -3.0, 1.0], offsets=[0, 1, 2, 3], shape=(count - 3, count))
    overlap = np.array([1.0, 26.0, 66.0, 26.0, 1.0]) / 120
    products = diags_array(overlap, offsets=[-2, -1, 0, 1, 2], shape=(count - 3, count - 3))
    penalty = third.T @ products @ third / width**5 / (2 * np.pi * fastest) ** 6
    step = float(np.median(np.diff(time)))
    known = np.isfinite(seen).all(axis=2)
    coefficients = np.empty((basis.shape[1], *seen.shape[1:]))
    patterns, which = np.unique(known, axis=1, return_inverse=True)
    for k, weights in enumerate(patterns.T):
        nodes = which.ravel() == k
        weighted = basis[weights] * step
        right = weighted.T @ seen[weights][:, nodes].reshape(int(weights.sum()), -1)
        solution = splu((basis[weights].T @ weighted + penalty).tocsc()).solve(right)
        coefficients[:, nodes] = solution.reshape(len(solution), -1, seen.shape[2])
    spline = BSpline(knots, coefficients, DEGREE)
    return [spline(at, nu) for nu in range(3)]


def steady_axes(motions: Sequence[Motion]) -> str:
    """The axes of the world, of "xyz", along which a steady force would be seen: not along the line of the grips, where
    it makes no torque, nor along gravity, where it is part of the weight.
    """
    out = ""
    for name, axis in zip("xyz", np.eye(3), strict=True):
        down = [m.gravity / max(np.linalg.norm(m.gravity), 1e-12) for m in motions]
        across = min(float(np.linalg.norm(axis - axis @ d * d)) for d in down)
        if across >= LEAST_ACROSS and all(m.sees(np.broadcast_to(axis, m.x.shape)) for m in motions):
            out += name
    return out


def between_frames(time: np.ndarray, at: np.ndarray) -> np.ndarray:
    """(S,) s from the frame before each of the times `at` to the one after it."""
    after = np.clip(np.searchsorted(time, at), 1, len(time) - 1)
    return time[after] - time[after - 1]


def in_gaps(time: np.ndarray, at: np.ndarray, longest: float, ends: float) -> np.ndarray:
    """Which of the times `at` (S,) are in a gap of more than `longest` s between frames, or within `ends` s of one."""
    first = np.flatnonzero(np.diff(time) > longest)
    return np.asarray(((at > time[first, None] - ends) & (at < time[first + 1, None] + ends)).any(axis=0))


def with_grips(seen: np.ndarray, material: np.ndarray, scene: Scene, time: np.ndarray) -> np.ndarray:
    """Positions (T, N, 3) in which nodes that are held are where their grip is, when they were not seen."""
    out = seen.copy()
    apart = np.linalg.norm(material[:, None] - scene.grip_material[None], axis=2)
    for node in np.flatnonzero(apart.min(axis=1) < 1e-3):
        path = scene.grip_position[:, int(np.argmin(apart[node]))]
        held = np.stack([np.interp(time, scene.grip_time, path[:, c]) for c in range(3)], axis=1)
        out[:, node] = np.where(np.isfinite(out[:, node]), out[:, node], held)
    return out


def bridged(seen: np.ndarray, material: np.ndarray, time: np.ndarray, longest: float) -> np.ndarray:
    """Positions (T, N, 3) in which nodes that were not seen for more than `longest` s, but were in most frames, lie on
    the plane through their neighbours on the sheet; shorter gaps are left to the spline.
    """
    out, known = seen.copy(), np.isfinite(seen[..., 0])
    for node in np.flatnonzero((~known).any(axis=0) & (known.mean(axis=0) >= LEAST_SEEN)):
        frames = np.flatnonzero(known[:, node])
        gap = np.full(len(time), np.inf)
        inner = slice(frames[0], frames[-1] + 1)
        gap[inner] = between_frames(time[frames], time[inner])
        nearest = np.argsort(np.linalg.norm(material - material[node], axis=1), kind="stable")[1:]
        for t in np.flatnonzero(~known[:, node] & (gap > longest)):
            around = nearest[known[t, nearest]][:NEIGHBOURS]
            design = np.column_stack([np.ones(len(around)), material[around] - material[node]])
            if np.linalg.matrix_rank(design) == 3:
                out[t, node] = np.linalg.lstsq(design, seen[t, around], rcond=None)[0][0]
    return out


def line_of_grips(scene: Scene, time: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """A point (T, 3) m of the line through the grips, and its direction (T, 3); None where they lie on no line."""
    if len(scene.grip_material) < 2:
        return None
    held = np.stack([[np.interp(time, scene.grip_time, c) for c in grip.T]
                     for grip in np.moveaxis(scene.grip_position, 1, 0)]).transpose(2, 0, 1)  # fmt: skip
    far = np.linalg.norm(scene.grip_material - scene.grip_material[0], axis=1)
    last = int(np.argmax(far))
    along = held[:, last] - held[:, 0]
    length = np.linalg.norm(along, axis=1, keepdims=True)
    if (length < 1e-6).any():
        return None
    direction = along / length
    away = held - held[:, :1]
    beside = away - np.einsum("tkc,tc->tk", away, direction)[..., None] * direction[:, None]
    return (held[:, 0], direction) if np.abs(beside).max() <= STRAIGHT * length.max() else None


def oriented(material: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """The triangles (F, 3), all turned the same way in the material."""
    return np.where(signed_area(material, triangles)[:, None] < 0, triangles[:, ::-1], triangles)


def signed_area(material: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(F,) m² in the material, negative where the corners go the other way round."""
    a, b, c = (material[triangles[:, k]] for k in range(3))
    one, other = b - a, c - a
    return np.asarray(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]) / 2


def normals(x: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Unit normals (T, N, 3) of the nodes, each triangle with its area."""
    a, b, c = (x[:, triangles[:, k]] for k in range(3))
    each, out = np.cross(b - a, c - a), np.zeros_like(x)
    for k in range(3):
        np.add.at(out.transpose(1, 0, 2), triangles[:, k], each.transpose(1, 0, 2))
    return out / np.maximum(np.linalg.norm(out, axis=2, keepdims=True), 1e-300)


def shares(material: np.ndarray, triangles: np.ndarray, scene: Scene) -> np.ndarray:
    """(N,) m²: a third of each triangle that a node is a corner of, together the whole sheet."""
    area, out = signed_area(material, triangles), np.zeros(len(material))
    for k in range(3):
        np.add.at(out, triangles[:, k], area / 3)
    return out * scene.width * scene.height / out.sum()
