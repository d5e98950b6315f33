"""The loop: calibrate, find the effect that explains what is left, add it, go round again; then one look at the
recordings held out. It ends in a `Finding`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import partial

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.optional import family_of
from clothbench.core.progress import StageProgress
from clothbench.studies.improve.account import Account
from clothbench.studies.improve.ahead import ahead
from clothbench.studies.improve.by_recording import (
    fitted_by_recording,
    on_held_out,
    size_of,
    with_own,
    with_own_amounts,
)
from clothbench.studies.improve.candidates import place_of
from clothbench.studies.improve.description import description_of
from clothbench.studies.improve.finding import Finding, Note
from clothbench.studies.improve.fitted import Fitted
from clothbench.studies.improve.fitting import better_of, calibrated_anew, fit, planned_evaluations
from clothbench.studies.improve.held_out import comparisons_of, held_out_errors, placebo_of
from clothbench.studies.improve.jumps import in_another_valley, jump_along_valley, off_bounds
from clothbench.studies.improve.problem import Problem
from clothbench.studies.improve.profile import profile_intervals
from clothbench.studies.improve.refinement import corrected, with_errors_of_mesh_and_model
from clothbench.studies.improve.refits import as_a_limit, beside_tied, by_chance
from clothbench.studies.improve.rounds import one_round, withdrawn, witnessed_round
from clothbench.studies.improve.selection import faulty, least_fall
from clothbench.studies.improve.settings import LOOP
from clothbench.studies.improve.state import Round, State
from clothbench.studies.improve.verdict import concluded, fails_to_hold, too_much_left


def improve(
    problem: Problem, candidates: Sequence[str], progress: StageProgress = lambda *_: None, timeout: float | None = None
) -> Finding:
    """Run the loop on the fit recordings, and judge once on the held-out ones what it finds.

    timeout: s, after which no further round is begun.
    """
    account = Account(progress)
    state, timed_out = all_rounds(problem, candidates, account, timeout)
    return finding_of(state, account, timed_out)


def all_rounds(
    problem: Problem, candidates: Sequence[str], account: Account, timeout: float | None = None
) -> tuple[State, bool]:
    """Stages 1 to 5: where the loop stands at the end, and whether it ran out of time."""
    state = initial_state(problem, account)
    for turn in range(problem.evidence.search.rounds):
        if state.final.rms <= LOOP.floor_factor * (state.floor if turn else state.noise):
            break
        if timeout is not None and problem.checkpoint.seconds > timeout:
            return state, True
        state, goes_on = next_round(state, candidates, account)
        if not goes_on:
            break
    return state, False


def initial_state(problem: Problem, account: Account) -> State:
    """The base calibrated, on all recordings and on each alone; what noise and mesh leave open."""
    base = calibrated(problem, account)
    noise = max(problem.evidence.noise(), problem.evidence.repeat_spread(base.residual))
    if not np.isfinite(base.rms):
        raise ClothbenchError(
            f"model {problem.model!r}: found no parameters with which all recordings to fit can be "
            "simulated; leave out those that it cannot do, or choose another model"
        )
    if not np.isfinite(noise):
        raise ClothbenchError(
            "noise_sigma: found NaN in recordings too short to show their noise, expected "
            f"{problem.evidence.unit.base}; state it in the recordings"
        )
    problem, base, mesh = corrected_in_best_valley(problem, base, noise, account)
    alone = each_alone(problem, base, account)
    account.stage("without any model", 0, 1)
    return State(problem, base, base, noise, mesh, alone=alone, balance=problem.evidence.balance(problem.seed))


def calibrated(problem: Problem, account: Account) -> Fitted:
    """The base model on all fit recordings together."""
    account.stage("calibrate", 0, planned_evaluations(problem.space(()), LOOP.calibration_rounds))
    base = fit(problem, (), None, LOOP.calibration_rounds, account=account)
    account.count(base.evaluations)
    return base


def corrected_in_best_valley(
    problem: Problem, base: Fitted, noise: float, account: Account
) -> tuple[Problem, Fitted, float]:
    """`corrected`, from another valley of the calibration if there is a better one. None is looked for where the mesh
    may be wrong by more than the noise: valleys are no better known then than its ripples are.
    """
    found = corrected(problem, base, noise, account)
    mesh = found[2]
    if mesh > noise or base.rms <= LOOP.floor_factor * float(np.hypot(noise, mesh)):
        return found
    better = in_best_valley(problem, base, account)
    return found if better is base else corrected(problem, better, noise, account)


def in_best_valley(problem: Problem, fitted: Fitted, account: Account) -> Fitted:
    """The fit, or one that leaves so much less that it lies in another valley of the error."""
    better, count = in_another_valley(problem, fitted, partial(account.stage, "another valley"))
    account.count(count)
    return better if better.rms**2 <= (1 - LOOP.least_valley) * fitted.rms**2 else fitted


def each_alone(problem: Problem, base: Fitted, account: Account) -> dict[str, Fitted]:
    """The base fitted to each recording by itself: on a mesh that is fine enough, parameters that drift may be a sign
    of missing physics.
    """
    out, cases = {}, problem.of_split("fit")
    account.stage("each recording alone", 0, len(cases))
    questions = [(problem.restricted(case), (), base.theta, LOOP.single_rounds) for case in cases]
    ahead(fit, questions, lambda done: account.stage("each recording alone", done, len(cases)))
    for k, (case, question) in enumerate(zip(cases, questions, strict=True)):
        account.stage("each recording alone", k, len(cases))
        out[case.name] = fit(*question)
        account.count(out[case.name].evaluations // len(cases))
    return out


def next_round(state: State, candidates: Sequence[str], account: Account) -> tuple[State, bool]:
    """One round more, and whether it named an effect that stands, so that another may follow. A further name is asked
    again from a better valley of the error, if what was named before leaves less there; so is the round that names none
    where so much is left that what was named before would fall with it.
    """
    after, goes_on = one_more(state, candidates, account)
    asked_again = bool(state.rounds) and (goes_on or too_much_left(after))
    if asked_again and (better := recalibrated(state, account)) is not state:
        return next_round(better, candidates, account)
    return after, goes_on


def one_more(state: State, candidates: Sequence[str], account: Account) -> tuple[State, bool]:
    """`next_round`, from the valley of the error in which the state is."""
    current, problem = state.final, state.problem
    rest = [c for c in candidates if c not in current.effects]
    earlier = state.rounds[-1].probes if state.rounds else ()
    fall = least_fall(current, state.floor, state.noise)
    found = one_round(problem, current, state.floor, state.mesh, fall, rest, earlier, account)
    if not found.named:
        found = witnessed_round(problem, state.law, found, state.mesh, account)
    if found.before is not current:  # the refit without the effect came to a better fit of what there was
        state, found = from_better(state, found, found.before)
    if found.after is None or (not state.rounds and found.after.rms > LOOP.floor_factor * state.floor):
        # What differs from recording to recording may pass, in part, for something that they share.
        own, without = with_own_amounts(state, found, rest, account)
        if own is not None:
            return own, True
        if found.after is None and without is not found.before:
            state, found = from_better(state, found, without)
    if found.after is None:
        return with_round(state, found), False
    return confirmed(state, found, account)


def recalibrated(state: State, account: Account) -> State:
    """The state with the model's own parameters sought anew beside what was named, if there is a better valley of the
    error: what was missing may have led the calibration astray, and what a wrong valley leaves looks like one thing
    more that is missing.
    """
    problem, fitted, rounds = state.problem, state.final, state.rounds
    account.stage(f"round {len(rounds) + 1}: calibrated anew", 0, 1)
    better, count = calibrated_anew(problem, fitted)
    account.count(count)
    if better.rms**2 > (1 - LOOP.least_valley) * fitted.rms**2:
        return state
    for name, known in state.own.items():
        better, own, count = fitted_by_recording(dataclasses.replace(problem, own={}), better, name, np.inf, known)
        account.count(count)
        problem = with_own(problem, own)
        rounds = tuple(dataclasses.replace(r, own={**r.own, name: own}) if name in r.own else r for r in rounds)
    problem, after, mesh = corrected(problem, better, state.noise, account)
    if not state.own:
        _, after, count = profile_intervals(problem, after)
        account.count(count)
    # What the probes of the last round change was seen in the valley that was left.
    rounds = (*rounds[:-1], dataclasses.replace(rounds[-1], probes=()))
    return dataclasses.replace(state, problem=problem, final=after, mesh=mesh, rounds=rounds)


def from_better(state: State, found: Round, better: Fitted) -> tuple[State, Round]:
    """Both with a better fit of what there was before the round."""
    before = with_errors_of_mesh_and_model(state.problem, better, state.noise)
    if not state.rounds:
        return dataclasses.replace(state, base=before, final=before), dataclasses.replace(found, before=before)
    # Its intervals are of first order; what was followed along the valleys from where the fit was before still holds.
    low, high = np.fmin(before.low, state.final.low), np.fmax(before.high, state.final.high)
    before = dataclasses.replace(before, low=low, high=high)
    return dataclasses.replace(state, final=before), dataclasses.replace(found, before=before)


def with_round(state: State, found: Round) -> State:
    return dataclasses.replace(state, rounds=(*state.rounds, found))


def confirmed(state: State, found: Round, account: Account) -> tuple[State, bool]:
    """The state after a round that named an effect: with it, if it stands beside whatever an earlier one is tied with,
    once it is fitted to the end and the errors of mesh and model are allowed for; without, and with the reason, if not.
    """
    assert found.after is not None
    if why := beside_tied(state, found, account):
        return with_round(state, withdrawn(found, state.floor, why)), False
    fitted = continued(state.problem, found.after, account)
    if why := as_a_limit(state.problem, fitted, account) or by_chance(state.problem, found.before, fitted, account):
        return with_round(state, withdrawn(found, state.floor, why)), False
    end, stands = with_errors_allowed_for(state, found, fitted, account)
    if not stands and (better := in_best_valley(state.problem, fitted, account)) is not fitted:
        end, stands = with_errors_allowed_for(state, dataclasses.replace(found, after=better), better, account)
    return end, stands


def with_errors_allowed_for(state: State, found: Round, fitted: Fitted, account: Account) -> tuple[State, bool]:
    """The state with the effect that a round named, as fitted to the end, if it stands beside the errors of mesh and
    model; without, and with the reason, if not.
    """
    assert found.after is not None
    name, current, noise = found.named[0], state.final, state.noise
    problem, after, mesh = corrected(state.problem, fitted, noise, account)
    # The fits are near each other: how far a finer mesh changes them is known no better than the two agree.
    doubtful = dataclasses.replace(state, mesh=max(state.mesh, mesh))
    if not found.witnessed and found.before.rms**2 - found.after.rms**2 < least_fall(current, doubtful.floor, noise):
        unit = problem.evidence.unit
        size = f"{unit.scale * mesh:.2g} {unit.reported}"
        why = f"what it explains may be the mesh's doing, which with it may be wrong by {size}"
        return with_round(doubtful, withdrawn(found, doubtful.floor, why)), False
    after, count = off_bounds(problem, after)
    account.count(count)
    if not (why := faulty(name, current, after, problem.evidence)):
        account.stage(f"round {len(state.rounds) + 1}: intervals", 0, 1)
        narrow, after, count = profile_intervals(problem, after)
        account.count(count)
        why = faulty(name, current, narrow, problem.evidence)
    if why:
        why = f"{why} once the errors of mesh and model are allowed for"
        return with_round(state, withdrawn(found, state.floor, why)), False
    state = dataclasses.replace(state, problem=problem, final=after, mesh=mesh, earlier=state)
    return with_round(state, dataclasses.replace(found, after=after)), True


def continued(problem: Problem, named: Fitted, account: Account) -> Fitted:
    """The fit with what was named, continued: refits of candidates get as many rounds as a comparison needs, and what
    such a fit has not yet come to must not be taken for another effect. Jumps along its valley may end in ripples that
    only a longer search gets out of.
    """
    account.stage(f"{named.effects[-1]} fitted out", 0, 1)
    fitted, count = better_of(problem, named, named.theta, LOOP.final_rounds)
    account.count(count)
    fitted, count = jump_along_valley(problem, fitted, LOOP.final_jumps, LOOP.refit_rounds, LOOP.final_jump_margin)
    account.count(count)
    fitted, count = off_bounds(problem, fitted)
    account.count(count)
    return fitted


def finding_of(state: State, account: Account, timed_out: bool = False) -> Finding:
    """Stages 6 and 7: the look at the held-out recordings, which changes nothing but whether amounts are shared, and
    all that is told of the run.
    """
    balance, description = state.balance, None
    account.stage("held-out recordings", 0, 1)
    before = held_out_errors(state.problem, state.base)
    if (other := where_amounts_differ(state, before, account)) is not None:
        state, before = other, held_out_errors(other.problem, other.base)  # which may have come to a better valley
    problem, own, base, numbers = state.problem, state.own, state.base, 0
    for name, amounts in own.items():
        problem, unseen = on_held_out(problem, state.final, name)
        own[name], numbers = {**amounts, **unseen}, numbers + size_of(unseen)
    with_names = held_out_errors(problem, state.final) if state.final.effects else ()
    end = concluded(state, before, timed_out, with_names, numbers)
    placebo, spent = placebo_of(problem, end.fit, state.rounds)
    account.count(spent)
    after = held_out_errors(problem, end.fit) if end.fit.effects else before
    if end.word == "unexplained" and balance is not None and balance.law is not None:
        description = description_of(problem, balance.law, base, before, account)
    comparisons = comparisons_of(problem, base, end.fit)
    account.stop()
    return Finding(
        key=problem.question, model=problem.model, base=problem.base, seed=problem.seed, evidence=problem.evidence,
        verdict=end.word, hint=end.hint, noise=state.noise, mesh=state.mesh_left(end.fit), unexplained=end.unexplained,
        calibrated=base, final=end.fit, rounds=tuple(dataclasses.replace(r, probes=()) for r in state.rounds),
        dropped=end.dropped, notes=notes(problem, state.rounds), alone=state.alone,
        held_out=tuple(zip((c.name for c in problem.of_split("held_out")), before, after, strict=True)),
        placebo=placebo, balance=balance, description=description,
        whereabouts=tuple(problem.evidence.whereabouts(end.fit.residual, problem.seed)),
        own=own if end.fit.effects else {}, comparisons=comparisons, evaluations=account.evaluations,
        wall_s=problem.checkpoint.seconds, stages=account.table, timed_out=timed_out,
    )  # fmt: skip


def where_amounts_differ(state: State, before: Sequence[float], account: Account) -> State | None:
    """Where the last effect's amounts, as they hold for all fit recordings, do not hold on the recordings held out: the
    state in which they are each recording's own, if that explains what is left; else None.

    before: errors of the calibrated model on the recordings held out. One effect of a run may have amounts of each
    recording's own.
    """
    if state.earlier is None or state.own or not fails_to_hold(before, held_out_errors(state.problem, state.final)):
        return None
    found = next(r for r in reversed(state.rounds) if r.named)
    candidates = [
        dataclasses.replace(c, why_not="its amounts do not hold on the recordings held out")
        if c.name in found.named
        else c
        for c in found.candidates
    ]
    refuted = dataclasses.replace(found, candidates=tuple(candidates), named=(), after=None)
    return with_own_amounts(state.earlier, refuted, [c.name for c in candidates], account)[0]


def notes(problem: Problem, rounds: Sequence[Round]) -> dict[str, Note]:
    """What there is to say of every candidate."""
    effects = {c.name: problem.make("effects", c.name) for found in rounds for c in found.candidates}
    return {name: Note(place_of(effect), effect.summary, family_of(effect)) for name, effect in effects.items()}
