"""`mass_spring`: the grid of springs and dampers of Provot (1995), as fitted in
"Cloth mechanical parameter estimation and simulation for optimized robotic manipulation", section 5.2.

Structural springs join neighbours, shear springs the diagonals of a cell, flexion springs nodes two apart. k1 is
shared by structural and shear springs, k2 belongs to the flexion springs, and all springs have the damping ratio ζ,
c = 2ζ√(k m); `spring_grid` says where this departs from the paper.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from clothbench import ClothbenchError, Effect, Interpolator, Parameter, ParameterSpace, Rollout, Scene
from clothbench.effects import BoundEffects
from clothbench.kernels import grid_triangles, no_effect
from clothbench.parallel import for_each
from clothbench.scene import initial_shape
from clothbench_models import mass_spring_kernels as kernels
from clothbench_models.spring_grid import FAMILIES, SpringGrid, even_count, grid_lines

SOURCE = "Provot 1995; Cloth mechanical parameter estimation … for optimized robotic manipulation, section 5.2"
SAFETY = 0.8  # share of the largest stable step that is used
SETTLE = np.array([9.0, 36.0])  # least and most settling time in units of 1/ω₁; soft, nearly buckled modes take longest
SMALL = 256  # nodes below which several parameter sets are interleaved
LANES = 8  # doubles in one vector register of AVX-512
MAX_STEPS = 20_000_000
REAL = {"double": np.float64, "single": np.float32}
# Speed [m/s] at which a settling sheet hangs still: so small that it does not matter when exactly it stops, but above
# what rounding alone keeps alive in single precision (about ω · 3e-8 m with ω of the stiffest mode).
AT_REST = {"double": 1e-6, "single": 1e-3}
LOST = 20.0  # cloth sizes from the start at which a sheet has blown up

PARAMETERS = ParameterSpace(
    (
        Parameter("k1", "k₁", "N/m", (1.0, 1000.0), "log", 60.0, "stiffness of structural and shear springs", SOURCE),
        Parameter("k2", "k₂", "N/m", (0.01, 100.0), "log", 1.0, "stiffness of flexion springs", SOURCE),
        Parameter("zeta", "ζ", "1", (0.001, 1.0), "log", 0.05, "damping ratio of every spring, c = 2ζ√(k m)", SOURCE),
    )
)


class MassSpring:
    """Provot's mass-spring-damper sheet, explicit leapfrog; see the module for equations and sources.

    resolution: nodes along (u, v) or one number for the longer side, where the scene does not say;
    dt: time step [s], or None for the largest stable one of each parameter set times 0.8; step_scale: multiplies
    that step (0.5 halves it, to see what the step costs in accuracy); precision: "double", or "single", which is
    twice as fast and takes no dynamics effects (a smoothly moving sheet differs by micrometres; one that folds without
    damping is chaotic, and then any rounding grows).
    """

    name = "mass_spring"
    version = 1
    kind = "explicit"
    parameters = PARAMETERS
    capabilities = frozenset({"dynamic", "static", "effects"})

    bench_options: tuple[dict[str, str], ...] = ({}, {"precision": "single"})

    def __init__(
        self, resolution: int | Sequence[int] = 13, dt: float | None = None, step_scale: float = 1.0,
        precision: str = "double",
    ):  # fmt: skip
        self.resolution, self.dt, self.step_scale, self.precision = resolution, dt, step_scale, precision
        if precision not in REAL:
            raise ClothbenchError(f"mass_spring: precision is {precision!r}, expected 'double' or 'single'")
        counts = [resolution] if isinstance(resolution, int) else resolution
        whole = isinstance(counts, Sequence) and all(isinstance(n, int) and n >= 3 for n in counts)
        if not whole or len(counts) not in (1, 2):
            raise ClothbenchError(f"mass_spring: resolution is {resolution!r}, expected one or two whole numbers ≥ 3")
        if not all(isinstance(x, int | float | None) for x in (dt, step_scale)):
            raise ClothbenchError(f"mass_spring: dt is {dt!r}, step_scale {step_scale!r}, expected numbers")
        if dt is not None and not dt > 0:
            raise ClothbenchError(f"mass_spring: dt is {dt}, expected seconds above 0")
        if not 0 < step_scale <= 1.2:
            raise ClothbenchError(f"mass_spring: step_scale is {step_scale}, expected above 0 and at most 1.2")

    def prepare(self, scene: Scene, effects: Sequence[Effect] = ()) -> MassSpringSimulation:
        bound = BoundEffects(self.parameters, tuple(effects))
        if self.precision == "single" and bound.at("dynamics"):
            raise ClothbenchError("mass_spring: precision=single takes no dynamics effects; leave it at double")
        return MassSpringSimulation(scene, self._shape(scene), bound, self.dt, self.step_scale, self.precision)

    def _shape(self, scene: Scene) -> tuple[int, int]:
        """Nodes along (u, v): as the scene says, else as asked, with square cells."""
        if scene.resolution is not None:
            return scene.resolution
        if not isinstance(self.resolution, int):
            nu, nv = self.resolution
            return int(nu), int(nv)
        wide = scene.width >= scene.height
        length, other = (scene.width, scene.height) if wide else (scene.height, scene.width)
        count = even_count(self.resolution, length, scene.grip_material[:, 0 if wide else 1])
        across = max(3, round(other * (count - 1) / length) + 1)
        return (count, across) if wide else (across, count)


@dataclass(frozen=True, eq=False)
class MassSpringSimulation:
    """One scene on one grid `shape` (nu, nv), ready for batches of parameter sets."""

    scene: Scene
    shape: tuple[int, int]
    effects: BoundEffects
    dt: float | None
    step_scale: float
    precision: str

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
    def grid(self) -> SpringGrid:
        return SpringGrid.of(self.lines, (self.scene.width, self.scene.height), self.scene.areal_density)

    def run(self, theta: np.ndarray) -> Rollout:
        """Simulate theta (B, P): k1 N/m, k2 N/m, ζ, then the effects' parameters."""
        theta = self.parameters.check(theta)
        batch = _Batch(self, theta)
        for_each(batch.run_block, batch.blocks)
        return batch.rollout()

    def stable_step(self, theta: np.ndarray) -> np.ndarray:
        """The largest stable step of each parameter set (B,) s: leapfrog with a lagging damping force.

        ω² and the damping rate are bounded by the flat sheet's, whose springs all pull in one plane.
        """
        k1, k2, zeta = theta[:, :3].T
        one, two = self.grid.largest_eigenvalues
        omega = np.sqrt(k1 * one + k2 * two)
        node = self.grid.node_mass
        rate = 2 * zeta * (np.sqrt(k1 * node) * one + np.sqrt(k2 * node) * two)
        half = rate / (2 * omega)
        return (2 / omega) * (np.sqrt(1 + half**2) - half)


class _Batch:
    """One call of `run`: parameter sets in blocks of lanes, results in arrays that the blocks fill side by side."""

    def __init__(self, simulation: MassSpringSimulation, theta: np.ndarray):
        self.simulation, self.theta, scene = simulation, theta, simulation.scene
        members = len(theta)
        self.dt = self._steps()
        self.times = simulation.effects.times(scene, theta)
        self.position = np.full((members, scene.times.size, len(scene.points), 3), np.nan)
        self.status, self.steps = np.zeros(members, np.int64), np.zeros(members, np.int64)
        self.curves = simulation.effects.grip_curves(scene, theta)
        self.kernels, self.stages, self.terms = simulation.effects.kernels(kernels.SLOTS, no_effect)
        u, v = simulation.lines
        self.interpolator = Interpolator.on_lines(scene.points, u, v)
        self.pins = _nearest(simulation.grid.uv, scene.grip_material)
        self.held_points, self.pins_of_points = _shared_points(scene.points, scene.grip_material)
        self.shape = initial_shape(scene, simulation.grid.uv)
        # Frames that nobody could afford are not begun: the member is a timeout, not a hang.
        span = self.times.max(axis=1) - scene.start_time + SETTLE[1] / self._slowest()
        self.late = span / self.dt > MAX_STEPS
        self.blocks = self._blocks(np.flatnonzero(~self.late))

    def _steps(self) -> np.ndarray:
        simulation = self.simulation
        if simulation.dt is not None:
            return np.full(len(self.theta), simulation.dt)
        return SAFETY * simulation.step_scale * simulation.stable_step(self.theta)

    def _slowest(self) -> float:
        """ω₁ of the hanging sheet, (2.4048/2)√(g/L) [rad/s]; where nothing pulls it down, that of a gentle pull."""
        scene = self.simulation.scene
        return 1.2024 * math.sqrt(max(np.linalg.norm(scene.gravity), 1.0) / scene.height)

    def _blocks(self, members: np.ndarray) -> list[np.ndarray]:
        """Members that run together, similar steps side by side; one by one on a large grid."""
        interleave = self.simulation.nodes < SMALL and self.terms == 0
        if not interleave:
            return [members[k : k + 1] for k in range(len(members))]
        order = members[np.argsort(self.dt[members], kind="stable")]
        return [order[k : k + LANES] for k in range(0, len(order), LANES)]

    def _bounds(self) -> float:
        """How far from the origin a sheet may get before it counts as blown up [m]; grips and free fall allowed."""
        scene = self.simulation.scene
        span = float(self.times.max() - scene.start_time)
        fall = 0.5 * float(np.linalg.norm(scene.gravity)) * span**2 if not len(self.pins) else 0.0
        reach = max(np.abs(self.shape).max(), np.abs(scene.grip_position).max(initial=0.0))
        return LOST * max(scene.width, scene.height) + float(reach) + fall

    def run_block(self, members: np.ndarray) -> None:
        simulation, scene, grid = self.simulation, self.simulation.scene, self.simulation.grid
        lanes, nodes = len(members), simulation.nodes
        stiffness, damping = self._springs(members)
        real = REAL[simulation.precision]
        out = np.full((lanes, *self.position.shape[1:]), np.nan)
        status, steps = np.zeros(lanes, np.int64), np.zeros(lanes, np.int64)
        slowest = self._slowest()
        effects = simulation.effects
        kernels.run_block(simulation.precision)(
            lanes, np.repeat(self.shape.T, lanes, axis=1).astype(real), grid.strides * lanes,
            np.repeat(grid.rest, lanes, axis=1).astype(real), stiffness.astype(real), damping.astype(real),
            grid.mass, grid.uv,
            np.array([scene.gravity]), grid.area, grid_triangles(simulation.shape), scene.air_density,
            self._bounds(),
            *self.kernels, self.stages, self.terms, effects.kernel_parameters(self.theta[members], kernels.SLOTS),
            effects.kernel_state(lanes, kernels.SLOTS, nodes),
            self.pins, np.array(scene.grip_time) if len(self.pins) else np.zeros(2),
            self.curves if len(self.curves) == 1 else self.curves[members], self.held_points, self.pins_of_points,
            scene.start_time, SETTLE / slowest, 2 * slowest, AT_REST[simulation.precision], self.dt[members],
            self.interpolator.index, self.interpolator.weight, self.times[members], out, status, steps,
        )  # fmt: skip
        self.position[members], self.status[members], self.steps[members] = out, status, steps

    def _springs(self, members: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Stiffness N/m and damping N·s/m of every spring, (6, n·lanes), lanes innermost."""
        grid = self.simulation.grid
        k1, k2, zeta = self.theta[members, :3].T
        flexion = np.array([f[2] for f in FAMILIES])[:, None]
        k = np.where(flexion, k2, k1)  # (6, lanes)
        c = 2 * zeta * np.sqrt(k * grid.node_mass)
        shape = (len(FAMILIES), -1)
        return (grid.share[:, :, None] * k[:, None]).reshape(shape), (grid.share[:, :, None] * c[:, None]).reshape(
            shape
        )

    def rollout(self) -> Rollout:
        scene = self.simulation.scene
        position = self.simulation.effects.seen(scene, self.theta, self.position)
        lost = ~(np.abs(position).max(axis=(2, 3), initial=0.0) < 1e6)
        gone = (self.status == kernels.DIVERGED) | (lost.any(axis=1) & ~self.late)
        status = np.where(self.late, "timeout", np.where(gone, "diverged", "ok"))
        reasons = {
            "ok": "",
            "diverged": "the sheet left all bounds: the step is too long for these parameters",
            "timeout": f"more than {MAX_STEPS:.0e} steps: these parameters need too short a step",
        }
        position[np.logical_or.accumulate(lost, axis=1)] = np.nan
        return Rollout(
            scene.times,
            position,
            tuple(map(str, status)),
            self.steps,
            self.simulation.nodes,
            tuple(reasons[s] for s in status),
        )


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
