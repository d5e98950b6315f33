"""Stage 5, by recording: effects whose amounts differ from recording to recording, where no amount for all would do.

A grip slips in some runs, each at its own time; a camera's clock is set anew for every take; the air in the room has
moved on. An effect says which of its parameters may do that (`VariesByRecording`); they are then each recording's own,
and all others stay shared. The freedom is paid for: a screening test in which chance has the same, a share of the mean
square for every further parameter, and the verdict's own demand that next to nothing is left.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from clothbench.core.optional import varying_of
from clothbench.core.parameters import ParameterSpace
from clothbench.core.statistics import sobol
from clothbench.studies.improve.account import Account
from clothbench.studies.improve.ahead import ahead
from clothbench.studies.improve.attribution import null_point, shapes_looked_at, tangents
from clothbench.studies.improve.fitted import Fitted, jackknife_interval, with_discrepancy
from clothbench.studies.improve.fitting import fit
from clothbench.studies.improve.permutation import span_of
from clothbench.studies.improve.problem import Problem
from clothbench.studies.improve.refinement import discretisation_error, with_errors_of_mesh_and_model
from clothbench.studies.improve.refits import refit_null
from clothbench.studies.improve.selection import Candidate, allowances, at_bound, least_fall
from clothbench.studies.improve.settings import LOOP
from clothbench.studies.improve.state import Round, State

Own = Mapping[str, Fitted]  # by recording: the parameters that are its own, fitted to it alone


def with_own_amounts(
    state: State, found: Round, candidates: Sequence[str], account: Account
) -> tuple[State | None, Fitted]:
    """The state with an effect whose amounts are each recording's own, if one explains what no amount that holds for
    all recordings does; None if none does. And the fit without it: in another valley, if the way led through a better.

    found: the round in which amounts that hold for all were tried, from where the state is now.
    """
    problem, current = state.problem, found.before
    if len(current.residual) < LOOP.least_recordings or state.own:
        return None, current
    account.stage("amounts by recording", 0, 1)
    fall = least_fall(current, state.floor, state.noise)
    screened = screen(problem, current, [name for name in candidates if name not in current.effects])
    screened = with_what_is_known(screened, found.candidates)
    promising = [
        candidate
        for candidate in with_rivals(screened, fall / LOOP.first_order_optimism / current.rms**2)
        if within_reach(
            current, candidate, bar(found, size_by_recording(problem, current, candidate.name)), state.floor
        )
    ]
    if not any(within_reach(current, c, price(problem, current, c.name), state.floor) for c in promising):
        return None, current
    tried: list[Candidate] = []
    own: dict[str, Own] = {}
    for k, candidate in enumerate(promising[: LOOP.fitted_by_recording]):
        account.stage("amounts by recording", k, LOOP.fitted_by_recording)
        name = candidate.name
        beside = bar(found, size_by_recording(problem, current, name))
        goal = min(current.rms**2 - fall, price(problem, current, name), beside)
        fitted, own[name], count = fitted_by_recording(problem, current, name, goal)
        account.count(count)
        tried.append(dataclasses.replace(candidate, fitted=fitted))
    tried, named = judged(problem, found, current, tried, own, fall)
    if named:
        # What the parameters that are shared gain in another valley is not what the amounts explain.
        better = next(c.fitted for c in tried if c.name == named[0])
        null = refit_null(problem, current, better, fall, account)
        if null is not current:
            current = null
            tried, named = judged(problem, found, current, tried, own, fall)
    if not named:
        return None, current
    others = [c for c in found.candidates if c.name not in own]
    after = next(c.fitted for c in tried if c.name == named[0])
    assert after is not None  # all that were tried were fitted
    of_each = {name: own[name] for name in named}
    last = Round(current, state.floor, (*tried, *others), found.probes, named, after, own=of_each)
    mine = with_own(problem, own[named[0]])
    after = with_errors_of_mesh_and_model(mine, after, state.noise)
    base = state.base
    if current is not found.before and not state.rounds:
        base = with_errors_of_mesh_and_model(problem, current, state.noise)
    return dataclasses.replace(state, problem=mine, base=base, final=after, rounds=(*state.rounds, last)), current


def judged(
    problem: Problem, found: Round, current: Fitted, tried: Sequence[Candidate], own: Mapping[str, Own], fall: float
) -> tuple[list[Candidate], tuple[str, ...]]:
    """The candidates, as they were fitted by recording, beside the `current` fit: with what each gains and why it
    cannot stand; and which are named.
    """
    out = []
    for candidate in tried:
        fitted, amounts = candidate.fitted, own[candidate.name]
        assert fitted is not None
        gain = current.rms**2 - fitted.rms**2
        why = (
            beyond_bounds(amounts)
            or at_bound(candidate.name, fitted)
            or problem.evidence.objection(current.residual, fitted.residual)
            or too_little(found, fitted, gain, size_of(amounts), fall)
        )
        out.append(dataclasses.replace(candidate, gain=gain, why_not=why))
    return out, chosen(current, out, [size_of(own[c.name]) for c in out])


def with_what_is_known(screened: Sequence[Candidate], shared: Sequence[Candidate]) -> list[Candidate]:
    """The candidates, with the better p-value of those that beat chance with amounts for all recordings: that they are
    there is then known, and how much of them is in each recording is a question of what its numbers cost.
    """
    beaten = {c.name: c.p_value for c in shared if c.p_value < LOOP.significance}
    return [
        dataclasses.replace(c, p_value=min(c.p_value, beaten[c.name]), why_not="") if c.name in beaten else c
        for c in screened
    ]


def with_rivals(screened: Sequence[Candidate], promise: float) -> list[Candidate]:
    """Those that chance does not explain, the best first, and such as explain as much as the best of them: a shift of
    the camera and one of the grips are the same, and a name for one alone would say too much.
    """
    least = max((c.share for c in screened if not c.why_not), default=np.inf)
    rivals = [c for c in screened if not c.why_not or c.share >= (1 - LOOP.tie_margin) * least]
    return [dataclasses.replace(c, why_not="") for c in rivals if c.share >= promise]


def within_reach(current: Fitted, candidate: Candidate, goal: float, floor: float) -> bool:
    """Whether a candidate may come below the goal, by what it promises to first order; not if that is less than the
    floor, from where nobody can tell it from what is named for all recordings.
    """
    least = (1 - LOOP.first_order_optimism * candidate.share) * current.rms**2
    return bool(goal >= max(least, floor**2))


def price(problem: Problem, current: Fitted, name: str) -> float:
    """The mean square below which a fit has to come for an effect's amounts, each recording's own, to be paid for."""
    count = len(own_names(problem, name)) * len(current.residual)
    return current.rms**2 / (1 + LOOP.parameter_penalty * count)


def bar(found: Round, size: int) -> float:
    """The mean square below which a fit with so many numbers, each recording's own among them, has to come beside those
    effects that stand with amounts for all recordings; infinite where none does.
    """
    return min((below(shared, size) for shared in standing_fits(found)), default=np.inf)


def standing_fits(found: Round) -> list[Fitted]:
    """The fits of effects that stand with amounts for all recordings."""
    return [c.fitted for c in found.candidates if c.fitted is not None and not c.why_not]


def below(shared: Fitted, size: int) -> float:
    """What a fit with so many numbers has to leave less than, to be worth more than the shared one."""
    return shared.rms**2 / (1 + LOOP.parameter_penalty * max(size - len(shared.theta), 0))


def size_by_recording(problem: Problem, current: Fitted, name: str) -> int:
    """How many numbers a fit has with what is each recording's own of an effect."""
    own, all_ = len(own_names(problem, name)), len(problem.space_of(name))
    return len(current.theta) + all_ + own * (len(current.residual) - 1)


def size_of(own: Own) -> int:
    """How many numbers are each recording's own, of all recordings together."""
    return sum(len(one.theta) for one in own.values())


def own_names(problem: Problem, name: str) -> tuple[str, ...]:
    """Names of an effect's parameters that may be each recording's own, with the effect's before."""
    return tuple(f"{name}.{own}" for own in varying_of(problem.make("effects", name)))


def screen(problem: Problem, current: Fitted, names: Sequence[str]) -> list[Candidate]:
    """What each effect explains if every recording may have its own of it, beside chance; the best first.

    Each recording takes what explains most of it, at whichever setting of the effect's shape, beside a base of its own:
    so much freedom has the residual itself, and so much have the surrogates (as in `permutation_test`).
    """
    cases, spans = problem.of_split("fit"), {}
    bases = [span_of(jacobian / len(jacobian) ** 0.5) for jacobian in current.jacobian]
    for name in names:
        try:
            if not own_names(problem, name):
                continue
            settings = settings_of(problem, current, name)
        except Exception:  # a stranger's effect may do anything; the rounds before have said what is wrong with it
            continue
        if not settings[0]:  # nor has one anything to explain that cannot be simulated
            continue
        spans[name] = [[at_right_angles(base, c) for c in some] for base, some in zip(bases, settings, strict=True)]
    if not spans:
        return []
    random = np.random.default_rng(problem.seed)
    draws = [case.surrogates(residual, spread=True) for case, residual in zip(cases, current.residual, strict=True)]
    seen = [(len(r) ** -0.5 * r)[None] for r in current.residual]
    parts, left = explained(bases, spans, seen)
    share = parts.sum(axis=0)[0] / left.sum(axis=0)[0]
    maxima = []
    for first in range(0, LOOP.permutations, LOOP.permutation_batch):
        count = min(LOOP.permutation_batch, LOOP.permutations - first)
        drawn = [np.array([draw(random) for _ in range(count)]) for draw in draws]
        by_chance, chance_left = explained(bases, spans, [len(d.T) ** -0.5 * d for d in drawn])
        maxima.append((by_chance.sum(axis=0) / chance_left.sum(axis=0)[:, None]).max(axis=1))
    null = np.concatenate(maxima)
    wins = np.argmax(parts[:, 0].sum(axis=0) - parts[:, 0], axis=1)  # of each recording left out
    out = []
    for k, name in enumerate(spans):
        # Twice the value: amounts that hold for all recordings were tested before, on the same residual.
        p_value = min(1.0, 2 * (1 + (null >= share[k]).sum()) / (1 + len(null)))
        why = "" if p_value < LOOP.significance else f"explains no more than chance would (p = {p_value:.2g})"
        out.append(Candidate(name, float(share[k]), float(p_value), selected=int((wins == k).sum()), why_not=why))
    return sorted(out, key=lambda c: -c.share)


def settings_of(problem: Problem, current: Fitted, name: str) -> list[list[np.ndarray]]:
    """For each fit recording what the effect changes of it, (M, k) weighted, at each setting of its shape."""
    tangent = tangents(problem, current, name, shapes_looked_at(problem, name))
    finite = [columns for columns in tangent if all(np.isfinite(c).all() for c in columns)]
    return [[columns[r].T / columns[r].shape[1] ** 0.5 for columns in finite] for r in range(len(current.residual))]


def at_right_angles(base: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """An orthonormal basis of what the columns (M, k) span beside the base (M, P)."""
    return span_of(columns - base @ (base.T @ columns), np.square(columns).sum())


def explained(
    bases: Sequence[np.ndarray], spans: Mapping[str, list[list[np.ndarray]]], residuals: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """(R, D, E): the sum of squares of each residual (D, M) of R recordings that each of E effects explains, at its
    best setting; and (R, D) what the base leaves of it.
    """
    left = [
        np.square(r).sum(axis=1) - np.square(r @ base).sum(axis=1) for r, base in zip(residuals, bases, strict=True)
    ]
    parts = [
        [np.max([np.square(r @ span).sum(axis=1) for span in some[k]], axis=0) for some in spans.values()]
        for k, r in enumerate(residuals)
    ]
    return np.array(parts).transpose(0, 2, 1), np.array(left)


def fitted_by_recording(
    problem: Problem, current: Fitted, name: str, goal: float, known: Own | None = None
) -> tuple[Fitted, Own, int]:
    """Everything refitted with what is each recording's own: in turn that, with all that is shared held, and what is
    shared with that held, as long as it pays; and how many parameter sets that took. What is shared is given up where
    it will not come below the goal, above which the effect cannot stand.

    known: what is each recording's own in `current`, if that has the effect already.
    """
    effects = current.effects if known else (*current.effects, name)
    shared = {f"{name}.{p.name}": p.default for p in problem.space_of(name)}
    shared |= dict(zip(current.space.names, current.theta, strict=True))
    cases, count = problem.of_split("fit"), 0
    fitted, own = current, known
    for _ in range(LOOP.turns_by_recording):
        before = fitted.rms**2
        own = own_amounts(problem, effects, name, shared, cases, own)
        count += sum(one.evaluations for one in own.values()) // len(cases)
        free = with_own(problem, own)
        start = np.array([shared[n] for n in free.space(effects).names])
        fitted = fit(free, effects, start, LOOP.refit_rounds, goal=goal)
        count += fitted.evaluations
        shared |= dict(zip(fitted.space.names, fitted.theta, strict=True))
        if fitted.rms**2 > (1 - LOOP.tie_margin) * before:
            break
    assert own is not None
    return fitted, own, count


def own_amounts(
    problem: Problem, effects: tuple[str, ...], name: str, shared: Mapping[str, float], cases: Sequence[Any],
    known: Own | None = None,
) -> dict[str, Fitted]:  # fmt: skip
    """What is each recording's own, fitted to it with all that is shared held. known: from where to set out, if not
    from places spread over all that it can be.
    """
    mine, out = own_names(problem, name), {}
    held = {n: value for n, value in shared.items() if n not in mine}
    questions = []
    for case in cases:
        alone = problem.restricted(dataclasses.replace(case, split="fit"))
        alone = dataclasses.replace(
            alone, own={case.name: {**problem.own.get(case.name, {}), **held}},
            bounds={**problem.bounds, **moments_within(problem.space_of(name), name, case.last_moment)},
        )  # fmt: skip
        start = places(alone.space(effects), problem.seed) if known is None else known[case.name].theta
        questions.append((alone, effects, start, LOOP.refit_rounds))
    ahead(fit, questions)
    for case, question in zip(cases, questions, strict=True):
        fitted = fit(*question)
        out[case.name] = with_interval_over_time(fitted, problem.evidence.noise())
    return out


def moments_within(space: ParameterSpace, name: str, last: float) -> dict[str, tuple[float, float]]:
    """Bounds for the moments [s] among an effect's shapes: none after `last`, the recording's end, where steps of a
    search that are shares of the range would else lead. A recording that ends before all that the bounds allow keeps
    them: there the effect does nothing, whatever its amounts.
    """
    moments = [p for p in space if p.unit == "s" and p.null is None and p.bounds[0] < last]
    return {f"{name}.{p.name}": (p.bounds[0], min(p.bounds[1], last)) for p in moments}


def places(space: ParameterSpace, seed: int) -> np.ndarray:
    """Where the search for what is a recording's own sets out, (S, P): nothing of it, the defaults, and a spread."""
    spread = sobol(len(space), np.random.default_rng(seed), LOOP.multistart_points)
    return np.vstack([null_point(space), space.defaults, space.from_unit(spread)])


def with_interval_over_time(fitted: Fitted, noise: float) -> Fitted:
    """The fit with 95 % intervals of what one recording alone says: how far it moves when a part of its time is left
    out, and what a part of all that is left above the noise may stand for. Frames near each other hang together; parts
    as long as these hardly do. A moment is told by one of them; the others then say nothing against it.
    """
    parts = min(LOOP.parts_of_recording, len(fitted.residual[0]))  # a drape's residual is a few quantities
    residual, jacobian = (np.array_split(of[0], parts) for of in (fitted.residual, fitted.jacobian))
    low, high = jackknife_interval(fitted.space, fitted.theta, residual, jacobian, alone=True)
    return with_discrepancy(dataclasses.replace(fitted, low=low, high=high), [0 * fitted.residual[0]], noise)


def with_own(problem: Problem, own: Own) -> Problem:
    """The problem with these amounts held, each in its recording."""
    held = {
        name: {**problem.own.get(name, {}), **dict(zip(one.space.names, one.theta, strict=True))}
        for name, one in own.items()
    }
    return dataclasses.replace(problem, own={**problem.own, **held})


def on_held_out(problem: Problem, fitted: Fitted, name: str) -> tuple[Problem, dict[str, Fitted]]:
    """The problem with what is each held-out recording's own of an effect fitted to it, and that; what is shared stays
    as the fit recordings have it. Where the mesh's error is taken away from these, it is from those held out as well.
    """
    shared, cases = dict(zip(fitted.space.names, fitted.theta, strict=True)), problem.of_split("held_out")
    own = own_amounts(problem, fitted.effects, name, shared, cases)
    if cases and problem.corrections:
        changes = discretisation_error(with_own(problem.uncorrected(), own), fitted, "held_out")
        unseen = {case.name: change for case, change in zip(cases, changes, strict=True)}
        problem = dataclasses.replace(problem, corrections={**problem.corrections, **unseen})
        own = own_amounts(problem, fitted.effects, name, shared, cases, own)
    return with_own(problem, own), own


def beyond_bounds(own: Own) -> str:
    """Which amount runs to its bound in which recording, or "". Shapes may: a moment at the end is none at all."""
    for recording, fitted in own.items():
        for i, parameter in enumerate(fitted.space):
            if parameter.null is None or not fitted.at_bound[i]:
                continue
            if abs(fitted.theta[i] - parameter.null) > LOOP.away_from_null * np.ptp(parameter.bounds):
                name = parameter.name.partition(".")[2]
                return f"its {name} runs to the bound {fitted.theta[i]:.3g} in {recording}"
    return ""


def too_little(found: Round, fitted: Fitted, gain: float, more: int, fall: float) -> str:
    """Why what was fitted by recording cannot stand, or "". more: numbers that are each recording's own."""
    if gain < fall:
        return "its amounts by recording explain too little"
    if gain < LOOP.parameter_penalty * more * fitted.rms**2:
        return f"what it explains does not pay for {more} parameters"
    for shared in standing_fits(found):
        if below(shared, len(fitted.theta) + more) <= fitted.rms**2:
            return f"{shared.effects[-1]} explains as much with an amount that holds for all recordings"
    return ""


def chosen(current: Fitted, tried: Sequence[Candidate], more: Sequence[int]) -> tuple[str, ...]:
    """The one that leaves least, `more` parameters of its own paid for, and others that cannot be told from it, paid
    for or not: what one has more of may be next to nothing.
    """
    standing = [k for k, c in enumerate(tried) if not c.why_not]
    if not standing:
        return ()
    square = [np.inf if c.fitted is None else c.fitted.rms**2 for c in tried]
    cost = {k: square[k] * (1 + LOOP.parameter_penalty * more[k]) for k in standing}
    allowed, order = allowances(current, tried), sorted(standing, key=lambda k: cost[k])
    best = order[0]
    close = [k for k in order if min(cost[k] / cost[best], square[k] / square[best]) <= allowed[best, k]]
    return tuple(tried[k].name for k in close[: LOOP.tied])
