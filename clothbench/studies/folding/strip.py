"""A stand-in strip of a fabric, whose stiffness differs from place to place as its measured fold heights did."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from clothbench.reference.fabrics import Fabric
from clothbench.reference.lifted_strip import Lifted, Stiffness, hold, lift

PATCH = 0.1  # m, over which the stiffness of a fabric hangs together
WAVES = 40
EXACT = 1e-5  # relative; micrometres, where the camera sees tenths of millimetres
UPRIGHT = 1.7  # rad, beyond what a strip that hangs freely from its end can lean
SLIP, SLIDE = 1e-6, 1e-3  # m: how well a slip is found, and the first that is tried
OFFSET, MOST = 0.0015, 2.0  # m, σ of the gripper's offset along x and z; how many σ it may be off


def scattered(fabric: Fabric, length: float, seed: int) -> Stiffness:
    """η_b along the strip [m⁻⁴·s²]: where the fold's height would be μ + ξσ it is the table's, log-quadratic in ξ.

    ξ(u) is a smooth Gaussian process of correlation length `PATCH` and unit variance (random cosines), bent back
    beyond ±2, since the table says nothing beyond.
    """
    random = np.random.default_rng(seed)
    waves, phases = random.normal(0.0, 1.0 / PATCH, WAVES), random.uniform(0.0, 2 * np.pi, WAVES)
    ends = np.log([fabric.eta_high, fabric.eta, fabric.eta_low])
    bend, slope = (ends[2] + ends[0] - 2 * ends[1]) / 8, (ends[2] - ends[0]) / 4

    def stiffness(u: np.ndarray) -> np.ndarray:
        wave = np.cos(np.multiply.outer(np.clip(u, 0.0, length), waves) + phases)
        xi = 2 * np.tanh(np.sqrt(2 / WAVES) * wave.sum(axis=-1) / 2)
        return np.exp(ends[1] + slope * xi + bend * xi**2)

    return stiffness


@dataclass(eq=False)
class TestStrip:
    """A strip `length` m long on the desk, its last end in a gripper that is `offset` (x, z) m from where it thinks.

    It is moved from pose to pose as a robot would: each state is reached from the last one. What lies on the desk slips
    as a whole where a coefficient of `friction` does not hold it: `origin` m is where its first end lies, `needed` the
    coefficient that would have held it where it lay.
    """

    __test__ = False  # no test of its own, whatever its name says

    length: float
    stiffness: Stiffness
    offset: np.ndarray
    friction: float = math.inf
    state: Lifted | None = field(default=None, init=False)
    origin: float = field(default=0.0, init=False)
    needed: float = field(default=0.0, init=False)

    @classmethod
    def of(cls, fabric: Fabric, length: float, stream: Callable[[str], int], friction: float = math.inf) -> TestStrip:
        """A strip of a fabric; `stream(purpose)` gives a seed for each thing that is left to chance."""
        random = np.random.default_rng(stream("gripper"))
        offset = OFFSET * np.clip(random.normal(size=2), -MOST, MOST)
        return cls(length, scattered(fabric, length, stream("fabric")), offset, friction)

    def move(self, pose: np.ndarray) -> Lifted:
        """The strip at rest with the gripper sent to x, z [m] and slope [rad]."""
        x, z, slope = pose
        x, z = x + self.offset[0], z + self.offset[1]
        near = self.state
        if near is None or near.pose[1] > z:
            near = lift(self.length, self.stiffness, z, tolerance=EXACT)
        elif near.pose[1] < z:
            near = lift(self.length, self.stiffness, z, near, tolerance=EXACT)
            if near.pose[2] > UPRIGHT:  # it has come from a pose so far off that it found a strip that is rolled up
                near = lift(self.length, self.stiffness, z, tolerance=EXACT)
        state = self._held(x, z, slope, near)
        self.needed = abs(state.pull) / state.press
        self.state = state if self.needed <= self.friction else self._slipped(x, z, slope, state)
        return self.state

    def line(self, u: np.ndarray) -> np.ndarray:
        """Where material points u (M,) m lie on the desk, (M, 2) m."""
        assert self.state is not None  # it has been moved
        return self.state.line(u) + np.array([self.origin, 0.0])

    def _held(self, x: float, z: float, slope: float, near: Lifted) -> Lifted:
        goal = (float(x - self.origin), float(z), float(slope))
        return hold(self.length, self.stiffness, goal, near, tolerance=EXACT)

    def _slipped(self, x: float, z: float, slope: float, state: Lifted) -> Lifted:
        """At rest again where the pull is what friction can bear; the origin goes where that is."""
        from scipy.optimize import brentq

        way = math.copysign(1.0, state.pull)

        def excess(origin: float) -> float:
            nonlocal state
            self.origin = origin
            state = self._held(x, z, slope, state)
            return way * state.pull - self.friction * state.press

        held, step = self.origin, SLIDE
        while excess(held + way * step) > 0:
            held, step = held + way * step, 2 * step
        brentq(excess, held, held + way * step, xtol=SLIP)
        return state
