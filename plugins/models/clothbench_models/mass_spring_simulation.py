"""What the mass-spring models share: options, and a batch's way through the compiled loop."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from clothbench import Rollout, check_choice
from clothbench.modelling import (
    RESTS,
    SLOTS,
    GridBatch,
    GridSimulation,
    Sampling,
    Start,
    Terms,
    check_number,
    check_resolution,
    for_each,
    layers_of,
    obstacle_table,
)
from clothbench_models import mass_spring_kernels as kernels
from clothbench_models.spring_grid import FAMILIES, Families, SpringGrid

SETTLE = np.array([9.0, 36.0])  # least and most settling time in units of 1/ω₁; soft, nearly buckled modes take longest
SMALL = 256  # nodes below which several parameter sets are interleaved
LANES = 8  # doubles in one vector register of AVX-512
LACKS = {"bending": "springs have no bending stiffness at small curvature"}  # of either model, by family of effects
REAL = {"double": np.float64, "single": np.float32}
AT_REST = 1e-6  # m/s at which a settling sheet hangs still: so slow that it does not matter when exactly it stops


@dataclass(frozen=True)
class SpringOptions:
    """resolution: nodes along (u, v) or one number; dt: s or None; the rest is as the models say."""

    resolution: int | Sequence[int]
    dt: float | None
    step_scale: float
    precision: str
    strain_limit: float | None = None

    def check(self, model: str) -> None:
        check_choice(model, "precision", self.precision, REAL)
        check_resolution(model, self.resolution)
        check_number(model, "dt", self.dt, 0.0)
        check_number(model, "step_scale", self.step_scale, 0.0, 1.2, optional=False)
        check_number(model, "strain_limit", self.strain_limit, 0.0)


@dataclass(frozen=True, eq=False)
class SpringSimulation(GridSimulation, ABC):
    """One scene on one grid of springs, ready for batches of parameter sets; a model says what its springs are."""

    options: SpringOptions

    families = FAMILIES
    safety = 0.8  # share of the largest stable step that is used
    limited = 0  # how many of the first families a strain limit holds for

    @cached_property
    def grid(self) -> SpringGrid:
        size = (self.scene.width, self.scene.height)
        if self.cover is not None:
            return SpringGrid.of(self.lines, size, self.scene.areal_density, self.families, self.cover)
        u, v = (tuple(map(float, lines)) for lines in self.lines)
        return whole_grid(u, v, size, self.scene.areal_density, self.families)

    def run(self, theta: np.ndarray) -> Rollout:
        """Simulate theta (B, P): the model's parameters in order, then those of the effects."""
        theta = self.parameters.check(theta)
        batch = _Batch(self, theta)
        batch.hang()
        for_each(batch.run_block, batch.blocks)
        return batch.rollout()

    @abstractmethod
    def stiffness(self, theta: np.ndarray) -> np.ndarray:
        """The stiffnesses that `families` refers to, (B, K) N/m."""

    def dashpots(self, theta: np.ndarray) -> np.ndarray | None:
        """The damping that belongs to each of them, (B, K) N·s/m, or None where springs have none."""
        return None

    def loss(self, theta: np.ndarray) -> np.ndarray:
        """Share of the velocity lost per second (B,) 1/s."""
        return np.zeros(len(theta))

    @abstractmethod
    def stable_step(self, theta: np.ndarray) -> np.ndarray:
        """The largest step of each parameter set (B,) s that is stable with damping of one stage, as sheets settle."""

    def stages_and_step(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """In how many stages damping is taken (B,), and the largest step (B,) s that is stable with them."""
        return np.ones(len(theta), np.int64), self.stable_step(theta)

    def stages_for(self, theta: np.ndarray, step: float) -> np.ndarray:
        """In how many stages damping is taken (B,) if a step [s] is given."""
        return np.ones(len(theta), np.int64)

    @abstractmethod
    def square_and_rate(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Bounds on ω² (B,) 1/s² and on the rate of damping (B,) 1/s of the sheet."""

    def restrained(self, theta: np.ndarray, stages: np.ndarray | int = 1) -> np.ndarray:
        """`restrained_step` with what of its damping is not taken in stages."""
        square, rate = self.square_and_rate(theta)
        return self.restrained_step(theta, square, np.where(np.asarray(stages) > 1, 0.0, rate))

    def fastest_square(self, theta: np.ndarray) -> np.ndarray:
        """A bound on ω² (B,) 1/s²: that of the flat sheet, whose springs all pull in one plane, and of the effects, for
        the least mass that these leave.
        """
        rows = np.zeros((len(theta), 2 * self.nodes))
        for k, row in zip(self.stiffness(theta).T, self.grid.eigenvalue_rows, strict=True):
            rows += k[:, None] * row  # not as a matrix product, whose last bits depend on how many sets there are
        return (rows.max(axis=1) + self.stiffest_effect(theta)) / self.effects.lightest(theta)


class _Batch(GridBatch):
    """Parameter sets in blocks of lanes."""

    simulation: SpringSimulation

    def __init__(self, simulation: SpringSimulation, theta: np.ndarray):
        options = simulation.options
        self.calmed = simulation.effects.resting(simulation.calmed(theta))
        scale = simulation.safety * options.step_scale
        held = options.step_scale * simulation.restrained(self.calmed)  # of each node by itself: a bound that is safe
        settling = np.minimum(scale * simulation.stable_step(self.calmed), held)
        if options.dt is None:
            self.damping_stages, step = simulation.stages_and_step(theta)
            held = options.step_scale * simulation.restrained(theta, self.damping_stages)
            dt, self.settle_dt = np.minimum(scale * step, held), settling
        else:
            self.damping_stages = simulation.stages_for(theta, options.dt)
            dt = np.full(len(theta), options.dt * options.step_scale)
            self.settle_dt = np.where(self.damping_stages > 1, np.minimum(dt, settling), dt)
        super().__init__(simulation, theta, dt, SETTLE[1] / simulation.slowest)
        self.strain_limit = math.inf if options.strain_limit is None else options.strain_limit

    def rests_first(self, members: np.ndarray) -> bool:
        """Whether sheets come to rest in a loop of their own before that of the run: without the effects that act in
        motion only; without stages, which the little damping of that time does not need; and in double precision,
        since in single rounding alone keeps soft modes moving.
        """
        apart = (
            self.terms > 0 or self.simulation.options.precision == "single" or (self.damping_stages[members] > 1).any()
        )
        return bool(apart) and self.hung is None and self.simulation.settles

    @property
    def blocks(self) -> list[np.ndarray]:
        """Members that run together, as many stages and similar steps side by side; one by one on a large grid."""
        alone = self.simulation.nodes >= SMALL or self.simulation.scene.thickness > 0 or self.terms > 0
        order = self.members[np.lexsort((self.dt[self.members], self.damping_stages[self.members]))]
        out = []
        for alike in np.split(order, np.flatnonzero(np.diff(self.damping_stages[order])) + 1):
            lanes = 1 if alone or self.rests_first(alike) else LANES
            out += [alike[k : k + lanes] for k in range(0, len(alike), lanes)]
        return out

    def start(self, members: np.ndarray) -> Start:
        """Where interleaved members begin."""
        each = [self.begin(int(b)) for b in members]

        def interleaved(rows: list[np.ndarray]) -> np.ndarray:
            return np.ascontiguousarray(np.stack(rows, axis=2).reshape(3, -1))

        return Start(interleaved([s.x for s in each]), interleaved([s.v for s in each]), each[0].settles)

    def springs(self, members: np.ndarray, stages: int, real: type) -> kernels.Springs:
        """The springs of members that run together, in the precision in which they run."""
        simulation, lanes, theta = self.simulation, len(members), self.theta[members]
        grid = simulation.grid

        def of_each(values: np.ndarray | None) -> np.ndarray:
            return np.zeros((0, 0), real) if values is None else _of_springs(grid, values).astype(real)

        return kernels.Springs(
            grid.strides * lanes, np.repeat(grid.rest, lanes, axis=1).astype(real),
            of_each(simulation.stiffness(theta)), of_each(simulation.dashpots(theta)),
            of_each(simulation.dashpots(self.calmed[members])), stages,
            simulation.loss(theta), self.strain_limit, simulation.limited,
        )  # fmt: skip

    def run_block(self, members: np.ndarray) -> None:
        simulation, scene, effects = self.simulation, self.simulation.scene, self.simulation.effects
        lanes, slowest, sheet = len(members), simulation.slowest, simulation.sheet
        out = np.full((lanes, *self.position.shape[1:]), np.nan)
        status, steps = np.zeros(lanes, np.int64), np.zeros(lanes, np.int64)
        settling = kernels.Settling(SETTLE / slowest, 2 * slowest, AT_REST, self.settle_dt[members])
        terms = Terms(
            self.stages, self.terms, effects.kernel_parameters(self.theta[members], SLOTS),
            effects.kernel_state(lanes, SLOTS, sheet),
        )  # fmt: skip
        begins, grips, layers = self.start(members), self.grips_of(members), layers_of(scene, sheet)
        sampling = Sampling(self.interpolator.index, self.interpolator.weight, self.times[members], out)

        def march(
            precision: str, begins: Start, effects: tuple[Callable, ...], sampling: Sampling, stages: int
        ) -> Start:
            real = REAL[precision]
            begins = begins._replace(x=begins.x.astype(real), v=begins.v.astype(real))
            kernels.run_block(precision)(
                lanes, begins, self.springs(members, stages, real), self.sheet(), *effects, terms, grips,
                obstacle_table(scene), layers, self.bounds(), scene.start_time, self.dt[members], settling, sampling,
                status, steps,
            )  # fmt: skip
            return begins

        if self.rests_first(members):
            hung = march("double", begins, self.settling_kernels, sampling._replace(times=np.zeros((lanes, 0))), 1)
            self.steps[members] += steps
            begins, steps[:] = Start(hung.x, np.zeros_like(hung.v), RESTS), 0
        if not status.any():
            march(simulation.options.precision, begins, self.kernels, sampling, int(self.damping_stages[members[0]]))
        self.position[members], self.status[members] = out, status
        self.steps[members] += steps


@lru_cache(64)
def whole_grid(
    u: tuple[float, ...], v: tuple[float, ...], size: tuple[float, float], areal_density: float, families: Families
) -> SpringGrid:
    """The grid of a whole sheet, once for all simulations on it: finding its largest eigenvalues takes a while."""
    return SpringGrid.of((np.array(u), np.array(v)), size, areal_density, families)


def _of_springs(grid: SpringGrid, values: np.ndarray) -> np.ndarray:
    """Values (lanes, K) of the model's stiffnesses or dashpots for every spring, (S, n·lanes), lanes innermost."""
    each = values[:, [which for _, _, which in grid.families]].T  # (S, lanes)
    return (grid.share[:, :, None] * each[:, None]).reshape(len(each), -1)
