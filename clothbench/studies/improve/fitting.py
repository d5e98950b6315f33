"""Fits of the loop: from where the last one stood, all parameters free, on all fit recordings together."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from clothbench.core.optional import options_of
from clothbench.core.parameters import ParameterSpace
from clothbench.core.protocols import Evaluation, Optimizer
from clothbench.core.statistics import sobol
from clothbench.estimation.search import drive
from clothbench.estimation.trials import Trial, evaluate, over
from clothbench.studies.improve.account import Account
from clothbench.studies.improve.fitted import Fitted, jackknife_interval
from clothbench.studies.improve.problem import Problem, residuals
from clothbench.studies.improve.settings import LOOP

SAME = 1e-9  # of the scaled range, within which two sets are one: scaling back and forth rounds


@dataclass(frozen=True, eq=False)
class Trace:
    """How a search went: after each of its batches (N,) how many sets had been simulated, the least mean square among
    them, and the set (N, P) that leaves it.
    """

    count: np.ndarray
    square: np.ndarray
    theta: np.ndarray

    def until(self, batches: int) -> Trace:
        return Trace(self.count[:batches], self.square[:batches], self.theta[:batches])


def fit(
    problem: Problem,
    names: tuple[str, ...],
    start: np.ndarray | None,
    rounds: int,
    goal: float = np.inf,
    account: Account | None = None,
    unless: Fitted | None = None,
    tolerance: float = 0.0,
) -> Fitted:
    """A search from the best of `start` (S, P) or (P,), which it is never worse than, or from the defaults and a spread
    of others if None; ended after so many `rounds`, if it does not end before; and once it is plain that its mean
    square will stay above `goal`.

    account: is told how far the search is, as the stage that runs; unless: a fit of the same effects, which is returned
    with this search's evaluations if the search comes to nothing better: what is not kept needs no Jacobian; tolerance:
    relative gain below which rounds in a row end the search, if more than what suits the evidence.
    """
    trace = searched(problem, names, start, rounds, goal, search_settings(problem, start is None, tolerance), account)
    theta, count = trace.theta[-1], int(trace.count[-1])
    if start is not None and np.ndim(start) > 1 and len(start) > 1:  # which of them is best was looked at first
        count += len(start)
    if unless is not None and not trace.square[-1] < unless.rms**2:
        return dataclasses.replace(unless, evaluations=count)
    return fitted_at(problem, names, theta, count)


def searched(
    problem: Problem,
    names: tuple[str, ...],
    start: np.ndarray | None,
    rounds: int,
    goal: float,
    settings: dict[str, Any],
    account: Account | None,
) -> Trace:
    """The search of `fit`. It is kept under a key without the goal: one with a stricter goal goes the same way, and
    ends sooner.
    """
    trials = problem.trials(names, "fit")
    space = problem.bounded(trials[0].simulation.parameters)
    planned = planned_evaluations(space, rounds)
    budget = planned * problem.evidence.search.budget_factor
    given_up = partial(cannot_reach, goal, planned_evaluations(space, 1), budget)
    key = problem.key("searched", names, None if start is None else np.asarray(start).tolist(), rounds, settings)
    if (known := problem.checkpoint.recall(key)) is not None:
        trace = Trace(known["count"], known["square"], known["theta"])
        end = next((n for n in range(1, len(trace.count)) if given_up(trace.until(n))), len(trace.count))
        if end < len(trace.count) or goal <= known["goal"]:
            return trace.until(end)
    begin = space if start is None else with_defaults(space, best_start(trials, space, np.atleast_2d(start)))
    optimizer = problem.plugins.make(
        "optimizers", problem.optimizer, begin, seed=problem.seed, budget=budget, **settings
    )
    tell = None if account is None else lambda count: account.stage(account.now, min(count, planned), planned)
    trace = search(trials, optimizer, begin, tell, given_up, known=start is not None, budget=budget)
    problem.checkpoint.keep(key, goal=np.array(goal), **vars(trace))
    return trace


def fitted_at(problem: Problem, names: tuple[str, ...], theta: np.ndarray, count: int) -> Fitted:
    """The fit that ended at theta (P,) after so many sets: residual, Jacobian and intervals there, which are kept."""

    def computed() -> dict[str, np.ndarray]:
        residual, jacobian, spent = finite_differences(trials, space, theta, problem.evidence.search.difference)
        return {
            "count": np.array(spent),
            **{f"residual-{k}": r for k, r in enumerate(residual)},
            **{f"jacobian-{k}": j for k, j in enumerate(jacobian)},
        }

    trials = problem.trials(names, "fit")
    space = problem.bounded(trials[0].simulation.parameters)
    known = problem.checkpoint.once(problem.key("fitted", names, theta.tolist()), computed)
    residual, jacobian = ([known[f"{what}-{k}"] for k in range(len(trials))] for what in ("residual", "jacobian"))
    low, high = jackknife_interval(space, theta, residual, jacobian)
    return Fitted(names, space, theta, residual, jacobian, low, high, count + int(known["count"]))


def search_settings(problem: Problem, first: bool, tolerance: float = 0.0) -> dict[str, Any]:
    """What the optimizer is told beside its seed and budget: of what suits the evidence what it has a setting for, then
    the user's own options; but a search from a known point sets out from there, if the optimizer has a setting for it.
    """
    suited = problem.evidence.search
    begin = {"starts": suited.starts, "walks": suited.walks}
    again = {"starts": suited.restart_starts, "walks": suited.restart_walks}
    at_start = {"start": "defaults"}
    own = dict(problem.options.get(problem.optimizer, {}))
    known = options_of(problem.plugins.load("optimizers", problem.optimizer))
    settings: dict[str, Any] = {
        "difference": suited.difference, "tolerance": max(suited.tolerance, tolerance), "patience": suited.patience,
    }  # fmt: skip
    settings |= begin if first else at_start if known & set(at_start) else again
    return {name: value for name, value in settings.items() if name in known} | {
        name: value for name, value in own.items() if first or name not in {**again, **at_start}
    }


def planned_evaluations(space: ParameterSpace, rounds: int) -> int:
    """How many parameter sets so many rounds of least squares take: more parameters, more of them."""
    return rounds * (len(space) + LOOP.sets_per_round)


def better_of(
    problem: Problem, known: Fitted, start: np.ndarray, rounds: int, goal: float = np.inf, tolerance: float = 0.0
) -> tuple[Fitted, int]:
    """The better of a fit that is known and one more of the same effects from `start` (P,); and how many sets the
    latter took.
    """
    again = fit(problem, known.effects, start, rounds, goal=goal, unless=known, tolerance=tolerance)
    return min(known, again, key=lambda f: f.rms), again.evaluations


def polish(problem: Problem, fitted: Fitted, rounds: int, goal: float = np.inf) -> tuple[Fitted, int]:
    """The better of this fit and of one more from a good place nearby, and how many sets that took. The latter is given
    up where it will not come below the goal.

    Cloth that wrinkles leaves ripples in the error, in which a search ends early; two candidates are compared fairly
    only when neither has ended in a ripple that the other has passed.
    """
    space, looks = fitted.space, LOOP.polish_points
    unit = space.to_unit(fitted.theta)
    away = np.random.default_rng(problem.seed).normal(0.0, LOOP.polish_radius, (looks, len(unit)))
    starts = space.from_unit(unit + away)
    square = sums_of_squares(evaluate(problem.trials(fitted.effects, "fit"), starts)[0])
    if not np.isfinite(square).any():
        return fitted, looks
    nearby, tolerance = starts[int(np.argmin(square))], problem.evidence.search.contest_tolerance
    fitted, count = better_of(problem, fitted, nearby, rounds, goal, tolerance)
    return fitted, looks + count


def multistart(problem: Problem, base: Fitted, fitted: Fitted, rounds: int, goal: float = np.inf) -> tuple[Fitted, int]:
    """The fit of an effect beside the base's, or a better one from places spread over all that the effect can be; and
    how many sets that took.

    An effect with several shape parameters has several valleys (little drag in much wind, much drag in little), and
    what is left in a wrong one looks like another effect.
    """
    effect, count = problem.space_of(fitted.effects[-1]), LOOP.multistart_points
    if sum(p.null is None for p in effect) < LOOP.multistart_shapes:
        return fitted, 0
    points = sobol(len(effect), np.random.default_rng(problem.seed), count)
    starts = np.hstack([np.tile(base.theta, (count, 1)), effect.from_unit(points)])
    tolerance = problem.evidence.search.contest_tolerance
    return from_best_of(problem, fitted, starts, LOOP.multistart_fits, rounds, goal, tolerance)


def calibrated_anew(problem: Problem, fitted: Fitted) -> tuple[Fitted, int]:
    """The fit, or a better one from places spread over all that the model's own parameters can be, the effects' from
    where they are; and how many sets that took.
    """
    model, count = problem.space(()), LOOP.calibration_points
    points = sobol(len(model), np.random.default_rng(problem.seed), count)
    starts = np.hstack([model.from_unit(points), np.tile(fitted.theta[len(model) :], (count, 1))])
    return from_best_of(problem, fitted, starts, LOOP.calibration_fits, LOOP.final_rounds)


def from_best_of(
    problem: Problem,
    fitted: Fitted,
    starts: np.ndarray,
    fits: int,
    rounds: int,
    goal: float = np.inf,
    tolerance: float = 0.0,
) -> tuple[Fitted, int]:
    """The fit, or a better one from so many of `starts` (S, P), those that leave least; and how many sets that took. A
    fit is given up where it will not come below the best, and below the goal.
    """
    square, count = sums_of_squares(evaluate(problem.trials(fitted.effects, "fit"), starts)[0]), len(starts)
    for k in np.argsort(square)[:fits]:  # what could not be simulated comes last
        if np.isfinite(square[k]):
            fitted, spent = better_of(problem, fitted, starts[k], rounds, min(fitted.rms**2, goal), tolerance)
            count += spent
    return fitted, count


def cannot_reach(goal: float, pace: int, budget: int, trace: Trace) -> bool:
    """Whether a search that goes on falling as in its last rounds (`LOOP.trend_rounds`, of `pace` sets each) ends above
    the goal.
    """
    count, value = trace.count[-1], trace.square[-1]
    before = np.flatnonzero(trace.count <= count - LOOP.trend_rounds * pace)
    if not len(before) or value <= goal:
        return False
    since, higher = trace.count[before[-1]], trace.square[before[-1]]
    return bool(value - (higher - value) / (count - since) * (budget - count) > goal)


def search(
    trials: list[Trial],
    optimizer: Optimizer,
    space: ParameterSpace,
    tell: Callable[[int], None] | None = None,
    given_up: Callable[[Trace], bool] = lambda trace: False,
    known: bool = False,
    budget: int | None = None,
) -> Trace:
    """All that the optimizer asks for until it ends, its budget is spent or it is `given_up`; `tell` hears how many
    points that is so far.

    known: the space's defaults are a known point, which is simulated too where the optimizer does not begin there.
    """
    theta, square, count = space.defaults, np.inf, 0
    counts: list[int] = []
    squares, points = [], []
    trace = Trace(np.zeros(1, int), np.array([square]), theta[None])
    for asked, evaluation in drive(optimizer, space, lambda theta: evaluate(trials, theta)[0], budget):
        count += len(asked)
        squares_now = sums_of_squares(evaluation)
        best = int(np.argmin(squares_now))
        if known and not counts:
            start, at_start, more = at_defaults(trials, space, asked, evaluation)
            count += more
            if at_start < square:
                theta, square = start, at_start
        if squares_now[best] < square:
            theta, square = asked[best], float(squares_now[best])
        counts.append(count)
        squares.append(square)
        points.append(theta)
        trace = Trace(np.array(counts), np.array(squares), np.array(points))
        if tell is not None:
            tell(count)
        if given_up(trace):
            break
    return trace


def at_defaults(
    trials: list[Trial], space: ParameterSpace, asked: np.ndarray, evaluation: Evaluation
) -> tuple[np.ndarray, float, int]:
    """The space's defaults (P,), their mean square (infinite: they could not be simulated), and how many sets that
    takes beside those (B, P) that were asked: none where the defaults are among them.
    """
    away = np.abs(space.to_unit(asked) - space.to_unit(space.defaults)).max(axis=1)
    if away[row := int(np.argmin(away))] < SAME:
        return asked[row], float(sums_of_squares(evaluation)[row]), 0
    return space.defaults, float(sums_of_squares(evaluate(trials, space.defaults[None])[0])[0]), 1


def sums_of_squares(evaluation: Evaluation) -> np.ndarray:
    """(B,) of the residuals, by which fits are compared: a metric's value may be another mean over the recordings.
    Infinite where a set could not be simulated.
    """
    assert evaluation.residual is not None
    return np.where(np.isfinite(evaluation.value), np.square(evaluation.residual).sum(axis=1), np.inf)


def best_start(trials: list[Trial], space: ParameterSpace, starts: np.ndarray) -> np.ndarray:
    """The one of `starts` (S, P), kept inside the bounds, that fits best."""
    starts = np.clip(starts, space.low, space.high)
    if len(starts) == 1:
        return starts[0]
    return starts[int(np.argmin(sums_of_squares(evaluate(trials, starts)[0])))]


def with_defaults(space: ParameterSpace, start: np.ndarray) -> ParameterSpace:
    """The same space with other defaults, kept inside the bounds."""
    inside = np.clip(start, space.low, space.high)
    return ParameterSpace(tuple(dataclasses.replace(p, default=float(v)) for p, v in zip(space, inside, strict=True)))


def finite_differences(
    trials: list[Trial], space: ParameterSpace, theta: np.ndarray, step: float
) -> tuple[list[np.ndarray], list[np.ndarray], int]:
    """Residual (M,) and Jacobian (M, P) of each recording at theta, by one-sided differences in the unit cube; and how
    many sets that took.
    """
    unit = space.to_unit(theta)
    away = np.where(unit + step <= 1.0, step, -step)
    points = space.from_unit(np.vstack([unit, unit + np.diag(away)]))
    points[0] = theta
    residual, jacobian = [], []
    for found in over(trials, lambda trial: residuals(trial, points)):
        residual.append(found[0])
        jacobian.append(np.nan_to_num((found[1:] - found[0]) / away[:, None]).T)
    return residual, jacobian, len(points)
