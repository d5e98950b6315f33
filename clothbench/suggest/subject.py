"""What is asked about: recordings beside a fitted model, and the effects that they cannot tell apart."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.observation import Observation
from clothbench.core.protocols import Score
from clothbench.core.scene import Scene
from clothbench.estimation.intervals import beside_held, clusters, held_by_bounds, jackknife
from clothbench.estimation.trials import Trial
from clothbench.studies.improve.fitted import Fitted
from clothbench.studies.improve.fitting import finite_differences, fit
from clothbench.studies.improve.problem import Problem
from clothbench.studies.improve.refinement import refinements
from clothbench.studies.improve.settings import LOOP
from clothbench.studies.improve.sheets import SheetCase, SheetEvidence, noise_of
from clothbench.suggest.information import (
    BEFOREHAND,
    beforehand,
    counted_noise,
    half_widths,
    information,
    pull_of,
    told_apart,
)  # fmt: skip
from clothbench.suggest.settings import Sensor
from clothbench.suggest.weighted import patient, weighted

CLEARLY = 3.0  # σ, by which a rival has to fit better to take the place of what was named first
REWEIGHTED = 1  # times that recordings are weighed anew by what the fit before left of each


@dataclass(frozen=True, eq=False)
class Known:
    """A fitted model and what the recordings tell of its parameters.

    fitted: the fit; counted: (R,) m, what each coordinate of each recording counts as its noise; noise: m, the
    sensor's; mesh: m, what a finer mesh would change in each recording, (M,) each; matrix: (P, P), the information of
    the recordings and of the range that is searched, in the unit cube; pull: (P,), how the mesh pulls at the fit;
    groups: row numbers of each recording's residual, by its pieces of evidence, seconds.
    """

    fitted: Fitted
    counted: np.ndarray
    noise: float
    mesh: tuple[np.ndarray, ...]
    matrix: np.ndarray
    pull: np.ndarray
    groups: tuple[list[np.ndarray], ...]

    @cached_property
    def unit(self) -> np.ndarray:
        """The fit in the unit cube (P,)."""
        return self.fitted.space.to_unit(self.fitted.theta)

    @property
    def half(self) -> np.ndarray:
        """Half-widths of the 95 % intervals (P,), in scaled ranges, as far as the information goes."""
        return half_widths(self.matrix, self.pull)

    @cached_property
    def told(self) -> np.ndarray:
        """The same as they are told: no narrower than a calibration's, up to the range that counts as known.

        What a model errs by lasts, so that sums over whole recordings go astray further than those over seconds say of
        which the fit has taken its share: without a second of one the fit would move so far (see `jackknife`).
        """
        count = np.array([len(of_one) for of_one in self.groups])
        counted, fitted, start = told_apart(self.counted, count), self.fitted, 0
        pieces, residual, jacobian = [], [], []
        for r, j, of_one, kappa in zip(fitted.residual, fitted.jacobian, self.groups, counted, strict=True):
            residual.append(r / kappa)
            jacobian.append(j / kappa)
            pieces += [start + rows for rows in of_one]
            start += len(r)
        left, columns = np.concatenate(residual), np.vstack(jacobian)
        held = held_by_bounds(fitted.space, fitted.theta, columns, left)
        astray = beside_held(lambda some: jackknife(some, left, pieces), columns, held)
        return np.maximum(self.half, np.minimum(astray, BEFOREHAND))

    @property
    def usual(self) -> float:
        """m: what a coordinate counts as its noise, over all recordings."""
        return float(np.sqrt(np.mean(self.counted**2)))

    @property
    def lasting(self) -> float:
        """By how many times the rms that it leaves a coordinate counts, as a mean over the recordings: 1 where its
        errors are independent, more where they last and hang together over the sheet.
        """
        left = np.array([np.sqrt(np.mean(residual**2)) for residual in self.fitted.residual])
        return float(np.mean(self.counted / np.maximum(left, self.noise)))


@dataclass(frozen=True, eq=False)
class Tie:
    """Two effects (or sets of them) that fit alike: one and its rival, each with its fit.

    now: by how much more the rival leaves, √Δχ² [σ], 0 where it leaves less; behind: by how much less, 0 where more.
    """

    one: str
    other: str
    known: Known
    rival: Known
    now: float
    behind: float = 0.0


@dataclass(frozen=True, eq=False)
class Subject:
    """problem: the recordings and the model; known: its fit, with the effects that count; ties: what is tied."""

    problem: Problem
    known: Known
    ties: tuple[Tie, ...]

    @property
    def like(self) -> SheetCase:
        """The recording whose sheet, points, frames and camera further experiments have."""
        return first_case(self.problem)

    @property
    def rate(self) -> float:
        """Frames a second."""
        return rate_of(self.like)

    def trial(self, scene: Scene, effects: Sequence[str]) -> Trial:
        """An experiment as a trial, seen at every point in every frame, with everything measured at the origin: its
        residual is where the points are.
        """
        return self._with(scene).trials(effects, "fit")[0]

    def finer_trial(self, scene: Scene, effects: Sequence[str]) -> Trial | None:
        """The same with half the cells and half the step; None where the mesh is the model's own, as in a cell of a run
        that states neither scene.resolution nor scene.spacing.
        """
        if scene.resolution is None or (finer := self._with(scene).refined()) is None:
            return None
        return finer.trials(effects, "fit")[0]

    def _with(self, scene: Scene) -> Problem:
        frames, points = len(scene.times), len(scene.points)
        seen = Observation(
            scene.times, np.zeros((frames, points, 3)), np.ones((frames, points), bool), self.known.noise, scene.points
        )
        return self.problem.restricted(dataclasses.replace(self.like, split="fit", observation=seen, scene=scene))


def rate_of(case: SheetCase) -> float:
    """Frames a second of a recording."""
    return float(1 / np.median(np.diff(case.observation.time)))


def sensor_of(problem: Problem) -> Sensor | None:
    """The camera in whose picture the recordings are, or None."""
    require_sheets(problem)
    observation = first_case(problem).observation
    return None if observation.sight is None else recorded_by(observation)


def recorded_by(observation: Observation) -> Sensor:
    """What saw points in its picture, its noise the one that they have."""
    camera, pixel = observation.sight, observation.pixel_size()[observation.visible]
    assert camera is not None
    across = 2 * np.degrees(np.arctan(camera.size[0] / 2 / camera.matrix[0, 0]))
    return Sensor(noise=noise_of(observation) / float(pixel.mean()), field_of_view=float(across), size=camera.size)


def first_case(problem: Problem) -> SheetCase:
    return problem.of_split("fit")[0]  # type: ignore[return-value]


def require_sheets(problem: Problem) -> None:
    """Refuse recordings that no other experiment can be made of."""
    if not isinstance(problem.evidence, SheetEvidence):
        raise ClothbenchError(
            f"found recordings of kind {problem.evidence.kind!r}, expected sheets that grips hold (kind 'nodes')"
        )
    case = first_case(problem)
    where = case.recording.path or case.name
    if not len(case.scene.grip_material):
        raise ClothbenchError(f"{where}: found no grips, expected a sheet that something holds and can move")


def known_of(problem: Problem, fitted: Fitted) -> Known:
    """What the recordings tell of a fit's parameters."""
    trials = problem.trials(fitted.effects, "fit")
    noise = np.array([noise_of(trial.observation) for trial in trials])
    if not np.isfinite(noise).all():
        short = trials[int(np.flatnonzero(~np.isfinite(noise))[0])].name
        raise ClothbenchError(
            f"{short}: noise_sigma: found NaN in a recording too short to show its noise, expected metres; state it"
        )
    groups = tuple(seconds(trial, len(residual)) for trial, residual in zip(trials, fitted.residual, strict=True))
    each = zip(fitted.residual, fitted.jacobian, groups, noise, strict=True)
    counted = np.array([counted_noise(*one) for one in each])
    sensor, mesh, nothing = float(np.sqrt(np.mean(noise**2))), mesh_errors(problem, fitted), np.empty(0)
    return counting(Known(fitted, counted, sensor, mesh, nothing, nothing, groups), counted)


def mesh_errors(problem: Problem, fitted: Fitted) -> tuple[np.ndarray, ...]:
    """What a finer mesh would change in each recording, (M,) m each, carried on to the limit from one halving of cells
    and step; 0 where the mesh is the model's own, and all that is left of a recording that cannot be simulated then.
    """
    stated = all(case.scene.resolution is not None for case in problem.of_split("fit"))  # type: ignore[attr-defined]
    for error, last in refinements(problem, fitted, "fit", 1) if stated else ():
        known = [np.isfinite(one).all() for one in last]
        return tuple(e if there else -r for e, there, r in zip(error, known, fitted.residual, strict=True))
    return tuple(np.zeros_like(residual) for residual in fitted.residual)


def seconds(trial: Trial, rows: int) -> list[np.ndarray]:
    """Row numbers of a residual of so many rows, second by second."""
    return clusters([trial], [Score(np.zeros(1), "m", residual=np.empty((1, rows)))])


def counting(known: Known, counted: np.ndarray) -> Known:
    """The same with other noises (R,) m that the coordinates count for."""
    each = list(zip(known.fitted.jacobian, known.mesh, counted, strict=True))
    matrix = beforehand(len(known.fitted.space)) + np.sum([information(j, kappa) for j, _, kappa in each], axis=0)
    pull = np.sum([pull_of(*one) for one in each], axis=0)
    return dataclasses.replace(known, counted=counted, matrix=matrix, pull=pull)


def fitted_at(problem: Problem, names: tuple[str, ...], values: Mapping[str, float]) -> Fitted:
    """A fit that was found before, by its parameters' values: nothing is searched."""
    space = problem.space(names)
    if missing := [name for name in space.names if name not in values]:
        raise ClothbenchError(
            f"found no value of parameter {missing[0]!r} among those that were fitted, expected all of "
            f"{', '.join(space.names)}; state bounds, options and base as that run had them"
        )
    theta = np.array([values[name] for name in space.names])
    step = problem.evidence.search.difference
    residual, jacobian, count = finite_differences(problem.trials(names, "fit"), space, theta, step)
    if not all(np.isfinite(one).all() for one in residual):
        raise ClothbenchError(
            f"model {problem.model!r}: cannot simulate all recordings to fit with the parameters that were found; "
            "leave out those that it cannot do, or choose another model"
        )
    nowhere = np.full(len(space), np.nan)
    return Fitted(names, space, theta, residual, jacobian, nowhere, nowhere, count)


def searched(problem: Problem, names: tuple[str, ...], start: Mapping[str, float] | None = None) -> Known:
    """A fit by least squares, from the values that are known, with the defaults of all others, or from a wide look;
    where there are several recordings, fitted again with each by what the model left of it.
    """
    begin, space, problem = None, problem.space(names), patient(problem)
    if start is not None:
        begin = np.array([start.get(p.name, p.default) for p in space])
    known = at(problem, names, fit(problem, names, begin, LOOP.calibration_rounds).theta)
    cases = [case.name for case in problem.of_split("fit")]
    for _ in range(REWEIGHTED if len(cases) > 1 else 0):
        again = weighted(problem, dict(zip(cases, known.counted.tolist(), strict=True)))
        known = at(problem, names, fit(again, names, known.fitted.theta, LOOP.final_rounds).theta)
    return known


def at(problem: Problem, names: tuple[str, ...], theta: np.ndarray) -> Known:
    space = problem.space(names)
    return known_of(problem, fitted_at(problem, names, dict(zip(space.names, theta.tolist(), strict=True))))


def subject_of(
    problem: Problem,
    effects: tuple[str, ...],
    tied: Sequence[tuple[str, str]],
    values: Mapping[str, float] | None = None,
) -> Subject:
    """The recordings with their fit, and one tie for each pair (effect, rival). values: of a fit that was found before;
    without, it is searched, and a rival that clearly fits better is what the others are held against.
    """
    require_sheets(problem)
    known = searched(problem, effects) if values is None else known_of(problem, fitted_at(problem, effects, values))
    ties = []
    for one, other in tied:
        names = tuple(other if name == one else name for name in effects)
        shared = dict(zip(known.fitted.space.names, known.fitted.theta.tolist(), strict=True))
        ties.append(tie_of(one, other, known, searched(problem, names, shared)))
    best = max(ties, key=lambda tie: tie.behind, default=None)
    if values is None and best is not None and best.behind > CLEARLY:
        known, fits = best.rival, {best.one: best.known, **{tie.other: tie.rival for tie in ties if tie is not best}}
        ties = [tie_of(best.other, other, known, rival) for other, rival in fits.items()]
    return Subject(problem, known, tuple(ties))


def tie_of(one: str, other: str, known: Known, rival: Known) -> Tie:
    """Both count by the same noises: of each recording that of the one which leaves less."""
    counted = np.minimum(known.counted, rival.counted)
    left = [np.array([float(r @ r) for r in k.fitted.residual]) / counted**2 for k in (known, rival)]
    more = float((left[1] - left[0]).sum())
    now, behind = np.sqrt(max(more, 0.0)), np.sqrt(max(-more, 0.0))
    return Tie(one, other, counting(known, counted), counting(rival, counted), float(now), float(behind))
