"""Experiments simulated with what is known, and put into order."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.progress import StageProgress
from clothbench.estimation.intervals import BLOCK
from clothbench.estimation.trials import Trial
from clothbench.studies.improve.fitting import finite_differences
from clothbench.studies.improve.problem import residuals
from clothbench.studies.improve.settings import LOOP
from clothbench.suggest.cameras import Look, Placed, look_of, placed
from clothbench.suggest.experiments import Experiment, Unsimulated
from clothbench.suggest.information import counted_noise, gain, half_widths, information, pull_of
from clothbench.suggest.settings import INFORMATION, TIE, Wanted
from clothbench.suggest.subject import Known, Subject
from clothbench.suggest.ties import Apart, apart, comparison, refitted

LOOKED_AT = 32  # parameter sets at least, of which those are drawn that the recordings allow; so many in one batch
FOR_EACH = 8  # as many are looked at for each that is drawn: of fewer, the recordings could not choose
NUDGE = 1e-3  # of the scaled range: after so small a change cloth that folds by chance is somewhere else altogether
ENOUGH = 0.9  # of what the longest duration tells: a shorter one that tells so much is preferred


@dataclass(frozen=True, eq=False)
class Promise:
    """What one experiment of one duration would tell.

    gain: nats, over all parameters together; after: (P,), expected half-widths of the 95 % intervals, in scaled ranges;
    best, worst: (P,), the same at the luckiest and the unluckiest of the parameter sets looked at; apart: one for each
    tie; counted: m, what a coordinate counts as its noise there; doubt: m, rms by which the model itself may be wrong
    there; view: the camera that sees it, None for markers; views: the same experiment seen by each of the cameras, the
    best first.
    """

    experiment: Experiment
    duration: float
    gain: float
    after: np.ndarray
    best: np.ndarray
    worst: np.ndarray
    apart: tuple[Apart, ...]
    counted: float
    doubt: float
    view: Placed | None = None
    views: tuple[Promise, ...] = ()

    def widens(self, now: np.ndarray) -> bool:
        """Whether the intervals, multiplied, become no narrower than they are `now` (P,): the mesh pulls at the fit
        there by more than the experiment tells.
        """
        return bool(np.log(self.after / now).sum() >= 0)


@dataclass(frozen=True)
class LeftOut:
    """An experiment that promises nothing, and why."""

    grips: str
    motion: str
    reason: str


def draws(subject: Subject, count: int) -> np.ndarray:
    """The fit and `count` other parameter sets, in the unit cube (1 + count, P), as the recordings leave them open.

    Drawn from the fit's own normal distribution inside the range, and again from these by how much better or worse than
    to first order each fits the recordings: where a parameter is not determined, the model is far from linear in it.
    """
    known, space = subject.known, subject.known.fitted.space
    if not count:
        return known.unit[None]
    random = np.random.default_rng([subject.problem.seed, len(space)])
    root = np.linalg.cholesky(np.linalg.inv(known.matrix))
    looked = max(LOOKED_AT, FOR_EACH * count)
    drawn = known.unit + random.standard_normal((100 * looked, len(space))) @ root.T
    inside = drawn[((drawn >= 0) & (drawn <= 1)).all(axis=1)][:looked]
    if not len(inside):  # the fit lies in a corner
        inside = np.clip(drawn[:looked], 0.0, 1.0)
    fitted, excess = known.fitted, np.zeros(len(inside))
    for k, trial in enumerate(subject.problem.trials(fitted.effects, "fit")):
        for begin in range(0, len(inside), LOOKED_AT):
            some = slice(begin, begin + LOOKED_AT)
            found, here = residuals(trial, space.from_unit(inside[some])), fitted.residual[k]
            first_order = here + (inside[some] - known.unit) @ fitted.jacobian[k].T
            excess[some] += ((found**2).sum(axis=1) - (first_order**2).sum(axis=1)) / known.counted[k] ** 2
    weight = np.nan_to_num(-0.5 * excess, nan=-np.inf)
    if not np.isfinite(weight).any():
        return known.unit[None]
    order = np.argsort(-(weight + random.gumbel(size=len(weight))))  # without replacement, by weight
    chosen = [k for k in order if np.isfinite(weight[k])][:count]
    return np.vstack([known.unit, inside[chosen]])


def promises(
    subject: Subject, chosen: Sequence[Experiment], wanted: Wanted, told: StageProgress = lambda *_: None
) -> tuple[list[Promise], list[LeftOut]]:
    """What each experiment would tell, in no order, one for each duration and camera; and those that tell nothing."""
    sets, out, left = draws(subject, wanted.draws), [], []
    for k, experiment in enumerate(chosen):
        told("experiments", k, len(chosen))
        try:
            out += list(promised(subject, experiment, sets, wanted))
        except (Unsimulated, ClothbenchError) as fault:  # the latter from a model that cannot do such a scene
            left.append(LeftOut(experiment.grips, experiment.motion, str(fault)))
    return out, left


def promised(subject: Subject, experiment: Experiment, sets: np.ndarray, wanted: Wanted) -> Iterator[Promise]:
    """What it tells at parameter sets (S, P) in the unit cube, for each of its durations and of the cameras."""
    known, difference = subject.known, subject.problem.evidence.search.difference
    trial = subject.trial(experiment.scene, known.fitted.effects)
    at, tangents = [], []
    for unit in sets:
        theta = known.fitted.space.from_unit(unit)
        (one,), (jacobian,), _ = finite_differences([trial], known.fitted.space, theta, difference)
        if np.isfinite(one).all():
            at.append(one)
            tangents.append(jacobian)
    if len(at) < len(sets):
        raise Unsimulated(f"could not be simulated with {len(sets) - len(at)} of {len(sets)} parameter sets")
    mesh = mesh_error(subject, experiment, at[0])
    doubt = doubts(subject, trial, at[0], tangents[0], mesh)
    frames = len(experiment.scene.times)
    rows = len(at[0]) // frames
    position = at[0].reshape(frames, -1, 3)
    views: list[Placed | None] = [*placed(subject.like.scene, experiment.scene, position, wanted)] or [None]
    whole = counted_in_ties(known, doubt, counted_there(known, doubt, tangents[0], experiment.durations[-1]))
    rivals = [refitted(tie, comparison(subject, experiment, tie), whole) for tie in subject.ties]
    for duration in experiment.durations:
        part = slice(0, rows * int(np.sum(experiment.scene.times <= duration + 1e-9)))
        counted = counted_there(known, doubt[part], tangents[0][part], duration)
        in_ties = counted_in_ties(known, doubt[part], counted)
        for view in views:
            looks, noise = looks_of(view, wanted, [one[part] for one in at], counted, known.noise)
            (look,), noise_in_ties = looks_of(view, wanted, [at[0][part]], in_ties, known.noise)
            jacobians = [see(jacobian[part]) for see, jacobian in zip(looks, tangents, strict=True)]
            wrong = [see(mesh[part]) for see in looks]
            more = [information(jacobian, noise) for jacobian in jacobians]
            pulls = [known.pull + pull_of(j, error, noise) for j, error in zip(jacobians, wrong, strict=True)]
            after = np.array([half_widths(known.matrix + one, pull) for one, pull in zip(more, pulls, strict=True)])
            yield Promise(
                experiment, duration, float(np.mean([gain(known.matrix, one) for one in more])),
                np.exp(np.log(after).mean(axis=0)), after.min(axis=0), after.max(axis=0),
                tuple(apart(rival, part, doubt, look, noise_in_ties) for rival in rivals),
                counted, float(np.sqrt(np.mean(doubt[part] ** 2))), view,
            )  # fmt: skip


def looks_of(
    view: Placed | None, wanted: Wanted, places: Sequence[np.ndarray], counted: float, noise: float
) -> tuple[list[Look], float]:
    """How an experiment with its points at each of several places (M,) m is looked at, and what each row then counts as
    its noise: markers as they are and as `counted` m; in a picture in σ. noise: m, of the sensor of the recordings,
    whose share in `counted` goes: the camera has its own.
    """
    if view is None:
        return [lambda rows: rows] * len(places), counted
    wrong = float(np.sqrt(max(counted**2 - noise**2, 0.0)))
    return [look_of(view, wanted.camera, place, wrong) for place in places], 1.0


def counted_there(known: Known, doubt: np.ndarray, jacobian: np.ndarray, duration: float) -> float:
    """What a coordinate will count as its noise [m]: as if `doubt` (M,) m were what a fit leaves there; but no less
    than in the recordings that there are.
    """
    groups = np.array_split(np.arange(len(doubt)), max(2, round(duration / BLOCK)))
    own = counted_noise(doubt, jacobian, groups, known.noise)
    return max(own, known.usual)


def counted_in_ties(known: Known, doubt: np.ndarray, counted: float) -> float:
    """The same [m] where two models are compared: no less than by so many times the rms of `doubt` (M,) m as in the
    recordings by that of what the fit leaves. What the mesh may be wrong by hangs together less than what a fit leaves.
    """
    return max(counted, known.lasting * float(np.sqrt(np.mean(doubt**2))))


def mesh_error(subject: Subject, experiment: Experiment, at: np.ndarray) -> np.ndarray:
    """What a finer mesh would change at every coordinate (M,) m of an experiment, which the fit has at (M,) m, carried
    on to the limit from half the cells; 0 where the mesh is the model's own.
    """
    fitted = subject.known.fitted
    if (finer := subject.finer_trial(experiment.scene, fitted.effects)) is None:
        return np.zeros_like(at)
    (there,) = residuals(finer, fitted.theta[None])
    return LOOP.richardson * (there - at)


def doubts(subject: Subject, trial: Trial, at: np.ndarray, jacobian: np.ndarray, mesh: np.ndarray) -> np.ndarray:
    """By how much the model may be wrong at every coordinate (M,) m: by its mesh (M,), and by what the least change of
    the parameters brings beyond the tangent; less what a refit makes up for.
    """
    known = subject.known
    step = np.where(known.unit < 0.5, NUDGE, -NUDGE)
    (nudged,) = residuals(trial, known.fitted.space.from_unit(known.unit + step)[None])
    wrong = nudged - at - jacobian @ step + mesh
    if not np.isfinite(wrong).all():
        raise Unsimulated("could not be simulated with half the cells, or after the least change of the parameters")
    told = information(jacobian, known.usual)
    return wrong - jacobian @ np.linalg.solve(known.matrix + told, pull_of(jacobian, wrong, known.usual))


def ranked(subject: Subject, found: Sequence[Promise], rank: str | None) -> list[Promise]:
    """The best first: of each experiment the shortest duration that tells nearly as much as the longest, then the
    others. By information, what makes the intervals wider comes last, as nats do not know of the mesh.
    """
    value = value_of(subject, rank)
    found = well_seen(found, value)
    experiments = {id(p.experiment): [q for q in found if q.experiment is p.experiment] for p in found}
    first = []
    for those in experiments.values():
        most = max(map(value, those))
        first.append(min((p for p in those if value(p) >= ENOUGH * most), key=lambda p: p.duration))
    rest = [p for p in found if p not in first]
    last = rank_of(subject, rank) == INFORMATION

    def order(promise: Promise) -> tuple[bool, float]:
        return not (last and promise.widens(subject.known.half)), value(promise)

    return [*sorted(first, key=order, reverse=True), *sorted(rest, key=order, reverse=True)]


def well_seen(found: Sequence[Promise], value: Callable[[Promise], float]) -> list[Promise]:
    """Each experiment of each duration by the best of the cameras; all as they are where there is none to choose."""
    groups: dict[tuple[int, float], list[Promise]] = {}
    for promise in found:
        groups.setdefault((id(promise.experiment), promise.duration), []).append(promise)
    out = []
    for those in groups.values():
        best, *_ = those = sorted(those, key=value, reverse=True)
        out.append(best if best.view is None else dataclasses.replace(best, views=tuple(those)))
    return out


def rank_of(subject: Subject, rank: str | None) -> str:
    """By what experiments are ranked: as asked for, or by a tie where there is one."""
    require_rank(rank, subject.known.fitted.space.names, bool(subject.ties))
    return rank or (TIE if subject.ties else INFORMATION)


def require_rank(rank: str | None, names: Sequence[str], tied: bool) -> None:
    """Refuse a word by which nothing can be ranked. names: of the parameters; tied: whether anything is."""
    if rank is not None and rank not in (known := (INFORMATION, TIE, *names)):
        raise ClothbenchError(f"setting 'rank' is {rank!r}, expected one of {', '.join(known)}")
    if rank == TIE and not tied:
        raise ClothbenchError("setting 'rank' is 'tie', and nothing is tied; name two effects with tied=ONE,OTHER")


def value_of(subject: Subject, rank: str | None) -> Callable[[Promise], float]:
    """The figure of a promise that is to be large."""
    rank = rank_of(subject, rank)
    if rank == TIE:
        return lambda promise: min(apart.least for apart in promise.apart)
    if rank == INFORMATION:
        return lambda promise: promise.gain
    k = subject.known.fitted.space.names.index(rank)
    return lambda promise: float(subject.known.half[k] / promise.after[k])
