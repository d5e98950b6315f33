"""Stage 6: the verdict in a word, by what is left beyond noise and mesh, and what is said beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from clothbench.core.optional import family_of, lacks_of
from clothbench.core.statistics import t_interval
from clothbench.studies.improve.by_recording import with_own
from clothbench.studies.improve.candidates import place_of
from clothbench.studies.improve.experiment import parting_experiment
from clothbench.studies.improve.fitted import Fitted
from clothbench.studies.improve.law import told_by
from clothbench.studies.improve.selection import (
    Candidate,
    amounts_at_bound,
    at_bound,
    correction_correlation,
    parameters_of,
)
from clothbench.studies.improve.settings import LOOP
from clothbench.studies.improve.state import Round, State

AT_LIMIT = "the fit leaves no more than noise and mesh account for"


@dataclass(frozen=True, eq=False)
class Conclusion:
    """What the rounds and the recordings held out come to.

    word: "complete", "attributed", "tied" or "unexplained";
    fit: what the verdict stands by: with what was named, or the calibrated model if nothing was;
    unexplained: what is left above the floor, base unit; 0 of what is no more than noise and mesh account for;
    hint: in one or two sentences;
    dropped: why what was named is no finding after all, or "".
    """

    word: str
    fit: Fitted
    unexplained: float
    hint: str
    dropped: str


def concluded(
    state: State,
    held_out: Sequence[float],
    timed_out: bool = False,
    held_out_after: Sequence[float] = (),
    own: int = 0,
) -> Conclusion:
    """held_out: errors of the calibrated model on the recordings held out, base unit, NaN where a run was stopped;
    held_out_after: the same with all that was named, none if nothing was: names have to hold there; own: how many
    numbers were fitted to the recordings held out, each to its own.
    """
    worse = fails_to_hold(held_out, held_out_after, own)
    word = "unexplained" if worse else word_of(state)
    fit = state.final if word in ("attributed", "tied") else state.base
    remark, rms, unseen = hint(state, word, fit, worse), fit.rms, pooled(held_out) or 0.0
    names = [case.name for case in state.problem.of_split("held_out")]
    stopped = [name for name, error in zip(names, held_out, strict=True) if np.isnan(error)]
    if word == "complete" and stopped:
        word = "unexplained"
        remark = f"{AT_LIMIT}, but {stopped[0]}, held out, could not be simulated with it"
    elif not state.final.effects and at_floor(state) and beyond_fitted(state, unseen):
        word, rms = "unexplained", unseen
        remark = (
            f"{AT_LIMIT}, but the error on held-out recordings stands at {unseen / state.floor:.1f} times that: "
            "what is missing shows in their motions; let some of them be fitted too"
        )
    if word == "complete" and timed_out:  # above the noise candidates are tried, also where the mesh is coarser
        word, remark = "unexplained", f"{AT_LIMIT}, but no candidate was tried"
    if timed_out:
        remark = "; ".join(filter(None, (remark, "time ran out before another round")))
    unexplained = left_beyond(rms, float(np.hypot(state.noise, state.mesh_left(fit))))
    return Conclusion(word, fit, unexplained, remark, why_dropped(state, worse) if state.final is not fit else "")


def beyond_fitted(state: State, unseen: float) -> bool:
    """Whether the calibrated model does not carry over. unseen: its error on recordings held out, base unit."""
    return unseen > state.problem.evidence.search.generalisation * state.floor


def fails_to_hold(before: Sequence[float], after: Sequence[float], own: int = 0) -> bool:
    """Whether what was named does not lower the error on the recordings held out; with it all of them have to be
    simulated, without it not. own: how many numbers were fitted to these, which have to be paid for as they are on the
    others: they lower an error whatever they stand for.
    """
    if not len(after):
        return False
    error, without = pooled(after), pooled(before)
    return error is None or (without is not None and error**2 * (1 + LOOP.parameter_penalty * own) >= without**2)


def fall_interval(before: Sequence[float], after: Sequence[float]) -> tuple[float | None, float | None]:
    """95 % interval of the fall of the pooled error: Student's t of the fall of the mean square over recordings, each
    beside itself, carried over to the root. Of fewer than two recordings there is none.
    """
    square = np.square(before) - np.square(after)
    without = pooled(before)
    if len(square) < 2 or without is None or not np.isfinite(square).all():
        return None, None
    low, high = (float(without - np.sqrt(max(without**2 - end, 0.0))) for end in t_interval(square))
    return low, high


def pooled(values: Sequence[float]) -> float | None:
    """Root-mean-square over recordings, each with the same say; None where there are none or one of them could not be
    simulated.
    """
    rms = np.sqrt(np.mean(np.square(values))) if len(values) else np.nan
    return float(rms) if np.isfinite(rms) else None


def word_of(state: State) -> str:
    """The verdict by the fit recordings alone."""
    named = [r for r in state.rounds if r.named]
    if not named:
        return "complete" if at_floor(state) and state.fine_enough else "unexplained"
    if too_much_left(state):
        return "unexplained"
    return "tied" if any(len(r.named) > 1 for r in named) else "attributed"


def too_much_left(state: State) -> bool:
    """Whether what is left after all that was named says that the names are wrong."""
    return not state.problem.evidence.search.steps and much_left(state) and not witnessed(state)


def much_left(state: State) -> bool:
    """Whether what is left after all that was named is worth another name."""
    explained = LOOP.least_explained_in_all if above_floor(state) else LOOP.least_explained_at_floor
    return share_left(state) > 1 - explained


def witnessed(state: State) -> bool:
    """Whether the recordings say without any model what was named with one: each name is, or is tied with, a force that
    goes with what the law's first term goes with, which is the one that beats chance.

    Whose cause has no name may pass for its nearest likeness, and then leaves much; two accounts that share no
    simulation do not agree on the likeness.
    """
    make = state.problem.make
    return all(any(told_by(state.law, make("effects", n)) for n in r.named) for r in state.rounds if r.named)


def at_floor(state: State) -> bool:
    """Whether what is left is no more than noise and mesh account for."""
    return state.final.rms <= LOOP.floor_factor * state.floor


def left_beyond(rms: float, floor: float) -> float:
    """What of an error noise and mesh do not account for: nothing of one that the verdict takes for nothing, which may
    be a little above the floor.
    """
    return 0.0 if rms <= LOOP.floor_factor * floor else float((rms**2 - floor**2) ** 0.5)


def share_left(state: State) -> float:
    """Share of the mean square above the floor (above the noise, if the base stood at the floor) that is still there
    after all that was named.
    """
    floor = (state.floor if above_floor(state) else state.noise) ** 2
    return (state.final.rms**2 - floor) / max(state.base.rms**2 - floor, 1e-12)


def above_floor(state: State) -> bool:
    """Whether the calibrated model stood above what noise and mesh account for."""
    return state.base.rms > LOOP.floor_factor * (state.rounds[0].floor if state.rounds else state.floor)


def why_dropped(state: State, worse: bool) -> str:
    """Why what passed every test of its own is no finding after all. worse: on what was held out."""
    if worse:
        return "the error on the recordings held out does not fall with it"
    return f"{what_is_left(state)}, so that something else must be missing"


def what_is_left(state: State) -> str:
    return f"{share_left(state):.0%} of what noise and mesh do not account for is left"


def hint(state: State, word: str, fit: Fitted, worse: bool = False) -> str:
    """What the reader may want to know or do next, in one or two sentences. fit: what the verdict stands by; worse:
    whether what was named does not hold on the recordings held out.
    """
    if word == "complete":
        return "nothing is left above the noise and the mesh"
    if word in ("attributed", "tied"):
        pairs = [undecided(state, r) for r in state.rounds if len(r.named) > 1]
        if at_floor(state) and not state.fine_enough:
            pairs.append(below_mesh(state))
        told = [r.named[0] for r in state.rounds if r.witnessed]
        if told or (not state.problem.evidence.search.steps and much_left(state)):
            same = f"the recordings say the same of {' and '.join(told or state.final.effects)} without any model"
            more = f"{what_is_left(state)}: something else is missing, too"
            pairs.append(f"{same}; {more}" if much_left(state) and not at_floor(state) else same)
        return "; ".join((*pairs, *own_lacks(state)))
    said, dropped = [], state.final.effects
    if at_floor(state) and not state.fine_enough and not dropped:
        return below_mesh(state)
    if dropped:
        fall = 1 - state.final.rms / state.base.rms
        why = "but not that on the recordings held out" if worse else "too little for a name"
        said.append(f"{' and '.join(dropped)} would lower the error of the fit by {fall:.0%}, {why}")
    last = state.rounds[-1] if state.rounds else None
    near = {c: explained(c, last) for c in last.candidates if c.name not in dropped} if last else {}
    if near:
        said.append(nearest(state, near, " beside that" if dropped else ""))
    if not said:
        return "the residual stands above the noise, and no candidate could be tried"
    where = state.problem.evidence.location(fit.residual)
    return "; ".join(filter(None, (f"no finding: {'; '.join(said)}", where)))


def own_lacks(state: State) -> list[str]:
    """What was named although the model is known to lack something of its own there."""
    make = state.problem.make
    lacks = lacks_of(make("models", state.problem.model))
    return [
        f"{name} may be a fault of {state.problem.model}, not of the cloth: {lacks[family]}; a second model would tell "
        f"(model=[{state.problem.model},…])"
        for found in state.rounds
        for name in found.named
        if (family := family_of(make("effects", name))) in lacks
    ]


def below_mesh(state: State) -> str:
    """That a small residual says nothing on a mesh which may be wrong by more than the noise."""
    unit = state.problem.evidence.unit
    rms, mesh, noise = (f"{unit.scale * e:.2g} {unit.reported}" for e in (state.final.rms, state.mesh, state.noise))
    capped = state.mesh_left(state.final) < state.mesh
    wrong_by = (
        f"at least as much as is left above the noise, {noise}" if capped else f"{mesh}, beside a noise of {noise}"
    )
    return (
        f"what is left, {rms}, is below what this mesh can tell: it may be wrong by {wrong_by}; "
        "a finer one (resolution=NODES) or a model that converges sooner would tell whether anything else is missing"
    )


def nearest(state: State, near: dict[Candidate, float], beside: str) -> str:
    """Which candidate explains most, though too little, and which among forces."""
    best = max(near, key=lambda c: near[c])
    forces = [c for c in near if place_of(state.problem.make("effects", c.name)) == "dynamics"]
    force = max(forces, key=lambda c: near[c], default=best)
    among = f", {with_amounts(force, near[force])} among forces" if force is not best else ""
    stopped = "".join(f"; {stopped_by_bound(c)}" for c in dict.fromkeys((best, force)) if held_by_bound(c))
    return f"{with_amounts(best, near[best])} comes nearest{beside}{among}{stopped}"


def held_by_bound(candidate: Candidate) -> bool:
    """Whether nothing else speaks against a candidate than that an amount has run to its bound."""
    fitted = candidate.fitted
    return fitted is not None and bool(why := at_bound(candidate.name, fitted)) and candidate.why_not == why


def stopped_by_bound(candidate: Candidate) -> str:
    """Which bound keeps a candidate from being named, and the word that moves it."""
    fitted = candidate.fitted
    assert fitted is not None  # as of all that a bound holds
    i = amounts_at_bound(candidate.name, fitted)[0]
    name, (low, high) = fitted.space.names[i], fitted.space.parameters[i].bounds
    wider = f"[{low:g},…]" if fitted.theta[i] > (low + high) / 2 else f"[…,{high:g}]"
    stopped = f"its {name} lies at its bound {fitted.theta[i]:.3g}, which alone keeps it from a name"
    return f"{stopped}; widen with bounds.{name}={wider}"


def explained(candidate: Candidate, tried: Round) -> float:
    """Share of the mean square a candidate took off when it was fitted, else what it promises to first order."""
    return candidate.share if candidate.fitted is None else max(0.0, candidate.gain) / tried.before.rms**2


def with_amounts(candidate: Candidate, share: float) -> str:
    """A candidate, what it explains and with which amounts: "lift (fitted with c = 1: 9% of the mean square)"."""
    fitted = candidate.fitted
    if fitted is None:
        return f"{candidate.name} ({share:.0%} of the mean square to first order)"
    amounts = []
    for own, i in parameters_of(fitted.space, candidate.name).items():
        unit = fitted.space.parameters[i].unit
        amounts.append(f"{own} = {fitted.theta[i]:.3g}" + ("" if unit == "1" else f" {unit}"))
    return f"{candidate.name} (fitted with {', '.join(amounts)}: {share:.0%} of the mean square)"


def undecided(state: State, found: Round) -> str:
    """How much alike tied effects correct, where two of them differ most in these recordings, and what would decide."""
    tied = [next(c for c in found.candidates if c.name == name) for name in found.named]
    alike = correction_correlation(found.before, tied)[np.triu_indices(len(tied), 1)]
    correlation = " … ".join(dict.fromkeys(f"{value:.2f}" for value in (alike.min(), alike.max())))
    size, pair, most, apart = 0.0, (tied[0], tied[1]), 0, found.before.residual[0]
    for one, other in combinations(tied, 2):
        assert one.fitted is not None  # what is named was fitted
        assert other.fitted is not None
        for k, (a, b) in enumerate(zip(one.fitted.residual, other.fitted.residual, strict=True)):
            if (by := float(np.sqrt(np.mean((a - b) ** 2)))) >= size:
                size, pair, most, apart = by, (one, other), k, a - b
    case, unit = state.problem.of_split("fit")[most], state.problem.evidence.unit
    which = f"{pair[0].name} and {pair[1].name}" if len(tied) > 2 else "they"
    return (
        f"{listed(found.named)} fit alike (what they correct correlates with {correlation}); {which} differ most in "
        f"{case.name}, by {unit.scale * size:.2g} {unit.reported}, around {case.peak(apart)}: "
        f"{what_would_part(state, found, pair, size)}"
    )


def what_would_part(state: State, found: Round, pair: tuple[Candidate, Candidate], size: float) -> str:
    """The motion in which two fits differ most, and by how much; or what to look for where none can be simulated."""
    fits = []
    for one in pair:
        assert one.fitted is not None  # what is named was fitted
        own = found.own.get(one.name)
        fits.append((with_own(state.problem, own) if own else state.problem, one.fitted))
    best, unit = parting_experiment(*fits), state.problem.evidence.unit
    if best is None or best.apart <= size:
        return "a recording that goes further there would tell them apart"
    said = (
        f"moved as in {best.case} but {best.how}, for {best.seconds:.1f} s, they would differ by "
        f"{unit.scale * best.apart:.2g} {unit.reported}"
    )
    return f"{said}, {best.apart / state.noise:.1f} times the noise" if state.noise > 0 else said


def listed(names: Sequence[str]) -> str:
    """ "one, two and three" """
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))
