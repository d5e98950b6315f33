"""Runs of a testing machine reduced to medians over equal steps of stretch, and how far runs differ."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.statistics import NORMAL, third_differences
from clothbench.recordings.curve import LEAST, Curve, last_rise

STEPS = 60  # of the common range of stretch, where the recordings have samples enough
HOLE = 3  # steps from one with a sample to the next, beyond which nothing is told in between


@dataclass(frozen=True, eq=False)
class CurveObservation:
    """Medians over S steps of stretch.

    stretch: (S,), length over the unloaded length;
    force: (S,) N, NaN where a step has no sample;
    visible: (S,) bool, where it has;
    samples: (S,), how many it has;
    sigma: N, what a perfect model would be off by.
    """

    stretch: np.ndarray
    force: np.ndarray
    visible: np.ndarray
    samples: np.ndarray
    sigma: float


def loading(curve: Curve) -> tuple[np.ndarray, np.ndarray]:
    """Stretch and force (M,) of the last rise to the largest stretch: what comes before or after is another curve."""
    up = last_rise(curve.stretch)
    stretch = curve.stretch[up]
    if np.ptp(stretch) < LEAST:
        raise ClothbenchError(
            f"{curve.path or curve.name}: variable 'stretch': found its largest, {stretch[-1]:.4g}, at sample "
            f"{up.stop - 1}, and no rise to it, expected the way up; give the samples in the order of the measurement, "
            "or leave the recording out"
        )
    return stretch, curve.force[up]


def common_steps(curves: Sequence[Curve]) -> np.ndarray:
    """Edges (S + 1,) of equal steps over the range of stretch that all these curves have."""
    ways = [loading(curve)[0] for curve in curves]
    low, high = max(float(way.min()) for way in ways), min(float(way.max()) for way in ways)
    if not high - low > 1e-3:
        raise ClothbenchError(
            f"{curves[0].path or curves[0].name}: found {low:.4g} to {high:.4g} as the range of stretch that all "
            f"{len(curves)} fit recordings share, expected some; leave the recordings out that break off early"
        )
    count = int(np.clip(min(len(way) for way in ways) // 3, 6, STEPS))
    return np.linspace(low, high, count + 1)


def observed(curve: Curve, edges: np.ndarray, sigma: float) -> CurveObservation:
    """Medians of stretch and of force in each step, on the way up."""
    stretch, force = loading(curve)
    inside = (stretch >= edges[0]) & (stretch <= edges[-1])
    step = np.clip(np.searchsorted(edges, stretch, side="right") - 1, 0, len(edges) - 2)
    out = np.full((2, len(edges) - 1), np.nan)
    samples = np.bincount(step[inside], minlength=len(edges) - 1)
    for k in range(len(edges) - 1):
        mine = inside & (step == k)
        if mine.any():
            out[:, k] = np.median(stretch[mine]), np.median(force[mine])
    return CurveObservation(out[0], out[1], np.isfinite(out[1]), samples, sigma)


def floor_of(seen: Sequence[CurveObservation], curves: Sequence[Curve]) -> float:
    """What a perfect model would be off by [N]: the spread between runs, or the noise of the only one."""
    if len(seen) > 1 and math.isfinite(between := spread(seen, [curve.sample_width for curve in curves])):
        return between
    stated = [
        curve.noise_sigma**2 * variance_of_median(one.samples[one.visible])
        for one, curve in zip(seen, curves, strict=True)
        if math.isfinite(curve.noise_sigma)
    ]
    if stated:
        return float(np.sqrt(np.mean(np.concatenate(stated))))
    jumps = [third_differences(one.stretch[one.visible], one.force[one.visible]) for one in seen]
    known = np.concatenate([*jumps, []])
    return NORMAL * float(np.median(np.abs(known))) if known.size else math.nan


def variance_of_median(samples: np.ndarray) -> np.ndarray:
    """Of the median of so many normal samples (S,), in variances of one: π/2n of many, within 4 % of any number."""
    return np.pi / (2 * samples + np.where(samples % 2, np.pi - 2, 2.5))


def spread(seen: Sequence[CurveObservation], widths: Sequence[float]) -> float:
    """Standard deviation [N] between runs at equal stretch, root-mean-square over the steps that two of them have.

    widths: m, of the samples; NaN = not known, of all of them. Forces are compared per width, and what they differ by
    is told of a sample of the root-mean-square width.
    """
    known = np.any([one.visible for one in seen], axis=0)
    centres = np.nanmean([one.stretch[known] for one in seen], axis=0)
    times = np.ones(len(seen)) if np.isnan(widths).any() else np.divide(widths, widths[0])
    forces = np.array(
        [force_at(one, centres, np.flatnonzero(known)) / wider for one, wider in zip(seen, times, strict=True)]
    )
    compared = np.isfinite(forces).sum(axis=0) > 1
    if not compared.any():
        return math.nan
    per_width = np.sqrt(np.mean(np.nanvar(np.ascontiguousarray(forces[:, compared]), axis=0, ddof=1)))
    return float(per_width * np.sqrt(np.mean(times**2)))


def force_at(one: CurveObservation, stretch: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Force (K,) N of a run at stretches (K,) that lie in `steps` (K,): between its median there and the next. NaN of a
    step in which it has no sample, and across a hole: there a straight line is no run.
    """
    mine = np.flatnonzero(one.visible)
    force = np.interp(stretch, one.stretch[mine], one.force[mine])
    beyond = np.searchsorted(mine, steps) + np.where(stretch > one.stretch[steps], 1, -1)
    apart = np.abs(mine[np.clip(beyond, 0, len(mine) - 1)] - steps)
    near = (apart <= HOLE) | np.isclose(stretch, one.stretch[steps])
    return np.where(one.visible[steps] & near, force, np.nan)
