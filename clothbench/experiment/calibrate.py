"""Calibration: alternate an optimizer's questions with simulated answers, then say how sure the result is."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import t as student

from clothbench.experiment.journal import Journal
from clothbench.observation import Observation
from clothbench.parallel import side_by_side
from clothbench.parameters import ParameterSpace
from clothbench.protocols import Evaluation, Metric, Optimizer, Score, Simulation
from clothbench.rollout import Rollout

BLOCK = 1.0  # s; a swing's errors hang together over about a period, so blocks this long count as one piece of evidence
# Step of the differences for the intervals, in units of the scaled range: it looks over ripples as the search does.
PROBE = 0.03
SINGULAR = 1e10  # condition number above which the data do not determine a parameter


@dataclass(frozen=True, eq=False)
class Trial:
    """One recording made ready for calibration: what was seen, and the simulation that should reproduce it."""

    name: str
    observation: Observation
    simulation: Simulation
    metric: Metric


@dataclass(frozen=True, eq=False)
class Fit:
    """What a calibration found. P parameters, E evaluations.

    best: (P,); low, high: (P,), 95 % intervals (NaN where there are none); at_bound: (P,); theta: (E, P) and
    value: (E,), the history; condition: of the scaled Jacobian; status: ok, diverged (nothing could be simulated)
    or timeout (stopped by the clock, best so far); wall_s: s, with that of stopped runs; start: (P,), where the search
    set out from after its first look around, if it says so; looked: evaluations that this look took.
    """

    space: ParameterSpace
    best: np.ndarray
    low: np.ndarray
    high: np.ndarray
    at_bound: np.ndarray
    theta: np.ndarray
    value: np.ndarray
    condition: float
    status: str
    stopped: str
    wall_s: float
    start: np.ndarray | None = None
    looked: int = 0

    @property
    def evaluations(self) -> int:
        return len(self.value)


def evaluate(trials: Sequence[Trial], theta: np.ndarray) -> tuple[Evaluation, list[Score]]:
    """Score theta (B, P) on all trials together: the mean of their values, residuals side by side and in σ or m.

    Every recording has the same say, however many frames it has.
    """
    scores = over(trials, lambda t: score_of(t, t.metric, t.simulation.run(theta)))
    value = np.mean([s.value for s in scores], axis=0)
    residuals = [s.residual for s in scores if s.residual is not None]
    if len(residuals) < len(scores):
        return Evaluation(value), scores
    weighted = [r / np.sqrt(max(r.shape[1], 1) * len(scores)) for r in residuals]
    return Evaluation(value, np.concatenate(weighted, axis=1)), scores


def remembered(trials: Sequence[Trial], theta: np.ndarray, journal: Journal | None) -> Evaluation:
    """`evaluate`, unless the journal knows what came of it."""
    journal = journal or Journal()
    if (known := journal.recall(theta)) is not None:
        return known
    evaluation, _ = evaluate(trials, theta)
    journal.keep(theta, evaluation)
    return evaluation


def over(trials: Sequence[Trial], work: Callable[[Trial], Any]) -> list[Any]:
    """[work(trial), …], side by side if the simulations can."""
    if all(getattr(trial.simulation, "threads", False) for trial in trials):
        return side_by_side(work, trials)
    return [work(trial) for trial in trials]


def calibrate(
    trials: Sequence[Trial],
    optimizer: Optimizer,
    space: ParameterSpace,
    *,
    timeout: float | None = None,
    progress: Callable[[int, float], None] | None = None,
    journal: Journal | None = None,
    bounded: bool = True,
) -> Fit:
    """Run the search to its end (or to `timeout` seconds) on the fit recordings together.

    `progress(evaluations, best value)` is called after every batch. A member that diverges is told to the optimizer
    as NaN and spoils no other. What `journal` holds of a run that was stopped is not simulated again. Without `bounded`
    the parameters get no intervals, which cost 2 P + 1 evaluations.
    """
    journal = journal or Journal()
    thetas: list[np.ndarray] = []
    values: list[np.ndarray] = []
    stopped, looked = "", 0
    while not optimizer.done:
        theta = np.asarray(optimizer.ask(), dtype=float)
        evaluation = remembered(trials, theta, journal)
        optimizer.tell(theta, evaluation)
        thetas.append(theta)
        values.append(evaluation.value)
        if not looked and getattr(optimizer, "start", None) is not None:
            looked = sum(map(len, values))
        if progress is not None:
            progress(sum(map(len, values)), _lowest(np.concatenate(values)))
        if timeout is not None and not optimizer.done and journal.seconds > timeout:
            stopped = f"stopped after {timeout:g} s, as asked"
            break
    theta, value = np.concatenate(thetas), np.concatenate(values)
    simulated = bool(np.isfinite(value).any())
    nothing = np.full(len(space), np.nan)  # no member ran to its end: there is no best
    best = theta[int(np.argmin(np.where(np.isfinite(value), value, np.inf)))] if simulated else nothing
    low, high, condition = intervals(trials, space, best) if simulated and bounded else (nothing, nothing, np.nan)
    return Fit(
        space=space,
        best=best,
        low=low,
        high=high,
        at_bound=space.at_bound(best) if simulated else np.zeros(len(space), bool),
        theta=theta,
        value=value,
        condition=condition,
        status="diverged" if not simulated else "timeout" if stopped else "ok",
        stopped=stopped or optimizer.stopped,
        wall_s=journal.seconds,
        start=getattr(optimizer, "start", None),
        looked=looked,
    )


def score_of(trial: Trial, metric: Metric, rollout: Rollout) -> Score:
    """The metric on this trial; a member that did not run to its end has no value, whatever positions it left."""
    score = metric(trial.observation, rollout)
    ok = np.array([status == "ok" for status in rollout.status])
    return score if ok.all() else dataclasses.replace(score, value=np.where(ok, score.value, np.nan))


def _lowest(value: np.ndarray) -> float:
    finite = value[np.isfinite(value)]
    return float(finite.min()) if finite.size else float("nan")


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
    """95 % interval of one recording's error by a moving-block bootstrap over its frames (Künsch 1989)."""
    if score.per_frame is None or not np.isfinite(score.value[0]):
        return float("nan"), float("nan")
    trace = score.per_frame[0][np.isfinite(score.per_frame[0])]
    duration = observation.time[-1] - observation.time[0]
    length = int(np.clip(round(len(trace) * BLOCK / max(duration, BLOCK)), 1, max(1, len(trace) // 2)))
    random = np.random.default_rng(seed)
    starts = random.integers(0, len(trace) - length + 1, (draws, -(-len(trace) // length)))
    frames = (starts[..., None] + np.arange(length)).reshape(draws, -1)[:, : len(trace)]
    away = np.quantile(trace[frames].mean(axis=1), [0.025, 0.975]) - trace.mean()
    return float(max(score.value[0] + away[0], 0.0)), float(score.value[0] + away[1])


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


def best_rollout(trial: Trial, fit: Fit) -> Rollout:
    """The trial simulated once more with the best parameters."""
    return trial.simulation.run(fit.best[None])
