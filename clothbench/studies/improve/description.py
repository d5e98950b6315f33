"""Stage 7: what no effect has a name for is described: the law of the missing force, put into the model and judged."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from clothbench.studies.improve.account import Account
from clothbench.studies.improve.described import NAME, Described
from clothbench.studies.improve.finding import Description
from clothbench.studies.improve.fitted import Fitted
from clothbench.studies.improve.fitting import better_of, fit
from clothbench.studies.improve.held_out import held_out_errors
from clothbench.studies.improve.law import Law
from clothbench.studies.improve.problem import Problem
from clothbench.studies.improve.selection import amounts_of, away_from_null
from clothbench.studies.improve.settings import LOOP
from clothbench.studies.improve.verdict import pooled


def description_of(
    problem: Problem, law: Law, base: Fitted, before: Sequence[float], account: Account
) -> Description | None:
    """The law of what the calibrated model leaves, if in the model each of its forces is something, too, and the model
    does better with it on recordings held out than by as long a search without it; None where there are none, since
    more parameters always leave less of what they are fitted to. before: errors of the base on those held out.
    """
    if not before:
        return None
    account.stage("missing force described", 0, 1)
    effect = Described(law)
    problem = dataclasses.replace(problem, made={NAME: effect})
    start = np.concatenate([base.theta, [effect.start[slot] for slot in sorted(effect.start)]])
    fitted = fit(problem, (NAME,), start, LOOP.refit_rounds)
    account.count(fitted.evaluations)
    if not away_from_null(fitted, amounts_of(fitted.space, NAME)).all():
        return None
    alone, count = better_of(problem, base, fitted.theta[: len(base.theta)], LOOP.refit_rounds)
    account.count(count)
    was, now = pooled(before), pooled(held_out_errors(problem, fitted))
    without = was if alone is base else pooled(held_out_errors(problem, alone))
    if was is None or now is None or now >= min(was, was if without is None else without):
        return None
    return Description(law, was, now)
