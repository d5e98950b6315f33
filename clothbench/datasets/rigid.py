"""Rigid motion from stamped poses: a tool's path on its own clock, smooth enough to drive a simulation."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import Akima1DInterpolator
from scipy.spatial.transform import Rotation

# Two publishers with one period can interleave into pairs of near-equal stamps; a spline through both would
# take their difference, a millisecond apart, for a speed.
SAME_INSTANT = 0.010


@dataclass(frozen=True, eq=False)
class PosePath:
    """Poses of a rigid body: time (K,) s strictly increasing, position (K, 3) m, quaternion (K, 4) as x, y,
    z, w.
    """

    time: np.ndarray
    position: np.ndarray
    quaternion: np.ndarray

    @cached_property
    def _smooth(self) -> Akima1DInterpolator:
        """Akima's local cubic: smooth where the body moves, without the overshoot of a spline where it stops."""
        return Akima1DInterpolator(self.time, np.hstack([self.position, self.quaternion]))

    def at(self, time: np.ndarray) -> tuple[np.ndarray, Rotation]:
        """Position (T, 3) in m and rotation at `time` (T,) in s; held at the ends."""
        values = self._smooth(np.clip(time, self.time[0], self.time[-1]))
        return values[:, :3], Rotation.from_quat(values[:, 3:])

    def velocity(self, time: np.ndarray, over: float = 0.05) -> np.ndarray:
        """Velocity (T, 3) in m/s as a central difference over ± `over` s."""
        return (self.at(time + over)[0] - self.at(time - over)[0]) / (2 * over)

    def carried(self, time: np.ndarray, offsets: np.ndarray) -> np.ndarray:
        """World positions (T, G, 3) of points fixed to the body at `offsets` (G, 3) m in its own frame."""
        position, rotation = self.at(time)
        return position[:, None] + np.einsum("tij,gj->tgi", rotation.as_matrix(), offsets)


def pose_path(stamp: np.ndarray, position: np.ndarray, quaternion: np.ndarray) -> PosePath:
    """A path from stamps (K,) s that may repeat, run backwards or come in pairs; quaternion signs made
    continuous.
    """
    usable = np.isfinite(position).all(axis=1) & (np.linalg.norm(np.nan_to_num(quaternion), axis=1) > 0.5)
    stamp, position, quaternion = stamp[usable], position[usable], quaternion[usable]
    keep, last = [], -np.inf
    for i, now in enumerate(stamp):
        if now >= last + SAME_INSTANT:
            keep.append(i)
            last = now
    unit = quaternion[keep] / np.linalg.norm(quaternion[keep], axis=1, keepdims=True)
    turns = np.where((unit[1:] * unit[:-1]).sum(axis=1) < 0, -1.0, 1.0)
    unit[1:] *= np.cumprod(turns)[:, None]
    return PosePath(stamp[keep], position[keep], unit)
