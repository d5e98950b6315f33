"""A stand-in strip of a fabric, whose stiffness differs from place to place as its measured fold heights did."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from clothbench.reference.fabrics import Fabric
from clothbench.reference.lifted_strip import Lifted, Stiffness, hold, lift

PATCH = 0.1  # m, over which the stiffness of a fabric hangs together
WAVES = 40
EXACT = 1e-5  # relative; micrometres, where the camera sees tenths of millimetres
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

    It is moved from pose to pose as a robot would: each state is reached from the last one.
    """

    __test__ = False  # no test of its own, whatever its name says

    length: float
    stiffness: Stiffness
    offset: np.ndarray
    state: Lifted | None = field(default=None, init=False)

    @classmethod
    def of(cls, fabric: Fabric, length: float, stream: Callable[[str], int]) -> TestStrip:
        """A strip of a fabric; `stream(purpose)` gives a seed for each thing that is left to chance."""
        random = np.random.default_rng(stream("gripper"))
        offset = OFFSET * np.clip(random.normal(size=2), -MOST, MOST)
        return cls(length, scattered(fabric, length, stream("fabric")), offset)

    def move(self, pose: np.ndarray) -> Lifted:
        """The strip at rest with the gripper sent to x, z [m] and slope [rad]."""
        x, z, slope = pose
        x, z = x + self.offset[0], z + self.offset[1]
        near = self.state
        if near is None or near.pose[1] > z:
            near = lift(self.length, self.stiffness, z, tolerance=EXACT)
        elif near.pose[1] < z:
            near = lift(self.length, self.stiffness, z, near, tolerance=EXACT)
        goal = (float(x), float(z), float(slope))
        self.state = hold(self.length, self.stiffness, goal, near, tolerance=EXACT)
        return self.state
