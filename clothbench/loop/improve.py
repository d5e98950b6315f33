"""Stages 1 to 5 in turn: calibrate, find the effect that explains what is left, add it, and go round again."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from clothbench.errors import ClothbenchError
from clothbench.loop.attribution import Probe, moved, outside, probes, ridge
from clothbench.loop.fitting import Fitted, fit, polish, widened
from clothbench.loop.guard import Shares, shares
from clothbench.loop.problem import Problem
from clothbench.loop.residual import correction, numerical_floor

ALPHA = 0.05
ROUNDS = 3  # effects that can be named one after the other
REFITS, NEAR = 4, 0.2  # how many candidates are fitted in earnest in each round, and from which part of the best share
AT_THE_FLOOR = 1.15  # times the floor: a residual this small is not worth a name
MATERIAL = 0.25  # share of the mean square above the floor that an effect has to explain to be worth a name
TIED = 0.1  # two candidates cannot be told apart if what they leave (mean square) differs by less than this share
ALIKE = 0.9  # correlation of what two candidates correct, from which on they may be one and the same
EXPLAINED = 0.6  # share of the mean square above the floor that all names together have to explain
COARSE = 0.45  # and of that above the noise, where the mesh alone may stand for the residual
PER_PARAMETER = 0.05  # and per parameter that one has more than the other
# Evaluations of the first fit, of one that begins where another ended, and of one of a single recording.
FIRST, AGAIN, ALONE = 140, 60, 25
POLISH = 80  # and to make sure that a candidate's search has not ended early
FINALISTS, CONTEST = 3, 2.0  # how many are made sure of, and what they may leave, times the least (mean squares)

Stage = Callable[[str, int, int], None]


class Budget:
    """Tells the caller which stage the loop is in, and adds up what each one takes: seconds and simulated sets."""

    def __init__(self, told: Stage):
        self.told = told
        self.spent: dict[str, list] = {}
        self.now, self.since = "", time.perf_counter()

    def stage(self, name: str, done: int, planned: int) -> None:
        self.told(name, done, planned)
        self.stop()
        self.now = name

    def stop(self) -> None:
        """The stage that runs is over, or goes on: its time so far counts."""
        now = time.perf_counter()
        if self.now:
            self._entry()[0] += now - self.since
        self.since = now

    def count(self, evaluations: int) -> None:
        """So many parameter sets were simulated in the stage that runs, on all fit recordings each."""
        self._entry()[1] += evaluations

    def _entry(self) -> list:
        return self.spent.setdefault(self.now, [0.0, 0])

    @property
    def table(self) -> list[tuple[str, float, int]]:
        """(stage, s, evaluations) in the order in which they began."""
        return [(name, float(seconds), int(count)) for name, (seconds, count) in self.spent.items()]

    @property
    def evaluations(self) -> int:
        return sum(count for _, _, count in self.table)


@dataclass(frozen=True, eq=False)
class Candidate:
    """What came of one candidate in one round.

    share: of the residual that only it could explain, to first order; p_value: of that share; gain: m², by which the
    mean square fell when all was refitted (NaN where it was not); chosen in so many of the leave-one-out rounds.
    """

    name: str
    share: float
    p_value: float
    gain: float = float("nan")
    selected: int = 0
    fitted: Fitted | None = None
    why_not: str = ""


@dataclass(frozen=True, eq=False)
class Round:
    """One turn of the loop: the fit it began with, its floor [m], the candidates, and who was named (or tied)."""

    before: Fitted
    floor: float
    candidates: tuple[Candidate, ...]
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
    noise = noise_of(problem)
    base = calibrated(problem, budget)
    problem, base, floor = corrected(problem, base, noise, budget)
    outcome = Outcome(problem, base, base, noise, floor, budget)
    outcome.alone = each_alone(problem, base, budget)
    current = base
    for turn in range(problem.rounds or ROUNDS):
        if current.rms <= AT_THE_FLOOR * (floor if turn else noise):
            break
        rest = [c for c in candidates if c not in current.effects]
        found = one_round(problem, current, floor, needed(current, floor, noise), rest, budget, turn)
        outcome.rounds.append(found)
        if found.after is None:
            break
        problem, current, floor = corrected(problem, found.after, noise, budget)
        outcome.rounds[-1] = dataclasses.replace(found, after=current)
        outcome.problem, outcome.final, outcome.floor = problem, current, floor
    budget.stop()
    return outcome


def calibrated(problem: Problem, budget: Budget) -> Fitted:
    """The base model on all fit recordings together."""
    budget.stage("calibrate", 0, FIRST)
    done = 0

    def told(more: int, _: float) -> None:
        nonlocal done
        done += more
        budget.stage("calibrate", min(done, FIRST), FIRST)

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


def needed(current: Fitted, floor: float, noise: float) -> float:
    """How far the mean square has to fall for a name [m²].

    A share of what stands above the floor. Where nothing does, a coarse mesh may stand for all that is left; then only
    an effect that explains much of it, noise apart, is no doing of the mesh.
    """
    square = current.rms**2
    if current.rms > AT_THE_FLOOR * floor:
        return MATERIAL * (square - floor**2)
    return COARSE * max(square - noise**2, 1e-12)


def noise_of(problem: Problem) -> float:
    """σ of one coordinate [m]: as stated, else from how much neighbouring frames jump."""
    found = []
    for case in problem.of_split("fit"):
        sigma = case.observation.sigma
        if not np.isfinite(sigma):
            x = np.where(case.observation.visible[..., None], case.observation.position, np.nan)
            sigma = 1.4826 * float(np.nanmedian(np.abs(np.diff(x, n=3, axis=0)))) / np.sqrt(20)
        found.append(sigma)
    return float(np.sqrt(np.mean(np.square(found))))


def corrected(problem: Problem, fitted: Fitted, noise: float, budget: Budget) -> tuple[Problem, Fitted, float]:
    """The problem with the mesh's error taken away at this fit, the fit again, and the floor [m] of noise and mesh."""
    budget.stage("mesh and step refined", 0, 2)
    plain = dataclasses.replace(problem, corrections={})
    changes = correction(plain, fitted, "fit")
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


def above(fitted: Fitted, changes: Sequence[np.ndarray]) -> float:
    """What a refit could not take up of the residual with these changes [m]."""
    total = fitted.left + np.concatenate(changes) * fitted.scale
    return float(np.linalg.norm(outside(fitted.tangent, total[:, None])))


def one_round(
    problem: Problem, current: Fitted, floor: float, gain: float, candidates: Sequence[str], budget: Budget, turn: int
) -> Round:
    """Screen all candidates to first order, fit the best in earnest, and name the one that stands every test.

    gain: m², by how much the mean square has to fall for a name.
    """
    found: list[Probe] = []
    for k, name in enumerate(candidates):
        budget.stage(f"round {turn + 1}: candidates", k, len(candidates))
        try:
            more = probes(problem, current, name)
        except ClothbenchError:
            continue  # a model may have no room for it; it is listed as not tried
        budget.count(2 * sum(len(probe.amounts) for probe in more))
        found += more
    seen = shares(problem.of_split("fit"), current, found, problem.seed)
    screened = screen(candidates, found, seen)
    most = max((c.share for c in screened), default=0.0)
    promising = [c for c in screened if c.p_value < ALPHA and c.share >= NEAR * most]
    promising = sorted(promising, key=lambda c: -c.share)[:REFITS]
    tried = []
    for k, candidate in enumerate(promising):
        budget.stage(f"round {turn + 1}: refits", k, len(promising))
        tried.append(done := refit(problem, current, candidate, found, seen))
        budget.count(done.fitted.evaluations if done.fitted else 0)
    tried = contest(problem, current, gain, tried, budget, turn)
    judged = judge(current, gain, tried)
    if named := choose(current, judged):
        current = second_thought(problem, current, next(c.fitted for c in judged if c.name == named[0]), budget)
        judged = judge(current, gain, tried)
        named = choose(current, judged)
    others = [c for c in screened if c.name not in {t.name for t in judged}]
    after = next((c.fitted for c in judged if named and c.name == named[0]), None)
    return Round(current, floor, tuple([*judged, *others]), named, after)


def contest(
    problem: Problem, current: Fitted, gain: float, tried: Sequence[Candidate], budget: Budget, turn: int
) -> list[Candidate]:
    """The candidates with those polished that may yet be named: a search that ended early must not decide."""
    fits = [c.fitted for c in tried if c.fitted is not None]
    least = min((f.rms**2 for f in fits), default=0.0)
    within = [f for f in fits if f.rms**2 <= CONTEST * least and f.rms**2 <= current.rms**2 - gain / 2]
    within = sorted(within, key=lambda f: f.rms)[:FINALISTS]
    better = {}
    for k, fitted in enumerate(within):
        budget.stage(f"round {turn + 1}: contest", k, len(within))
        better[fitted.effects], count = polish(problem, fitted, POLISH)
        budget.count(count)
    return [
        c if c.fitted is None else dataclasses.replace(c, fitted=better.get(c.fitted.effects, c.fitted)) for c in tried
    ]


def second_thought(problem: Problem, current: Fitted, better: Fitted | None, budget: Budget) -> Fitted:
    """The fit without the effect again, from where the fit with it ended: a gain must not come from a better valley."""
    if better is None:
        return current
    again = fit(problem, current.effects, better.theta[: len(current.theta)], AGAIN)
    budget.count(again.evaluations)
    return again if again.rms < current.rms else current


def screen(candidates: Sequence[str], found: Sequence[Probe], seen: Shares) -> list[Candidate]:
    """Each candidate at the best setting of its other parameters."""
    out = []
    for name in candidates:
        mine = [k for k, probe in enumerate(found) if probe.effect == name]
        if not mine:
            out.append(Candidate(name, 0.0, 1.0, why_not="could not be simulated with this model"))
            continue
        best = max(mine, key=lambda k: seen.share[k])
        p_value = seen.p_value(best)
        why = "" if p_value < ALPHA else f"explains no more than chance would (p = {p_value:.2g})"
        out.append(Candidate(name, float(seen.share[best]), p_value, why_not=why))
    return out


def refit(problem: Problem, current: Fitted, candidate: Candidate, found: Sequence[Probe], seen: Shares) -> Candidate:
    """Everything fitted again with the candidate, from its best probe's first-order amount."""
    mine = [k for k, probe in enumerate(found) if probe.effect == candidate.name]
    probe = found[max(mine, key=lambda k: seen.share[k])]
    fitted = fit(problem, (*current.effects, candidate.name), first_order(current, probe), AGAIN)
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


def judge(current: Fitted, gain: float, tried: Sequence[Candidate]) -> list[Candidate]:
    """What speaks against each of them, if anything; and in how many leave-one-out rounds it is the best."""
    count = len(current.squares)
    left = np.array([c.fitted.squares for c in tried if c.fitted is not None]).reshape(-1, count)
    allowed = allowances(current, tried)
    out = []
    for k, candidate in enumerate(tried):
        candidate = dataclasses.replace(candidate, gain=float((current.squares - left[k]).mean()))
        wins = 0
        for left_out in range(count):
            rest = [r for r in range(count) if r != left_out] or [0]
            wins += bool((left[k, rest].mean() <= allowed[:, k] * left[:, rest].mean(axis=1)).all())
        helped = int((left[k] < current.squares).sum())
        why = ""
        if candidate.gain < gain:
            why = f"explains only {max(candidate.gain, 0) / gain:.0%} of what a name has to"
        elif helped < count - 1:
            why = f"helps in {helped} of {count} recordings only"
        elif fault := unphysical(candidate):
            why = fault
        elif wins < count - 1:
            why = f"another is better when a recording is left out ({wins} of {count})"
        out.append(dataclasses.replace(candidate, selected=int(wins), why_not=why))
    return sorted(out, key=lambda c: -c.gain)


def unphysical(candidate: Candidate) -> str:
    """Why the fitted amounts cannot stand, or ""."""
    assert candidate.fitted is not None
    space, fitted = candidate.fitted.space, candidate.fitted
    own = [i for i, n in enumerate(space.names) if n.startswith(f"{candidate.name}.")]
    amounts = [i for i in own if space.parameters[i].null is not None]
    null = np.array([space.parameters[i].null for i in amounts])
    far = np.abs(fitted.theta[amounts] - null) > 1e-3 * (space.high - space.low)[amounts]
    at_bound = [i for i, away in zip(amounts, far, strict=True) if away and fitted.at_bound[i]]
    if at_bound:
        return f"its {space.names[at_bound[0]]} runs to the bound {fitted.theta[at_bound[0]]:.3g}"
    if not far.any():
        return "its amount is fitted to nothing"
    low, high = fitted.low[amounts], fitted.high[amounts]
    if not (far & ((low > null) | (high < null))).any():
        return "its amount cannot be told from nothing"
    return ""


def allowances(current: Fitted, tried: Sequence[Candidate]) -> np.ndarray:
    """(K, K): candidate k stands beside j if it leaves at most [j, k] times what j leaves (mean squares).

    Within `TIED` two cannot be told apart, within twice that if what they correct is alike; beyond that every further
    parameter has to pay for itself.
    """
    size = np.array([0 if c.fitted is None else len(c.fitted.theta) for c in tried])
    more = size[:, None] - size[None, :]
    alike = (likeness(current, tried) >= ALIKE) & (np.abs(more) <= 1)
    return 1 + TIED * np.where(alike, 2, 1) + PER_PARAMETER * np.maximum(more, 0)


def likeness(current: Fitted, tried: Sequence[Candidate]) -> np.ndarray:
    """(K, K): correlation of what the candidates take from the residual."""
    before = np.concatenate(current.residual)
    taken = [np.zeros_like(before) if c.fitted is None else before - np.concatenate(c.fitted.residual) for c in tried]
    unit = np.array([t / max(float(np.linalg.norm(t)), 1e-300) for t in taken]).reshape(len(tried), len(before))
    return unit @ unit.T


def choose(current: Fitted, judged: Sequence[Candidate]) -> tuple[str, ...]:
    """The one that stands; of several as good as each other the one with the fewest parameters, or two as tied: equally
    simple ones, or one that corrects the same and is hardly less simple."""
    standing = [c for c in judged if not c.why_not and c.fitted is not None]
    if not standing:
        return ()
    left = np.array([c.fitted.rms**2 for c in standing if c.fitted is not None])
    size = np.array([len(c.fitted.theta) for c in standing if c.fitted is not None])
    allowed, alike = allowances(current, standing), likeness(current, standing) >= ALIKE
    close = [k for k in range(len(standing)) if (left[k] <= allowed[:, k] * left).all()]
    first = min(close, key=lambda k: (size[k], left[k]))
    others = [
        k for k in close if k != first and (size[k] == size[first] or (alike[k, first] and size[k] == size[first] + 1))
    ]
    return tuple(standing[k].name for k in [first, *sorted(others, key=lambda k: left[k])][:2])
