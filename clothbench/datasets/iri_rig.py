"""What one recording of the IRI data brings to the alignment, and the rig that several of them share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from clothbench.datasets.rigid import PosePath

SLOW = 0.05  # m/s; below this a stamp cannot be told from the motion


@dataclass(frozen=True, eq=False)
class Take:
    """One recording on its way: stamps `time` (T,) s, `gap` (T,) s to the stamp before, upper row `edge` (T,
    n, 3) m and mean `column` direction (T, 3) in the robot's base as the camera states it, the tool's path,
    material u (n,).
    """

    time: np.ndarray
    gap: np.ndarray
    edge: np.ndarray
    column: np.ndarray
    tool: PosePath
    u: np.ndarray


@dataclass(frozen=True, eq=False)
class Rig:
    """turn: rotation vector (3,) rad about `pivot` (3,) m that corrects the camera; centre, direction: the
    hanger in the tool's frame, m and unit; offset: median clock offset in s; per_gap: further offset per
    second of gap beyond `usual_gap`; jitter: what is left of the stamps' scatter, s.
    """

    turn: np.ndarray
    pivot: np.ndarray
    centre: np.ndarray
    direction: np.ndarray
    usual_gap: float
    offset: float = 0.0
    per_gap: float = 0.0
    jitter: float = 0.04

    def corrected(self, points: np.ndarray) -> np.ndarray:
        """Points (..., 3) m with the camera's orientation put right."""
        return (points - self.pivot) @ Rotation.from_rotvec(self.turn).as_matrix().T + self.pivot

    def held(self, u: np.ndarray) -> np.ndarray:
        """Tool-frame offsets (n, 3) m of the upper edge's points at material u (n,)."""
        return self.centre + (u - u.mean())[:, None] * self.direction

    def age(self, take: Take, offset: float) -> np.ndarray:
        """How old each image was when it was stamped (T,), in s."""
        return offset + self.per_gap * (take.gap - self.usual_gap)


def lateness(rig: Rig, take: Take, offset: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """How much older still each image looks (T,) s, the speed it is read from (T,) m/s, and the row's miss
    (T, 3) m.

    The upper row's miss along the tool's velocity, divided by the speed; NaN where the row was not seen.
    """
    when = take.time - rig.age(take, offset)
    miss = rig.corrected(take.edge) - take.tool.carried(when, rig.held(take.u))
    counted = np.isfinite(miss).all(axis=-1, keepdims=True)
    enough = counted.sum(axis=1) * 2 >= take.edge.shape[1]
    miss = np.where(enough, np.where(counted, miss, 0.0).sum(axis=1) / np.maximum(counted.sum(axis=1), 1), np.nan)
    velocity = take.tool.velocity(when)
    speed = np.linalg.norm(velocity, axis=1)
    return -(miss * velocity).sum(axis=1) / np.maximum(speed, SLOW) ** 2, speed, miss


def resting(tool: PosePath, when: np.ndarray, before: float = 0.4, within: float = 0.003) -> np.ndarray:
    """Frames (T,) at which the tool has been still to `within` m for `before` s, and just after."""
    back = [tool.at(when - s)[0] for s in np.linspace(-0.1, before, 6)]
    return (np.ptp(np.stack(back), axis=0) < within).all(axis=-1)
