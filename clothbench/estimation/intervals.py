"""How sure estimates and errors are: jackknife, bootstrap over frames, Student's t over recordings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import t as student

from clothbench.core.observation import Observation
from clothbench.core.parameters import ParameterSpace
from clothbench.core.protocols import Score
from clothbench.estimation.trials import Trial, evaluate

BLOCK = 1.0  # s; a swing's errors hang together over about a period, so blocks this long count as one piece of evidence
# Step of the differences for the intervals, in units of the scaled range: it looks over ripples as the search does.
PROBE = 0.03
SINGULAR = 1e10  # condition number above which the data do not determine a parameter


def intervals(trials: Sequence[Trial], space: ParameterSpace, best: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """95 % intervals (P,), (P,) of the best parameters and the condition of the scaled Jacobian.

    How far the parameters would move, to first order, if one second of one recording were left out (the jackknife over
    clusters, which is the sandwich covariance CR3 of Bell and McCaffrey 2002): neighbouring frames err alike, and a
    model's error is no noise, so the textbook's σ²(JᵀJ)⁻¹ would be far too sure. NaN where the metric has no residuals;
    the parameter's bounds where the data do not determine it.
    """
    nowhere = np.full(len(space), np.nan)
    unit = space.to_unit(best)
    up, down = np.minimum(unit + PROBE, 1.0), np.maximum(unit - PROBE, 0.0)
    points = np.vstack([unit[None], unit + np.diag(up - unit), unit - np.diag(unit - down)])
    evaluation, scores = evaluate(trials, space.from_unit(points))
    residual, count = evaluation.residual, len(space)
    if residual is None or not np.isfinite(residual).all():
        return nowhere, nowhere, float("nan")
    jacobian = ((residual[1 : count + 1] - residual[count + 1 :]) / (up - down)[:, None]).T
    hessian = jacobian.T @ jacobian
    condition = float(np.linalg.cond(hessian)) if np.isfinite(hessian).all() else float("inf")
    half = jackknife(jacobian, residual[0], clusters(trials, scores))
    return space.from_unit(unit - half), space.from_unit(unit + half), condition**0.5


def jackknife(jacobian: np.ndarray, residual: np.ndarray, groups: Sequence[np.ndarray]) -> np.ndarray:
    """Half-width (P,) of the 95 % interval from leaving out each group of rows of J (R, P) and r (R,) in turn.

    Infinite where the data do not determine a parameter.
    """
    hessian = jacobian.T @ jacobian
    moved = []
    for rows in groups:
        rest = hessian - jacobian[rows].T @ jacobian[rows]
        moved.append(np.linalg.lstsq(rest, jacobian[rows].T @ residual[rows], rcond=1 / SINGULAR)[0])
    count = len(moved)
    half = student.ppf(0.975, count - 1) * np.sqrt((count - 1) / count * np.square(moved).sum(axis=0))
    half[undetermined(hessian)] = np.inf
    return half


def undetermined(hessian: np.ndarray) -> np.ndarray:
    """Which parameters (P,) the data say nothing about: they take part in a direction that changes no residual."""
    if not np.isfinite(hessian).all():
        return np.ones(len(hessian), bool)
    strength, direction = np.linalg.eigh(hessian)
    nothing = direction[:, strength <= strength.max() / SINGULAR]
    return (nothing**2).sum(axis=1) > 0.01


def clusters(trials: Sequence[Trial], scores: Sequence[Score]) -> list[np.ndarray]:
    """Row numbers of the joined residual, in blocks of about `BLOCK` seconds of one recording."""
    out, start = [], 0
    for trial, score in zip(trials, scores, strict=True):
        assert score.residual is not None  # evaluate() joined them
        duration = trial.observation.time[-1] - trial.observation.time[0]
        rows = np.arange(start, start + score.residual.shape[1])
        out += np.array_split(rows, max(2, round(duration / BLOCK)))
        start += score.residual.shape[1]
    return out


def error_interval(score: Score, observation: Observation, seed: int, draws: int = 1000) -> tuple[float, float]:
    """95 % interval of one recording's error by a moving-block bootstrap over its frames (Künsch 1989).

    Quantiles are counted from the draws' own mean: blocks reach the first and the last frames less often than the
    others, and of few frames the mean of all draws is not that of the frames. The interval holds the error.
    """
    if score.per_frame is None or not np.isfinite(score.value[0]):
        return float("nan"), float("nan")
    trace = score.per_frame[0][np.isfinite(score.per_frame[0])]
    duration = observation.time[-1] - observation.time[0]
    length = int(np.clip(round(len(trace) * BLOCK / max(duration, BLOCK)), 1, max(1, len(trace) // 2)))
    random = np.random.default_rng(seed)
    starts = random.integers(0, len(trace) - length + 1, (draws, -(-len(trace) // length)))
    frames = (starts[..., None] + np.arange(length)).reshape(draws, -1)[:, : len(trace)]
    means = trace[frames].mean(axis=1)
    below, above = np.quantile(means, [0.025, 0.975]) - means.mean()
    return float(max(score.value[0] + min(below, 0.0), 0.0)), float(score.value[0] + max(above, 0.0))


def mean_interval(values: Sequence[float], halves: Sequence[float]) -> tuple[float, float]:
    """95 % interval of a mean over recordings: the recording is the unit of evidence (Student's t).

    Of one or two recordings the spread says next to nothing (t = 12.7); there the recordings' own half-widths are
    joined instead, which says how sure the mean of *these* is, not of others.
    """
    sample = np.asarray(values, dtype=float)
    if len(sample) < 3:
        half = float(np.sqrt(np.sum(np.square(halves)))) / len(sample)
    else:
        half = student.ppf(0.975, len(sample) - 1) * sample.std(ddof=1) / np.sqrt(len(sample))
    return float(max(sample.mean() - half, 0.0)), float(sample.mean() + half)
