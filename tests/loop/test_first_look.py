"""First looks on a coarser mesh: what it is, and that the fit leaves there what it leaves on its own."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from clothbench import Observation, Scene
from clothbench.plugins.discovery import catalogue
from clothbench.studies.improve.account import Account
from clothbench.studies.improve.fitted import Fitted
from clothbench.studies.improve.fitting import first_look, fit
from clothbench.studies.improve.loop import calibrated
from clothbench.studies.improve.problem import Problem, residuals
from clothbench.studies.improve.settings import LOOP
from clothbench.studies.improve.sheets import SheetCase, SheetEvidence, coarsened

TIME = np.arange(0.0, 1.0, 0.1)
CLOCK = np.linspace(0.0, 1.0, 101)
HELD = np.stack([np.linspace(0.0, 0.3, 4), np.zeros(4), np.zeros(4)], axis=1)  # the whole upper edge: nothing wrinkles
POINTS = np.array([[0.15, 0.1], [0.15, 0.2], [0.15, 0.3]])
TRUTH = {"k1": 80.0, "k2": 0.5, "zeta": 0.05}


def problem_of(nodes: int) -> Problem:
    """A sheet whose upper edge swings across it, seen at three points as springs on twice as fine a mesh have it."""
    path = HELD + np.stack([0 * CLOCK, 0.05 * np.sin(2 * np.pi * CLOCK) ** 2, 0 * CLOCK], axis=1)[:, None]
    scene = Scene(0.3, 0.3, 0.2, CLOCK, HELD[:, [0, 2]], path, TIME, POINTS, resolution=(25, 25))
    simulation = catalogue().make("models", "mass_spring").prepare(scene, ())
    seen = simulation.run(np.array([[TRUTH[p.name] for p in simulation.parameters]])).position[0]
    observation = Observation(TIME, seen, np.ones(seen.shape[:2], bool), 1e-3, POINTS)
    coarse = dataclasses.replace(scene, resolution=(nodes, nodes))
    case = SheetCase("swung", "fit", None, observation, coarse)
    return Problem("mass_spring", SheetEvidence((case,)), catalogue(), "least_squares")


def fit_at_defaults(problem: Problem) -> Fitted:
    space, (trial,) = problem.space(()), problem.trials((), "fit")
    residual = residuals(trial, space.defaults[None])[0]
    return Fitted(
        (), space, space.defaults, [residual], [np.ones((len(residual), len(space)))], space.low, space.high, 1
    )


@pytest.mark.parametrize(
    ("nodes", "fewer"), [((13, 13), (7, 7)), ((9, 9), (7, 7)), ((7, 7), (7, 7)), ((5, 9), (5, 9)), ((13, 33), (7, 17))]
)
def test_cells_are_doubled_as_far_as_six_are_left(nodes, fewer):
    scene = problem_of(9).of_split("fit")[0].scene
    assert coarsened(dataclasses.replace(scene, resolution=nodes)).resolution == fewer


def test_what_the_fit_leaves_is_left_on_the_coarser_mesh_too():
    problem = problem_of(13)
    fitted = fit_at_defaults(problem)
    coarse = first_look(problem, fitted)
    (case,), (trial,) = coarse.of_split("fit"), coarse.trials((), "fit")
    assert case.scene.resolution == (7, 7)
    assert residuals(trial, fitted.theta[None])[0] == pytest.approx(fitted.residual[0], abs=1e-12)
    # What an effect of some size changes is much the same on both meshes.
    tilted = np.concatenate([fitted.theta, [0.1, 0.0]])
    fine, rough = (residuals(p.trials(("gravity_tilt",), "fit")[0], tilted[None])[0] for p in (problem, coarse))
    change, looked = fine - fitted.residual[0], rough - fitted.residual[0]
    assert np.linalg.norm(change) > 0.01
    assert change @ looked > 0.9 * np.linalg.norm(change) * np.linalg.norm(looked)


def test_where_no_coarser_mesh_is_there_the_problem_is_its_own_first_look():
    problem = problem_of(7)
    assert first_look(problem, fit_at_defaults(problem)) is problem


def test_the_base_sought_on_a_coarser_mesh_is_fitted_on_its_own():
    problem = problem_of(9)
    account = Account(lambda *_: None)
    base = calibrated(problem, account)
    (trial,) = problem.trials((), "fit")
    assert residuals(trial, base.theta[None])[0] == pytest.approx(base.residual[0], abs=1e-12)
    direct = fit(problem, (), None, LOOP.calibration_rounds)
    assert base.rms < 1.05 * direct.rms
    assert base.evaluations < direct.evaluations / 2
    assert account.evaluations > base.evaluations
