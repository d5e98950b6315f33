"""What the torque about the grips goes with: present motion, or its past as well; and how long the past counts.

The past is a kernel over lag, without any form given beforehand: f = −b v_n n − n ∫ K(s) v̇_n(t − s) ds, K linear
between a few lags and zero beyond the last. Air that follows the sheet with one relaxation time has K = h exp(−s/τ)
(`air_memory`), drag without a memory none, and added mass all of K at s = 0. Coefficients by least squares with a
penalty on the kernel's second difference, which is chosen by recordings left out.

The band about the kernel is the spread between recordings and no more: that the penalty smooths a kernel which falls
steeply moves all of them alike, and lies outside it. And K is known only up to what it is at the last lag: a constant
over all lags is drag on the velocity now. The shares are of recordings left out, by which the penalty was chosen, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clothbench.core.statistics import jackknife_half_width
from clothbench.studies.improve.law import Law, law_of, solved
from clothbench.studies.improve.motion import Motion, steady_axes
from clothbench.studies.improve.settings import LOOP

LAGS = (0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.55, 0.75, 1.0)  # s; the kernel is zero at the last
PENALTIES = (1e-3, 1e-2, 1e-1, 1.0, 10.0, 100.0)  # beside the mean square of a lag's column


@dataclass(frozen=True)
class Past:
    """What the missing torque goes with.

    shares: (of what, share of its mean square that this predicts on recordings left out);
    lag: s; value, low, high: kg/(m²·s), the kernel there and the spread between recordings.
    """

    shares: tuple[tuple[str, float], ...]
    lag: tuple[float, ...]
    value: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]


@dataclass(frozen=True)
class Balance:
    """What the recordings say without any model. past: what the torque about the grips goes with; law: the sparsest law
    that predicts it, None where nothing beats chance; recordings: on how many this rests, of so many that were fitted.
    """

    past: Past
    law: Law | None
    recordings: tuple[int, int]


def balance_of(motions: Sequence[Motion | None], seed: int) -> Balance | None:
    """What the balance of torques tells; None of fewer than three recordings. motions: None of one of which a
    balance would say nothing (`motion_of`).
    """
    known = [m for m in motions if m is not None]
    past = past_of(known)
    return None if past is None else Balance(past, law_of(known, seed), (len(known), len(motions)))


def past_of(motions: Sequence[Motion]) -> Past | None:
    """The shares and the kernel; None of fewer than three recordings."""
    if len(motions) < LOOP.least_recordings:
        return None
    missing = [m.missing[m.counted] for m in motions]
    steady = [np.eye(3)["xyz".index(axis)] for axis in steady_axes(motions)]
    velocity = [of_velocity(m, steady)[m.counted] for m in motions]
    acceleration, past = ([each(m)[m.counted] for m in motions] for each in (of_acceleration, of_past))
    rough = np.diff(np.eye(past[0].shape[1] + 1)[:, :-1], n=2, axis=0)  # the last lag's value is zero
    stiff = np.zeros((velocity[0].shape[1] + rough.shape[1],) * 2)
    stiff[-rough.shape[1] :, -rough.shape[1] :] = rough.T @ rough
    stiff *= np.mean([np.mean(p**2) for p in past])
    both = joined(velocity, past)
    penalty = smoothest([left_out(both, missing, size * stiff) for size in PENALTIES])
    total = float(np.mean([np.mean(q**2) for q in missing]))
    shares = (
        ("velocity", left_out(velocity, missing)),
        ("velocity and acceleration", left_out(joined(velocity, acceleration), missing)),
        ("velocity and its past", left_out(both, missing, penalty * stiff)),
    )
    value, low, high = kernel_of(both, missing, penalty * stiff, past[0].shape[1])
    told = tuple((what, float(1 - left.mean() / total)) for what, left in shares)
    return Past(told, LAGS, value, low, high)


def joined(*columns: Sequence[np.ndarray]) -> list[np.ndarray]:
    """(T, K) of each recording, of several sets of columns."""
    return [np.hstack(each) for each in zip(*columns, strict=True)]


def smoothest(errors: Sequence[np.ndarray]) -> float:
    """The largest penalty whose error on recordings left out is within one standard error of the least."""
    means = np.array([each.mean() for each in errors])
    best = int(np.argmin(means))
    most = means[best] + errors[best].std(ddof=1) / np.sqrt(len(errors[best]))
    return max(size for size, mean in zip(PENALTIES, means, strict=True) if mean <= most)


def of_velocity(motion: Motion, steady: Sequence[np.ndarray]) -> np.ndarray:
    """(T, 2) torques against velocity, of all motion and of that along the normal, and of a steady force along each of
    these axes (3,), which a frame that leans makes as well.
    """
    along = -motion.along_normal[..., None] * motion.normal
    pushes = [np.broadcast_to(axis, motion.x.shape) for axis in steady]
    return np.column_stack([motion.torque(-motion.v), motion.torque(along), *map(motion.torque, pushes)])


def of_acceleration(motion: Motion) -> np.ndarray:
    """(T, 1) torque against the acceleration along the normal."""
    along = -np.einsum("tnc,tnc->tn", motion.a, motion.normal)
    return motion.torque(along[..., None] * motion.normal)[:, None]


def of_past(motion: Motion) -> np.ndarray:
    """(T, K) torques against the change of the normal velocity at each lag but the last, weighted as a kernel that is 1
    there and falls to 0 at the next lags on either side. Before the first frame nothing moved.
    """
    step = float(motion.time[1] - motion.time[0])
    change = np.gradient(motion.along_normal, step, axis=0)
    fine = np.arange(0.0, LAGS[-1] + step / 2, step)
    out = np.zeros((len(motion.time), len(LAGS) - 1))
    for k in range(len(LAGS) - 1):
        weight = np.interp(fine, LAGS, np.eye(len(LAGS))[k]) * step
        weight[0] /= 2
        sums = np.apply_along_axis(lambda series, w: np.convolve(series, w)[: len(series)], 0, change, weight)
        out[:, k] = motion.torque(-sums[..., None] * motion.normal)
    return out


def solution(design: Sequence[np.ndarray], missing: Sequence[np.ndarray], stiff: np.ndarray | float) -> np.ndarray:
    """(K,) coefficients of least squares in which each recording has the same say."""
    hessian = np.sum([d.T @ d / len(d) for d in design], axis=0) + len(design) * np.asarray(stiff)
    gradient = np.sum([d.T @ q / len(q) for d, q in zip(design, missing, strict=True)], axis=0)
    return solved(hessian, gradient)


def left_out(
    design: Sequence[np.ndarray], missing: Sequence[np.ndarray], stiff: np.ndarray | float = 0.0
) -> np.ndarray:
    """(R,) mean square of what is left of each recording by coefficients from all others."""
    out = []
    for r in range(len(missing)):
        others = [k for k in range(len(missing)) if k != r]
        found = solution([design[k] for k in others], [missing[k] for k in others], stiff)
        out.append(np.mean((missing[r] - design[r] @ found) ** 2))
    return np.array(out)


def kernel_of(
    design: Sequence[np.ndarray], missing: Sequence[np.ndarray], stiff: np.ndarray, lags: int
) -> tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]:
    """The kernel at each lag, and the spread between recordings: how far it would be moved by other ones (jackknife, 95
    %), not what the penalty makes of all of them.
    """
    count = len(missing)
    value = np.append(solution(design, missing, stiff)[-lags:], 0.0)
    moved = []
    for r in range(count):
        others = [k for k in range(count) if k != r]
        moved.append(np.append(solution([design[k] for k in others], [missing[k] for k in others], stiff)[-lags:], 0.0))
    half = jackknife_half_width(np.array(moved) - np.mean(moved, axis=0))
    return tuple(map(float, value)), tuple(map(float, value - half)), tuple(map(float, value + half))
