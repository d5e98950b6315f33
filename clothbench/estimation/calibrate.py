"""Calibration: an optimizer's questions answered by simulations, and how sure the result is."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clothbench.core.brief import brief
from clothbench.core.errors import ClothbenchError
from clothbench.core.optional import start_of, temperature_of
from clothbench.core.parameters import ParameterSpace
from clothbench.core.progress import Progress
from clothbench.core.protocols import Evaluation, Optimizer
from clothbench.core.rollout import Rollout
from clothbench.engine.checkpoint import Checkpoint
from clothbench.estimation.front import chosen, on_front
from clothbench.estimation.intervals import intervals
from clothbench.estimation.search import drive
from clothbench.estimation.trials import Trial, evaluate, simulated


@dataclass(frozen=True, eq=False)
class Fit:
    """What a calibration found. P parameters, E evaluations.

    best: (P,); low, high: (P,), 95 % intervals (NaN where there are none); at_bound: (P,); theta: (E, P) and value:
    (E,), the history; condition: of the scaled Jacobian; status: ok, diverged (nothing came to a number) or timeout
    (stopped by the clock, best so far); wall_s: s, with that of stopped runs, without compiling; start: (P,), where the
    search set out from after its first look around, if it says so; looked: evaluations that this look took; objectives:
    (E, M), in units of their spread, of a metric with several, or None; temperature: (E,), in the score's unit, of a
    search that cools, or None; seed: of the search, None where the caller did not say.
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
    objectives: np.ndarray | None = None
    temperature: np.ndarray | None = None
    seed: int | None = None

    __repr__ = brief

    @property
    def evaluations(self) -> int:
        return len(self.value)

    @property
    def error(self) -> float:
        """The value of the best, NaN where nothing came to a number. Another may have less: of several objectives the
        best is `chosen` on their front.
        """
        mine = (self.theta == self.best).all(axis=1) & np.isfinite(self.value)
        return float(self.value[mine][0]) if mine.any() else float("nan")

    @property
    def lost(self) -> int:
        """How many evaluations came to nothing: runs that diverged or took too long."""
        return int((~np.isfinite(self.value)).sum())

    @property
    def front(self) -> np.ndarray:
        """Numbers of the evaluations that no other is as good as in all objectives; the best's, where there is one."""
        if self.objectives is None:
            known = np.flatnonzero(np.isfinite(self.value))
            return known[np.argsort(self.value[known], kind="stable")][:1]
        return np.flatnonzero(on_front(self.objectives))


def remembered(trials: Sequence[Trial], theta: np.ndarray, checkpoint: Checkpoint | None) -> Evaluation:
    """`evaluate`, unless the checkpoint knows what came of this batch (B, P)."""
    return _remembered(trials, theta, checkpoint or Checkpoint())[0]


def _remembered(trials: Sequence[Trial], theta: np.ndarray, checkpoint: Checkpoint) -> tuple[Evaluation, float]:
    """The same, and when [s] on the checkpoint's clock the answer was there; 0 where it was kept without."""
    key = batch_key(theta)
    known = checkpoint.recall(key)
    if known is not None and "value" in known:
        found = Evaluation(known["value"], known.get("residual"), known.get("objectives"))
        return found, float(known.get("seconds", 0.0))
    evaluation, _ = evaluate(trials, theta)
    seconds = checkpoint.seconds
    more = {"residual": evaluation.residual, "objectives": evaluation.objectives}
    arrays = {name: array for name, array in more.items() if array is not None}
    checkpoint.keep(key, value=evaluation.value, seconds=np.array(seconds), **arrays)
    return evaluation, seconds


def batch_key(theta: np.ndarray) -> str:
    """24 hexadecimal digits of a batch of parameter sets."""
    return hashlib.sha256(np.ascontiguousarray(theta).tobytes()).hexdigest()[:24]


def calibrate(
    trials: Sequence[Trial],
    optimizer: Optimizer,
    space: ParameterSpace,
    *,
    timeout: float | None = None,
    progress: Progress | None = None,
    checkpoint: Checkpoint | None = None,
    bounded: bool = True,
    choice: str = "nearest",
    budget: int | None = None,
    seed: int | None = None,
) -> Fit:
    """Run the search to its end (or to `timeout` seconds) on the fit recordings together.

    `progress(evaluations, best value)` is called after every batch. A member that diverges is told to the optimizer
    as NaN and spoils no other. choice: which of the front is best, where the metric has several objectives. What
    `checkpoint` holds of a run that was stopped is not simulated again, and took as long as it took then. Without
    `bounded` the parameters get no intervals, which cost 2 P + 1 evaluations, and one more of drapes. budget: of
    evaluations, at which a search is stopped that would go on. seed: what the optimizer was made with, which it need
    not tell; the fit holds it.
    """
    checkpoint = checkpoint or Checkpoint()
    thetas: list[np.ndarray] = []
    values: list[np.ndarray] = []
    several: list[np.ndarray] = []
    warmth: list[np.ndarray] = []
    stopped, looked, given = "", 0, start_of(optimizer) is not None  # one that begins at the defaults looks at nothing
    clock = 0.0

    def answer(theta: np.ndarray) -> Evaluation:
        nonlocal clock
        if (temperature := temperature_of(optimizer)) is not None:
            warmth.append(np.full(len(theta), temperature))
        # A recalled batch tells the time of the run that simulated it: what was done in that run later, as analyses,
        # is no time of the search, which else would be stopped at another batch than it was.
        evaluation, seconds = _remembered(trials, theta, checkpoint)
        clock = max(clock, seconds)
        return evaluation

    for theta, evaluation in drive(optimizer, space, answer, budget):
        thetas.append(theta)
        values.append(evaluation.value)
        if evaluation.objectives is not None:
            several.append(evaluation.objectives)
        if not given and not looked and start_of(optimizer) is not None:
            looked = sum(map(len, values))
        if progress is not None:
            progress(sum(map(len, values)), _lowest(np.concatenate(values)))
        if timeout is not None and not optimizer.done and clock > timeout:
            stopped = f"stopped after {timeout:g} s, as asked"
            break
    if not thetas:
        raise ClothbenchError(f"optimizer {optimizer.name!r}: found it done before it asked anything, expected a batch")
    theta, value = np.concatenate(thetas), np.concatenate(values)
    beyond = "" if optimizer.done else f"stopped at its budget of {budget} evaluations; it would have gone on"
    simulated = bool(np.isfinite(value).any())
    nothing = np.full(len(space), np.nan)  # no member ran to its end: there is no best
    objectives = np.concatenate(several) if several else None
    first = chosen(value[:, None] if objectives is None else objectives, value, choice)
    best = theta[first] if simulated else nothing
    since = checkpoint.seconds
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
        stopped=stopped or beyond or optimizer.stopped,
        wall_s=clock + checkpoint.seconds - since,
        start=start_of(optimizer),
        looked=looked,
        objectives=objectives,
        temperature=np.concatenate(warmth) if warmth else None,
        seed=seed,
    )


def _lowest(value: np.ndarray) -> float:
    finite = value[np.isfinite(value)]
    return float(finite.min()) if finite.size else float("nan")


def best_rollout(trial: Trial, fit: Fit) -> Rollout:
    """The trial simulated once more with the best parameters."""
    return simulated(trial, fit.best[None])
