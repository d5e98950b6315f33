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
from clothbench.estimation.intervals import clusters
from clothbench.estimation.trials import Trial
from clothbench.studies.improve.fitted import Fitted
from clothbench.studies.improve.fitting import finite_differences, fit
from clothbench.studies.improve.problem import Problem
from clothbench.studies.improve.settings import LOOP
from clothbench.studies.improve.sheets import SheetCase, SheetEvidence, noise_of
from clothbench.suggest.information import beforehand, counted_noise, information


@dataclass(frozen=True, eq=False)
class Known:
    """A fitted model and what the recordings tell of its parameters.

    fitted: the fit; counted: m, what each coordinate counts as its noise; noise: m, the sensor's; matrix: (P, P), the
    information of the recordings and of the range that is searched, in the unit cube.
    """

    fitted: Fitted
    counted: float
    noise: float
    matrix: np.ndarray

    @cached_property
    def unit(self) -> np.ndarray:
        """The fit in the unit cube (P,)."""
        return self.fitted.space.to_unit(self.fitted.theta)


@dataclass(frozen=True, eq=False)
class Tie:
    """Two effects (or sets of them) that fit alike: one and its rival, each with its fit.

    now: by how much more the rival leaves, √Δχ² [σ], 0 where it leaves less.
    """

    one: str
    other: str
    known: Known
    rival: Known
    now: float


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
        return float(1 / np.median(np.diff(self.like.observation.time)))

    def trial(self, scene: Scene, effects: Sequence[str], refined: bool = False) -> Trial | None:
        """An experiment as a trial, seen at every point in every frame, with everything measured at the origin: its
        residual is where the points are. refined: with half the cells and half the step; None where nothing is
        discretised.
        """
        frames, points = len(scene.times), len(scene.points)
        seen = Observation(
            scene.times, np.zeros((frames, points, 3)), np.ones((frames, points), bool), self.known.noise, scene.points,
        )  # fmt: skip
        case = dataclasses.replace(self.like, split="fit", observation=seen, scene=scene)
        problem = self.problem.restricted(case)
        if refined and (problem := problem.refined()) is None:
            return None
        return problem.trials(effects, "fit")[0]


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
    if problem.evidence.in_pictures:
        raise ClothbenchError(
            f"{where}: found points in one camera's picture, expected places in space (a sheet in another place may be "
            "out of that picture)"
        )


def known_of(problem: Problem, fitted: Fitted) -> Known:
    """What the recordings tell of a fit's parameters."""
    trials = problem.trials(fitted.effects, "fit")
    noise = [noise_of(trial.observation) for trial in trials]
    sigma = float(np.sqrt(np.mean(np.square(noise))))
    residual, jacobian = np.concatenate(fitted.residual), np.vstack(fitted.jacobian)
    scores = [Score(np.zeros(1), "m", residual=one[None]) for one in fitted.residual]
    counted = counted_noise(residual, jacobian, clusters(trials, scores), sigma if np.isfinite(sigma) else 0.0)
    return Known(fitted, counted, sigma, information(jacobian, counted) + beforehand(len(fitted.space)))


def with_noise(known: Known, counted: float) -> Known:
    """The same with another noise that each coordinate counts for."""
    jacobian = np.vstack(known.fitted.jacobian)
    matrix = information(jacobian, counted) + beforehand(jacobian.shape[1])
    return dataclasses.replace(known, counted=counted, matrix=matrix)


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
    nowhere = np.full(len(space), np.nan)
    return Fitted(names, space, theta, residual, jacobian, nowhere, nowhere, count)


def searched(problem: Problem, names: tuple[str, ...], start: Mapping[str, float] | None = None) -> Fitted:
    """A fit by least squares; from the values that are known, with the defaults of all others, or from a wide look."""
    begin = None
    if start is not None:
        begin = np.array([start.get(p.name, p.default) for p in problem.space(names)])
    found = fit(problem, names, begin, LOOP.calibration_rounds)
    if not np.isfinite(found.rms):
        raise ClothbenchError(
            f"model {problem.model!r}: found no parameters with which all recordings to fit can be simulated; leave "
            "out those that it cannot do, or choose another model"
        )
    return found


def subject_of(
    problem: Problem,
    effects: tuple[str, ...],
    tied: Sequence[tuple[str, str]],
    values: Mapping[str, float] | None = None,
) -> Subject:
    """The recordings with their fit, and one tie for each pair (effect, rival). values: of a fit that was found before;
    without, it is searched.
    """
    require_sheets(problem)
    first = searched(problem, effects) if values is None else fitted_at(problem, effects, values)
    known, ties = known_of(problem, first), []
    for one, other in tied:
        names = tuple(other if name == one else name for name in effects)
        shared = dict(zip(first.space.names, first.theta.tolist(), strict=True))
        ties.append(tie_of(one, other, known, known_of(problem, searched(problem, names, shared))))
    return Subject(problem, known, tuple(ties))


def tie_of(one: str, other: str, known: Known, rival: Known) -> Tie:
    """Both count by the same noise: that of the one which leaves less."""
    counted = min(known.counted, rival.counted)
    left = [sum(float(r @ r) for r in k.fitted.residual) for k in (known, rival)]
    now = float(np.sqrt(max(left[1] - left[0], 0.0))) / counted
    return Tie(one, other, with_noise(known, counted), with_noise(rival, counted), now)
