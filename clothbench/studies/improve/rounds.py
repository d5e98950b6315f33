"""Stages 1 to 5 in turn: calibrate, find the effect that explains what is left, add it, and go round again."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.plugins.discovery import reason_of
from clothbench.studies.improve.attribution import Probe, moved, outside, probes, ridge, share_of
from clothbench.studies.improve.budget import Budget, Stage
from clothbench.studies.improve.fitting import Fitted, better_of, elsewhere, evaluations, fit, polish, widened
from clothbench.studies.improve.guard import Shares, shares
from clothbench.studies.improve.judge import AT_THE_FLOOR, TIED, Candidate, choose, judge, needed, unphysical
from clothbench.studies.improve.problem import Problem
from clothbench.studies.improve.profile import leaped, profiled
from clothbench.studies.improve.residual import correction, noise_of, numerical_floor, repeat_spread

ALPHA = 0.05
ROUNDS = 3  # effects that can be named one after the other
AFRESH = 10  # how many candidates a later round simulates anew: those that explain most by what they changed before
REFITS, NEAR = 4, 0.3  # how many candidates are fitted in earnest in each round, and from which part of the best share
SHORT = 3.0  # how many times less than a refit gains a share to first order may promise (seen: up to twice)
# Rounds of the first fit (of all its walks together), of one that is to be ended, of one that begins where another
# ended, and of one of a single recording.
FIRST, OUT, AGAIN, ALONE = 34, 17, 8, 3
# Leaps along the valley of what was named, each followed by whole searches from where it is not worse by more than this
# share: more cost more than they give.
FARTHER, LANDED = 1, 0.5
NEARBY = 0.05  # of the scaled range: how far from a fit the mesh's error is looked at
POLISH, POLISHES = 5, 4  # and to make sure that a candidate's search has not ended early; how often at most
FINALISTS = 3  # how many are made sure of


@dataclass(frozen=True, eq=False)
class Round:
    """One turn of the loop: the fit it began with, its floor [m], the candidates with what was tried of them, and who
    was named (or tied).
    """

    before: Fitted
    floor: float
    candidates: tuple[Candidate, ...]
    probes: tuple[Probe, ...]
    named: tuple[str, ...]
    after: Fitted | None = None


@dataclass
class Outcome:
    """All that the loop found out."""

    problem: Problem
    base: Fitted
    final: Fitted
    noise: float
    floor: float
    budget: Budget
    rounds: list[Round] = field(default_factory=list)
    alone: dict[str, Fitted] = field(default_factory=dict)  # the base fitted to each recording by itself

    @property
    def stages(self) -> list[tuple[str, float, int]]:
        """(stage, s, evaluations): where the time went."""
        return self.budget.table

    @property
    def evaluations(self) -> int:
        return self.budget.evaluations


def improve(problem: Problem, candidates: Sequence[str], told: Stage) -> Outcome:
    """Run the loop on the fit recordings; what it finds is judged on the held-out ones afterwards."""
    budget = Budget(told)
    base = calibrated(problem, budget)
    noise = max(noise_of(problem), repeat_spread(problem, base))
    if not np.isfinite(base.rms):
        raise ClothbenchError(
            f"model {problem.model!r}: found no parameters with which all recordings to fit can be "
            "simulated; leave out those that it cannot do, or choose another model"
        )
    if not np.isfinite(noise):
        raise ClothbenchError(
            "noise_sigma: found NaN in recordings too short to show their noise, expected metres; "
            "state it in the recordings"
        )
    problem, base, floor = corrected(problem, base, noise, budget)
    outcome = Outcome(problem, base, base, noise, floor, budget)
    outcome.alone = each_alone(problem, base, budget)
    current = base
    for turn in range(problem.rounds or ROUNDS):
        if current.rms <= AT_THE_FLOOR * (floor if turn else noise):
            break
        rest = [c for c in candidates if c not in current.effects]
        earlier = outcome.rounds[-1].probes if outcome.rounds else ()
        found = one_round(problem, current, floor, needed(current, floor, noise), rest, earlier, budget)
        outcome.rounds.append(found)
        if found.before is not current:  # a second thought found a better fit of what there was
            current = outcome.final = found.before
            outcome.base = outcome.base if turn else current
        if found.after is None:
            break
        finer, after, doubt = corrected(problem, fitted_out(problem, found.after, budget), noise, budget)
        if found.before.rms**2 - found.after.rms**2 < needed(current, max(floor, doubt), noise):
            # The fits are near each other: how far a finer mesh changes them is known no better than the two agree.
            outcome.floor = max(floor, doubt)
            why = f"what it explains may be the mesh's doing, which with it may be wrong by {1e3 * doubt:.2g} mm"
            outcome.rounds[-1] = withdrawn(found, outcome.floor, why)
            break
        if not (why := unphysical(found.named[0], after)):
            budget.stage(f"round {turn + 1}: intervals", 0, 1)
            narrow, after, count = profiled(finer, after)
            budget.count(count)
            why = unphysical(found.named[0], narrow)
        if why:
            outcome.rounds[-1] = withdrawn(found, floor, f"{why} once the errors of mesh and model are allowed for")
            break
        problem, current, floor = finer, after, doubt
        outcome.rounds[-1] = dataclasses.replace(found, after=current)
        outcome.problem, outcome.final, outcome.floor = problem, current, floor
    budget.stop()
    return outcome


def calibrated(problem: Problem, budget: Budget) -> Fitted:
    """The base model on all fit recordings together."""
    done, planned = 0, evaluations(problem.space(()), FIRST)
    budget.stage("calibrate", 0, planned)

    def told(more: int, _: float) -> None:
        nonlocal done
        done += more
        budget.stage("calibrate", min(done, planned), planned)

    base = fit(problem, (), None, FIRST, told)
    budget.count(base.evaluations)
    return base


def each_alone(problem: Problem, base: Fitted, budget: Budget) -> dict[str, Fitted]:
    """The base fitted to each recording by itself: parameters that drift say that physics is missing."""
    out, cases = {}, problem.of_split("fit")
    for k, case in enumerate(cases):
        budget.stage("each recording alone", k, len(cases))
        out[case.name] = fit(dataclasses.replace(problem, cases=(case,)), (), base.theta, ALONE)
        budget.count(out[case.name].evaluations // len(cases))
    return out


def corrected(problem: Problem, fitted: Fitted, noise: float, budget: Budget) -> tuple[Problem, Fitted, float]:
    """The problem with the mesh's error near this fit taken away, the fit again, the floor [m] of noise and mesh."""
    budget.stage("mesh and step refined", 0, 2)
    plain = dataclasses.replace(problem, corrections={})
    changes = correction(plain, beside_fit(problem, fitted), "fit")
    budget.stage("mesh and step refined", 1, 2)
    left = numerical_floor(fitted, changes)
    if above(fitted, changes) >= above(fitted, [0 * c for c in changes]):
        # What a finer mesh changes is no step towards what was seen: the model does not converge to it, and all of the
        # change is doubt.
        return plain, widened(fitted, changes, noise), float(np.hypot(noise, 2 * left))
    names = [case.name for case in problem.of_split("fit")]
    problem = dataclasses.replace(problem, corrections=dict(zip(names, changes, strict=True)))
    again = fit(problem, fitted.effects, fitted.theta, AGAIN)
    budget.count(again.evaluations)
    return problem, widened(again, [c / 3 for c in changes], noise), float(np.hypot(noise, left))


def beside_fit(problem: Problem, fitted: Fitted) -> Fitted:
    """The fit with its base moved a little, all ways at random: where the mesh's error is looked at.

    At the fit itself the change would hold the ripples of just this coarse rollout as well; with them taken away no
    other parameters could fit as well as these, right or wrong.
    """
    shift = np.zeros(len(fitted.theta))
    base = len(problem.space(()))
    shift[:base] = NEARBY * np.random.default_rng(problem.seed).choice([-1.0, 1.0], base)
    return dataclasses.replace(fitted, theta=moved(fitted, shift))


def above(fitted: Fitted, changes: Sequence[np.ndarray]) -> float:
    """What a refit could not take up of the residual with these changes [m]."""
    total = fitted.left + np.concatenate(changes) * fitted.scale
    return float(np.linalg.norm(outside(fitted.tangent, total[:, None])))


def fitted_out(problem: Problem, named: Fitted, budget: Budget) -> Fitted:
    """The fit with what was named, continued: refits of candidates get as many rounds as a comparison needs, and what
    such a fit has not yet come to must not be taken for another effect. Leaps along its valley may end in ripples that
    only a longer search gets out of.
    """
    budget.stage(f"{named.effects[-1]} fitted out", 0, 1)
    fitted, count = better_of(problem, named, named.theta, OUT)
    budget.count(count)
    fitted, count = leaped(problem, fitted, FARTHER, AGAIN, LANDED)
    budget.count(count)
    return fitted


def one_round(
    problem: Problem,
    current: Fitted,
    floor: float,
    gain: float,
    candidates: Sequence[str],
    earlier: Sequence[Probe],
    budget: Budget,
) -> Round:
    """Screen all candidates to first order, fit the best in earnest, and name the one that stands every test.

    gain: m², by how much the mean square has to fall for a name; earlier: what was tried in the round before.
    """
    turn = len(current.effects)
    promise = gain / SHORT / current.rms**2
    anew = worth_trying(current, candidates, earlier, promise)
    found = [probe for probe in earlier if probe.effect in candidates and probe.effect not in anew]
    refused: dict[str, str] = {}
    for k, name in enumerate(anew):
        budget.stage(f"round {turn + 1}: candidates", k, len(anew))
        try:
            more, count = probes(problem, current, name)
        except Exception as fault:  # a model may have no room for it, a stranger's effect may do anything
            refused[name] = reason_of(fault)
            continue
        budget.count(count)
        found += more
    seen = shares(problem.of_split("fit"), current, found, problem.seed)
    screened = screen(candidates, found, seen, refused)
    most = max((c.share for c in screened), default=0.0)
    least = max(NEAR * most, promise)
    promising = [c for c in screened if c.name in anew and c.p_value < ALPHA and c.share >= least]
    promising = sorted(promising, key=lambda c: -c.share)[:REFITS]
    tried: list[Candidate] = []
    for k, candidate in enumerate(promising):
        budget.stage(f"round {turn + 1}: refits", k, len(promising))
        goal = min([current.rms**2 - gain / 2, *(problem.contest * c.fitted.rms**2 for c in tried if c.fitted)])
        tried.append(refit(problem, current, candidate, found, seen, goal, budget))
    tried = contest(problem, current, gain, tried, budget, turn)
    judged = judge(current, gain, tried)
    if named := choose(current, judged):
        current = second_thought(problem, current, next(c.fitted for c in judged if c.name == named[0]), gain, budget)
        judged = judge(current, gain, tried)
        named = choose(current, judged)
    others = [c for c in screened if c.name not in {t.name for t in judged}]
    after = next((c.fitted for c in judged if named and c.name == named[0]), None)
    return Round(current, floor, tuple([*judged, *others]), tuple(found), named, after)


def withdrawn(found: Round, floor: float, why: str) -> Round:
    """The round without a name, and the reason at the candidates that had been named."""
    candidates = [dataclasses.replace(c, why_not=why) if c.name in found.named else c for c in found.candidates]
    return dataclasses.replace(found, floor=floor, candidates=tuple(candidates), named=(), after=None)


def worth_trying(current: Fitted, candidates: Sequence[str], earlier: Sequence[Probe], promise: float) -> list[str]:
    """All candidates in the first round; later those that would explain most of what is left now, and not less than
    the share `promise`, by what they changed before the last effect was added, which it leaves much as it was.
    """
    if not earlier:
        return list(candidates)
    best = {name: -1.0 for name in candidates}
    for probe in earlier:
        if probe.effect in best:
            best[probe.effect] = max(best[probe.effect], share_of(current, [c.T for c in probe.columns]))
    ahead = sorted((name for name in candidates if best[name] >= promise), key=lambda name: -best[name])[:AFRESH]
    return [name for name in candidates if name in ahead]


def contest(
    problem: Problem, current: Fitted, gain: float, tried: Sequence[Candidate], budget: Budget, turn: int
) -> list[Candidate]:
    """The candidates, with those sought in other valleys and polished that may yet be named where there are several,
    each of them also from where the best has left what they share: neither a search that ended early nor a better
    valley must decide between them.
    """
    fits = [c.fitted for c in tried if c.fitted is not None]
    least = min((f.rms**2 for f in fits), default=0.0)
    most = min(current.rms**2 - gain / 2, problem.contest * least)
    within = [f for f in fits if f.rms**2 <= most]
    within = sorted(within, key=lambda f: f.rms)[:FINALISTS] if len(within) > 1 else []
    better = {}
    for k, fitted in enumerate(within):
        budget.stage(f"round {turn + 1}: contest", k, 2 * len(within))
        fitted, count = elsewhere(problem, current, fitted, AGAIN)
        budget.count(count)
        better[fitted.effects] = settled(problem, fitted, budget)
    best, shared = min(better.values(), key=lambda f: f.rms, default=current), len(current.theta)
    for k, (effects, fitted) in enumerate(better.items()):
        budget.stage(f"round {turn + 1}: contest", len(within) + k, 2 * len(within))
        if fitted is not best:
            start = np.concatenate([best.theta[:shared], fitted.theta[shared:]])
            better[effects], count = better_of(problem, fitted, start, POLISH)
            budget.count(count)
    return [
        c if c.fitted is None else dataclasses.replace(c, fitted=better.get(c.fitted.effects, c.fitted)) for c in tried
    ]


def settled(problem: Problem, fitted: Fitted, budget: Budget) -> Fitted:
    """The fit polished as long as that takes off what would decide between two candidates: the more parameters one has,
    the more often its search ends in a ripple.
    """
    for _ in range(POLISHES):
        before = fitted.rms**2
        fitted, count = polish(problem, fitted, POLISH)
        budget.count(count)
        if fitted.rms**2 > (1 - TIED) * before:
            break
    return fitted


def second_thought(problem: Problem, current: Fitted, better: Fitted | None, gain: float, budget: Budget) -> Fitted:
    """The fit without the effect again, from where the fit with it ended: a gain must not come from a better valley.
    Given up where it will not come so near that the gain falls below `gain`.
    """
    if better is None:
        return current
    start = better.theta[: len(current.theta)]
    fitted, count = better_of(problem, current, start, AGAIN, goal=better.rms**2 + gain)
    budget.count(count)
    return fitted


def screen(
    candidates: Sequence[str], found: Sequence[Probe], seen: Shares, refused: Mapping[str, str]
) -> list[Candidate]:
    """Each candidate at the best setting of its other parameters; or why it was refused."""
    out = []
    for name in candidates:
        mine = [k for k, probe in enumerate(found) if probe.effect == name]
        if not mine:
            out.append(Candidate(name, 0.0, 1.0, why_not=refused.get(name, "could not be tried")))
            continue
        best = max(mine, key=lambda k: seen.share[k])
        p_value = seen.p_value(best)
        why = "" if p_value < ALPHA else f"explains no more than chance would (p = {p_value:.2g})"
        out.append(Candidate(name, float(seen.share[best]), p_value, why_not=why))
    return out


def refit(
    problem: Problem,
    current: Fitted,
    candidate: Candidate,
    found: Sequence[Probe],
    seen: Shares,
    goal: float,
    budget: Budget,
) -> Candidate:
    """Everything fitted again with the candidate, from its best probe's first-order amount, and beyond the ripple that
    this may end in; given up where it will not come below the goal, above which it can be neither named nor tied.
    """
    mine = [k for k, probe in enumerate(found) if probe.effect == candidate.name]
    probe = found[max(mine, key=lambda k: seen.share[k])]
    fitted = fit(problem, (*current.effects, candidate.name), first_order(current, probe), AGAIN, goal=goal)
    budget.count(fitted.evaluations)
    fitted, count = leaped(problem, fitted)
    budget.count(count)
    return dataclasses.replace(candidate, fitted=fitted)


def first_order(current: Fitted, probe: Probe) -> np.ndarray:
    """Starts (S, P): the probe with the amounts that least squares gives it, with and without the base's own step
    beside it; and the probe as it was tried.
    """
    columns = np.vstack(probe.columns) * current.scale[:, None]
    found = ridge(np.hstack([columns, current.tangent]), -current.left)
    count = len(probe.amounts)
    starts = []
    nothing = np.zeros(len(current.theta))
    tried = np.ones(count) / count
    for amount, shift in ((found[:count], found[count:]), (found[:count], nothing), (tried, nothing)):
        phi = probe.phi.copy()
        phi[list(probe.amounts)] += amount * probe.steps
        starts.append(np.concatenate([moved(current, amount @ probe.shifts + shift), phi]))
    return np.array(starts)
