"""`spectrum`: does the cloth swing as fast, and come to rest as fast, as the one that was seen?"""

from __future__ import annotations

import math
import weakref
from dataclasses import dataclass

import numpy as np

from clothbench import ClothbenchError, Observation, Rollout, Score
from clothbench_metrics.node_error import check_shape
from clothbench_metrics.poles import poles

LEAST_FRAMES = 10  # of five unknowns, twice as many
LEAST_SHARE = 0.5  # of the frames in which a node is seen, and of the pattern that is seen in a frame
DRAWS = 20  # of the floor


@dataclass(frozen=True, eq=False)
class Swing:
    """What was seen to swing. known: (T, N) bool, what counts; direction: (N, C), of length 1; frames: (K,) of the
    window; weight: (K,), squares of the direction that were seen; q: (K,) m; pole: −δ + iω [1/s], NaN if none is told.
    """

    known: np.ndarray
    direction: np.ndarray
    frames: np.ndarray
    weight: np.ndarray
    time: np.ndarray
    q: np.ndarray
    pole: complex


class Spectrum:
    """100 |s_sim − s| / |s|, s = −δ + iω the pole of the swing that was seen, s_sim that of the simulated one: by how
    much frequency and decay differ, in percent of the frequency. A phase, an amplitude or a place that is wrong counts
    nothing.

    The swing is q(t), the first principal component of the displacement of the nodes (seen in at least half of the
    frames) from their means over the frames: the pattern in which they moved most, in the frames in which half of it or
    more was seen. The same pattern, nodes and frames serve for the rollout. From when the hands are still,
    c + exp(−δt) (a cos ωt + b sin ωt) is fitted to both: c, a and b are linear, and ω and δ searched for on a grid, up
    to a quarter of the frame rate, and by least squares from there (variable projection: Golub and Pereyra, The
    Differentiation of Pseudo-Inverses and Nonlinear Least Squares Problems Whose Variables Separate, 1973). Stamps may
    be uneven.

    since: s on the recording's clock, from when the hands are still. None: from the largest excursion of q in the first
    half of the recording on, or from its beginning if that leaves less than one period. While hands still move the
    cloth the frequency is that of their motion, which every model follows, and the metric tells little: say `since`
    where it is known.

    The trace is 100 |exp(s_sim τ) − exp(s τ)|, by how much two swings that start alike have come apart τ after the
    window's beginning, in percent of their first amplitude. There is no value where the seen motion tells no
    frequency: fewer than 10 frames or less than one period in the window, a pattern that noise alone could make, or
    less than half of q's variance explained; nor for a rollout that does not move, or of which as little is explained.
    """

    name = "spectrum"
    version = 2
    unit = "%"

    def __init__(self, since: float | None = None):
        number = isinstance(since, int | float) and not isinstance(since, bool) and math.isfinite(since)
        if since is not None and not number:
            raise ClothbenchError(f"spectrum: since is {since!r}, expected seconds, or null for the largest excursion")
        self.since = None if since is None else float(since)
        self._known: weakref.WeakKeyDictionary[Observation, Swing] = weakref.WeakKeyDictionary()

    def __call__(self, observation: Observation, rollout: Rollout) -> Score:
        check_shape(observation, rollout)
        seen, members = self._seen(observation), len(rollout)
        per_frame = np.full((members, len(observation.time)), np.nan)
        if not np.isfinite(seen.pole):
            return Score(np.full(members, np.nan), self.unit, per_frame)
        q = component(places(observation, rollout.position), seen.known, seen.direction)[0][:, seen.frames]
        found = poles(seen.time, q)
        apart = np.exp(found[:, None] * seen.time) - np.exp(seen.pole * seen.time)
        per_frame[:, seen.frames] = 100 * np.abs(apart)
        return Score(self._value(found, seen.pole), self.unit, per_frame)

    @staticmethod
    def _value(found: np.ndarray, pole: complex) -> np.ndarray:
        return 100 * np.abs(found - pole) / abs(pole)

    def floor(self, observation: Observation) -> float:
        """What noise alone gives a perfect model, drawn with a fixed seed: the pole of q against those of q with the
        noise that σ of one coordinate makes of it. NaN if σ is not known or no frequency is told.
        """
        seen = self._seen(observation)
        if not np.isfinite(seen.pole) or not math.isfinite(observation.sigma):
            return math.nan
        noise = np.random.default_rng(0).normal(0.0, observation.sigma, (DRAWS, len(seen.q))) / np.sqrt(seen.weight)
        return float(np.mean(self._value(poles(seen.time, seen.q + noise), seen.pole)))

    def interval(self, observation: Observation, rollout: Rollout, seed: int) -> tuple[float, float]:
        """Not known: a recording has one swing; blocks of the trace say how it comes apart, not how sure that is."""
        return math.nan, math.nan

    def _seen(self, observation: Observation) -> Swing:
        """The swing that was seen, looked for once."""
        if observation not in self._known:
            self._known[observation] = swing(observation, self.since)
        return self._known[observation]


def swing(observation: Observation, since: float | None) -> Swing:
    """The swing in an observation from `since` [s] on; from None, see `Spectrum`."""
    time, position = observation.time, places(observation, observation.position[None])
    late = np.ones(len(time), bool) if since is None else time >= since
    known = observation.visible & late[:, None]
    watched = int(known.any(axis=1).sum())
    known = known & (known.sum(axis=0) >= LEAST_SHARE * watched)
    direction, strength = pattern(position[0], known)
    (q,), weight = component(position, known, direction)
    # Noise alone has a pattern of this strength at most (the edge of Marchenko and Pastur's distribution).
    coordinates = direction.shape[1] * int(known.any(axis=0).sum())
    noise = np.nan_to_num(observation.sigma) * (math.sqrt(watched) + math.sqrt(coordinates))
    every = np.flatnonzero(weight >= LEAST_SHARE)
    windows = [every] if since is not None or not len(every) else [after_largest(time, q, every), every]
    for frames in windows:
        tau, pole = time[frames] - time[frames[:1]], complex(np.nan, np.nan)
        if len(frames) >= LEAST_FRAMES and strength > noise:
            pole = complex(poles(tau, q[None, frames])[0])
        if abs(pole.imag) * tau[-1:].sum() >= 2 * math.pi:
            return Swing(known, direction, frames, weight[frames], tau, q[frames], pole)
    return Swing(known, direction, frames, weight[frames], tau, q[frames], complex(np.nan, np.nan))


def after_largest(time: np.ndarray, q: np.ndarray, frames: np.ndarray) -> np.ndarray:
    """Those of some frames (K,) that do not come before the largest |q| (T,) in the first half of their time."""
    half = frames[time[frames] <= (time[frames[0]] + time[frames[-1]]) / 2]
    return frames[frames >= half[np.argmax(np.abs(q[half]))]]


def places(observation: Observation, position: np.ndarray) -> np.ndarray:
    """Positions (B, T, N, 3) m in the coordinates that were measured, (B, T, N, C) m: those of a picture at the depth
    of what was seen.
    """
    if observation.sight is None:
        return position
    seen = observation.sight.in_view(np.nan_to_num(observation.position))[..., :2]
    return seen + observation.differences(position)


def pattern(position: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, float]:
    """The direction (N, C), of length 1, in which positions (T, N, C) m leave their means most, where known (T, N), and
    the singular value of it, m.
    """
    moved = about_mean(position[None], known)[0].reshape(len(position), -1)
    _, strength, directions = np.linalg.svd(moved, full_matrices=False)
    return directions[0].reshape(position.shape[1:]), float(strength[0])


def component(position: np.ndarray, known: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far positions (B, T, N, C) m are out along a direction (N, C), (B, T) m, by least squares over what is known;
    and the squares of the direction that are (T,).
    """
    weight = known @ (direction**2).sum(axis=1)
    with np.errstate(invalid="ignore"):  # of a rollout that went to infinity
        along = np.einsum("btnc,nc->bt", about_mean(position, known), direction)
    return along / np.where(weight > 0, weight, 1.0), weight


def about_mean(position: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Positions (B, T, N, C) m from each node's mean over the frames in which it is known, 0 where it is not."""
    mask = known[..., None]
    mean = np.where(mask, position, 0.0).sum(axis=1, keepdims=True) / np.maximum(known.sum(axis=0), 1)[:, None]
    return np.where(mask, position - mean, 0.0)
