"""Jumps along a bent valley of the error, out of the local minimum in which a search that crept along it stopped."""

from __future__ import annotations

import numpy as np

from clothbench.studies.improve.constrained import conditional_direction, constrained_fits
from clothbench.studies.improve.fitted import Fitted, normal_equations
from clothbench.studies.improve.fitting import better_of
from clothbench.studies.improve.problem import Problem
from clothbench.studies.improve.selection import amounts_of
from clothbench.studies.improve.settings import LOOP


def jump_along_valley(
    problem: Problem,
    fitted: Fitted,
    limit: int = LOOP.jump_limit,
    rounds: int = LOOP.jump_rounds,
    margin: float = 0.0,
) -> tuple[Fitted, int]:
    """The fit, or a better one on the other side of what its search ended in; and how many parameter sets that took.

    Each amount of the last effect is doubled, and halved, with the others fitted again; where that is better, or by
    no more than the share `margin` of the mean square is not, the search goes on from there for so many `rounds`, if it
    can still come below the fit; and so forth while it pays, `limit` times at most.
    """
    evaluations = 0
    for _ in range(limit):
        which, where = jumps(fitted)
        if not which:
            break
        trials, space = problem.trials(fitted.effects, "fit"), fitted.space
        square, found, asked = constrained_fits(trials, fitted, np.array(which), np.array(where), LOOP.jump_steps)
        evaluations += asked
        before = fitted.rms**2
        for k in np.argsort(square):
            if square[k] <= (1 + margin) * before:
                start = space.from_unit(found[k])
                fitted, count = better_of(problem, fitted, start, rounds, goal=fitted.rms**2)
                evaluations += count
        if fitted.rms**2 >= (1 - LOOP.least_gain) * before:
            break
    return fitted, evaluations


def jumps(fitted: Fitted) -> tuple[list[int], list[np.ndarray]]:
    """Which amounts of the last effect are changed, and all parameters (P,) in the unit cube where they are: the others
    go along as the tangent of the valley has it.
    """
    space, unit = fitted.space, fitted.space.to_unit(fitted.theta)
    hessian, _ = normal_equations(fitted.residual, fitted.jacobian)
    which, where = [], []
    for i in amounts_of(space, fitted.effects[-1]):
        null = space.parameters[i].null
        assert null is not None  # it is an amount
        for factor in (LOOP.jump_factor, 1 / LOOP.jump_factor):
            there = fitted.theta.copy()
            there[i] = np.clip(null + factor * (fitted.theta[i] - null), space.low[i], space.high[i])
            step = space.to_unit(there)[i] - unit[i]
            if step:
                which.append(i)
                where.append(unit + step * conditional_direction(hessian, i))
    return which, where
