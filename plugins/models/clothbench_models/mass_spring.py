"""`mass_spring`: the grid of springs and dampers of Provot (1995), as fitted in
"Cloth mechanical parameter estimation and simulation for optimized robotic manipulation", section 5.2.

Structural springs join neighbours, shear springs the diagonals of a cell, flexion springs nodes two apart. k1 is
shared by structural and shear springs, k2 belongs to the flexion springs, and all springs have the damping ratio ζ,
c = 2ζ√(k m); `spring_grid` says where this departs from the paper.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from clothbench import ClothbenchError, Effect, Parameter, ParameterSpace, Rollout, Scene
from clothbench.effects import BoundEffects
from clothbench.kernels import own_sheet
from clothbench.parallel import for_each
from clothbench_models import loop
from clothbench_models import mass_spring_kernels as kernels
from clothbench_models.grid_sheet import GridBatch, GridSimulation, check_number, check_resolution, grid_shape
from clothbench_models.spring_grid import FAMILIES, SpringGrid

SOURCE = "Provot 1995; Cloth mechanical parameter estimation … for optimized robotic manipulation, section 5.2"
SAFETY = 0.8  # share of the largest stable step that is used
SETTLE = np.array([9.0, 36.0])  # least and most settling time in units of 1/ω₁; soft, nearly buckled modes take longest
SMALL = 256  # nodes below which several parameter sets are interleaved
LANES = 8  # doubles in one vector register of AVX-512
REAL = {"double": np.float64, "single": np.float32}
# Speed [m/s] at which a settling sheet hangs still: so small that it does not matter when exactly it stops, but above
# what rounding alone keeps alive in single precision (about ω · 3e-8 m with ω of the stiffest mode).
AT_REST = {"double": 1e-6, "single": 1e-3}

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
        check_resolution("mass_spring", resolution)
        check_number("mass_spring", "dt", dt, 0.0)
        check_number("mass_spring", "step_scale", step_scale, 0.0, 1.2)

    def prepare(self, scene: Scene, effects: Sequence[Effect] = ()) -> MassSpringSimulation:
        bound = BoundEffects(self.parameters, tuple(effects))
        if self.precision == "single" and bound.at("dynamics"):
            raise ClothbenchError("mass_spring: precision=single takes no dynamics effects; leave it at double")
        return MassSpringSimulation(
            scene, grid_shape(scene, self.resolution), bound, self.dt, self.step_scale, self.precision
        )


@dataclass(frozen=True, eq=False)
class MassSpringSimulation(GridSimulation):
    """One scene on one grid, ready for batches of parameter sets."""

    dt: float | None
    step_scale: float
    precision: str

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
        omega = np.sqrt(k1 * one + k2 * two + self.stiffest_effect(theta))
        node = self.grid.node_mass
        rate = 2 * zeta * (np.sqrt(k1 * node) * one + np.sqrt(k2 * node) * two)
        half = rate / (2 * omega)
        return (2 / omega) * (np.sqrt(1 + half**2) - half)


class _Batch(GridBatch):
    """Parameter sets in blocks of lanes."""

    def __init__(self, simulation: MassSpringSimulation, theta: np.ndarray):
        steps = SAFETY * simulation.step_scale * simulation.stable_step(theta)
        dt = steps if simulation.dt is None else np.full(len(theta), simulation.dt)
        super().__init__(simulation, theta, dt, SETTLE[1] / simulation.slowest)
        self.blocks = self._blocks(np.flatnonzero(~self.late))

    def _blocks(self, members: np.ndarray) -> list[np.ndarray]:
        """Members that run together, similar steps side by side; one by one on a large grid."""
        interleave = self.simulation.nodes < SMALL and self.terms == 0
        if not interleave:
            return [members[k : k + 1] for k in range(len(members))]
        order = members[np.argsort(self.dt[members], kind="stable")]
        return [order[k : k + LANES] for k in range(0, len(order), LANES)]

    def run_block(self, members: np.ndarray) -> None:
        simulation, scene = self.simulation, self.simulation.scene
        assert isinstance(simulation, MassSpringSimulation)
        grid, effects, lanes = simulation.grid, simulation.effects, len(members)
        stiffness, damping = self._springs(grid, members)
        real = REAL[simulation.precision]
        out = np.full((lanes, *self.position.shape[1:]), np.nan)
        status, steps = np.zeros(lanes, np.int64), np.zeros(lanes, np.int64)
        kernels.run_block(simulation.precision)(
            lanes, np.repeat(self.shape.T, lanes, axis=1).astype(real), grid.strides * lanes,
            np.repeat(grid.rest, lanes, axis=1).astype(real), stiffness.astype(real), damping.astype(real),
            own_sheet(simulation.sheet), self.bounds(),
            *self.kernels, self.stages, self.terms, effects.kernel_parameters(self.theta[members], loop.SLOTS),
            effects.kernel_state(lanes, loop.SLOTS, simulation.sheet),
            self.pins, self.knots, self.curve(members), self.held_points, self.pins_of_points,
            scene.start_time, SETTLE / simulation.slowest, 2 * simulation.slowest, AT_REST[simulation.precision],
            self.dt[members],
            self.interpolator.index, self.interpolator.weight, self.times[members], out, status, steps,
        )  # fmt: skip
        self.position[members], self.status[members], self.steps[members] = out, status, steps

    def _springs(self, grid: SpringGrid, members: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Stiffness N/m and damping N·s/m of every spring, (6, n·lanes), lanes innermost."""
        k1, k2, zeta = self.theta[members, :3].T
        flexion = np.array([f[2] for f in FAMILIES])[:, None]
        k = np.where(flexion, k2, k1)  # (6, lanes)
        c = 2 * zeta * np.sqrt(k * grid.node_mass)
        shape = (len(FAMILIES), -1)
        return (grid.share[:, :, None] * k[:, None]).reshape(shape), (grid.share[:, :, None] * c[:, None]).reshape(
            shape
        )
