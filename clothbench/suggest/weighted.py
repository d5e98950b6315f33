"""Fits in which each recording counts by what the model leaves of it, not each the same.

A cloth that hangs still is fitted to its noise; the same model errs by more where it swings. With the same say for both
the swing would spoil what the other told, and no further experiment could be worth anything.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from clothbench.core.observation import Observation
from clothbench.core.optional import takes_option
from clothbench.core.protocols import Metric, Score
from clothbench.core.rollout import Rollout
from clothbench.estimation.trials import Trial
from clothbench.studies.improve.problem import Problem

TOLERANCE = 1e-3  # relative gain in the sum of squares below which a search ends: it has thousands of squares


class InSigma:
    """A metric's residuals in units of what each element counts as its noise, and as much say as there are elements."""

    name: ClassVar[str] = "in_sigma"
    version: ClassVar[int] = 1
    unit = "1"

    def __init__(self, metric: Metric, counted: float):
        self.metric, self.counted = metric, counted

    def __call__(self, observation: Observation, rollout: Rollout) -> Score:
        score = self.metric(observation, rollout)
        assert score.residual is not None  # as of every metric of improve
        scale = np.sqrt(score.residual.shape[1]) / self.counted
        return Score(score.value / self.counted, self.unit, residual=score.residual * scale)

    def floor(self, observation: Observation) -> float:
        return self.metric.floor(observation) / self.counted


@dataclass(frozen=True, eq=False)
class Weighted(Problem):
    """A problem whose residuals are in σ. counted: by recording, m, what each coordinate counts as its noise."""

    counted: Mapping[str, float] = field(default_factory=dict)

    def trials(self, names: Sequence[str], split: str) -> list[Trial]:
        return [
            dataclasses.replace(trial, metric=InSigma(trial.metric, self.counted[trial.name]))
            for trial in super().trials(names, split)
        ]

    def key(self, *more: Any) -> str:
        return super().key(sorted(self.counted.items()), *more)


def weighted(problem: Problem, counted: Mapping[str, float]) -> Weighted:
    own = {f.name: getattr(problem, f.name) for f in dataclasses.fields(Problem)}
    return Weighted(**own, counted=dict(counted))


def patient(problem: Problem) -> Problem:
    """The same with searches that go on to the end, where the optimizer has a setting for that."""
    if not takes_option(problem.plugins.load("optimizers", problem.optimizer), "tolerance"):
        return problem
    own = {"tolerance": TOLERANCE, **problem.options.get(problem.optimizer, {})}
    return dataclasses.replace(problem, options={**problem.options, problem.optimizer: own})
