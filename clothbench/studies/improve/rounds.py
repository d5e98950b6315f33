"""One round of the loop: screen all candidates, fit the best in earnest, and name the one that stands every test."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from clothbench.plugins.discovery import reason_of
from clothbench.studies.improve.account import Account
from clothbench.studies.improve.attribution import (
    Probe,
    explained_share,
    probe_candidate,
    ridge_solution,
    shifted,
)
from clothbench.studies.improve.fitted import Fitted
from clothbench.studies.improve.fitting import better_of, fit, multistart, polish
from clothbench.studies.improve.jumps import jump_along_valley
from clothbench.studies.improve.permutation import PermutationTest, permutation_test
from clothbench.studies.improve.problem import Problem
from clothbench.studies.improve.selection import Candidate, assess, choose
from clothbench.studies.improve.settings import LOOP
from clothbench.studies.improve.state import Round


def one_round(
    problem: Problem,
    current: Fitted,
    floor: float,
    fall: float,
    candidates: Sequence[str],
    earlier: Sequence[Probe],
    account: Account,
) -> Round:
    """What came of the candidates beside the `current` fit.

    fall: base unit squared, by how much the mean square has to fall for a name; earlier: probes of the round before.
    """
    turn = len(current.effects)
    promise = fall / LOOP.first_order_optimism / current.rms**2
    anew = rescreened(current, candidates, earlier, promise)
    found = [probe for probe in earlier if probe.effect in candidates and probe.effect not in anew]
    refused: dict[str, str] = {}
    for k, name in enumerate(anew):
        account.stage(f"round {turn + 1}: candidates", k, len(anew))
        try:
            more, count = probe_candidate(problem, current, name)
        except Exception as fault:  # a model may have no room for it, a stranger's effect may do anything
            refused[name] = reason_of(fault)
            continue
        account.count(count)
        found += more
    test = permutation_test(problem.of_split("fit"), current, found, problem.seed)
    screened = screen(candidates, found, test, refused)
    tried: list[Candidate] = []
    promising = most_promising(screened, anew, promise)
    for k, candidate in enumerate(promising):
        account.stage(f"round {turn + 1}: refits", k, len(promising))
        rivals = [problem.evidence.search.contention * c.fitted.rms**2 for c in tried if c.fitted]
        goal = min([current.rms**2 - fall / 2, *rivals])
        tried.append(refit(problem, current, candidate, found, test, goal, account))
    tried = refine_finalists(problem, current, fall, tried, account, turn)
    assessed = assess(current, fall, tried)
    if named := choose(current, assessed):
        current = refit_null(problem, current, next(c.fitted for c in assessed if c.name == named[0]), fall, account)
        assessed = assess(current, fall, tried)
        named = choose(current, assessed)
    others = [c for c in screened if c.name not in {t.name for t in assessed}]
    after = next((c.fitted for c in assessed if named and c.name == named[0]), None)
    return Round(current, floor, tuple([*assessed, *others]), tuple(found), named, after)


def withdrawn(found: Round, floor: float, why: str) -> Round:
    """The round without a name, and the reason at the candidates that had been named."""
    candidates = [dataclasses.replace(c, why_not=why) if c.name in found.named else c for c in found.candidates]
    return dataclasses.replace(found, floor=floor, candidates=tuple(candidates), named=(), after=None)


def rescreened(current: Fitted, candidates: Sequence[str], earlier: Sequence[Probe], promise: float) -> list[str]:
    """All candidates in the first round; later those that would explain most of what is left now, and not less than
    the share `promise`, by what they changed before the last effect was added, which it leaves much as it was.
    """
    if not earlier:
        return list(candidates)
    best = {name: -1.0 for name in candidates}
    for probe in earlier:
        if probe.effect in best:
            best[probe.effect] = max(best[probe.effect], explained_share(current, [c.T for c in probe.columns]))
    ahead = sorted((name for name in candidates if best[name] >= promise), key=lambda name: -best[name])
    return [name for name in candidates if name in ahead[: LOOP.rescreened]]


def screen(
    candidates: Sequence[str], found: Sequence[Probe], test: PermutationTest, refused: Mapping[str, str]
) -> list[Candidate]:
    """Each candidate at the best setting of its shape parameters; or why it was refused."""
    out = []
    for name in candidates:
        if (best := best_probe(name, found, test)) is None:
            out.append(Candidate(name, 0.0, 1.0, why_not=refused.get(name, "could not be tried")))
            continue
        p_value = test.p_value(best)
        why = "" if p_value < LOOP.significance else f"explains no more than chance would (p = {p_value:.2g})"
        out.append(Candidate(name, float(test.explained[best]), p_value, why_not=why))
    return out


def best_probe(name: str, found: Sequence[Probe], test: PermutationTest) -> int | None:
    """Number of the probe of a candidate that explains most; None if it has none."""
    mine = [k for k, probe in enumerate(found) if probe.effect == name]
    return max(mine, key=lambda k: test.explained[k], default=None)


def most_promising(screened: Sequence[Candidate], anew: Sequence[str], promise: float) -> list[Candidate]:
    """Those of the candidates simulated anew that are to be fitted, the best first."""
    most = max((c.share for c in screened), default=0.0)
    least = max(LOOP.refit_share * most, promise)
    found = [c for c in screened if c.name in anew and c.p_value < LOOP.significance and c.share >= least]
    return sorted(found, key=lambda c: -c.share)[: LOOP.refitted]


def refit(
    problem: Problem,
    current: Fitted,
    candidate: Candidate,
    found: Sequence[Probe],
    test: PermutationTest,
    goal: float,
    account: Account,
) -> Candidate:
    """Everything fitted again with the candidate, from its best probe's first-order amount, and beyond the ripple that
    this may end in; given up where it will not come below the goal, above which it can be neither named nor tied.
    """
    best = best_probe(candidate.name, found, test)
    assert best is not None  # it was screened
    names = (*current.effects, candidate.name)
    fitted = fit(problem, names, first_order_starts(current, found[best]), LOOP.refit_rounds, goal=goal)
    account.count(fitted.evaluations)
    fitted, count = jump_along_valley(problem, fitted)
    account.count(count)
    return dataclasses.replace(candidate, fitted=fitted)


def first_order_starts(current: Fitted, probe: Probe) -> np.ndarray:
    """Starts (S, P): the probe with the amounts that least squares gives it, with and without the base's own step
    beside it; and the probe as it was tried.
    """
    columns = np.vstack(probe.columns) * current.weights[:, None]
    found = ridge_solution(np.hstack([columns, current.weighted_jacobian]), -current.weighted_residual)
    count = len(probe.amounts)
    starts = []
    nothing = np.zeros(len(current.theta))
    tried = np.ones(count) / count
    for amount, shift in ((found[:count], found[count:]), (found[:count], nothing), (tried, nothing)):
        phi = probe.phi.copy()
        phi[list(probe.amounts)] += amount * probe.steps
        starts.append(np.concatenate([shifted(current, amount @ probe.shifts + shift), phi]))
    return np.array(starts)


def refine_finalists(
    problem: Problem, current: Fitted, fall: float, tried: Sequence[Candidate], account: Account, turn: int
) -> list[Candidate]:
    """The candidates, with those that may yet be named sought in other valleys and polished where there are several,
    each of them also from where the best has left what they share: neither a search that ended early nor a better
    valley must decide between them.
    """
    fits = [c.fitted for c in tried if c.fitted is not None]
    least = min((f.rms**2 for f in fits), default=0.0)
    most = min(current.rms**2 - fall / 2, problem.evidence.search.contention * least)
    within = [f for f in fits if f.rms**2 <= most]
    within = sorted(within, key=lambda f: f.rms)[: LOOP.finalists] if len(within) > 1 else []
    better = {}
    for k, fitted in enumerate(within):
        account.stage(f"round {turn + 1}: contest", k, 2 * len(within))
        fitted, count = multistart(problem, current, fitted, LOOP.refit_rounds)
        account.count(count)
        better[fitted.effects] = polished(problem, fitted, account)
    best, shared = min(better.values(), key=lambda f: f.rms, default=current), len(current.theta)
    for k, (effects, fitted) in enumerate(better.items()):
        account.stage(f"round {turn + 1}: contest", len(within) + k, 2 * len(within))
        if fitted is not best:
            start = np.concatenate([best.theta[:shared], fitted.theta[shared:]])
            better[effects], count = better_of(problem, fitted, start, LOOP.polish_rounds)
            account.count(count)
    return [
        c if c.fitted is None else dataclasses.replace(c, fitted=better.get(c.fitted.effects, c.fitted)) for c in tried
    ]


def polished(problem: Problem, fitted: Fitted, account: Account) -> Fitted:
    """The fit polished as long as that takes off what would decide between two candidates: the more parameters one has,
    the more often its search ends in a ripple.
    """
    for _ in range(LOOP.polish_limit):
        before = fitted.rms**2
        fitted, count = polish(problem, fitted, LOOP.polish_rounds)
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
