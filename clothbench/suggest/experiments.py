"""The experiments to choose from: how the cloth is gripped (`GRIPS`), how the grips move (`MOTIONS`), and which goes
with which (`EXPERIMENTS`). A new one is a line here.

Everything is made for the sheet at hand, where it was recorded: across is along its warp, out across the sheet, up
against gravity. Motions begin and end at rest, where they began, and each is made as large as the robot can.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.scene import Obstacle, Scene, minimum_jerk
from clothbench.suggest.settings import Wanted

RATE = 100.0  # Hz, of the grips' path
RISE = 0.6  # s, in which a swing grows to its size
LEAST_REACH = 5e-3  # m: a motion that the robot can only do smaller than this is none
TABLE_GAP = 0.02  # m, between the hanging cloth and the table that it is lowered onto
BULGE = 0.02  # of the width, that a sheet is bent to one side at first, so that no rounding error decides on which
ALIKE = 0.03  # of the width, by which grips may be off those of the recording and still be the same
PULLED = 0.02  # of the height, by which a sheet held at four corners is pulled longer


@dataclass(frozen=True, eq=False)
class Held:
    """How a sheet is gripped. material: (G, 2) m; place: (G, 3) m across, out and up from the middle of the upper
    edge; bend: (n, 2) m of material → (n, 3) m, about where the sheet is then, in the same directions.
    """

    material: np.ndarray
    place: np.ndarray
    bend: Callable[[np.ndarray], np.ndarray]


def upright(width: float, height: float, narrower: float = 1.0) -> Callable[[np.ndarray], np.ndarray]:
    """The sheet in its vertical plane, its sides brought together, bent to one side."""

    def place(uv: np.ndarray) -> np.ndarray:
        out = BULGE * width * np.sin(np.pi * uv[:, 0] / width) * (0.3 + 0.7 * uv[:, 1] / height)
        return np.stack([narrower * (uv[:, 0] - width / 2), out, -uv[:, 1]], axis=1)

    return place


def hung(material: list[tuple[float, float]], narrower: float = 1.0) -> Callable[[float, float], Held]:
    """Grips at shares (u, v) of width and height, the sheet hanging from them with its sides that much nearer."""

    def held(width: float, height: float) -> Held:
        at, bend = np.array(material) * [width, height], upright(width, height, narrower)
        return Held(at, bend(at) * [1.0, 0.0, 1.0], bend)

    return held


def level(width: float, height: float) -> Held:
    """Clamped level along one side, a twelfth of the width deep; the rest bends down under its own weight."""
    depth = width / 12
    at = np.array([[u, v] for u in (0.0, depth) for v in np.linspace(0.0, height, 6)])

    def bend(uv: np.ndarray) -> np.ndarray:
        slope = np.clip((uv[:, 0] - depth) / (width - depth), 0.0, 1.0) * 1.2  # rad; a quarter circle would be 1.57
        across = uv[:, 0] * np.cos(slope / 2) - width / 2
        return np.stack([across, height / 2 - uv[:, 1], -uv[:, 0] * np.sin(slope / 2)], axis=1)

    return Held(at, bend(at), bend)


GRIPS: dict[str, Callable[[float, float], Held]] = {
    "two corners": hung([(0.0, 0.0), (1.0, 0.0)], 0.99),
    "two slack corners": hung([(0.0, 0.0), (1.0, 0.0)], 0.85),
    "one corner": hung([(0.0, 0.0)]),
    "upper edge": hung([(u, 0.0) for u in np.linspace(0.0, 1.0, 5)]),
    "four corners": hung([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)]),
    "level side": level,
}
AS_RECORDED = "as recorded"

# (times (K,) s, grips' places (G, 3) m, height m) → displacement (K, G, 3) m across, out and up, of any size: it is
# made as large as reach, speed and acceleration allow.
Motion = Callable[[np.ndarray, np.ndarray, float], np.ndarray]


def together(way: np.ndarray, direction: Sequence[float], grips: np.ndarray) -> np.ndarray:
    """All grips the same way (K,) m into one direction."""
    return way[:, None, None] * np.ones((1, len(grips), 1)) * np.array(direction)


def swing(direction: Sequence[float], rate: float, stop: float = np.inf) -> Motion:
    """To and fro at `rate` Hz; from `stop` s on it dies away, and the cloth swings by itself."""

    def path(time: np.ndarray, grips: np.ndarray, height: float) -> np.ndarray:
        size = minimum_jerk(time / RISE) * (1 - minimum_jerk((time - stop) / RISE))
        return together(size * np.sin(2 * np.pi * rate * time), direction, grips)

    return path


def hold(time: np.ndarray, grips: np.ndarray, height: float) -> np.ndarray:
    return np.zeros((len(time), len(grips), 3))


def lift_and_drop(time: np.ndarray, grips: np.ndarray, height: float) -> np.ndarray:
    """Up within half a second, down within a quarter, and once more every second."""
    phase = time % 1.0
    return together(minimum_jerk(phase / 0.5) - minimum_jerk((phase - 0.5) / 0.25), (0.0, 0.0, 1.0), grips)


def lower(time: np.ndarray, grips: np.ndarray, height: float) -> np.ndarray:
    """Down within a second, and there to stay."""
    return together(-minimum_jerk(time / 1.0), (0.0, 0.0, 1.0), grips)


def pull(time: np.ndarray, grips: np.ndarray, height: float) -> np.ndarray:
    """The lower grips down by `PULLED` of the height within half a second."""
    low = grips[:, 2] < grips[:, 2].max() - height / 2
    return minimum_jerk(time / 0.5)[:, None, None] * np.where(low[:, None], [0.0, 0.0, -PULLED * height], 0.0)


OUT, ACROSS, UP = (0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
HOLD, PULL, LOWER = "hold still", "pull longer by 2 %", "lower onto a table"
LET_OUT, STOP = "swing across the sheet, 1 Hz, let it swing out", 1.0  # and when its grips begin to come to rest, s
MOTIONS: dict[str, Motion] = {
    HOLD: hold,
    PULL: pull,
    "swing across the sheet, 0.5 Hz": swing(OUT, 0.5),
    "swing across the sheet, 1 Hz": swing(OUT, 1.0),
    "swing across the sheet, 2 Hz": swing(OUT, 2.0),
    LET_OUT: swing(OUT, 1.0, stop=STOP),
    "swing along the warp, 1 Hz": swing(ACROSS, 1.0),
    "up and down, 2 Hz": swing(UP, 2.0),
    "lift and drop": lift_and_drop,
    LOWER: lower,
}
AS_STATED = (HOLD, PULL)  # motions whose size is their own

_SWINGS = [name for name in MOTIONS if name.startswith("swing across")]
EXPERIMENTS: tuple[tuple[str, str], ...] = (
    *((AS_RECORDED, motion) for motion in (HOLD, *_SWINGS, "lift and drop")),
    *(("two corners", motion) for motion in (HOLD, *_SWINGS, "swing along the warp, 1 Hz", "up and down, 2 Hz")),
    ("two corners", "lift and drop"), ("two corners", LOWER),
    *(("two slack corners", motion) for motion in (HOLD, "swing across the sheet, 1 Hz", "up and down, 2 Hz")),
    *(("one corner", motion) for motion in (HOLD, "swing across the sheet, 1 Hz")),
    *(("upper edge", motion) for motion in (*_SWINGS, "lift and drop", LOWER)),
    ("four corners", HOLD), ("four corners", PULL), ("four corners", "swing across the sheet, 1 Hz"),
    ("level side", HOLD), ("level side", "up and down, 2 Hz"),
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Experiment:
    """One to choose from. scene: what is simulated, for the longest duration, and its motion goes on after that;
    durations: s, of which it may last one.
    """

    grips: str
    motion: str
    scene: Scene
    durations: tuple[float, ...]

    def lasting(self, duration: float) -> Scene:
        """The same, seen for so many seconds; the grips then go back to where they began, and stay."""
        scene = self.scene
        moved = scene.grip_position - scene.grip_position[0]
        return dataclasses.replace(
            scene, times=scene.times[scene.times <= duration + 1e-9],
            grip_position=scene.grip_position[0] + ended(moved, scene.grip_time, duration),
        )  # fmt: skip

    def fastest(self, duration: float) -> tuple[float, float]:
        """The most speed [m/s] and acceleration [m/s²] of a grip, where it lasts so many seconds."""
        return fastest(self.lasting(duration).grip_position)


class Unsimulated(Exception):
    """Why an experiment cannot be simulated."""


def experiments(
    like: Scene, rate: float, wanted: Wanted, contact: bool, chosen: Sequence[tuple[str, str]] = EXPERIMENTS
) -> Iterator[Experiment]:
    """All that can be done with a sheet recorded in a scene, seen at the same points `rate` times a second.

    contact: whether the model keeps out of obstacles.
    """
    known = list(dict.fromkeys(grips for grips, _ in chosen))
    stray = next((name for name in wanted.grips or () if name not in known), None)
    if stray is not None:
        raise ClothbenchError(f"setting 'grips' names {stray!r}, expected some of {', '.join(known)}")
    if int(wanted.durations[0] * rate + 1e-6) < 1:
        raise ClothbenchError(
            f"setting 'durations' begins with {wanted.durations[0]:g} s, expected two frames at least, at {rate:.3g} "
            f"frames a second {1 / rate:.3g} s"
        )
    if wanted.grips and like.outline is not None and AS_RECORDED not in wanted.grips:
        raise ClothbenchError(
            f"setting 'grips' names {', '.join(wanted.grips)}, which a cloth that was cut along an outline may not "
            f"have; expected {AS_RECORDED!r}"
        )
    asked = {AS_RECORDED if name != AS_RECORDED and recorded_in(like, name) else name for name in wanted.grips or known}
    for grips, motion in chosen:
        if grips not in asked:
            continue
        if motion == LOWER and not contact:
            continue
        if grips != AS_RECORDED and like.outline is not None:  # corners and edges may have been cut off
            continue
        if (made := experiment(like, rate, wanted, grips, motion)) is not None:
            yield made


def experiment(like: Scene, rate: float, wanted: Wanted, grips: str, motion: str) -> Experiment | None:
    """One of them; None where the robot can only do it so small that it is none, it is what it is called in none of the
    durations, or the sheet was recorded in these very grips, so that they are "as recorded".
    """
    across, out, up, middle = directions(like)
    turn = np.stack([across, out, up])  # rows: from a sheet's own directions into the world's
    material, place, start = like.grip_material, (like.grip_position[0] - middle) @ turn.T, like.start
    if grips != AS_RECORDED:
        if recorded_in(like, grips):
            return None
        held = GRIPS[grips](like.width, like.height)
        material, place, start = held.material, held.place, middle + held.bend(like.points) @ turn
    durations = wanted.durations if motion != HOLD else wanted.durations[:1]
    if motion == LET_OUT:  # until its grips come to rest it is the swing that goes on
        durations = tuple(d for d in durations if d > STOP)
        if not durations:
            return None
    clock = np.arange(round((durations[-1] + RISE) * RATE) + 1) / RATE
    path = MOTIONS[motion](clock, place, like.height)
    paths = [ended(path, clock, duration) for duration in durations]
    size = min(largest(one, wanted) for one in paths)
    size = min(size, 1.0) if motion in AS_STATED else size
    path = size * path
    if motion not in AS_STATED and np.abs(path).max() < LEAST_REACH:
        return None
    obstacles = like.obstacles
    if motion == LOWER:
        lowered = [np.abs(path[clock <= d]).max() for d in durations]
        durations = tuple(d for d, by in zip(durations, lowered, strict=True) if by >= TABLE_GAP + LEAST_REACH)
        if not durations:  # the cloth would never lie on the table
            return None
        below = middle - (like.height + TABLE_GAP) * up
        obstacles = (*obstacles, Obstacle("plane", triple(below), triple(up)))
    scene = dataclasses.replace(
        like, grip_time=clock, grip_material=material, grip_position=middle + (place + path) @ turn,
        times=np.arange(int(durations[-1] * rate + 1e-6) + 1) / rate, start=start, velocity=None, obstacles=obstacles,
    )  # fmt: skip
    return Experiment(grips, motion, scene, durations)


def recorded_in(like: Scene, grips: str) -> bool:
    """Whether the sheet was recorded in these very grips."""
    across, out, up, middle = directions(like)
    place = (like.grip_position[0] - middle) @ np.stack([across, out, up]).T
    held = GRIPS[grips](like.width, like.height)
    alike = held.material.shape == like.grip_material.shape
    return alike and bool(np.allclose(held.place, place, atol=ALIKE * like.width))


def ended(path: np.ndarray, clock: np.ndarray, duration: float) -> np.ndarray:
    """A path (K, G, 3) m that from `duration` s on goes back to where it began."""
    return (1 - minimum_jerk((clock - duration) / RISE))[:, None, None] * path


def triple(vector: np.ndarray) -> tuple[float, float, float]:
    x, y, z = vector.tolist()
    return x, y, z


def directions(scene: Scene) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Across, out and up of a recorded sheet (3,), and where the middle of its upper edge was at first (3,) m."""
    gravity, at, held = np.array(scene.gravity), scene.grip_position[0], scene.grip_material
    weight = float(np.linalg.norm(gravity))
    up = -gravity / weight if weight > 0 else np.array([0.0, 0.0, 1.0])
    along = at[np.argmax(held[:, 0])] - at[np.argmin(held[:, 0])]
    along = along - along @ up * up
    if np.linalg.norm(along) < 1e-6:  # one grip, or all below each other
        helper = np.array([1.0, 0.0, 0.0]) if abs(up[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
        along = helper - helper @ up * up
    across = along / np.linalg.norm(along)
    centre = held.mean(axis=0)
    middle = at.mean(axis=0) + (scene.width / 2 - centre[0]) * across + centre[1] * up
    return across, np.cross(across, -up), up, middle


def fastest(path: np.ndarray) -> tuple[float, float]:
    """The most speed [m/s] and acceleration [m/s²] of grips along a path (K, G, 3) m at `RATE`."""
    speed = np.linalg.norm(np.diff(path, axis=0) * RATE, axis=-1)
    acceleration = np.linalg.norm(np.diff(path, n=2, axis=0) * RATE**2, axis=-1)
    return float(speed.max(initial=0.0)), float(acceleration.max(initial=0.0))


def largest(path: np.ndarray, wanted: Wanted) -> float:
    """By how much a path (K, G, 3) m may be enlarged, so that it keeps to reach, speed and acceleration."""
    speed, acceleration = fastest(path)
    most = [
        (wanted.reach, float(np.linalg.norm(path, axis=-1).max(initial=0.0))),
        (wanted.max_speed, speed), (wanted.max_acceleration, acceleration),
    ]  # fmt: skip
    return min((limit / value for limit, value in most if value > 0), default=1.0)
