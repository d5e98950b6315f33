"""Jumps along a bent valley of the error, out of the local minimum in which a search that crept along it stopped."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from clothbench.studies.improve.constrained import conditional_direction, constrained_fits
from clothbench.studies.improve.fitted import Fitted, normal_equations
from clothbench.studies.improve.fitting import better_of, fit, fitted_at
from clothbench.studies.improve.problem import Problem
from clothbench.studies.improve.selection import amounts_at_bound, amounts_of
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
        square, found, asked = across(problem, fitted, np.array(which), np.array(where))
        evaluations += asked
        before = fitted.rms**2
        for k in np.argsort(square):
            if square[k] <= (1 + margin) * before:
                start = fitted.space.from_unit(found[k])
                fitted, count = better_of(problem, fitted, start, rounds, goal=fitted.rms**2)
                evaluations += count
        if fitted.rms**2 >= (1 - LOOP.least_gain) * before:
            break
    return fitted, evaluations


def in_another_valley(
    problem: Problem, fitted: Fitted, tell: Callable[[int, int], None] = lambda done, of: None
) -> tuple[Fitted, int]:
    """The fit, or a better one in another valley of the error than its search went down; and how many parameter sets
    that took. tell: how many looks of how many at most are done.

    A stiff sheet whose bending is damped much may sway nearly like a soft one, and no search leaves such a valley by
    itself. So each parameter is moved by parts of its range with the others fitted again, once by itself and once along
    the valley that it is in; a search goes on from the best of each; and so forth while it pays.
    """
    evaluations = 0
    for turn in range(LOOP.valley_turns):
        before = fitted.rms**2
        for along in (False, True):
            tell(2 * turn + along, 2 * LOOP.valley_turns)
            which, where = moved(fitted, along)
            square, found, asked = across(problem, fitted, which, where)
            evaluations += asked
            best: dict[int, int] = {}  # of each parameter's moves
            for k in np.argsort(square):
                if square[k] <= (1 + LOOP.valley_margin) * before:
                    best.setdefault(int(which[k]), int(k))
            for k in list(best.values())[: LOOP.valley_fits]:
                start = fitted.space.from_unit(found[k])
                fitted, count = better_of(problem, fitted, start, LOOP.refit_rounds, goal=fitted.rms**2)
                evaluations += count
        if fitted.rms**2 > (1 - LOOP.least_valley) * before:
            break
    return fitted, evaluations


def moved(fitted: Fitted, along: bool) -> tuple[np.ndarray, np.ndarray]:
    """Which parameter (W,) is moved, and all parameters (W, P) in the unit cube where it is: the others stay, or go
    along as the tangent of the valley has it.
    """
    unit = fitted.space.to_unit(fitted.theta)
    hessian, _ = normal_equations(fitted.residual, fitted.jacobian)
    which, where = [], []
    for i in range(len(unit)):
        way = conditional_direction(hessian, i) if along else np.eye(len(unit))[i]
        for step in LOOP.valley_moves:
            if 0.0 <= unit[i] + step <= 1.0:
                which.append(i)
                where.append(unit + step * way)
    return np.array(which), np.array(where)


def off_bounds(problem: Problem, fitted: Fitted) -> tuple[Fitted, int]:
    """The fit of an effect whose amount has run to its bound, or one that can hardly be told from it with half of that
    amount at most; and how many parameter sets that took.

    A hem twice as heavy and half as wide is nearly the same hem: that a search ends at one end of such a valley says
    nothing against the effect. What leaves more with half of the amount is driven to its bound.
    """
    bound = amounts_at_bound(fitted.effects[-1], fitted) if fitted.effects else []
    if not bound:
        return fitted, 0
    space, i = fitted.space, bound[0]
    hessian, _ = normal_equations(fitted.residual, fitted.jacobian)
    start = space.from_unit(np.clip(along_valley(fitted, hessian, i, 1 / LOOP.jump_factor), 0.0, 1.0))
    half = {space.names[i]: tuple(sorted((space.parameters[i].null, start[i])))}
    limit = (1 + LOOP.tie_margin) * fitted.rms**2
    nearer = dataclasses.replace(problem, bounds={**problem.bounds, **half})
    again = fit(nearer, fitted.effects, start, LOOP.refit_rounds, goal=limit)
    if not again.rms**2 <= limit:
        return fitted, again.evaluations
    inside = fitted_at(problem, fitted.effects, again.theta, again.evaluations)
    return inside, inside.evaluations


def across(
    problem: Problem, fitted: Fitted, which: np.ndarray, where: np.ndarray
) -> tuple[np.ndarray, np.ndarray, int]:
    """`constrained_fits` from where a parameter was moved at once, kept."""

    def computed() -> dict[str, np.ndarray]:
        trials = problem.trials(fitted.effects, "fit")
        square, found, asked = constrained_fits(trials, fitted, which, where, LOOP.jump_steps)
        return {"square": square, "found": found, "asked": np.array(asked)}

    key = problem.key("across", fitted.effects, fitted.theta.tolist(), which.tolist(), where.tolist())
    known = problem.checkpoint.once(key, computed)
    return known["square"], known["found"], int(known["asked"])


def jumps(fitted: Fitted) -> tuple[list[int], list[np.ndarray]]:
    """Which amounts of the last effect are changed, and all parameters (P,) in the unit cube where they are."""
    unit = fitted.space.to_unit(fitted.theta)
    hessian, _ = normal_equations(fitted.residual, fitted.jacobian)
    which, where = [], []
    for i in amounts_of(fitted.space, fitted.effects[-1]):
        for factor in (LOOP.jump_factor, 1 / LOOP.jump_factor):
            point = along_valley(fitted, hessian, i, factor)
            if point[i] != unit[i]:
                which.append(i)
                where.append(point)
    return which, where


def along_valley(fitted: Fitted, hessian: np.ndarray, i: int, factor: float) -> np.ndarray:
    """All parameters (P,) in the unit cube where amount i is so many times what it is, within its bounds: the others
    go along as the tangent of the valley has it.
    """
    space, unit = fitted.space, fitted.space.to_unit(fitted.theta)
    null, there = space.parameters[i].null, fitted.theta.copy()
    assert null is not None  # it is an amount
    there[i] = np.clip(null + factor * (fitted.theta[i] - null), space.low[i], space.high[i])
    step = space.to_unit(there)[i] - unit[i]
    return np.asarray(unit + step * conditional_direction(hessian, i))
