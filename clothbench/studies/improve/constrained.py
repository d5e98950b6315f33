"""Fits with one parameter held: what profile likelihoods and jumps along a valley are made of.

The others follow by Gauss-Newton steps with the Jacobian that is known, which learns from every step (Broyden 1965).
"""

from __future__ import annotations

import numpy as np

from clothbench.estimation.trials import Trial, evaluate
from clothbench.studies.improve.fitted import Fitted, solve_damped

Known = tuple[np.ndarray, np.ndarray, np.ndarray]  # a point in the unit cube, the residual there, and its Jacobian


def constrained_fits(
    trials: list[Trial], fitted: Fitted, which: np.ndarray, where: np.ndarray, steps: int
) -> tuple[np.ndarray, np.ndarray, int]:
    """At each of `where` (W, P), in the unit cube, parameter `which` (W,) held and the others fitted again, by so many
    `steps`: the mean squares (W,), infinite where nothing could be simulated, the points (W, P), and how many sets that
    took.
    """
    unit, count = fitted.space.to_unit(fitted.theta), len(fitted.residual)
    best, found, evaluations = np.full(len(which), np.inf), np.tile(unit, (len(which), 1)), 0
    start = (unit, fitted.weighted_residual / np.sqrt(count), fitted.weighted_jacobian / np.sqrt(count))
    known = [start] * len(which)
    for step in range(steps + 1):
        where = np.clip(where, 0.0, 1.0)
        residual = evaluate(trials, fitted.space.from_unit(where))[0].residual
        assert residual is not None
        evaluations += len(where)
        square = np.sum(residual**2, axis=1)
        better = square < best  # false for what could not be simulated
        best[better], found[better] = square[better], where[better]
        if step < steps:
            known = [broyden_update(*one) for one in zip(known, where, residual, strict=True)]
            where = np.array([constrained_step(*one, i) for one, i in zip(known, which, strict=True)])
    return best, found, evaluations


def conditional_direction(hessian: np.ndarray, i: int) -> np.ndarray:
    """How all parameters (P,) go with parameter i, to first order, if the others stay fitted; 1 for i itself."""
    others = np.arange(len(hessian)) != i
    out = np.ones(len(hessian))
    out[others] = solve_damped(hessian[np.ix_(others, others)], -hessian[others, i])
    return out


def broyden_update(known: Known, where: np.ndarray, residual: np.ndarray) -> Known:
    """What is known of the residual (M,) and its Jacobian (M, P) after it was seen at one more point (P,)."""
    before, expected, jacobian = known
    step = where - before
    if not (np.isfinite(residual).all() and step.any()):
        return known
    missed = residual - expected - jacobian @ step
    return where, residual, jacobian + np.outer(missed, step / (step @ step))


def constrained_step(where: np.ndarray, residual: np.ndarray, jacobian: np.ndarray, i: int) -> np.ndarray:
    """One Gauss-Newton step (P,) of all parameters but i, which is held."""
    free = np.arange(len(where)) != i
    columns = jacobian[:, free]
    out = where.copy()
    out[free] += solve_damped(columns.T @ columns, -columns.T @ residual)
    return out
