"""When the walks of `least_squares` end."""

from __future__ import annotations

import numpy as np
import pytest
from clothbench_optimizers.iterative_least_squares import IterativeLeastSquares
from clothbench_optimizers.least_squares import DAMPINGS, LeastSquares

from clothbench.core.errors import ClothbenchError
from clothbench.core.parameters import Parameter, ParameterSpace
from clothbench.core.protocols import Evaluation
from clothbench.estimation.search import drive
from clothbench.plugins.discovery import catalogue

SPACE = ParameterSpace(
    tuple(Parameter(n, n, "1", (0.0, 1.0), "linear", 0.2, "a number", "a test") for n in ("a", "b", "c"))
)


def walked(**settings) -> tuple[np.ndarray, int]:
    """Where one walk down a bowl ends (3,), and how many points it asked for."""

    def evaluate(theta: np.ndarray) -> Evaluation:
        residual = np.hstack([theta - 0.6, np.ones((len(theta), 1))])
        return Evaluation(np.square(residual).sum(axis=1), residual)

    search = LeastSquares(SPACE, seed=0, budget=200, starts=0, walks=1, **settings)
    asked = [(theta, found.value) for theta, found in drive(search, SPACE, evaluate)]
    points, values = (np.concatenate(parts) for parts in zip(*asked, strict=True))
    return points[int(np.argmin(values))], len(points)


def test_a_walk_ends_after_as_many_rounds_without_a_gain_as_it_has_patience():
    (end, few), (_, more), (_, most) = (walked(patience=patience) for patience in (1, 2, 3))
    assert end == pytest.approx(0.6, abs=1e-3)
    assert (more - few, most - more) == (len(DAMPINGS), len(DAMPINGS))
    assert walked()[1] == more  # two, where nothing is said


@pytest.mark.parametrize("budget", range(1, 40))
def test_no_more_than_a_third_of_the_budget_goes_into_looking_around(budget):
    assert len(LeastSquares(SPACE, seed=0, budget=budget).ask()) <= max(1, budget / 3)


@pytest.mark.parametrize("name", ["nelder_mead", "annealing"])
@pytest.mark.parametrize("start", ["defaults", "look"])
def test_where_all_about_the_start_is_lost_a_search_looks_elsewhere(name, start):
    def evaluate(theta: np.ndarray) -> Evaluation:
        value = np.square(theta - 0.8).sum(axis=1)
        return Evaluation(np.where((theta > 0.6).all(axis=1), value, np.nan))

    for seed in range(4):
        search = catalogue().make("optimizers", name, SPACE, seed=seed, budget=300, start=start)
        values = np.concatenate([found.value for _, found in drive(search, SPACE, evaluate)])
        assert np.nanmin(values) < 0.01

    def lost(theta: np.ndarray) -> Evaluation:
        return Evaluation(np.full(len(theta), np.nan))

    search = catalogue().make("optimizers", name, SPACE, seed=0, budget=100, start=start)
    points = np.concatenate([theta for theta, _ in drive(search, SPACE, lost)])
    assert len(np.unique(points, axis=0)) > 80


@pytest.mark.parametrize("budget", range(1, 12))
def test_a_new_measurement_begins_at_the_best_of_the_last_one(budget):
    """Also of the batch that spent the budget."""

    def evaluate(theta: np.ndarray) -> Evaluation:
        residual = theta - 0.6
        return Evaluation(np.square(residual).sum(axis=1), residual)

    search = IterativeLeastSquares(SPACE, seed=0, budget=budget)
    asked = [(theta, found.value) for theta, found in drive(search, SPACE, evaluate)]
    points, values = (np.concatenate(parts) for parts in zip(*asked, strict=True))
    search.renew()
    assert evaluate(search.ask()).value[0] <= values.min() + 1e-5  # differences are no steps of the walk
    assert len(points) <= budget


@pytest.mark.parametrize("name", ["least_squares", "iterative_least_squares"])
@pytest.mark.parametrize("lost", [np.nan, np.inf])
def test_beside_runs_that_are_lost_differences_go_to_the_other_side(name, lost):
    """Else a parameter would stay where it began, and the search would say that it converged."""

    def evaluate(theta: np.ndarray) -> Evaluation:
        residual = np.where(theta[:, :1] > 0.2001, lost, theta - 0.1)
        return Evaluation(np.square(residual).sum(axis=1), residual)

    search = catalogue().make("optimizers", name, SPACE, seed=0, budget=200)
    values = np.concatenate([found.value for _, found in drive(search, SPACE, evaluate)])
    assert np.nanmin(values) < 1e-9
    assert search.stopped == "converged"


@pytest.mark.parametrize("budget", [10.0, 7.5, True, "10", 0])
def test_a_budget_is_a_whole_number(budget):
    for name in ("least_squares", "ga"):
        with pytest.raises(ClothbenchError, match=f"{name}: budget is {budget!r}, expected a whole number, at least 1"):
            catalogue().make("optimizers", name, SPACE, seed=0, budget=budget)


@pytest.mark.parametrize("name", ["least_squares", "iterative_least_squares"])
def test_a_parameter_that_no_run_lets_move_is_told(name):
    def evaluate(theta: np.ndarray) -> Evaluation:
        residual = np.where(np.abs(theta[:, :1] - 0.2) > 1e-9, np.nan, theta - 0.1)
        return Evaluation(np.square(residual).sum(axis=1), residual)

    search = catalogue().make("optimizers", name, SPACE, seed=0, budget=200)
    values = np.concatenate([found.value for _, found in drive(search, SPACE, evaluate)])
    assert np.nanmin(values) == pytest.approx(0.01)
    assert search.stopped == "converged, but runs are lost to either side of a"


@pytest.mark.parametrize("name", ["least_squares", "iterative_least_squares"])
def test_what_has_a_residual_and_no_value_is_lost(name):
    """However small its residual: it would else be walked to."""

    def evaluate(theta: np.ndarray) -> Evaluation:
        residual = theta - 0.1
        return Evaluation(np.where(theta[:, 0] < 0.15, np.nan, np.square(residual).sum(axis=1)), residual)

    search = catalogue().make("optimizers", name, SPACE, seed=0, budget=200)
    values = np.concatenate([found.value for _, found in drive(search, SPACE, evaluate)])
    assert np.nanmin(values) < 1e-2
    assert np.isnan(values).mean() < 0.5
