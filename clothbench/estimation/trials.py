"""Trials: recordings made ready to be compared with simulations, and the score of parameter sets on several of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.observation import Observation
from clothbench.core.optional import runs_in_threads
from clothbench.core.parallel import side_by_side
from clothbench.core.protocols import Evaluation, Metric, Score, Simulation
from clothbench.core.rollout import STATUSES, Rollout


@dataclass(frozen=True, eq=False)
class Trial:
    """One recording made ready for calibration: what was seen, and the simulation that should reproduce it."""

    name: str
    observation: Observation
    simulation: Simulation
    metric: Metric


def simulated(trial: Trial, theta: np.ndarray) -> Rollout:
    """The trial simulated with theta (B, P). A rollout of other shapes than were asked for is refused here: numpy would
    stumble over it later, or broadcast it and find a number.
    """
    rollout = trial.simulation.run(theta)
    if not isinstance(trial.observation, Observation):  # but a force-extension curve, which is compared in its own way
        return rollout
    if not isinstance(rollout, Rollout):
        raise ClothbenchError(f"the model's simulation gave {type(rollout).__name__}, expected a clothbench.Rollout")
    frames, nodes = len(trial.observation.time), len(trial.observation.material)
    found, expected = np.shape(rollout.position), (len(theta), frames, nodes, 3)
    if trial.observation.outlines is not None:  # its frames are captures, of which a simulation knows nothing
        expected = (len(theta), *found[1:3], 3)
    if found != expected:
        raise ClothbenchError(f"the model's rollout: found positions {found}, expected (B, T, N, 3) = {expected}")
    status = rollout.status
    if not (isinstance(status, tuple) and len(status) == len(theta) and set(status) <= set(STATUSES)):
        raise ClothbenchError(
            f"the model's rollout: found status {status!r}, expected {len(theta)} of {', '.join(STATUSES)}, a tuple"
        )
    return rollout


def evaluate(trials: Sequence[Trial], theta: np.ndarray) -> tuple[Evaluation, list[Score]]:
    """Score theta (B, P) on all trials together: the mean of their values, residuals side by side and in σ or m.

    Every recording has the same say, however many frames it has. Objectives are means, too, each in units of its
    spread; a member without a value has none.
    """
    scores = over(trials, lambda t: score_of(t, t.metric, simulated(t, theta)))
    value = np.mean([s.value for s in scores], axis=0)
    objectives = _objectives(scores, np.isfinite(value))
    residuals = [s.residual for s in scores if s.residual is not None]
    if len(residuals) < len(scores):
        return Evaluation(value, objectives=objectives), scores
    weighted = [r / np.sqrt(max(r.shape[1], 1) * len(scores)) for r in residuals]
    return Evaluation(value, np.concatenate(weighted, axis=1), objectives), scores


def _objectives(scores: Sequence[Score], known: np.ndarray) -> np.ndarray | None:
    """The mean over recordings of each objective in units of its spread (B, M); None where a metric has none."""
    scaled = [s.objectives / s.spread for s in scores if s.objectives is not None and s.spread is not None]
    if len(scaled) < len(scores):
        return None
    return np.where(known[:, None], np.mean(scaled, axis=0), np.nan)


def over(trials: Sequence[Trial], work: Callable[[Trial], Any]) -> list[Any]:
    """[work(trial), …], side by side if the simulations can."""
    if all(runs_in_threads(trial.simulation) for trial in trials):
        return side_by_side(work, trials)
    return [work(trial) for trial in trials]


def score_of(trial: Trial, metric: Metric, rollout: Rollout) -> Score:
    """The metric on this trial, checked."""
    return checked_score(metric(trial.observation, rollout), metric, rollout)


def checked_score(given: Score, metric: Metric, rollout: Rollout) -> Score:
    """What a metric gave, checked; a member that did not run to its end has no value, residual or objectives, whatever
    positions it left: a search by any of them would else take it for a good one.
    """
    score = _checked(given, metric, len(rollout.status))
    ok = np.array([status == "ok" for status in rollout.status])
    if ok.all():
        return score

    def kept(rows: np.ndarray | None) -> np.ndarray | None:
        return None if rows is None else np.where(ok[:, None], rows, np.nan)

    value, residual, objectives = np.where(ok, score.value, np.nan), kept(score.residual), kept(score.objectives)
    return dataclasses.replace(score, value=value, residual=residual, objectives=objectives)


def _checked(score: Score, metric: Metric, members: int) -> Score:
    """The score in double precision, refused unless it has one value, and one row of everything else, for each member,
    all real numbers, in the metric's own unit.
    """
    if not isinstance(score, Score):
        raise ClothbenchError(f"metric {metric.name!r} gave {type(score).__name__}, expected a clothbench.Score")
    if score.unit != metric.unit:
        raise ClothbenchError(
            f"metric {metric.name!r}: found a score in {score.unit!r}, expected its own {metric.unit!r}"
        )
    double: dict[str, Any] = {}
    for name, dims in (("value", 1), ("per_frame", 2), ("per_node", 2), ("residual", 2), ("objectives", 2)):
        found = getattr(score, name)
        if found is None and name != "value":
            continue
        array = np.asarray(found)
        if array.ndim != dims or len(array) != members:
            expected = f"({members},)" if dims == 1 else f"({members}, …)"
            raise ClothbenchError(f"metric {metric.name!r}: found {name} of shape {array.shape}, expected {expected}")
        if array.dtype.kind not in "fiub":
            raise ClothbenchError(f"metric {metric.name!r}: found {name} of {array.dtype}, expected real numbers")
        double[name] = array.astype(float, copy=False)
    return dataclasses.replace(score, **double)
