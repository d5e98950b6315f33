"""How sure estimates and errors are: jackknife, Student's t over blocks of frames and over recordings."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from clothbench.core.observation import Observation
from clothbench.core.optional import HasInterval
from clothbench.core.parameters import ParameterSpace
from clothbench.core.protocols import Metric, Score
from clothbench.core.rollout import Rollout
from clothbench.core.statistics import jackknife_half_width, student, uncut_half
from clothbench.estimation.trials import Trial, evaluate

BLOCK = 1.0  # s; a swing's errors hang together over about a period, so blocks this long count as one piece of evidence
ENOUGH = 1.6  # s of a trace from which on an error's interval is made from three blocks
MOST = 6  # blocks of a trace that an error's interval is made from: more would be surer of it than its errors allow
FEW = 3  # recordings from which on their spread says how sure their mean is
# Step of the differences for the intervals, in units of the scaled range: it looks over ripples as the search does.
PROBE = 0.03
SINGULAR = 1e10  # condition number above which the data do not determine a parameter


def intervals(trials: Sequence[Trial], space: ParameterSpace, best: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """95 % intervals (P,), (P,) of the best parameters and the condition of the scaled Jacobian.

    How far the parameters would move, to first order, if one second of one recording were left out (the jackknife over
    clusters, which is the sandwich covariance CR3 of Bell and McCaffrey 2002): neighbouring frames err alike, and a
    model's error is no noise, so the textbook's σ²(JᵀJ)⁻¹ would be far too sure. Drapes have no seconds: see
    `jackknife_of_drapes`. NaN where the metric has no residuals, or where there is nothing to leave out; the
    parameter's bounds where the data do not determine it. The others move beside what is `held_by_bounds`.
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
    drapes = any(trial.observation.outlines is not None for trial in trials)
    left_out = [changes_of_drapes(trial, best) for trial in trials] if drapes else []
    groups, left = [] if drapes else clusters(trials, scores), residual[0]

    def half_of(columns: np.ndarray) -> np.ndarray:
        return jackknife_of_drapes(left_out, columns) if drapes else jackknife(columns, left, groups)

    half = beside_held(half_of, jacobian, held_by_bounds(space, best, jacobian, left))
    return space.from_unit(unit - half), space.from_unit(unit + half), condition**0.5


def held_by_bounds(space: ParameterSpace, best: np.ndarray, jacobian: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Which parameters (P,) of a fit (P,) are marked as on a bound and would leave the range: that is where Σ r² falls,
    from the sensitivities J (R, P) in the unit cube of its residual r (R,).
    """
    outwards = np.where(space.to_unit(best) < 0.5, 1.0, -1.0) * (jacobian.T @ residual) > 0
    return np.asarray(space.at_bound(best) & outwards)


def beside_held(half_of: Callable[[np.ndarray], np.ndarray], jacobian: np.ndarray, held: np.ndarray) -> np.ndarray:
    """Half-widths (P,) that `half_of` makes of columns of J (R, P), where some parameters are `held` (P,).

    With other data these would stay where they are, so that they take nothing from the others' certainty; what the
    data themselves say of them is told as if they were not held.
    """
    half = half_of(jacobian)
    if held.any() and not held.all():
        half[~held] = half_of(jacobian[:, ~held])
    return half


def jackknife(jacobian: np.ndarray, residual: np.ndarray, groups: Sequence[np.ndarray]) -> np.ndarray:
    """Half-width (P,) of the 95 % interval from leaving out each group of rows of J (R, P) and r (R,) in turn.

    Infinite where the data do not determine a parameter, all of them or those without one of the groups: then nobody
    knows how far it would move. What is left of a group is held against all of the data, parameter by parameter.
    """
    hessian = jacobian.T @ jacobian
    rest = [hessian - jacobian[rows].T @ jacobian[rows] for rows in groups]
    moved = [
        np.linalg.lstsq(others, jacobian[rows].T @ residual[rows], rcond=1 / SINGULAR)[0]
        for rows, others in zip(groups, rest, strict=True)
    ]
    half = jackknife_half_width(np.array(moved))
    half[undetermined_by_some(hessian, rest)] = np.inf
    return half


def jackknife_of_drapes(left_out: Sequence[tuple[np.ndarray, np.ndarray]], jacobian: np.ndarray) -> np.ndarray:
    """Half-width (P,) of the 95 % interval from leaving out each specimen, and each first shape, in turn.

    left_out: of each recording what its residual changes by, see `changes_of_drapes`. Each row of a drape's residual is
    one quantity, of all captures and all simulated drapes at once, so rows are no pieces of evidence as seconds of a
    film are. Captures of one specimen are alike, hence the specimen is one; the other chance is which drape the
    simulation falls into from each of its first shapes. Both are independent, so their half-widths are added as
    squares; so are those of several recordings' specimens. First shapes are the same in all recordings, and each is
    left out of all at once. How far the parameters would move is −(JᵀJ)⁻¹Jᵀ times what the residual changes by. NaN
    where a recording has a single specimen or its simulation a single first shape, since then nobody knows what another
    would have been like.
    """
    hessian, square, start = jacobian.T @ jacobian, np.zeros(jacobian.shape[1]), 0
    shapes: list[np.ndarray] = []  # (S, P) of each recording, how far the parameters move without each first shape
    for fewer_specimens, fewer_shapes in left_out:
        if min(len(fewer_specimens), len(fewer_shapes)) < 2:
            return np.full(jacobian.shape[1], np.nan)
        count = fewer_specimens.shape[1]
        rows = jacobian[start : start + count] / np.sqrt(count * len(left_out))  # weighed as `evaluate` does
        start += count
        specimens, moved = (
            np.linalg.lstsq(hessian, rows.T @ change.T, rcond=1 / SINGULAR)[0].T
            for change in (fewer_specimens, fewer_shapes)
        )
        square += jackknife_half_width(specimens) ** 2
        shapes.append(moved)
    square += jackknife_half_width(np.sum(shapes, axis=0)) ** 2
    half = np.sqrt(square)
    half[undetermined(hessian)] = np.inf
    return half


def changes_of_drapes(trial: Trial, best: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What the residual (R,) of drapes changes by, (S, R) and (F, R): without each of S specimens, and without each of
    F first shapes; of one there is nothing to leave out, (0, R).
    """
    rollout = trial.simulation.run(best[None])
    whole = _residual(trial, trial.observation, rollout)
    specimens = [_residual(trial, seen, rollout) - whole for seen in _without_each_specimen(trial.observation)]
    shapes = [_residual(trial, trial.observation, fewer) - whole for fewer in _without_each_frame(rollout)]
    return np.reshape(specimens, (-1, len(whole))), np.reshape(shapes, (-1, len(whole)))


def _residual(trial: Trial, seen: Observation, rollout: Rollout) -> np.ndarray:
    """The residual (R,) of a rollout's first member beside what was seen."""
    residual = trial.metric(seen, rollout).residual
    assert residual is not None  # the same metric gave one for all of it
    return residual[0]


def _without_each_specimen(seen: Observation) -> Iterator[Observation]:
    outlines = seen.outlines
    assert outlines is not None
    samples = np.unique(outlines.sample)
    for sample in samples if len(samples) > 1 else ():
        rest = outlines.sample != sample
        yield dataclasses.replace(
            seen, time=seen.time[rest], position=seen.position[rest], visible=seen.visible[rest],
            confidence=None if seen.confidence is None else seen.confidence[rest],
            outlines=dataclasses.replace(outlines, radius=outlines.radius[rest], sample=outlines.sample[rest]),
        )  # fmt: skip


def _without_each_frame(rollout: Rollout) -> Iterator[Rollout]:
    """Frames of a simulated drape are where it came to rest from each of its first shapes."""
    count = rollout.position.shape[1]
    for frame in range(count) if count > 1 else ():
        rest = np.arange(count) != frame
        yield dataclasses.replace(rollout, time=rollout.time[rest], position=rollout.position[:, rest])


def undetermined_by_some(hessian: np.ndarray, rest: Sequence[np.ndarray]) -> np.ndarray:
    """Which parameters (P,) all data (P, P) say nothing about, or what is left of them without one group, `rest`: held
    against all of the data, parameter by parameter.
    """
    told = np.sqrt(np.diag(hessian))
    told[told == 0.0] = 1.0
    return np.any([undetermined(hessian), *(undetermined(others / np.outer(told, told)) for others in rest)], axis=0)


def undetermined(hessian: np.ndarray) -> np.ndarray:
    """Which parameters (P,) the data say nothing about: they take part in a direction that changes no residual."""
    if not np.isfinite(hessian).all():
        return np.ones(len(hessian), bool)
    strength, direction = np.linalg.eigh(hessian)
    nothing = direction[:, strength <= strength.max() / SINGULAR]
    return (nothing**2).sum(axis=1) > 0.01


def clusters(trials: Sequence[Trial], scores: Sequence[Score]) -> list[np.ndarray]:
    """Row numbers of the joined residual, in blocks of about `BLOCK` seconds of one recording, none of them empty."""
    out, start = [], 0
    for trial, score in zip(trials, scores, strict=True):
        assert score.residual is not None  # evaluate() joined them
        duration = trial.observation.time[-1] - trial.observation.time[0]
        rows = np.arange(start, start + score.residual.shape[1])
        out += [block for block in np.array_split(rows, max(2, round(duration / BLOCK))) if len(block)]
        start += score.residual.shape[1]
    return out


def interval_of(
    metric: Metric, score: Score, observation: Observation, rollout: Rollout, seed: int
) -> tuple[float, float]:
    """95 % interval of one recording's error, as the metric knows it (`HasInterval`), or from blocks of its frames."""
    if isinstance(metric, HasInterval):
        return metric.interval(observation, rollout, seed)
    return error_interval(score, observation)


def error_interval(score: Score, observation: Observation) -> tuple[float, float]:
    """95 % interval of one recording's error: Student's t over the means of blocks of its frames.

    Neighbouring frames err alike, blocks of about `BLOCK` seconds hardly do (batch means, Law and Kelton 2000, section
    9.5): one a second, at most `MOST`, and three of `ENOUGH` seconds or more; two of a shorter trace, of which little
    is known. Of traces of 1 to 20 s whose errors hang together over a third of a second, it covers the mean in 90 to
    94 % of cases. The interval holds the error and does not go below 0; NaN of fewer than two frames, of
    which nothing is known.
    """
    if score.per_frame is None or not np.isfinite(score.value[0]):
        return float("nan"), float("nan")
    seen = np.isfinite(score.per_frame[0])
    trace, time = score.per_frame[0][seen], observation.time[seen]
    if len(trace) < 2:
        return float("nan"), float("nan")
    seconds = float(time[-1] - time[0]) * len(trace) / (len(trace) - 1)  # with the last frame's own time
    count = min(max(round(seconds / BLOCK), 3 if seconds >= ENOUGH else 2), MOST, len(trace))
    means = np.array([block.mean() for block in np.array_split(trace, count)])
    half = student(count - 1) * means.std(ddof=1) / np.sqrt(count)
    return float(max(score.value[0] - half, 0.0)), float(score.value[0] + half)


def mean_of_split(rows: Sequence[Mapping[str, Any]]) -> dict[str, float | None]:
    """value, floor, low and high of the mean over the rows of one split, each of which has these and a value.

    None for the floor where a row has none, and for the interval of two where one has none: from three recordings on
    their spread alone says it. One recording is its own mean, with its own interval. What is handed in and what is run
    are averaged here both, so that their scores can be compared.
    """
    values, floors = [row["value"] for row in rows], [row["floor"] for row in rows]
    low = high = None
    if len(rows) == 1:
        low, high = rows[0]["low"], rows[0]["high"]
    elif len(rows) >= FEW or all(row["low"] is not None for row in rows):
        low, high = mean_interval(values, [half_width(row) for row in rows])
    floor = None if None in floors else float(np.mean(floors))
    return {"value": float(np.mean(values)), "floor": floor, "low": low, "high": high}


def half_width(row: Mapping[str, Any]) -> float:
    """Half the width of a row's interval, of the side that is not cut at 0; NaN where it has none."""
    known = row["low"] is not None and row["high"] is not None
    return uncut_half(row["value"], row["low"], row["high"]) if known else float("nan")


def mean_interval(values: Sequence[float], halves: Sequence[float]) -> tuple[float, float]:
    """95 % interval of a mean over recordings: the recording is the unit of evidence (Student's t).

    Of one or two recordings the spread says next to nothing (t = 12.7); there the recordings' own half-widths are
    joined instead, which says how sure the mean of *these* is, not of others.
    """
    sample = np.asarray(values, dtype=float)
    if len(sample) < FEW:
        half = float(np.sqrt(np.sum(np.square(halves)))) / len(sample)
    else:
        half = student(len(sample) - 1) * sample.std(ddof=1) / np.sqrt(len(sample))
    return float(max(sample.mean() - half, 0.0)), float(sample.mean() + half)
