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
    n, 3) m, mean `column` direction (T, 3) and that of its uppermost part `hang` (T, 3) in the robot's base as
    the camera states it, the tool's path, material u (n,).
    """

    time: np.ndarray
    gap: np.ndarray
    edge: np.ndarray
    column: np.ndarray
    hang: np.ndarray
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
        return self.turned(points - self.pivot) + self.pivot

    def turned(self, directions: np.ndarray) -> np.ndarray:
        """Directions (..., 3) with the camera's orientation put right."""
        return directions @ Rotation.from_rotvec(self.turn).as_matrix().T

    def held(self, u: np.ndarray) -> np.ndarray:
        """Tool-frame offsets (n, 3) m of the upper edge's points at material u (n,)."""
        return self.centre + (u - u.mean())[:, None] * self.direction

    def age(self, take: Take, offset: float) -> np.ndarray:
        """How old each image was when it was stamped (T,), in s."""
        return offset + self.per_gap * (take.gap - self.usual_gap)


@dataclass(frozen=True, eq=False)
class Miss:
    """How the upper row lies to the hanger, frame by frame, NaN where it was not seen.

    along: (T,) m, how far down the sheet the row lies: what is not seen above it; across: (T,) m, out of the sheet's
    own plane, and speed: (T,) m/s, of the hanger that way: together they tell the time; points: (T, n, 3) m, what is
    left of each point's distance once `along` is taken away.
    """

    along: np.ndarray
    across: np.ndarray
    speed: np.ndarray
    points: np.ndarray


def miss_of(rig: Rig, take: Take, when: np.ndarray) -> Miss:
    """The upper row beside the hanger at `when` (T,) s.

    A mask that is newer than the depth, or an edge that is too bright, cuts off some of the sheet or leaves too much:
    the outline slides on the sheet, and the row with it. Across the sheet nothing slides.
    """
    points = rig.corrected(take.edge) - take.tool.carried(when, rig.held(take.u))
    hang = rig.turned(take.hang)
    bar = take.tool.at(when)[1].apply(rig.direction)
    normal = np.cross(bar, hang)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    seen = np.isfinite(points).all(axis=-1, keepdims=True)
    enough = (seen.sum(axis=1) * 2 >= take.edge.shape[1]) & np.isfinite(hang).all(axis=1, keepdims=True)
    mean = np.where(enough, np.where(seen, points, 0.0).sum(axis=1) / np.maximum(seen.sum(axis=1), 1), np.nan)
    along = (mean * hang).sum(axis=1)
    velocity = take.tool.velocity(when)
    left = points - (np.nan_to_num(along)[:, None] * np.nan_to_num(hang))[:, None]
    return Miss(along, (mean * normal).sum(axis=1), (velocity * normal).sum(axis=1), left)


def lateness(rig: Rig, take: Take, offset: float) -> tuple[np.ndarray, np.ndarray]:
    """How much older still each image looks (T,) s, NaN where the row was not seen, and the speed it is read from (T,)
    m/s: the hanger's across the sheet.
    """
    miss = miss_of(rig, take, take.time - rig.age(take, offset))
    size = np.maximum(np.abs(miss.speed), SLOW)
    return -miss.across * np.sign(miss.speed) / size, np.abs(miss.speed)


def resting(tool: PosePath, when: np.ndarray, before: float = 0.4, within: float = 0.003) -> np.ndarray:
    """Frames (T,) at which the tool has been still to `within` m for `before` s, and just after."""
    back = [tool.at(when - s)[0] for s in np.linspace(-0.1, before, 6)]
    return (np.ptp(np.stack(back), axis=0) < within).all(axis=-1)
