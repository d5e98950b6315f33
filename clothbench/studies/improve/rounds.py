"""One round of the loop: screen all candidates, fit the best in earnest, and name the one that stands every test."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from clothbench.plugins.discovery import reason_of
from clothbench.studies.improve.account import Account
from clothbench.studies.improve.ahead import ahead
from clothbench.studies.improve.attribution import (
    Probe,
    explained_share,
    probe_candidate,
    shapes_looked_at,
    tangents,
)
from clothbench.studies.improve.fitted import Fitted
from clothbench.studies.improve.law import Law, told_by
from clothbench.studies.improve.permutation import PermutationTest, permutation_test
from clothbench.studies.improve.problem import Problem
from clothbench.studies.improve.refits import fit_starts, near, polished, refine_finalists, refit, refit_null
from clothbench.studies.improve.selection import Candidate, assess, choose, correction_correlation, least_fall_beside
from clothbench.studies.improve.settings import LOOP
from clothbench.studies.improve.state import Round


def one_round(
    problem: Problem,
    current: Fitted,
    floor: float,
    mesh: float,
    fall: float,
    candidates: Sequence[str],
    earlier: Sequence[Probe],
    account: Account,
) -> Round:
    """What came of the candidates beside the `current` fit.

    floor, mesh: base unit, what noise and mesh account for, and what the mesh alone may be wrong by; fall: base unit
    squared, by how much the mean square has to fall for a name; earlier: probes of the round before.
    """
    turn = len(current.effects)
    promise = fall / LOOP.first_order_optimism / current.rms**2
    anew = rescreened(current, candidates, earlier, promise)
    found = [probe for probe in earlier if probe.effect in candidates and probe.effect not in anew]
    refused: dict[str, str] = {}
    if anew:
        account.stage(f"round {turn + 1}: candidates", 0, len(anew))
    questions = [(problem, current, name) for name in anew]
    ahead(probe_candidate, questions, lambda done: account.stage(f"round {turn + 1}: candidates", done, len(anew)))
    for k, name in enumerate(anew):
        account.stage(f"round {turn + 1}: candidates", k, len(anew))
        try:
            more, count = probe_candidate(problem, current, name)
        except Exception as fault:  # a model may have no room for it, a stranger's effect may do anything
            refused[name] = reason_of(fault)
            continue
        account.count(count)
        found += more
    test = against_chance(problem, current, found)
    screened = screen(candidates, found, test, refused)
    tried: list[Candidate] = []
    promising = most_promising(screened, anew, promise)
    stage, goal = f"round {turn + 1}: refits", current.rms**2 - fall / 2
    asked = [((*current.effects, c.name), fit_starts(c.name, current, found)) for c in promising]
    # Workers wait for no rival; here what the best one leaves ends the others sooner.
    ahead(refit, [(problem, *one, goal) for one in asked], lambda done: account.stage(stage, done, len(asked)))
    for k, (candidate, one) in enumerate(zip(promising, asked, strict=True)):
        account.stage(stage, k, len(asked))
        fitted, count = refit(problem, *one, goal)
        account.count(count)
        tried.append(dataclasses.replace(candidate, fitted=fitted))
        goal = min(goal, problem.evidence.search.contention * fitted.rms**2)
    tried = refine_finalists(problem, current, floor, fall, tried, account, turn)
    assessed = assess(current, fall, tried, problem.evidence, mesh)
    if named := choose(current, assessed, mesh):
        current = refit_null(problem, current, next(c.fitted for c in assessed if c.name == named[0]), fall, account)
        assessed = assess(current, fall, tried, problem.evidence, mesh)
        named = choose(current, assessed, mesh)
    others = [c for c in screened if c.name not in {t.name for t in assessed}]
    after = next((c.fitted for c in assessed if named and c.name == named[0]), None)
    return Round(current, floor, tuple([*assessed, *others]), tuple(found), named, after)


def witnessed_round(problem: Problem, law: Law | None, found: Round, mesh: float, account: Account) -> Round:
    """The round, if nothing was named in it, with an effect whose force goes with what the torques that the recordings
    leave go with (`law`), and whatever corrects the same; without a name, but with the reason, where it does not stand.

    A model's damping takes up most of what drag does, so that little is left of it beside what the mesh may be wrong
    by; but the balance of torques knows neither. Its word for the same force is a second account of it, from other
    assumptions, and the effect has to pay for no more than its parameters. As the torques say which it is, it has to
    beat what chance gives it alone, not the best of all candidates.
    """
    before, effects = found.before, {c.name: c for c in found.candidates}
    beat_chance = [n for n, c in effects.items() if c.p_alone < LOOP.significance]
    probed = [n for n in beat_chance if any(p.effect == n for p in found.probes)]
    told = [n for n in (*before.effects, *probed) if law is not None and told_by(law, problem.make("effects", n))]
    if not told or told[0] in before.effects:
        return found
    name, turn = told[0], len(before.effects) + 1
    account.stage(f"round {turn}: {name}, told without any model", 0, 1)
    if (p_alone := at_any_shape(problem, before, name, found.probes)) >= LOOP.significance:
        return found
    fall = least_fall_beside(before, len(problem.space_of(name)))
    fitted, goal = effects[name].fitted, before.rms**2 - fall / 2
    if fitted is None:
        fitted, count = refit(problem, (*before.effects, name), fit_starts(name, before, found.probes), goal)
        account.count(count)
    fitted = polished(problem, fitted, account, goal) if near(fitted, goal) else fitted
    before = refit_null(problem, before, fitted, fall, account)
    mine = dataclasses.replace(effects[name], fitted=fitted, p_value=p_alone, why_not="")
    rivals = [c for c in found.candidates if c.fitted is not None and c.name != name]
    same = correction_correlation(before, [mine, *rivals])[0, 1:] >= LOOP.alike_correlation
    tried = [mine, *(c for c, alike in zip(rivals, same, strict=True) if alike)]
    assessed = assess(before, fall, tried, problem.evidence, mesh)
    named = choose(before, assessed, mesh)
    if name not in named:
        mine = next(c for c in assessed if c.name == name)
        why = mine.why_not or f"what it explains may be {named[0]}"
        why = f"{why}, though the recordings say the same without any model"
        effects[name] = dataclasses.replace(mine, why_not=why)
        return dataclasses.replace(found, before=before, candidates=tuple(effects.values()))
    effects |= {c.name: c for c in assessed}
    after = effects[named[0]].fitted
    return Round(before, found.floor, tuple(effects.values()), found.probes, named, after, witnessed=True)


def at_any_shape(problem: Problem, before: Fitted, name: str, probes: Sequence[Probe]) -> float:
    """p of what an effect explains alone, where chance may choose its shape as it was chosen here: its probes are those
    at the shapes that explained most, and surrogates held against these only would do worse than chance can.
    """
    settings = shapes_looked_at(problem, name)
    changes = tangents(problem, before, name, settings)
    every = [
        Probe(name, phi, amounts, steps, np.zeros((len(amounts), len(before.theta))), [c.T for c in change])
        for (phi, amounts, steps), change in zip(settings, changes, strict=True)
        if all(np.isfinite(c).all() for c in change)
    ]
    mine = [*(p for p in probes if p.effect == name), *every]
    return against_chance(problem, before, mine).p_alone(range(len(mine)))


def against_chance(problem: Problem, fitted: Fitted, found: Sequence[Probe]) -> PermutationTest:
    """The test of probes beside a fit, on the fit recordings, as suits the evidence."""
    search = problem.evidence.search
    cases = problem.of_split("fit")
    return permutation_test(cases, fitted, found, problem.seed, search.least_own, search.chance_recordings)


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
        if not (mine := [k for k, probe in enumerate(found) if probe.effect == name]):
            out.append(Candidate(name, 0.0, 1.0, why_not=refused.get(name, "could not be tried")))
            continue
        best = max(mine, key=lambda k: test.explained[k])
        p_value, p_alone = test.p_value(best), test.p_alone(mine)
        why = test.why_not(p_value)
        out.append(Candidate(name, float(test.explained[best]), p_value, why_not=why, p_alone=p_alone))
    return out


def most_promising(screened: Sequence[Candidate], anew: Sequence[str], promise: float) -> list[Candidate]:
    """Those of the candidates simulated anew that are to be fitted, the best first."""
    most = max((c.share for c in screened), default=0.0)
    least = max(LOOP.refit_share * most, promise)
    found = [c for c in screened if c.name in anew and c.p_value < LOOP.significance and c.share >= least]
    return sorted(found, key=lambda c: -c.share)[: LOOP.refitted]
