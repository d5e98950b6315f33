"""The experiment that would tell two tied effects apart."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from clothbench import Observation, Scene
from clothbench.plugins.discovery import catalogue
from clothbench.studies.improve.attribution import shapes_looked_at
from clothbench.studies.improve.experiment import MOTIONS, parting_experiment
from clothbench.studies.improve.fitted import Fitted
from clothbench.studies.improve.problem import Problem, residuals
from clothbench.studies.improve.sheets import SheetCase, SheetEvidence

TIME = np.arange(0.0, 1.5, 0.05)
CLOCK = np.linspace(0.0, 1.5, 151)
HELD = np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0]])


def case_of(motion: float) -> SheetCase:
    """A sheet whose two corners swing across it by so many metres, seen at three points."""
    path = HELD + np.stack([0 * CLOCK, motion * np.sin(2 * np.pi * CLOCK) ** 2, 0 * CLOCK], axis=1)[:, None]
    points = np.array([[0.15, 0.1], [0.15, 0.2], [0.15, 0.3]])
    scene = Scene(0.3, 0.3, 0.2, CLOCK, HELD[:, [0, 2]], path, TIME, points, resolution=(5, 5))
    seen = np.zeros((len(TIME), 3, 3))
    observation = Observation(TIME, seen, np.ones(seen.shape[:2], bool), 1e-3, points)
    return SheetCase("swung", "fit", SimpleNamespace(path=""), observation, scene)


@pytest.fixture
def problem():
    return Problem("mass_spring", SheetEvidence((case_of(0.05),)), catalogue(), "least_squares")


def fit_of(problem: Problem, effects: tuple[str, ...], **values: float) -> Fitted:
    space = problem.space(effects)
    theta = np.array([values.get(p.name.partition(".")[2], p.default) for p in space])
    (trial,) = problem.trials(effects, "fit")
    residual = [residuals(trial, theta[None])[0]]
    return Fitted(effects, space, theta, residual, [np.ones((len(residual[0]), len(theta)))], theta, theta, 1)


def test_a_motion_done_otherwise():
    case = case_of(0.05)
    moved = case.moved(2.0, 0.5)
    assert moved.duration == pytest.approx(2 * case.duration)
    away, was = moved.scene.grip_position - HELD, case.scene.grip_position - HELD
    assert away == pytest.approx(2 * was)
    assert moved.scene.grip_time == pytest.approx(2 * CLOCK)
    assert case.scene.grip_time == pytest.approx(CLOCK)  # the recording's own stays


def test_moments_count_from_the_grips_first_stamp_and_frames_may_come_late():
    case = case_of(0.05)
    assert case.last_moment == case.duration == pytest.approx(1.45)
    late = dataclasses.replace(case.observation, time=TIME + 2.0)
    late = dataclasses.replace(
        case,
        observation=late,
        scene=dataclasses.replace(case.scene, times=TIME + 2.0, grip_time=np.linspace(0.0, 3.5, 151)),
    )
    assert late.duration == pytest.approx(1.45)
    problem = Problem("mass_spring", SheetEvidence((late,)), catalogue(), "least_squares")
    at = problem.space_of("grip_slip").names.index("time")
    times = [phi[at] for phi, _, _ in shapes_looked_at(problem, "grip_slip")]
    assert max(times) <= late.last_moment == pytest.approx(3.45)
    assert any(t > 2.0 for t in times)


def test_the_motion_named_parts_the_two_by_what_it_says(problem):
    """Still air and air that drags differ the more, the faster the sheet moves."""
    one, other = fit_of(problem, ("quadratic_drag",), normal=0.3), fit_of(problem, ("quadratic_drag",), normal=1.0)
    best = parting_experiment((problem, one), (problem, other))
    recorded = float(np.sqrt(np.mean((one.residual[0] - other.residual[0]) ** 2)))
    assert best.apart > 1.5 * recorded
    way, speed = next(motion for motion, how in MOTIONS.items() if how == best.how)
    moved = problem.restricted(problem.of_split("fit")[0].moved(way, speed))
    seen = [t.simulation.run(f.theta[None]).position[0] for f in (one, other) for t in moved.trials(f.effects, "fit")]
    assert best.apart == pytest.approx(float(np.sqrt(np.mean((seen[0] - seen[1]) ** 2))))
    assert best.seconds == pytest.approx(moved.of_split("fit")[0].duration)


def test_fits_whose_amounts_are_each_recording_s_own_are_simulated_with_them(problem):
    """Such a fit has the shared parameters only; the amount is held by a problem of its own."""
    (case,) = problem.of_split("fit")[:1]
    shared = fit_of(problem, ())

    def own(drag):
        amount = {f"quadratic_drag.{p.name}": p.default for p in problem.space_of("quadratic_drag")}
        amount["quadratic_drag.normal"] = drag
        return dataclasses.replace(problem.restricted(case), own={case.name: amount})

    def with_drag(drag):
        return own(drag), dataclasses.replace(shared, effects=("quadratic_drag",))

    best = parting_experiment(with_drag(0.3), with_drag(1.0))
    held = parting_experiment(
        *((problem.restricted(case), fit_of(problem, ("quadratic_drag",), normal=n)) for n in (0.3, 1.0))
    )
    assert best == held


def test_nothing_is_proposed_where_nothing_is_moved(problem):
    class Still(SheetCase):
        def moved(self, way, speed):
            return None

    case = problem.of_split("fit")[0]
    still = problem.restricted(Still(**{name: getattr(case, name) for name in case.__dataclass_fields__}))
    fit = fit_of(problem, ())
    assert parting_experiment((still, fit), (still, fit)) is None
