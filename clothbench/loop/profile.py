"""Along bent valleys: how far an amount can go if the other parameters make up for it.

A hem twice as heavy and half as wide is nearly the same hem. Where the error has such a valley, the tangent at the fit
leaves it soon: intervals to first order end too early, and a search that creeps along it may stop in a ripple. So each
amount is set apart and the others are fitted again (profile likelihood: Venzon and Moolgavkar 1988, A method for
computing profile-likelihood-based confidence intervals), with the Jacobian that is known and learns from every step
(Broyden 1965).
"""

from __future__ import annotations

import dataclasses

import numpy as np

from clothbench.experiment.calibrate import Trial, evaluate
from clothbench.loop.fitting import GAIN, Fitted, better_of, freedom, normal_equations, solve
from clothbench.loop.judge import TIED, amounts_of
from clothbench.loop.problem import Problem

Known = tuple[np.ndarray, np.ndarray, np.ndarray]  # a point in the unit cube, the residual there, and its Jacobian

AWAY = (1.5, 3.0, 6.0, 12.0)  # times the half-width to be reported: how far each parameter is set apart, in turn
CORRECTIONS = 5  # Gauss-Newton steps of the others at each of these: too few, and a valley is taken for its wall
GLANCES = 2  # such steps where a leap lands, which is searched from if it is worth it
LEAP, LEAPS = 2.0, 4  # by which factor an amount is changed at once, and how often at most
LANDING = 1  # rounds of the search after each, where a comparison of candidates is all that it is for


def profiled(problem: Problem, fitted: Fitted) -> tuple[Fitted, Fitted, int]:
    """The fit with wider intervals of its effects' parameters where their valleys are bent, never narrower ones; the
    same with intervals to be reported; and how many parameter sets that took.

    An interval to first order is where the mean square has risen by some amount; here that is how far the parameter
    can go, along its valley, before it really has. What is reported holds every amount that leaves hardly more than the
    best, as much as tells two candidates apart that correct alike; but not "nothing", if the first interval does not.
    """
    space, unit = fitted.space, fitted.space.to_unit(fitted.theta)
    ends = np.array([space.to_unit(end) for end in (fitted.low, fitted.high)])
    hessian, _ = normal_equations(fitted.residual, fitted.jacobian)
    free = freedom(hessian, len(fitted.residual))
    first = len(problem.space(()))
    walks = [
        (i, side)
        for i in range(first, len(unit))
        for side in (0, 1)
        if 0.0 < ends[side, i] < 1.0 and ends[side, i] != unit[i] and free[i] > 0
    ]
    if not walks:
        return fitted, fitted, 0
    which, sides = np.array(walks).T
    sign = np.where(sides == 1, 1.0, -1.0)
    # Rows: the interval as it is, and the one that is reported; how far each goes, and the rise [m²] that this makes.
    reach = np.abs(ends[sides, which] - unit[which]) * np.ones((2, 1))
    hardly = 2 * TIED * fitted.rms**2
    reach[1] = np.maximum(reach[1], np.sqrt(hardly * free[which]))
    rise = reach**2 / free[which]
    direction = np.array([along(hessian, i) for i in which]) * (sign * reach[1])[:, None]
    trials, evaluations, going = problem.trials(fitted.effects, "fit"), 0, np.arange(len(walks))
    risen = np.zeros(reach.shape, bool)  # beyond where it has, an end is not looked for
    for away in AWAY:
        best, found, asked = refitted(trials, fitted, which[going], unit + away * direction[going], CORRECTIONS)
        evaluations += asked
        excess = np.maximum(best - fitted.rms**2, 1e-300)
        gone = np.abs((found - unit)[np.arange(len(going)), which[going]])
        # Between the fit and here the root of the excess is taken to rise evenly, as it does in a straight valley.
        end = np.maximum(reach[:, going], gone * np.minimum(np.sqrt(rise[:, going] / excess), 1.0))
        reach[:, going] = np.where(risen[:, going], reach[:, going], end)
        risen[:, going] |= excess >= rise[:, going]
        direction[going] = (found - unit) / away
        # Where one parameter's walk has got to without much of a rise is in the others' intervals too.
        for point in found[excess <= hardly]:
            reach[1] = np.maximum(reach[1], sign * (point - unit)[which])
        going = going[~risen[1, going]]
        if not len(going):
            break
    null = space.to_unit(np.array([np.nan if p.null is None else p.null for p in space]))[which]
    from_null = sign * (null - unit[which])  # above 0 where the walk goes towards nothing
    towards = (from_null > 0) & (reach[0] < from_null)
    reach[1] = np.where(towards & (reach[1] >= from_null), reach[0], reach[1])
    out = []
    for far in reach:
        ends[sides, which] = np.clip(unit[which] + sign * far, 0.0, 1.0)
        low, high = (space.from_unit(end) for end in ends)
        out.append(dataclasses.replace(fitted, low=low, high=high))
    return out[0], out[1], evaluations


def leaped(
    problem: Problem, fitted: Fitted, leaps: int = LEAPS, rounds: int = LANDING, worse: float = 0.0
) -> tuple[Fitted, int]:
    """The fit, or a better one on the other side of what its search ended in; and how many parameter sets that took.

    Each amount of the last effect is doubled, and halved, with the others fitted again; where that is better, or by
    no more than the share `worse` of the mean square is not, the search goes on from there for so many `rounds`, if it
    can still come below the fit; and so forth while it pays, `leaps` times at most.
    """
    evaluations = 0
    for _ in range(leaps):
        space, unit = fitted.space, fitted.space.to_unit(fitted.theta)
        hessian, _ = normal_equations(fitted.residual, fitted.jacobian)
        which, where = [], []
        for i in amounts_of(space, fitted.effects[-1]):
            null = space.parameters[i].null
            for factor in (LEAP, 1 / LEAP):
                there = fitted.theta.copy()
                there[i] = np.clip(null + factor * (fitted.theta[i] - null), space.low[i], space.high[i])
                step = space.to_unit(there)[i] - unit[i]
                if step:
                    which.append(i)
                    where.append(unit + step * along(hessian, i))
        if not which:
            break
        trials = problem.trials(fitted.effects, "fit")
        best, found, asked = refitted(trials, fitted, np.array(which), np.array(where), GLANCES)
        evaluations += asked
        before = fitted.rms**2
        for k in np.argsort(best):
            if best[k] <= (1 + worse) * before:
                start = space.from_unit(found[k])
                fitted, count = better_of(problem, fitted, start, rounds, goal=fitted.rms**2)
                evaluations += count
        if fitted.rms**2 >= (1 - GAIN) * before:
            break
    return fitted, evaluations


def refitted(
    trials: list[Trial], fitted: Fitted, which: np.ndarray, where: np.ndarray, corrections: int
) -> tuple[np.ndarray, np.ndarray, int]:
    """At each of `where` (W, P), in the unit cube, parameter `which` (W,) held and the others fitted again, by so many
    `corrections`: the mean squares (W,) m², infinite where nothing could be simulated, the points (W, P), and how many
    sets that took.
    """
    unit, count = fitted.space.to_unit(fitted.theta), len(fitted.residual)
    best, found, evaluations = np.full(len(which), np.inf), np.tile(unit, (len(which), 1)), 0
    known = [(unit, fitted.left / np.sqrt(count), fitted.tangent / np.sqrt(count))] * len(which)
    for correction in range(corrections + 1):
        where = np.clip(where, 0.0, 1.0)
        residual = evaluate(trials, fitted.space.from_unit(where))[0].residual
        assert residual is not None
        evaluations += len(where)
        square = np.sum(residual**2, axis=1)
        better = square < best  # false for what could not be simulated
        best[better], found[better] = square[better], where[better]
        if correction < corrections:
            known = [learned(*one) for one in zip(known, where, residual, strict=True)]
            where = np.array([others_fitted(*one, i) for one, i in zip(known, which, strict=True)])
    return best, found, evaluations


def along(hessian: np.ndarray, i: int) -> np.ndarray:
    """How all parameters (P,) go with parameter i, to first order, if the others stay fitted; 1 for i itself."""
    others = np.arange(len(hessian)) != i
    out = np.ones(len(hessian))
    out[others] = solve(hessian[np.ix_(others, others)], -hessian[others, i])
    return out


def learned(known: Known, where: np.ndarray, residual: np.ndarray) -> Known:
    """What is known of the residual (M,) and its Jacobian (M, P) after it was seen at one more point (P,)."""
    before, left, jacobian = known
    step = where - before
    if not (np.isfinite(residual).all() and step.any()):
        return known
    missed = residual - left - jacobian @ step
    return where, residual, jacobian + np.outer(missed, step / (step @ step))


def others_fitted(where: np.ndarray, residual: np.ndarray, jacobian: np.ndarray, i: int) -> np.ndarray:
    """One Gauss-Newton step (P,) of all parameters but i, which is held."""
    free = np.arange(len(where)) != i
    columns = jacobian[:, free]
    out = where.copy()
    out[free] += solve(columns.T @ columns, -columns.T @ residual)
    return out
