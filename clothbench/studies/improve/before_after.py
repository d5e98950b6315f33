"""Every recording with what the model made of it before the loop and after: what tables and pictures are made from."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clothbench.estimation.trials import Trial
from clothbench.studies.improve.curves import CurveCase
from clothbench.studies.improve.fitting import Fitted
from clothbench.studies.improve.problem import Case, Problem
from clothbench.studies.improve.rounds import Outcome
from clothbench.studies.improve.verdict import held_out_residuals

SPLITS = ("fit", "held_out")


@dataclass(frozen=True, eq=False)
class Seen:
    """One recording and its two rollouts.

    before, after: (T, N, 3) m, as the sensor sees them, NaN from the frame on at which a run was stopped; left_before,
    left_after: (M,) m, simulated minus seen at the M visible coordinates, the mesh's own error taken away as in the
    verdict.
    """

    case: Case
    before: np.ndarray
    after: np.ndarray
    left_before: np.ndarray
    left_after: np.ndarray


@dataclass(frozen=True, eq=False)
class Pulled:
    """One force-extension curve at its M steps of stretch: the force measured, before and after (M,) N."""

    case: Case
    stretch: np.ndarray
    force: np.ndarray
    before: np.ndarray
    after: np.ndarray


def both(outcome: Outcome, after: Fitted) -> list[Seen]:
    """All recordings of node positions before and after, those that were fitted first."""
    out: list[Seen] = []
    for split in SPLITS:
        cases = outcome.problem.of_split(split)
        if any(isinstance(case, CurveCase) for case in cases):
            return []
        first = rollouts(outcome.problem, outcome.base, split)
        last = first if after is outcome.base else rollouts(outcome.problem, after, split)
        left = left_by(outcome.problem, outcome.base, split)
        rest = left if after is outcome.base else left_by(outcome.problem, after, split)
        found = zip(cases, first, last, left, rest, strict=True)
        out += [Seen(*one) for one in found if one[0].observation.visible.any()]
    return out


def pulled(outcome: Outcome, after: Fitted) -> list[Pulled]:
    """All force-extension curves before and after, those that were fitted first."""
    out = []
    for split in SPLITS:
        cases = [case for case in outcome.problem.of_split(split) if isinstance(case, CurveCase)]
        left = [left_by(outcome.problem, fitted, split) for fitted in (outcome.base, after)] if cases else [[], []]
        for case, first, last in zip(cases, *left, strict=True):
            seen = case.observation
            stretch, force = seen.stretch[seen.visible], seen.force[seen.visible]
            out.append(Pulled(case, stretch, force, force + first, force + last))
    return out


def rollouts(problem: Problem, fitted: Fitted, split: str) -> list[np.ndarray]:
    """What the sensor would see of each recording of a split (T, N, 3) m."""
    plain = dataclasses.replace(problem, corrections={})
    trials: Sequence[Trial] = plain.trials(fitted.effects, split)
    return [trial.simulation.run(fitted.theta[None]).position[0] for trial in trials]


def left_by(problem: Problem, fitted: Fitted, split: str) -> list[np.ndarray]:
    """The residual (M,) m of each recording of a split; that of the fit recordings is known from the fit."""
    return fitted.residual if split == "fit" else held_out_residuals(problem, fitted)
