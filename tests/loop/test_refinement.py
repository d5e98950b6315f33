"""What a coarse mesh has to do with the residual: halved cells, carried on to the limit."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest

from clothbench.core.parameters import Parameter, ParameterSpace
from clothbench.core.protocols import Score
from clothbench.studies.improve import refinement
from clothbench.studies.improve.account import Account
from clothbench.studies.improve.fitted import Fitted, jackknife_interval
from clothbench.studies.improve.refinement import corrected, discretisation_error, refinements

SPACE = ParameterSpace((Parameter("stiffness", "k", "N/m", (0.0, 1.0), "linear", 0.5, "of the model", "made up"),))
OTHERWISE = [np.array([[2.0], [1.0], [0.0]]), np.array([[0.0], [1.0], [0.0]])]  # what it does: nothing like the pattern
PATTERN = np.array([[1.0, -2.0, 0.5], [0.3, 0.0, 1.0]])  # of the mesh's error in two recordings [m]


@dataclass(frozen=True)
class Meshed:
    """A problem whose residuals are `left` plus an error that falls with the square (or another power) of the cell."""

    left: float
    order: float = 2.0
    cell: float = 1.0
    halvings: int = 0
    corrections: dict = field(default_factory=dict)
    seed: int = 0

    def uncorrected(self):
        return Meshed(self.left, self.order, self.cell, self.halvings)

    def refined(self):
        return Meshed(self.left, self.order, self.cell / 2)

    def space(self, names):
        return SPACE

    def of_split(self, split):
        return [SimpleNamespace(name=name) for name in ("first", "second")]

    def trials(self, names, split):
        return [self._trial(name, row) for name, row in zip(("first", "second"), PATTERN, strict=True)]

    def _trial(self, name, row):
        found = (self.left + row * self.cell**self.order)[None]
        if self.corrections:
            found = found + self.corrections[name]
        run = SimpleNamespace(run=lambda theta: SimpleNamespace(status=("ok",)))
        return SimpleNamespace(observation=None, simulation=run, metric=Told(found))


@dataclass(frozen=True)
class Told:
    """A metric that knows its residual."""

    residual: np.ndarray
    name: str = "told"
    unit: str = "m"

    def __call__(self, *_):
        return Score(np.zeros(len(self.residual)), self.unit, residual=self.residual)


def fit_of(problem, *_):
    """There is nothing to be fitted: what the problem's mesh leaves."""
    residual = [t.metric().residual[0] for t in problem.trials((), "fit")]
    middle = np.full(1, 0.5)
    return Fitted((), SPACE, middle, residual, OTHERWISE, middle - 0.1, middle + 0.1, 1)


@pytest.fixture
def judged(monkeypatch):
    """Runs `corrected` on a meshed problem, with that fit in place of a search."""
    monkeypatch.setattr(refinement, "fit", fit_of)
    return lambda problem, noise: corrected(problem, fit_of(problem), noise, Account(lambda *_: None))


def test_halved_cells_tell_the_error_of_the_mesh_where_it_falls_with_their_square():
    problem = Meshed(0.1)
    for error, _ in refinements(problem, fit_of(problem), "fit"):
        np.testing.assert_allclose(error, -PATTERN, atol=1e-12)
    steps = [np.linalg.norm(step) for _, step in refinements(problem, fit_of(problem), "fit")]
    np.testing.assert_allclose(steps, np.linalg.norm(PATTERN) * np.array([1.0, 0.25]))


def test_what_cannot_be_simulated_on_the_coarse_mesh_is_corrected_by_nothing(monkeypatch):
    """The parameters beside a fit may be such; a correction that is no number would spoil all that follows."""
    lost, problem = Meshed(np.nan), Meshed(0.1)
    fitted, finer = fit_of(problem), problem.refined()
    monkeypatch.setattr(Meshed, "refined", lambda self: finer if self.cell == 1.0 else None)
    found = list(refinements(lost, fitted, "fit"))
    assert len(found) == 1
    np.testing.assert_array_equal(found[0][0], np.zeros_like(PATTERN))
    assert not np.isfinite(found[0][1]).any()  # of how much of that is doubt nothing is known


def test_cells_are_halved_until_what_is_open_lies_below_the_noise(judged):
    once = np.sqrt(np.mean(PATTERN**2)) / 3  # a third of the first step
    for noise, halvings, mesh in ((1.1 * once, 1, once), (0.9 * once, 2, once / 4), (0.1 * once, 2, once / 4)):
        problem, after, doubt = judged(Meshed(0.1), noise)
        assert problem.halvings == halvings
        assert doubt == pytest.approx(mesh)
        np.testing.assert_allclose(after.residual, 0.1, atol=1e-12)
        np.testing.assert_allclose(discretisation_error(problem.uncorrected(), after, "held_out"), -PATTERN, atol=1e-12)


def test_what_an_earlier_fit_was_corrected_by_is_not_taken_away_twice(judged):
    """As after a name, or in another valley."""
    first, fitted, doubt = judged(Meshed(0.1), 0.01)
    problem, again, mesh = judged(first, 0.01)
    assert problem.halvings == first.halvings
    assert mesh == pytest.approx(doubt)
    np.testing.assert_allclose(again.residual, fitted.residual, atol=1e-12)
    np.testing.assert_allclose(problem.trials((), "fit")[0].metric().residual[0], again.residual[0], atol=1e-12)


def test_a_fit_without_the_correction_is_one_of_the_problem_without(judged):
    """Where a name has led to parameters with which the model does not converge."""
    problem, after, _ = judged(
        Meshed(0.1, order=-1.0, corrections=dict(zip(("first", "second"), -PATTERN, strict=True))), 0.01
    )
    assert not problem.corrections
    np.testing.assert_allclose(after.residual, 0.1 + PATTERN)


def test_a_model_that_does_not_converge_is_not_corrected(judged):
    """What finer cells change leads away from what was seen: all of it is doubt, and the residual stays."""
    problem, after, doubt = judged(Meshed(0.1, order=-1.0), 0.01)
    assert not problem.corrections
    np.testing.assert_allclose(after.residual, 0.1 + PATTERN)
    assert doubt == pytest.approx(2 / 3 * 4 / 3 * np.sqrt(np.mean(PATTERN**2)))  # two thirds of what it would come to


def test_the_mesh_is_looked_at_beside_the_base_with_the_effect_as_it_is():
    space = ParameterSpace((*SPACE, Parameter("drag", "c", "1", (0.0, 1.0), "linear", 0.5, "of an effect", "made up")))
    fitted = dataclasses.replace(fit_of(Meshed(0.1)), space=space, theta=np.array([0.5, 0.3]))
    beside = refinement.beside_fit(Meshed(0.1), fitted).theta
    assert abs(beside[0] - 0.5) == pytest.approx(0.05)
    assert beside[1] == 0.3


def test_a_third_of_what_the_mesh_is_corrected_by_stays_in_the_interval():
    names, fitted = ("first", "second"), fit_of(Meshed(0.1))
    changes = {name: 0.3 * column[:, 0] for name, column in zip(names, OTHERWISE, strict=True)}  # shifts by 0.3
    wide = refinement.with_errors_of_mesh_and_model(Meshed(0.1, corrections=changes), fitted, fitted.rms)
    np.testing.assert_allclose([0.5 - wide.low[0], wide.high[0] - 0.5], np.hypot(0.1, 0.1), rtol=1e-6)


def test_what_a_finer_mesh_cannot_simulate_may_all_be_the_mesh(judged, monkeypatch):
    """A second recording that diverges on finer cells: no correction of it, and all that is left of it in doubt."""
    coarse = Meshed._trial

    def trial(problem, name, row):
        return coarse(problem, name, row if problem.cell == 1.0 or name == "first" else np.full(3, np.nan))

    monkeypatch.setattr(Meshed, "_trial", trial)
    _, after, doubt = judged(Meshed(0.1), 0.01)
    np.testing.assert_allclose(after.residual[0], 0.1, atol=1e-12)
    np.testing.assert_allclose(after.residual[1], 0.1 + PATTERN[1])
    assert doubt >= np.sqrt(np.mean((0.1 + PATTERN[1]) ** 2) / 2)
    assert np.isfinite(after.low).all()


def test_a_parameter_that_changes_nothing_may_be_anything():
    """Nor may two that change the same."""
    names = ("a", "b", "nothing")
    space = ParameterSpace(tuple(Parameter(n, n, "1", (0.0, 2.0), "linear", 1.0, n, "made up") for n in names))
    random = np.random.default_rng(0)
    columns = [random.normal(size=(20, 1)) for _ in range(4)]
    residual = [0.01 * random.normal(size=20) for _ in columns]
    middle = np.array([1.2, 1.2, 1.2])
    low, high = jackknife_interval(space, middle, residual, [np.hstack([c, c, 0 * c]) for c in columns])
    assert (low.tolist(), high.tolist()) == ([0.0] * 3, [2.0] * 3)
    others = [np.hstack([c, random.normal(size=c.shape), 0 * c]) for c in columns]
    low, high = jackknife_interval(space, middle, residual, others)
    assert (high - low)[:2].max() < 0.1
    assert (low[2], high[2]) == (0.0, 2.0)
    told_once = [np.hstack([c, random.normal(size=c.shape) * (k == 0)]) for k, c in enumerate(columns)]
    two = ParameterSpace(space.parameters[:2])
    low, high = jackknife_interval(two, middle[:2], residual, told_once)  # who knows what another recording would say
    assert high[0] - low[0] < 0.1
    assert (low[1], high[1]) == (0.0, 2.0)
    low, high = jackknife_interval(two, middle[:2], residual, told_once, alone=True)
    assert high[1] - low[1] < 0.1


def few(recordings, off=0.0):
    """The interval that so many recordings give a fit whose search stopped `off` its end, of the scaled range."""
    random = np.random.default_rng(1)
    columns = [random.normal(size=(20, 1)) for _ in range(recordings)]
    residual = [0.01 * random.normal(size=20) + off * c[:, 0] for c in columns]
    return jackknife_interval(SPACE, np.array([0.5]), residual, columns)


def test_a_search_that_stopped_short_is_as_sure_as_one_that_did_not():
    """How far the fit moves without each recording is told from the mean of these, not from where it stopped."""
    np.testing.assert_allclose(few(4, off=0.1), few(4), rtol=1e-6)
    low, high = few(4)
    assert 0 < high[0] - low[0] < 0.1


@pytest.mark.parametrize(("recordings", "known"), [(2, False), (3, True)])
def test_fewer_than_three_recordings_give_no_interval(recordings, known):
    assert np.isfinite(few(recordings)).all() == known
