"""What other simulators share as models: the way from a scene to their sheet, and back to a rollout.

Nodes, grips and material points are those of `grid_sheet`. The simulator gets its mesh from there; all that it must
be able to do is said by `Engine`. Effects come in as nodal forces, evaluated before each step.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from clothbench import ClothbenchError, Rollout, Scene
from clothbench.modelling import (
    DIVERGED,
    FORCE,
    SLOTS,
    BoundEffects,
    GridBatch,
    GridSimulation,
    for_each,
    grid_normals,
    own_sheet,
)
from clothbench_models.peers import missing

SETTLE = np.array([8.0, 60.0])  # least and most settling time in units of 1/ω₁
LOOK_AFTER = 0.25  # 1/ω₁, how often a settling sheet is looked at
# Damping while settling, in units of ω₁: strong at first, so that the sheet creeps into the nearest shape of rest
# and is not thrown into another one; then little, so that soft modes get there.
DAMPING, EASING = (1.2, 100.0), 1.2
MOST_DAMPING = 0.2  # of 1/dt: far inside what an explicit step can take
PATH = 2000  # steps of a grip's path that are laid out at once


def reason_to_skip(module: str, scene: Scene) -> str | None:
    """What to install, or why a simulator without contact cannot do a scene; None if nothing is in the way."""
    if reason := missing(module, module):
        return reason
    if scene.outline is not None:
        return f"{module}: is set up for whole rectangles here, and this scene's cloth is cut"
    if scene.obstacles or scene.thickness > 0:
        return f"{module}: is set up without contacts here, and this scene has some"
    return None


def refuse_mass(effects: BoundEffects, who: str) -> None:
    """Refuse effects that add to the nodes' masses, where the simulator has no place for them."""
    for effect in effects.at("dynamics"):
        if getattr(effect, "inertia", None) is not None:
            raise ClothbenchError(f"{who} takes no effects that add mass, as {effect.name!r} does; leave it out")


class Engine(Protocol):
    """One sheet in a simulator. Arrays (n, 3), nodes as in `GridSimulation.sheet`."""

    dt: float

    def place(self, position: np.ndarray, velocity: np.ndarray) -> None:
        """Put all nodes there [m], moving like that [m/s]."""

    def damp(self, rate: float) -> None:
        """From now on take `rate` [1/s] of each node's momentum away, for settling; 0 ends that."""

    def stay(self, steps: int) -> None:
        """Make steps; the held nodes stay where they are."""

    def follow(self, path: np.ndarray) -> None:
        """Make K steps; the held nodes are led along path (K + 1, G, 3) m, from the first to the last."""

    def push(self, force: np.ndarray, mass: np.ndarray | None) -> None:
        """Add nodal forces (3, n) N, and mass tensors (6, n) kg unless None, in the next step only."""

    def motion(self) -> tuple[np.ndarray, np.ndarray]:
        """Position [m] and velocity [m/s] now; not to be written to, nor kept."""
        ...


@dataclass(frozen=True, eq=False)
class ExternalSimulation(GridSimulation):
    """One scene ready for an external simulator; a subclass says how its sheet is made."""

    at_rest = 1e-6  # m/s at which a settling sheet hangs still

    @abstractmethod
    def engine(self, theta: np.ndarray) -> Engine:
        """The sheet with one parameter set (P,), effects' parameters included."""

    def library(self) -> AbstractContextManager:
        """What has to surround all use of the simulator."""
        return nullcontext()

    def run(self, theta: np.ndarray) -> Rollout:
        """Simulate theta (B, P), each in its parameter's unit."""
        theta = self.parameters.check(theta)
        with self.library():
            batch = _Batch(self, theta)
            members = batch.members.tolist()
            if self.threads:
                for_each(batch.run_member, members)
            else:
                for b in members:
                    batch.run_member(b)
        return batch.rollout()


class _Batch(GridBatch):
    """The engines of one call of `run`."""

    simulation: ExternalSimulation

    def __init__(self, simulation: ExternalSimulation, theta: np.ndarray):
        self.engines = [simulation.engine(row) for row in theta]
        dt = np.array([engine.dt for engine in self.engines])
        super().__init__(simulation, theta, dt, SETTLE[1] / simulation.slowest)

    def run_member(self, b: int) -> None:
        """Settle one member, then move it past the times at which it is looked at."""
        march = _March(self, b)
        # Positions at a time between two steps lie on the line between them.
        since = self.times[b] - self.simulation.scene.start_time
        late = np.maximum(since, 0.0) / self.dt[b]
        before = np.floor(late).astype(int)
        stops = np.union1d(before, before + 1)
        seen = np.full((len(stops), *self.position.shape[2:]), np.nan)
        alive = march.settle()
        for k, stop in enumerate(stops.tolist()):
            alive = alive and march.advance_to(stop)
            if not alive:
                self.status[b] = DIVERGED
                break
            seen[k] = self.interpolator(march.position)
        first, part = np.searchsorted(stops, before), (late - before)[:, None, None]
        self.position[b] = (1 - part) * seen[first] + part * seen[first + 1]
        if since[0] < 0:  # before a run begins a sheet that was seen to move came from somewhere
            self.position[b] += np.minimum(since, 0.0)[:, None, None] * self.interpolator(self.velocity)
        lost = np.isnan(self.position[b]).any(axis=(1, 2))
        at = march.grips(self.times[b])[:, self.pins_of_points]
        self.position[b][:, self.held_points] = np.where(lost[:, None, None], np.nan, at)
        self.steps[b] = march.steps


class _March:
    """One member on its way through the scene."""

    def __init__(self, batch: _Batch, b: int):
        self.scene, self.engine, self.dt = batch.simulation.scene, batch.engines[b], float(batch.dt[b])
        self.rest = SETTLE / batch.simulation.slowest
        self.slowest, self.at_rest = batch.simulation.slowest, batch.simulation.at_rest
        self.knots, self.curve = batch.knots, batch.curves[b % len(batch.curves)]
        self.still = not self.curve[:3].any() and not np.ptp(self.curve[3], axis=0).any()
        self.forces = Forces(batch, b) if batch.terms else None
        self.limit, self.held = batch.bounds(), batch.simulation.anchored
        self.steps = self.now = 0
        self.settles = self.held and self.scene.velocity is None
        self._begin(batch.shape_of(b), batch.velocity)

    @property
    def position(self) -> np.ndarray:
        return self.engine.motion()[0]

    def grips(self, times: np.ndarray) -> np.ndarray:
        """Where the grips are at `times` (T,) s → (T, G, 3) m."""
        times = np.clip(times, self.knots[0], self.knots[-1])
        i = np.clip(np.searchsorted(self.knots, times, side="right") - 1, 0, self.curve.shape[1] - 1)
        s, c = (times - self.knots[i])[:, None, None], self.curve
        return ((c[0, i] * s + c[1, i]) * s + c[2, i]) * s + c[3, i]

    def settle(self) -> bool:
        """Let the sheet come to rest in the grips' first pose, unless it begins in motion; whether it is there."""
        if not self.settles:
            return True
        least, most = self.rest
        look = max(1, round(LOOK_AFTER / self.slowest / self.dt))
        start = np.full(look, self.scene.start_time)
        # How far nodes get from look to look: rounding keeps their velocities alive, but not their way.
        before, slow = self.position.copy(), self.at_rest * look * self.dt
        while self.steps * self.dt < most:
            self.engine.damp(self._damping(self.steps * self.dt * self.slowest))
            self._step(start, moving=False, settling=True)
            if not self._is_there():
                return False
            after = self.position.copy()
            if self.steps * self.dt > least and np.abs(after - before).max() < slow:
                break
            before = after
        self.engine.damp(0.0)
        shape = self.position.copy()
        self._begin(shape, np.zeros_like(shape))
        return True

    def _begin(self, shape: np.ndarray, velocity: np.ndarray) -> None:
        """Put the sheet there, in that motion, the held nodes exactly where the grips are."""
        self.engine.place(shape, velocity)
        if self.held:
            self.engine.follow(self.grips(np.array([self.scene.start_time])))

    def _damping(self, periods: float) -> float:
        """Damping [1/s] so long [1/ω₁] after the start."""
        last, first = (share * self.slowest for share in DAMPING)
        return max(last, min(first, MOST_DAMPING / self.dt) * math.exp(-EASING * periods))

    def advance_to(self, step: int) -> bool:
        """Go on to the end of that step, counted from the start; whether the sheet is still there."""
        while self.now < step:
            count = min(step - self.now, PATH)
            # Times are counted from the start: the same whatever else is looked at on the way.
            self._step(self.scene.start_time + self.dt * np.arange(self.now, self.now + count), not self.still)
            self.now += count
        return self._is_there()

    def _step(self, times: np.ndarray, moving: bool, settling: bool = False) -> None:
        """One step from each of `times` on."""
        self.steps += len(times)
        if self.forces is None and not moving:
            self.engine.stay(len(times))
            return
        path = self.grips(np.append(times, times[-1] + self.dt if moving else times[-1]))
        if self.forces is None:
            self.engine.follow(path)
            return
        for k, t in enumerate(times):
            self.engine.push(*self.forces(t, path[k], *self.engine.motion(), settling))
            self.engine.follow(path[k : k + 2])

    def _is_there(self) -> bool:
        return bool(np.abs(self.position).max() < self.limit)


class Forces:
    """The effects of one member as nodal forces and masses."""

    def __init__(self, batch: _Batch, b: int):
        simulation = batch.simulation
        self.sheet, self.columns, self.dt = own_sheet(simulation.sheet), simulation.shape[0], float(batch.dt[b])
        parameters = simulation.effects.kernel_parameters(batch.theta[b : b + 1], SLOTS)[0]
        state = simulation.effects.kernel_state(1, SLOTS, simulation.sheet)[0]
        self.terms: list[tuple[Callable, bool, np.ndarray, np.ndarray]] = [
            (batch.kernels[k], batch.stages[k] == FORCE, parameters[k], state[k]) for k in range(batch.terms)
        ]

    def __call__(
        self, t: float, grip: np.ndarray, position: np.ndarray, velocity: np.ndarray, settling: bool
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """Forces (3, n) N at time t [s], and masses (6, n) kg where an effect adds some.

        While the sheet settles the masses are left out: they do not matter for where it comes to rest.
        """
        x, v = np.ascontiguousarray(position.T), np.ascontiguousarray(velocity.T)
        sheet, force, mass = self.sheet, np.zeros_like(x), None
        grid_normals(x, self.columns, sheet.normal)
        sheet.grip[:] = grip.T
        for kernel, is_force, parameters, state in self.terms:
            if is_force:
                kernel(t, self.dt, x, v, force, sheet, parameters, state)
            elif not settling:
                mass = np.zeros((6, x.shape[1])) if mass is None else mass
                kernel(t, self.dt, x, v, mass, sheet, parameters, state)
        return force, mass
