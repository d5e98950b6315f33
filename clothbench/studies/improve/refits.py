"""Stage 5: the most promising candidates fitted in earnest, so that neither a search that ended early nor a better
valley decides between them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from clothbench.core.optional import limits_of
from clothbench.estimation.trials import evaluate
from clothbench.studies.improve.account import Account
from clothbench.studies.improve.attribution import Probe, ridge_solution, shifted
from clothbench.studies.improve.fitted import Fitted, solve_damped
from clothbench.studies.improve.fitting import better_of, fit, multistart, polish
from clothbench.studies.improve.jumps import jump_along_valley, off_bounds
from clothbench.studies.improve.problem import Problem, residuals_of_fit
from clothbench.studies.improve.selection import Candidate, allowance, faulty, least_fall, parameters_of
from clothbench.studies.improve.settings import LOOP
from clothbench.studies.improve.state import Round, State


def refit(problem: Problem, names: tuple[str, ...], start: np.ndarray, goal: float) -> tuple[Fitted, int]:
    """Everything fitted again with the last of these effects, from the best of `start` (S, P), and beyond the ripple
    that it may end in; given up where it will not come below the goal, above which it can be neither named nor tied;
    and how many parameter sets that took.
    """
    tolerance = problem.evidence.search.contest_tolerance
    fitted = fit(problem, names, start, LOOP.refit_rounds, goal=goal, tolerance=tolerance)
    # However far it is from the goal: out of a wrong valley a jump may lead all the way (wind that blew the other way).
    better, count = jump_along_valley(problem, fitted)
    return better, fitted.evaluations + count


def fit_starts(effect: str, current: Fitted, probes: Sequence[Probe]) -> np.ndarray:
    """Starts (S, P) of a fit with the effect: what first order makes of each of its probes."""
    return np.vstack([first_order_starts(current, probe) for probe in probes if probe.effect == effect])


def first_order_starts(current: Fitted, probe: Probe) -> np.ndarray:
    """Starts (S, P): the probe with the amounts that least squares gives it, with and without the base's own step
    beside it; and the probe as it was tried.
    """
    columns = np.vstack(probe.columns) * current.weights[:, None]
    found = ridge_solution(np.hstack([columns, current.weighted_jacobian]), -current.weighted_residual)
    count = len(probe.amounts)
    starts = []
    nothing = np.zeros(len(current.theta))
    # A probe of an earlier round knows nothing of the effect named since, whose parameters stand behind all others.
    shifts = np.pad(probe.shifts, [(0, 0), (0, len(nothing) - probe.shifts.shape[1])])
    tried = np.ones(count) / count
    for amount, shift in ((found[:count], found[count:]), (found[:count], nothing), (tried, nothing)):
        phi = probe.phi.copy()
        phi[list(probe.amounts)] += amount * probe.steps
        starts.append(np.concatenate([shifted(current, amount @ shifts + shift), phi]))
    return np.array(starts)


def refine_finalists(
    problem: Problem,
    current: Fitted,
    floor: float,
    fall: float,
    tried: Sequence[Candidate],
    account: Account,
    turn: int,
) -> list[Candidate]:
    """The candidates, with those that may yet be named sought in other valleys and polished where there are several,
    each of them also from where the best has left what they share: neither a search that ended early nor a better
    valley must decide between them. Whoever could be named only with less than the floor stays as it is.
    """
    fits = [c.fitted for c in tried if c.fitted is not None]
    least = min((f.rms**2 for f in fits), default=0.0)
    most = min(current.rms**2 - fall / 2, problem.evidence.search.contention * least)
    within = [f for f in fits if f.rms**2 <= most]
    within = sorted(within, key=lambda f: f.rms)[: LOOP.finalists] if len(within) > 1 else []
    within = sorted(within, key=lambda f: len(f.theta))  # what the simple leave says what the others have to come to
    better: dict[tuple[str, ...], Fitted] = {}
    for k, fitted in enumerate(within):
        account.stage(f"round {turn + 1}: contest", k, 2 * len(within))
        goal = standing(problem, current, better, fitted)
        if goal >= floor**2:
            fitted, count = multistart(problem, current, fitted, LOOP.refit_rounds, goal)
            account.count(count)
            fitted = polished(problem, fitted, account, goal) if near(fitted, goal) else fitted
        better[fitted.effects] = fitted
    best, shared = min(better.values(), key=lambda f: f.rms, default=current), len(current.theta)
    for k, (effects, fitted) in enumerate(better.items()):
        account.stage(f"round {turn + 1}: contest", len(within) + k, 2 * len(within))
        goal = standing(problem, current, better, fitted)
        if fitted is not best and goal >= floor**2 and near(fitted, goal):
            start = np.concatenate([best.theta[:shared], fitted.theta[shared:]])
            tolerance = problem.evidence.search.contest_tolerance
            better[effects], count = better_of(problem, fitted, start, LOOP.polish_rounds, goal, tolerance)
            account.count(count)
    out = []
    for candidate in tried:
        if candidate.fitted is not None:
            fitted = better.get(candidate.fitted.effects, candidate.fitted)
            fitted, count = off_bounds(problem, fitted) if fitted.rms**2 <= most else (fitted, 0)
            account.count(count)
            candidate = dataclasses.replace(candidate, fitted=fitted)
        out.append(candidate)
    return out


def standing(problem: Problem, current: Fitted, better: Mapping[tuple[str, ...], Fitted], fitted: Fitted) -> float:
    """The mean square that a fit has to come to if it is to be named beside, or instead of, those that are better; any
    where searches cost so little that none is given up.

    One with two or more parameters more than another has something to say if it leaves less (`choose`). A fit that
    cannot stand itself is in nobody's way.
    """
    if not np.isfinite(problem.evidence.search.contention):
        return np.inf
    goals = [np.inf]
    for effects, other in better.items():
        if effects == fitted.effects or faulty(effects[-1], current, other, problem.evidence):
            continue
        more = len(fitted.theta) - len(other.theta)
        factor = allowance(-more, alike=True) if more < 2 else 1.0
        goals.append(float(factor) * other.rms**2)
    return min(goals)


def near(fitted: Fitted, goal: float) -> bool:
    """Whether a fit may come to the goal if nothing but the ripple that it ended in keeps it from there."""
    return fitted.rms**2 <= LOOP.polish_reach * goal


def polished(problem: Problem, fitted: Fitted, account: Account, goal: float = np.inf) -> Fitted:
    """The fit polished as long as that takes off what would decide between two candidates: the more parameters one has,
    the more often its search ends in a ripple. Searches that will not come below the goal are given up.
    """
    for _ in range(LOOP.polish_limit):
        before = fitted.rms**2
        fitted, count = polish(problem, fitted, LOOP.polish_rounds, goal)
        account.count(count)
        if fitted.rms**2 > (1 - LOOP.tie_margin) * before:
            break
    return fitted


def refit_null(problem: Problem, current: Fitted, better: Fitted | None, fall: float, account: Account) -> Fitted:
    """The fit without the effect again, from where the fit with it ended: a gain must not come from a better valley.
    Given up where it will not come so near that the gain is less than `fall`.
    """
    if better is None:
        return current
    start = better.theta[: len(current.theta)]
    fitted, count = better_of(problem, current, start, LOOP.refit_rounds, goal=better.rms**2 + fall)
    account.count(count)
    return fitted


def beside_tied(state: State, found: Round, account: Account) -> str:
    """Why what this round named is not to be named beside an effect that an earlier name is tied with, or "": what the
    wrong one of two leaves may look like a third.
    """
    problem, current, new = state.problem, state.final, found.after
    assert new is not None
    for number, earlier in enumerate(r for r in state.rounds if r.named):
        for rival in () if earlier.own else earlier.named[1:]:
            effects = (*current.effects[:number], rival, *current.effects[number + 1 :])
            known = next(c.fitted for c in earlier.candidates if c.name == rival)
            assert known is not None
            without = fit(problem, effects, starts_as(problem, effects, known, current), LOOP.refit_rounds)
            account.count(without.evaluations)
            contention = problem.evidence.search.contention
            if without.rms**2 > min(allowance(0, alike=True) * current.rms**2, contention * new.rms**2):
                continue  # it has fallen behind
            fall = least_fall(without, state.floor, state.noise)
            start = starts_as(problem, (*effects, new.effects[-1]), without, new)
            fitted = fit(problem, (*effects, new.effects[-1]), start, LOOP.refit_rounds, goal=without.rms**2 - fall)
            account.count(fitted.evaluations)
            if (gain := without.rms**2 - fitted.rms**2) < fall:
                return (
                    f"explains only {max(gain, 0) / fall:.0%} of what a name has to beside {rival}, which "
                    f"{earlier.named[0]} is tied with"
                )
    return ""


def as_a_limit(problem: Problem, fitted: Fitted, account: Account) -> str:
    """Why the last effect of a fit is not to be named, or "": what it turns into beyond its range, and models have of
    their own, does nearly as well as it (`HasLimits`), the other parameters following as the Jacobian has them.
    """
    name, unit = fitted.effects[-1], fitted.space.to_unit(fitted.theta)
    own = list(parameters_of(fitted.space, name).values())
    others = np.setdiff1d(np.arange(len(unit)), own)
    columns = fitted.weighted_jacobian[:, others] / np.sqrt(len(fitted.residual))
    trials = problem.trials(fitted.effects, "fit")
    for what, phi in limits_of(problem.make("effects", name), fitted.theta[own]).items():
        where, square = unit.copy(), np.inf
        for _ in range(LOOP.limit_steps + 1):
            theta = fitted.space.from_unit(where)
            theta[own] = phi
            residual = evaluate(trials, theta[None])[0].residual
            assert residual is not None  # as of every metric of the loop
            account.count(1)
            square = min(square, float(residual[0] @ residual[0]))
            if square <= allowance(0, alike=True) * fitted.rms**2:
                return f"cannot be told from {what}"
            if not np.isfinite(residual).all():
                break
            where[others] += solve_damped(columns.T @ columns, -columns.T @ residual[0])
    return ""


def by_chance(problem: Problem, before: Fitted, fitted: Fitted, account: Account) -> str:
    """Why the last effect of a fit is not to be named, or "": what it explains is not what simulations have in common
    that chance has begun otherwise.
    """
    found = []
    for other in problem.relaid():
        found.append(residuals_of_fit(other, fitted, "fit"))
        account.count(1)
    if not found:
        return ""
    mean = [np.mean(each, axis=0) for each in zip(*found, strict=True)]
    if not all(np.isfinite(r).all() for r in mean):
        return "cannot be simulated from other first shapes"
    why = problem.evidence.objection(before.residual, mean, LOOP.least_explained_otherwise)
    return f"does not hold from other first shapes: {why}" if why else ""


def starts_as(problem: Problem, effects: tuple[str, ...], *fits: Fitted) -> np.ndarray:
    """Starts (S, P) of a fit with these effects: each parameter as in the first of the fits that have it, and as in the
    last.
    """
    space = problem.space(effects)
    known = [dict(zip(f.space.names, f.theta, strict=True)) for f in fits]
    orders = (known, known[::-1])
    return np.array([[next(k[name] for k in order if name in k) for name in space.names] for order in orders])
