"""Fits of the loop: from where the last one stood, all parameters free, on all fit recordings together."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from scipy.stats import qmc
from scipy.stats import t as student

from clothbench.core.parameters import ParameterSpace
from clothbench.core.protocols import Optimizer
from clothbench.estimation.search import drive
from clothbench.estimation.trials import Trial, evaluate, over
from clothbench.studies.improve.problem import Problem, Told, residuals

# Step of differences, in units of the scaled range: folding cloth leaves ripples in the error, and a shorter step sees
# these rather than what a parameter does.
PROBE = 0.1
GAIN = 0.005  # of the sum of squares; ripples give as much by chance, so that two rounds with less end a search
PACES = 2  # rounds by whose fall it is judged whether a search can still come to where it matters
DAMPINGS = 4  # sets that a round of `least_squares` tries beside one for each parameter's difference
MIMIC = 0.2  # amplitude; about a hundred patterns in space and time are independent, of which a parameter makes one
SEVERAL = 2  # shape parameters that make valleys: so many places are looked at, and from so many of them it is fitted
PLACES, WALKS = 16, 2
ENOUGH = 3  # recordings that an interval takes: each is left out once
AROUND, LOOKS = 0.1, 7  # how far around a fit other starts are looked for, of the scaled range, and how many


@dataclass(frozen=True, eq=False)
class Fitted:
    """A calibrated model with some effects.

    effects: names beyond the problem's base; theta: (P,); residual: per fit recording (M,) m, simulated minus seen at
    visible coordinates; jacobian: per fit recording (M, P), by the scaled parameters; low, high: (P,), 95 %.
    """

    effects: tuple[str, ...]
    space: ParameterSpace
    theta: np.ndarray
    residual: list[np.ndarray]
    jacobian: list[np.ndarray]
    low: np.ndarray
    high: np.ndarray
    evaluations: int

    @cached_property
    def scale(self) -> np.ndarray:
        """1/√M of every row of all recordings joined, so that each recording has the same say."""
        return np.concatenate([np.full(len(r), len(r) ** -0.5) for r in self.residual])

    @cached_property
    def left(self) -> np.ndarray:
        """The residuals joined and scaled."""
        return np.concatenate(self.residual) * self.scale

    @cached_property
    def tangent(self) -> np.ndarray:
        """The Jacobians joined and scaled: what small changes of the base do."""
        return np.vstack(self.jacobian) * self.scale[:, None]

    @property
    def at_bound(self) -> np.ndarray:
        return self.space.at_bound(self.theta)

    @property
    def squares(self) -> np.ndarray:
        """Mean square of the residual of each fit recording (R,) m²."""
        return np.array([float(np.mean(r**2)) for r in self.residual])

    @property
    def rms(self) -> float:
        """m; every recording has the same say."""
        return float(np.sqrt(self.squares.mean()))


def fit(
    problem: Problem,
    names: tuple[str, ...],
    start: np.ndarray | None,
    rounds: int,
    told: Told | None = None,
    goal: float = np.inf,
) -> Fitted:
    """Least squares from the best of `start` (S, P) or (P,), or from the defaults and a spread of others if None; ended
    after so many `rounds`, if it does not end before; and once it is plain that its mean square will stay above `goal`.
    """
    starts, walks = (31, 4) if start is None else (0, 1)
    settings = {"starts": starts, "walks": walks, "difference": PROBE, "tolerance": GAIN} | problem.search
    key = problem.key("fitted", names, None if start is None else np.asarray(start).tolist(), rounds, goal, settings)
    trials = problem.trials(names, "fit")
    space = trials[0].simulation.parameters
    known = problem.memory.recall(key)
    if known is None:
        begin = space if start is None else started(space, better(trials, space, np.atleast_2d(start)))
        budget = evaluations(space, rounds) * problem.patience
        optimizer = problem.plugins.make(
            "optimizers", "least_squares", begin, seed=problem.seed, budget=budget, **settings
        )
        theta, count = search(trials, optimizer, begin, told, partial(hopeless, goal, evaluations(space, 1), budget))
        residual, jacobian, spent = differences(trials, space, theta, problem.probe or PROBE)
        known = {"theta": theta, "count": np.array(count + spent)}
        known |= {f"residual-{k}": r for k, r in enumerate(residual)}
        known |= {f"jacobian-{k}": j for k, j in enumerate(jacobian)}
        problem.memory.keep(key, **known)
    theta = known["theta"]
    residual, jacobian = ([known[f"{what}-{k}"] for k in range(len(trials))] for what in ("residual", "jacobian"))
    low, high = interval(space, theta, residual, jacobian)
    return Fitted(names, space, theta, residual, jacobian, low, high, int(known["count"]))


def evaluations(space: ParameterSpace, rounds: int) -> int:
    """How many parameter sets so many rounds of least squares take: more parameters, more of them."""
    return rounds * (len(space) + DAMPINGS)


def better_of(
    problem: Problem, known: Fitted, start: np.ndarray, rounds: int, goal: float = np.inf
) -> tuple[Fitted, int]:
    """The better of a fit that is known and one more of the same effects from `start` (P,); and how many sets the
    latter took.
    """
    again = fit(problem, known.effects, start, rounds, goal=goal)
    return min(known, again, key=lambda f: f.rms), again.evaluations


def polish(problem: Problem, fitted: Fitted, rounds: int) -> tuple[Fitted, int]:
    """The better of this fit and of one more from a good place nearby, and how many sets that took.

    Folding cloth leaves ripples in the error, in which a search ends early; two candidates are compared fairly only
    when neither has ended in a ripple that the other has passed.
    """
    space = fitted.space
    unit = space.to_unit(fitted.theta)
    away = np.random.default_rng(problem.seed).normal(0.0, AROUND, (LOOKS, len(unit)))
    starts = space.from_unit(unit + away)
    value = evaluate(problem.trials(fitted.effects, "fit"), starts)[0].value
    if not np.isfinite(value).any():
        return fitted, LOOKS
    fitted, count = better_of(problem, fitted, starts[int(np.nanargmin(value))], rounds)
    return fitted, LOOKS + count


def elsewhere(problem: Problem, base: Fitted, fitted: Fitted, rounds: int) -> tuple[Fitted, int]:
    """The fit of an effect beside the base's, or a better one from places spread over all that the effect can be; and
    how many sets that took.

    An effect with several shape parameters has several valleys (little drag in much wind, much drag in little), and
    what is left in a wrong one looks like another effect. A fit is given up where it will not come below the best.
    """
    effect = problem.plugins.make("effects", fitted.effects[-1])
    if sum(p.null is None for p in effect.parameters) < SEVERAL:
        return fitted, 0
    points = qmc.Sobol(len(effect.parameters), rng=np.random.default_rng(problem.seed)).random(PLACES)
    starts = np.hstack([np.tile(base.theta, (PLACES, 1)), effect.parameters.from_unit(points)])
    value, count = evaluate(problem.trials(fitted.effects, "fit"), starts)[0].value, PLACES
    for k in np.argsort(value)[:WALKS]:  # what could not be simulated comes last
        if np.isfinite(value[k]):
            fitted, spent = better_of(problem, fitted, starts[k], rounds, goal=fitted.rms**2)
            count += spent
    return fitted, count


Trail = list[tuple[int, float]]  # how many sets had been simulated, and the least mean square [m²] among them


def hopeless(goal: float, pace: int, budget: int, trail: Trail) -> bool:
    """Whether a search that goes on falling as in its last `PACES` rounds, of `pace` sets each, ends above the goal."""
    count, value = trail[-1]
    before = [(c, v) for c, v in trail if c <= count - PACES * pace]
    if not before or value <= goal:
        return False
    since, higher = before[-1]
    return value - (higher - value) / (count - since) * (budget - count) > goal


def search(
    trials: list[Trial],
    optimizer: Optimizer,
    space: ParameterSpace,
    told: Told | None = None,
    given_up: Callable[[Trail], bool] = lambda trail: False,
) -> tuple[np.ndarray, int]:
    """The best point that the optimizer comes to (P,), and how many it asked for."""
    theta, value, count = space.defaults, np.inf, 0
    trail: Trail = []
    for asked, evaluation in drive(optimizer, lambda theta: evaluate(trials, theta)[0]):
        count += len(asked)
        best = int(np.argmin(np.where(np.isfinite(evaluation.value), evaluation.value, np.inf)))
        assert evaluation.residual is not None
        cost = float(np.sum(evaluation.residual[best] ** 2)) if np.isfinite(evaluation.value[best]) else np.inf
        if cost < value:
            theta, value = asked[best], cost
        trail.append((count, value))
        if told is not None:
            told(len(asked), 1e3 * np.sqrt(value))
        if given_up(trail):
            break
    return theta, count


def better(trials: list[Trial], space: ParameterSpace, starts: np.ndarray) -> np.ndarray:
    """The one of `starts` (S, P), kept inside the bounds, that fits best."""
    starts = np.clip(starts, space.low, space.high)
    if len(starts) == 1:
        return starts[0]
    value = evaluate(trials, starts)[0].value
    return starts[int(np.argmin(np.where(np.isfinite(value), value, np.inf)))]


def started(space: ParameterSpace, start: np.ndarray) -> ParameterSpace:
    """The same space with other defaults, kept inside the bounds."""
    inside = np.clip(start, space.low, space.high)
    return ParameterSpace(tuple(dataclasses.replace(p, default=float(v)) for p, v in zip(space, inside, strict=True)))


def differences(
    trials: list[Trial], space: ParameterSpace, theta: np.ndarray, probe: float = PROBE
) -> tuple[list, list, int]:
    """Residual (M,) m and Jacobian (M, P) m of each recording at theta, by one-sided differences in the unit cube."""
    unit = space.to_unit(theta)
    away = np.where(unit + probe <= 1.0, probe, -probe)
    points = space.from_unit(np.vstack([unit, unit + np.diag(away)]))
    points[0] = theta
    residual, jacobian = [], []
    for found in over(trials, lambda trial: residuals(trial, points)):
        residual.append(found[0])
        jacobian.append(np.nan_to_num((found[1:] - found[0]) / away[:, None]).T)
    return residual, jacobian, len(points)


def interval(space: ParameterSpace, theta: np.ndarray, residual: list, jacobian: list) -> tuple[np.ndarray, np.ndarray]:
    """95 % intervals (P,), (P,): how far the fit moves, to first order, when one recording is left out (jackknife)."""
    whole = normal_equations(residual, jacobian)
    count = len(residual)
    unit = space.to_unit(theta)
    if count < ENOUGH:
        return np.full(len(space), np.nan), np.full(len(space), np.nan)
    parts = [normal_equations(residual[r : r + 1], jacobian[r : r + 1]) for r in range(count)]
    moved = np.array([solve(whole[0] - part[0], whole[1] - part[1]) for part in parts])
    half = student.ppf(0.975, count - 1) * np.sqrt(
        (count - 1) / count * ((moved - moved.mean(axis=0)) ** 2).sum(axis=0)
    )
    return space.from_unit(unit - half), space.from_unit(unit + half)


def widened(fitted: Fitted, doubt: list[np.ndarray], noise: float) -> Fitted:
    """The same fit with intervals that also hold what no number of recordings averages out.

    That is, to first order, what it would move by if the residual were changed by `doubt`, (M,) m for each recording,
    the error of the mesh; and if a part `MIMIC` of what is left above the noise [m], wherever it comes from, looked
    like the parameter (model discrepancy: Kennedy & O'Hagan 2001, Bayesian calibration of computer models).
    """
    hessian, gradient = normal_equations(doubt, fitted.jacobian)
    mesh = np.abs(solve(hessian, gradient))
    discrepancy = MIMIC * np.sqrt(max(fitted.rms**2 - noise**2, 0.0) * freedom(hessian, len(fitted.residual)))
    unit, low, high = (fitted.space.to_unit(t) for t in (fitted.theta, fitted.low, fitted.high))
    lower = unit - np.sqrt((unit - low) ** 2 + mesh**2 + discrepancy**2)
    upper = unit + np.sqrt((high - unit) ** 2 + mesh**2 + discrepancy**2)
    return dataclasses.replace(
        fitted, low=fitted.space.from_unit(np.maximum(lower, 0.0)), high=fitted.space.from_unit(np.minimum(upper, 1.0))
    )


def freedom(hessian: np.ndarray, recordings: int) -> np.ndarray:
    """(P,) 1/m²: the square of how far each scaled parameter can go, the others fitted again, over the rise of the mean
    square [m²] that this makes.
    """
    return recordings * np.diag(np.linalg.pinv(hessian, rcond=1e-10, hermitian=True))


def normal_equations(residual: list, jacobian: list) -> tuple[np.ndarray, np.ndarray]:
    """JᵀJ and −Jᵀr, each recording with the same say."""
    hessian = sum(j.T @ j / len(j) for j in jacobian)
    gradient = -sum(j.T @ r / len(r) for j, r in zip(jacobian, residual, strict=True))
    return hessian, gradient


def solve(hessian: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    return np.linalg.lstsq(
        hessian + 1e-10 * np.trace(hessian) / len(hessian) * np.eye(len(hessian)), gradient, rcond=None
    )[0]
