"""The scene: all that a model needs to know to simulate one recorded run."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clothbench.core.brief import brief
from clothbench.core.camera import Camera
from clothbench.core.errors import ClothbenchError
from clothbench.core.outline import checked_outline
from clothbench.core.scene_rules import (
    as_array,
    check_gravity,
    check_grips,
    check_number,
    check_points,
    check_resolution,
    check_stamps,
    grip_off,
    is_triple,
)

AIR_DENSITY = 1.2  # kg/m³, dry air at 20 °C
ALIGNED = 1e-6  # of a sheet's size, by which points may lie beside a line that they are all on
HEAVIEST = 5.0  # kg/m², of any cloth


SHAPES = ("plane", "disc", "sphere")


@dataclass(frozen=True, eq=False)
class Obstacle:
    """Something solid that the cloth cannot enter.

    shape: "plane" (half-space below `centre`, against `normal`), "disc" (flat, `radius` about `centre`, infinitely
    thick against `normal`: a pedestal) or "sphere"; centre: (3,) m; normal: (3,), unit, outwards, of plane and disc;
    radius: m, of disc and sphere; friction: Coulomb's coefficient; clamps: of a disc only, the part of the cloth that
    lies on it when the run begins is pressed onto it and does not move, as a drapemeter's two plates hold it; carried:
    it moves as the mean of the grips does, without turning, as the body does that wears a skirt: `centre` is where it
    stands when the run begins. What is not carried does not move.
    """

    shape: str
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    normal: tuple[float, float, float] = (0.0, 0.0, 1.0)
    radius: float = math.inf
    friction: float = 0.0
    clamps: bool = False
    carried: bool = False

    def __post_init__(self) -> None:
        if self.shape not in SHAPES:
            raise ClothbenchError(f"obstacle: shape is {self.shape!r}, expected one of {', '.join(SHAPES)}")
        if self.shape != "plane" and not (math.isfinite(self.radius) and self.radius > 0):
            raise ClothbenchError(f"obstacle: radius of a {self.shape} is {self.radius}, expected metres above 0")
        if not (math.isfinite(self.friction) and self.friction >= 0):
            raise ClothbenchError(f"obstacle: friction is {self.friction}, expected 0 or above")
        for name in ("centre", "normal"):
            if not is_triple(getattr(self, name)):
                raise ClothbenchError(f"obstacle: {name} is {getattr(self, name)!r}, expected three finite numbers")
        for name in ("clamps", "carried"):  # any text would be taken for yes
            if not isinstance(getattr(self, name), bool):
                raise ClothbenchError(f"obstacle: {name} is {getattr(self, name)!r}, expected true or false")
        length = math.hypot(*self.normal)
        if not (math.isfinite(length) and length > 0):
            raise ClothbenchError(f"obstacle: normal is {self.normal}, expected a direction")
        if self.clamps and self.shape != "disc":
            raise ClothbenchError(f"obstacle: a {self.shape} cannot clamp the cloth; only a disc can")
        if self.clamps and self.carried:
            raise ClothbenchError("obstacle: a disc that clamps the cloth stands still and cannot be carried by grips")
        object.__setattr__(self, "normal", tuple(c / length for c in self.normal))


def obstacles_of(stated: Sequence[Obstacle | Mapping[str, Any]]) -> tuple[Obstacle, ...]:
    """Obstacles, some of which may be as settings state them: what `Obstacle` takes, lists for its triples."""

    def made(words: Mapping[str, Any]) -> Obstacle:
        values: dict[str, Any] = {n: tuple(v) if isinstance(v, list) else v for n, v in words.items()}
        return Obstacle(**values)

    return tuple(o if isinstance(o, Obstacle) else made(o) for o in stated)


@dataclass(frozen=True, eq=False)
class Scene:
    """One run to simulate. SI, world frame, z up; arrays are read-only.

    width, height: m; areal_density: kg/m²; grip_time: (K,) s; grip_material: (G, 2) m; grip_position: (K, G, 3) m (G
    = 0: nothing is held); times: (T,) s and points: (N, 2) m, where and when the rollout is wanted; gravity: (3,)
    m/s²; air_density: kg/m³; resolution: nodes along (u, v), or None for the model's own choice; start: (N, 3) m,
    where the points were first seen (NaN = unknown): it tells a model which of several resting shapes the cloth hung
    in; velocity: (N, 3) m/s, how fast the points were at times[0] (NaN = unknown), or None; obstacles: what it cannot
    enter; thickness: m, how far apart its own layers stay (0: they pass through each other); camera: the one in whose
    picture the points are looked for, or None; outline: (M, 2) m, corners of the simple polygon that the sheet has been
    cut to, or None for the whole rectangle. The cloth rests, settled, in the grips' first pose when the run begins, or
    on the disc that clamps it; held by neither it starts from `start`, or flat, at rest. With a `velocity` it does not
    settle: at times[0] it goes on from `start` as it was seen to move (models of the capability "moving_start").
    """

    width: float
    height: float
    areal_density: float
    grip_time: np.ndarray
    grip_material: np.ndarray
    grip_position: np.ndarray
    times: np.ndarray
    points: np.ndarray
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    air_density: float = AIR_DENSITY
    resolution: tuple[int, int] | None = None
    start: np.ndarray | None = None
    obstacles: tuple[Obstacle, ...] = ()
    thickness: float = 0.0
    velocity: np.ndarray | None = None
    camera: Camera | None = None
    outline: np.ndarray | None = None

    __repr__ = brief

    def __post_init__(self) -> None:
        for name in ("grip_time", "grip_material", "grip_position", "times", "points", "start", "velocity"):
            if (value := getattr(self, name)) is not None:
                object.__setattr__(self, name, as_array(name, value))
        for name in ("width", "height", "areal_density"):
            check_number(name, getattr(self, name), above_zero=True)
        for name in ("thickness", "air_density"):
            check_number(name, getattr(self, name))
        check_gravity(self.gravity)
        check_resolution(self.resolution)
        check_stamps("times", self.times)
        check_points(self.points, [("start", self.start), ("velocity", self.velocity)])
        size = np.array([self.width, self.height])
        check_grips(self.grip_time, self.grip_material, self.grip_position, size)
        self._check_surroundings()
        if self.outline is not None:
            outline = checked_outline(self.outline, self.width, self.height)
            outline.flags.writeable = False
            object.__setattr__(self, "outline", outline)
            if not self.grips_carry and (fault := grip_off(outline, self.grip_material, size)):
                raise ClothbenchError(f"scene: {fault}")

    def _check_surroundings(self) -> None:
        for obstacle in self.obstacles:
            if not isinstance(obstacle, Obstacle):
                raise ClothbenchError(
                    f"scene: obstacles hold a {type(obstacle).__name__}, expected clothbench.Obstacle"
                )
        if self.grips_carry and not self.grip_material.size:
            raise ClothbenchError("scene: an obstacle is carried by the grips, and the scene has none")

    @property
    def grips_carry(self) -> bool:
        """Whether the grips carry an obstacle: they need not hold any cloth then."""
        return any(o.carried for o in self.obstacles)

    @property
    def start_time(self) -> float:
        """When the settled cloth is let go or begins to be moved, or when it was seen to move [s]."""
        if self.velocity is not None:
            return float(self.times[0])
        first = [self.times[0]] + ([self.grip_time[0]] if self.grip_material.size else [])
        return float(min(first))

    def grip_curve(self, position: np.ndarray | None = None) -> np.ndarray:
        """Piecewise cubic through the grips' stamps: coefficients (4, K-1, G, 3), highest power first.

        Modified Akima (Akima 1970): local and without overshoot where stamps crowd together, as a robot's do.
        """
        from scipy.interpolate import Akima1DInterpolator, PPoly

        position = self.grip_position if position is None else position
        if self.grip_time.size < 3:
            slope = np.diff(position, axis=0) / np.diff(self.grip_time)[:, None, None]
            return np.stack([np.zeros_like(slope), np.zeros_like(slope), slope, position[:-1]])
        curve: PPoly = Akima1DInterpolator(self.grip_time, position, method="makima")
        return np.ascontiguousarray(curve.c)

    def grips_at(self, times: np.ndarray, curve: np.ndarray | None = None) -> np.ndarray:
        """Where the grips are at `times` (T,) s → (T, G, 3) m; held still before the first and after the last stamp.

        curve: of grips that are elsewhere than the scene says, as `grip_curve` gives it.
        """
        times = np.clip(times, self.grip_time[0], self.grip_time[-1])
        i = np.clip(np.searchsorted(self.grip_time, times, side="right") - 1, 0, self.grip_time.size - 2)
        s = (times - self.grip_time[i])[:, None, None]
        c = self.grip_curve() if curve is None else curve
        return ((c[0, i] * s + c[1, i]) * s + c[2, i]) * s + c[3, i]


def initial_shape(scene: Scene, uv: np.ndarray) -> np.ndarray:
    """A first guess for material points `uv` (n, 2) m → (n, 3) m, from which a model settles to rest.

    The flat sheet hung from its grips, laid on the disc that clamps it, or flat where nothing holds it, bent towards
    where the points were first seen; or, where nobody saw them, turned as the grips hold it and bent into an arc
    between two that are nearer to each other than the cloth between them is long. Smooth, so that a fine mesh is not
    shaken by the noise of single nodes.
    """
    if scene.start is None:
        return _hung_free(scene, uv)
    seen = np.isfinite(scene.start).all(axis=1)
    size = np.array([scene.width, scene.height])
    at = scene.points[seen] / size
    if seen.sum() < 6 or np.linalg.matrix_rank(at - at[0], ALIGNED) < 2:  # too few, or all on one line, to say more
        return _hung_free(scene, uv)  # about the shape than the grips do
    hung = _hung_flat(scene, uv)
    from scipy.interpolate import RBFInterpolator

    away = scene.start[seen] - _hung_flat(scene, scene.points[seen])
    try:
        return hung + RBFInterpolator(at, away, smoothing=1e-3, neighbors=min(50, len(at)))(uv / size)
    except np.linalg.LinAlgError:  # the nearest of a narrow lattice may all lie on one line
        return hung + RBFInterpolator(at, away, smoothing=1e-3)(uv / size)


def initial_velocity(scene: Scene, uv: np.ndarray) -> np.ndarray:
    """How fast material points `uv` (n, 2) m move when the run begins → (n, 3) m/s: not at all, or as was seen.

    A cubic over the sheet, as far as so many points carry one: velocities of single nodes are mostly noise.
    """
    still = np.zeros((len(uv), 3))
    if scene.velocity is None:
        return still
    seen = np.isfinite(scene.velocity).all(axis=1)
    degree = int(np.clip(np.sqrt(2 * seen.sum()) / 2 - 1.5, 0, 3))  # at least twice as many points as terms
    if not seen.any():
        return still
    size = np.array([scene.width, scene.height])

    def terms(at: np.ndarray) -> np.ndarray:
        u, v = (2 * at / size - 1).T
        return np.stack([u**i * v**j for i in range(degree + 1) for j in range(degree + 1 - i)], axis=1)

    weight, *_ = np.linalg.lstsq(terms(scene.points[seen]), scene.velocity[seen], rcond=None)
    return terms(uv) @ weight


def minimum_jerk(s: np.ndarray) -> np.ndarray:
    """From 0 to 1 while s does, with no jerk at either end: 10 s³ − 15 s⁴ + 6 s⁵ (Flash and Hogan 1985)."""
    s = np.clip(s, 0.0, 1.0)
    return s**3 * (10 - 15 * s + 6 * s**2)


def arc(along: np.ndarray, length: float, chord: float) -> tuple[np.ndarray, np.ndarray]:
    """Places (n,) m along a strip of that length, when it is bent so that its ends are `chord` apart: how far they lie
    along the chord from its middle, and across it, (n,) m each. Beyond its ends the circle goes on.
    """
    low, high = 1e-6, np.pi
    for _ in range(80):  # bisection for sin φ / φ = chord / length
        middle = 0.5 * (low + high)
        low, high = (middle, high) if np.sin(middle) / middle > chord / length else (low, middle)
    radius, angle = length / (2.0 * low), low * (2.0 * along / length - 1.0)
    return radius * np.sin(angle), radius * (np.cos(angle) - np.cos(low))


def _hung_free(scene: Scene, uv: np.ndarray) -> np.ndarray:
    """The undeformed sheet as its grips let it hang, when nobody saw how: turned so that the line between the two that
    are farthest apart on the cloth lies along theirs, and the rest hangs down or goes to the other grips; and bent into
    an arc where they leave it slack.

    In its plane slack cloth could only be squeezed, and by symmetry nothing would ever push it out.
    """
    held = scene.grip_material
    if len(held) == 0:
        return _hung_flat(scene, uv)
    at, down = scene.grip_position[0], _down(scene)
    apart = np.linalg.norm(held[:, None] - held[None], axis=2)
    one, other = np.unravel_index(np.argmax(apart), apart.shape)
    length, span = float(apart[one, other]), at[other] - at[one]
    chord, middle = float(np.linalg.norm(span)), np.array([scene.width, scene.height]) / 2
    if length > 0:
        along = (held[other] - held[one]) / length
        beside = np.array([-along[1], along[0]])
        if (middle - held[one]) @ beside < -1e-9 * length:
            beside = -beside
    else:
        beside = middle - held[one] if not np.allclose(middle, held[one]) else np.array([0.0, 1.0])
        beside = beside / np.linalg.norm(beside)
        along = np.array([beside[1], -beside[0]])
    first = span / chord if chord > 0 else _across(held[:1], at[:1], down)
    second = _aside(first, (held - held[one]) @ beside, at - at[one], down)
    s, t = (uv - held[one]) @ along, (uv - held[one]) @ beside
    if length == 0:
        return at[one] + s[:, None] * first + t[:, None] * second
    if chord < (1 - 1e-6) * length:
        s, bulge = arc(s, length, chord)
    else:
        s, bulge = s - length / 2, 0 * s
    ends = (at[one] + at[other]) / 2
    return ends + s[:, None] * first + t[:, None] * second + bulge[:, None] * np.cross(first, second)


def _aside(first: np.ndarray, beside: np.ndarray, at: np.ndarray, down: np.ndarray) -> np.ndarray:
    """Unit vector (3,) at right angles to `first`, into which a sheet goes beside the line between two of its grips:
    towards the others, of which `beside` (G,) m says how far from that line they are on the cloth and `at` (G, 3) m
    where they are held, both from one end of it; or else downwards.
    """
    farthest = int(np.argmax(np.abs(beside)))
    wanted = [np.sign(beside[farthest]) * at[farthest]] if abs(beside[farthest]) > 1e-9 else []
    for way in (*wanted, down, *np.eye(3)):
        aside = way - way @ first * first
        if (size := float(np.linalg.norm(aside))) > 1e-6 * max(float(np.linalg.norm(way)), 1e-12):
            return aside / size
    raise AssertionError("three axes cannot all be parallel to one vector")


def _down(scene: Scene) -> np.ndarray:
    """Unit vector (3,) into which gravity points, or downwards where there is none."""
    gravity = np.array(scene.gravity)
    return gravity / np.linalg.norm(gravity) if np.linalg.norm(gravity) > 0 else np.array([0.0, 0.0, -1.0])


def _hung_flat(scene: Scene, uv: np.ndarray) -> np.ndarray:
    """The undeformed sheet in the vertical plane through its grips; u along them, v down."""
    down = _down(scene)
    held, at = scene.grip_material, scene.grip_position[0] if scene.grip_material.size else np.zeros((0, 3))
    across = _across(held, at, down)
    if len(held) == 0 and (disc := next((o for o in scene.obstacles if o.clamps), None)) is not None:
        return _laid_on(disc, uv - np.array([scene.width, scene.height]) / 2)
    if len(held) == 0:
        return uv[:, :1] * across + uv[:, 1:] * down
    centre_uv, centre = held.mean(axis=0), at.mean(axis=0)
    return centre + (uv[:, :1] - centre_uv[0]) * across + (uv[:, 1:] - centre_uv[1]) * down


def _laid_on(disc: Obstacle, middle: np.ndarray) -> np.ndarray:
    """Material points (n, 2) m from the sheet's middle, laid flat on a disc, which bears the middle: u to the right as
    seen from above with the y axis upwards, v down.
    """
    normal = np.array(disc.normal)
    helper = np.array([0.0, 1.0, 0.0]) if abs(normal[1]) < 0.9 else np.array([0.0, 0.0, -1.0])
    right = np.cross(helper, normal)
    right /= np.linalg.norm(right)
    return np.array(disc.centre) + middle[:, :1] * right - middle[:, 1:] * np.cross(normal, right)


def _across(held: np.ndarray, at: np.ndarray, down: np.ndarray) -> np.ndarray:
    """Unit vector (3,) into which the warp direction points: along the grips if two differ in u."""
    if len(held) >= 2 and np.ptp(held[:, 0]) > 0:
        left, right = np.argmin(held[:, 0]), np.argmax(held[:, 0])
        across = at[right] - at[left]
        if np.linalg.norm(across) > 0:
            return across / np.linalg.norm(across)
    helper = np.array([1.0, 0.0, 0.0]) if abs(down[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    across = helper - helper @ down * down
    return across / np.linalg.norm(across)
