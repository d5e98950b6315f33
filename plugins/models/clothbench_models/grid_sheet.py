"""What the models on a rectangular grid share: where the nodes lie, what is held, and a batch's way to a rollout."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from clothbench import ClothbenchError, Interpolator, ParameterSpace, Rollout, Scene, Sheet, sheet_of
from clothbench.core.scene import initial_shape
from clothbench.modelling.bound_effects import BoundEffects
from clothbench.modelling.kernels import grid_triangles, no_effect
from clothbench_models import loop
from clothbench_models.spring_grid import even_count, grid_lines, tributary

MAX_STEPS = 20_000_000
LOST = 20.0  # cloth sizes from the start at which a sheet has blown up


def check_resolution(model: str, resolution: int | Sequence[int]) -> None:
    """Refuse what is not one or two whole numbers of nodes."""
    counts = [resolution] if isinstance(resolution, int) else resolution
    whole = isinstance(counts, Sequence) and all(isinstance(n, int) and n >= 3 for n in counts)
    if not whole or len(counts) not in (1, 2):
        raise ClothbenchError(f"{model}: resolution is {resolution!r}, expected one or two whole numbers ≥ 3")


def check_number(model: str, name: str, value: float | None, low: float, high: float = math.inf) -> None:
    """Refuse an option that is neither None nor a number above `low` and at most `high`."""
    if value is None:
        return
    if not isinstance(value, int | float) or not low < value <= high:
        limit = f"above {low:g}" + ("" if high == math.inf else f" and at most {high:g}")
        raise ClothbenchError(f"{model}: {name} is {value!r}, expected a number {limit}")


def grid_shape(scene: Scene, resolution: int | Sequence[int]) -> tuple[int, int]:
    """Nodes along (u, v): as the scene says, else as asked, with square cells."""
    if scene.resolution is not None:
        return scene.resolution
    if not isinstance(resolution, int):
        nu, nv = resolution
        return int(nu), int(nv)
    wide = scene.width >= scene.height
    length, other = (scene.width, scene.height) if wide else (scene.height, scene.width)
    count = even_count(resolution, length, scene.grip_material[:, 0 if wide else 1])
    across = max(3, round(other * (count - 1) / length) + 1)
    return (count, across) if wide else (across, count)


@dataclass(frozen=True, eq=False)
class GridSimulation:
    """One scene on one grid `shape` (nu, nv), node number j·nu + i, ready for batches of parameter sets."""

    scene: Scene
    shape: tuple[int, int]
    effects: BoundEffects
    threads: ClassVar[bool] = True  # several of them may run at the same time

    @property
    def parameters(self) -> ParameterSpace:
        return self.effects.parameters

    @property
    def nodes(self) -> int:
        return self.shape[0] * self.shape[1]

    @cached_property
    def lines(self) -> tuple[np.ndarray, np.ndarray]:
        """Grid lines along u (nu,) and v (nv,) m, moved onto the held points so that every grip is a node."""
        held = self.scene.grip_material
        return (
            grid_lines(self.scene.width, self.shape[0], held[:, 0]),
            grid_lines(self.scene.height, self.shape[1], held[:, 1]),
        )

    @cached_property
    def sheet(self) -> Sheet:
        """Nodes with the mass and area that they stand for, and the triangles between them."""
        u, v = self.lines
        v_of, u_of = (a.ravel() for a in np.meshgrid(v, u, indexing="ij"))
        area = np.outer(tributary(v, self.scene.height), tributary(u, self.scene.width)).ravel()
        uv = np.stack([u_of, v_of], axis=1)
        scene = self.scene
        triangles = grid_triangles(self.shape)
        held = _nearest(uv, scene.grip_material)
        return sheet_of(uv, scene.areal_density * area, area, triangles, scene.gravity, scene.air_density, held)

    def stiffest_effect(self, theta: np.ndarray) -> np.ndarray:
        """A bound on what effects add to the largest ω² (B,) 1/s²: that of a plate of the smallest cell [rad²/s²].

        ω² ≤ 4 E (1/h_u² + 1/h_v²)/ρ in the plane and 16 D (1/h_u² + 1/h_v²)²/ρ across, the finite-difference values;
        triangles stay below three times as much.
        """
        stretch, bending = self.effects.stiffness(theta).T
        wave = sum(1 / np.diff(lines).min() ** 2 for lines in self.lines)
        return 3 * (4 * stretch * wave + 16 * bending * wave**2) / self.scene.areal_density

    @property
    def slowest(self) -> float:
        """ω₁ of the hanging sheet, (2.4048/2)√(g/L) [rad/s]; where nothing pulls it down, that of a gentle pull."""
        return 1.2024 * math.sqrt(max(np.linalg.norm(self.scene.gravity), 1.0) / self.scene.height)


class GridBatch:
    """One call of `run`: what every member needs, and the arrays that members fill side by side.

    dt (B,) s and settling (s) tell which members nobody could afford: they are timeouts, not begun at all. Only
    `members` are run: the others move as one of them does, and just the sensor sees them otherwise.
    """

    def __init__(self, simulation: GridSimulation, theta: np.ndarray, dt: np.ndarray, settling: float):
        self.simulation, self.theta, self.dt = simulation, theta, dt
        scene, effects, members = simulation.scene, simulation.effects, len(theta)
        self.times = effects.times(scene, theta)
        self.position = np.full((members, scene.times.size, len(scene.points), 3), np.nan)
        self.status, self.steps = np.zeros(members, np.int64), np.zeros(members, np.int64)
        self.curves = effects.grip_curves(scene, theta)
        self.knots = np.array(scene.grip_time) if len(scene.grip_material) else np.zeros(2)
        self.kernels, self.stages, self.terms = effects.kernels(loop.SLOTS, no_effect)
        self.interpolator = Interpolator.on_lines(scene.points, *simulation.lines)
        self.pins = simulation.sheet.held
        self.held_points, self.pins_of_points = _shared_points(scene.points, scene.grip_material)
        self.shape = initial_shape(scene, simulation.sheet.uv)
        span = self.times.max(axis=1) - scene.start_time + settling
        self.late = span / dt > MAX_STEPS
        first, self.alike = effects.distinct(theta, self.times)
        self.members = first[~self.late[first]]

    def curve(self, members: np.ndarray) -> np.ndarray:
        return self.curves if len(self.curves) == 1 else self.curves[members]

    def bounds(self) -> float:
        """How far from the origin a sheet may get before it counts as blown up [m]; grips and free fall allowed."""
        scene = self.simulation.scene
        span = float(self.times.max() - scene.start_time)
        fall = 0.5 * float(np.linalg.norm(scene.gravity)) * span**2 if not len(self.pins) else 0.0
        reach = max(np.abs(self.shape).max(), np.abs(scene.grip_position).max(initial=0.0))
        return LOST * max(scene.width, scene.height) + float(reach) + fall

    def rollout(self) -> Rollout:
        """What the sensor makes of the positions, with a status for every member."""
        scene = self.simulation.scene
        position = self.simulation.effects.seen(scene, self.theta, self.position[self.alike])
        lost = ~(np.abs(position).max(axis=(2, 3), initial=0.0) < 1e6)
        gone = (self.status[self.alike] == loop.DIVERGED) | (lost.any(axis=1) & ~self.late)
        status = np.where(self.late, "timeout", np.where(gone, "diverged", "ok"))
        reasons = {
            "ok": "",
            "diverged": "the sheet left all bounds: the step is too long for these parameters",
            "timeout": f"more than {MAX_STEPS:.0e} steps: these parameters need too short a step",
        }
        position[np.logical_or.accumulate(lost, axis=1)] = np.nan
        return Rollout(
            scene.times, position, tuple(map(str, status)), self.steps[self.alike], self.simulation.nodes,
            tuple(reasons[s] for s in status),
        )  # fmt: skip


def _nearest(uv: np.ndarray, held: np.ndarray) -> np.ndarray:
    """The node on each held material point (G,): grid lines were laid through them."""
    return np.array([np.argmin(((uv - point) ** 2).sum(axis=1)) for point in held], dtype=np.int64)


def _shared_points(points: np.ndarray, held: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which of the wanted points (N, 2) are grips: their numbers, and the grip of each."""
    if not len(held):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    apart = np.abs(points[:, None] - held[None]).max(axis=2)
    on = np.flatnonzero(apart.min(axis=1) < 1e-9)
    return on, apart[on].argmin(axis=1)
