"""The balance of torques about the line of the grips: an identity of mechanics that no model's fault can touch.

A small rotation of the whole sheet about the line through its grips strains nothing and moves no grip, so neither what
is inside the cloth nor what holds it does any work on it (d'Alembert's principle; Lanczos 1970, The Variational
Principles of Mechanics, ch. IV). What is left of weight and inertia is what acts from outside: the air, and whatever
else nobody has named. No model is needed to see it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.signal import savgol_coeffs, savgol_filter
from scipy.spatial import Delaunay

from clothbench.core.observation import Observation
from clothbench.core.scene import Scene

SMOOTHED = 0.3  # s, over which positions are taken for a parabola to get velocity and acceleration
LEAST_FRAMES = 20  # that are left of a recording
LEAST_COVERED = 0.9  # of the sheet, that lies between nodes seen in all frames but for short gaps
LONGEST_GAP = 3  # frames, that a node which was not seen is carried over
STRAIGHT = 0.02  # of the length of the line of the grips, by which one may lie beside it
ORDER = 4
POWERS = (1.5, 2.0, 2.5, 3.0)  # of the speed, in laws of drag
TIMES = (0.02, 0.05, 0.1, 0.15, 0.25, 0.4, 0.7, 1.2)  # s, relaxation times of the air


@dataclass(frozen=True, eq=False)
class Motion:
    """A sheet as it was seen to move, and how much of it each node stands for.

    time: (T,) s; x, v, a: (T, N, 3) m, m/s, m/s²; normal: (T, N, 3); lever: (T, N, 3) m, how a node moves by one radian
    about the line of the grips; area: (N,) m²; along: (N, 2), place on the sheet, 0 to 1 from left to right and from
    the upper edge to the lower; width: m; density: kg/m²; gravity: (3,) m/s²; noise: m, σ of a coordinate.
    """

    time: np.ndarray
    x: np.ndarray
    v: np.ndarray
    a: np.ndarray
    normal: np.ndarray
    lever: np.ndarray
    area: np.ndarray
    along: np.ndarray
    width: float
    density: float
    gravity: np.ndarray
    noise: float

    def torque(self, force: np.ndarray) -> np.ndarray:
        """(T,) N·m about the line of the grips, of forces per area (T, N, 3) N/m²."""
        return np.einsum("tnc,tnc,n->t", force, self.lever, self.area)

    @property
    def missing(self) -> np.ndarray:
        """(T,) N·m: what must act from outside, inertia less weight."""
        return self.torque(self.density * (self.a - self.gravity))

    @property
    def missing_sigma(self) -> float:
        """N·m, of `missing`, from the noise of the nodes."""
        step = float(np.median(np.diff(self.time)))
        weights = savgol_coeffs(window_of(step), ORDER, deriv=2, delta=step)
        acceleration = self.noise * float(np.linalg.norm(weights))
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
    """The motion between the first and the last smoothed frame; None where the balance says nothing: grips on no line,
    frames that are too few or uneven, nodes in a picture or on too little of the sheet, other contacts. noise: m, σ of
    a coordinate.
    """
    time = observation.time
    if observation.sight is not None or scene.obstacles or len(time) < LEAST_FRAMES or scene.outline is not None:
        return None
    steps, step = np.diff(time), float(np.median(np.diff(time)))
    if np.ptp(steps) > 0.2 * step or (line := line_of_grips(scene, time)) is None:
        return None
    seen = np.where(observation.visible[..., None], observation.position, np.nan)
    seen = carried_over(seen)
    whole = np.asarray(np.isfinite(seen).all(axis=(0, 2)))
    window = window_of(step)
    seen, material = seen[:, whole], observation.material[whole]
    if len(time) < LEAST_FRAMES + window or len(material) < 3 or np.linalg.matrix_rank(material - material[0]) < 2:
        return None
    triangles = oriented(material, Delaunay(material).simplices)
    if signed_area(material, triangles).sum() < LEAST_COVERED * scene.width * scene.height:
        return None
    inside = slice(window // 2, len(time) - window // 2)
    x, v, a = (savgol_filter(seen, window, ORDER, deriv=d, delta=step, axis=0)[inside] for d in range(3))
    middle, direction = (each[inside] for each in line)
    return Motion(
        time=time[inside], x=x, v=v, a=a, normal=normals(x, triangles),
        lever=np.cross(direction[:, None], x - middle[:, None]), area=shares(material, triangles, scene),
        along=material / [scene.width, scene.height], width=scene.width, density=scene.areal_density,
        gravity=np.array(scene.gravity), noise=noise,
    )  # fmt: skip


def window_of(step: float) -> int:
    """Frames that are smoothed over: an odd number, five at least."""
    return max(5, 2 * round(SMOOTHED / step / 2) + 1)


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


def carried_over(seen: np.ndarray) -> np.ndarray:
    """Positions (T, N, 3) with short gaps filled evenly in time."""
    out, frames = seen.copy(), np.arange(len(seen))
    for n in range(seen.shape[1]):
        known = np.isfinite(seen[:, n, 0])
        if known.all() or known.sum() < 2:
            continue
        before = np.maximum.accumulate(np.where(known, frames, -1))
        after = np.minimum.accumulate(np.where(known, frames, len(seen))[::-1])[::-1]
        short = ~known & (after - before - 1 <= LONGEST_GAP) & (before >= 0) & (after < len(seen))
        for c in range(3):
            out[short, n, c] = np.interp(frames[short], frames[known], seen[known, n, c])
    return out


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


def late(motion: Motion, relaxation: float) -> np.ndarray:
    """(T, N) m/s: by how much the normal velocity is ahead of air that follows it in `relaxation` s (`air_memory`)."""
    speed = motion.along_normal
    out = np.zeros_like(speed)
    for k, step in enumerate(np.diff(motion.time)):
        s = step / relaxation
        out[k + 1] = np.exp(-s) * out[k] - np.expm1(-s) / s * (speed[k + 1] - speed[k])
    return out


def delayed(motion: Motion, relaxation: float) -> np.ndarray:
    """Forces per area (T, N, 3) against the normal velocity that the air does not have yet."""
    return -late(motion, relaxation)[..., None] * motion.normal


def power(motion: Motion, exponent: float) -> np.ndarray:
    """Forces per area (T, N, 3) against the normal velocity to a power."""
    speed = motion.along_normal
    return -(np.abs(speed) ** (exponent - 1) * speed)[..., None] * motion.normal


def along_axis(motion: Motion, axis: int, by_place: bool) -> np.ndarray:
    """Forces per area (T, N, 3) along an axis of the world, alike everywhere or growing against the place."""
    out = np.zeros_like(motion.x)
    out[..., axis] = -motion.x[..., axis] if by_place else 1.0
    return out


@dataclass(frozen=True)
class Term:
    """One term of a law. name: as it is told; formula: with its coefficient k; unit: of the coefficient; force: per
    area (T, N, 3) at a coefficient of 1; slot: number of the coefficient in `missing_force`, shape: of a number beside
    it, and its value; positive: mass, which cannot be negative: a sheet without any would balance whatever it did.
    """

    name: str
    formula: str
    unit: str
    force: Callable[[Motion], np.ndarray]
    slot: int
    shape: tuple[int, float] | None = None
    positive: bool = False


def terms() -> tuple[Term, ...]:
    """What a missing force may go with: velocity to a power, acceleration, the past, place, and places on the cloth."""
    return (
        Term("normal velocity", "−k v_n n", "kg/(m²·s)", lambda m: power(m, 1.0), 0),
        *(
            Term(f"normal velocity to the power {p:g}", f"−k |v_n|{'' if p == 2 else f'^{p - 1:g}'} v_n n",
                 f"N/m² (s/m)^{p:g}", partial(power, exponent=p), 1, (2, p))
            for p in POWERS
        ),
        Term("speed squared", "−k |v| v", "kg/m³", lambda m: -np.linalg.norm(m.v, axis=2, keepdims=True) * m.v, 3),
        Term("normal acceleration", "−k a_n n", "kg/m²",
             lambda m: -np.einsum("tnc,tnc->tn", m.a, m.normal)[..., None] * m.normal, 4, positive=True),
        *(
            Term(f"normal velocity of the last {t:g} s", f"−k y n, ẏ = v̇_n − y/({t:g} s)", "kg/(m²·s)",
                 partial(delayed, relaxation=t), 5, (6, t), positive=True)
            for t in TIMES
        ),
        Term("normal velocity, lower down", "−k (s/H) v_n n", "kg/(m²·s)",
             lambda m: power(m, 1.0) * m.along[None, :, 1:], 7),
        Term("mass along the lower edge", "−k δ(s − H) (a − g)", "kg/m",
             lambda m: -(m.a - m.gravity) * m.lower_edge[None, :, None], 8, positive=True),
        Term("mass, lower down", "−k (s/H) (a − g)", "kg/m²",
             lambda m: -(m.a - m.gravity) * m.along[None, :, 1:], 9, positive=True),
        *(
            Term(f"a steady force along {axis}", f"k e_{axis}", "N/m²",
                 partial(along_axis, axis=i, by_place=False), 10 + i)
            for i, axis in enumerate("xyz")
        ),
        *(
            Term(f"place along {axis}", f"−k {axis} e_{axis}", "N/m³",
                 partial(along_axis, axis=i, by_place=True), 13 + i)
            for i, axis in enumerate("xyz")
        ),
    )  # fmt: skip
