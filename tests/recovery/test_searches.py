"""Derivative-free searches on toys with a known bottom, and what makes each of them what it is."""

import itertools

import numpy as np
import pytest

from clothbench import ClothbenchError, Evaluation, Parameter, ParameterSpace
from clothbench.plugins.discovery import catalogue
from clothbench.testing.toys import bowl, cornered, valley


def search(name, problem, budget, seed=0, **options):
    """Play the caller's part; the optimizer at its end, all points (E, P) of the unit cube and their values (E,)."""
    optimizer = catalogue().make("optimizers", name, problem.space, seed=seed, budget=budget, **options)
    asked, told, batches = [], [], []
    while not optimizer.done:
        theta = optimizer.ask()
        evaluation = problem.evaluate(theta)
        optimizer.tell(theta, evaluation)
        asked.append(problem.space.to_unit(theta))
        told.append(evaluation.value)
        batches.append(len(theta))
    return optimizer, np.vstack(asked), np.concatenate(told), batches


@pytest.mark.parametrize("name", ["annealing", "nelder_mead", "cma_es"])
@pytest.mark.parametrize(
    ("make", "bottom", "near"),
    [(bowl, [0.62, 0.31, 0.73], 0.02), (valley, [0.75, 0.75, 0.75], 0.12), (cornered, [1.0, 0.0, 1.0], 0.05)],
)
def test_planted_parameters_are_recovered(name, make, bottom, near):
    problem = make() if make is cornered else make(3)
    for seed in (0, 1):
        _, unit, value, _ = search(name, problem, 500, seed)
        assert np.abs(unit[np.argmin(value)] - bottom).max() < near


@pytest.mark.parametrize("name", ["annealing", "nelder_mead", "cma_es"])
def test_a_search_may_begin_at_the_defaults(name):
    problem = bowl(3)
    optimizer, unit, *_ = search(name, problem, 60, start="defaults")
    here = problem.space.to_unit(problem.space.defaults)
    np.testing.assert_allclose(unit[0], here)
    np.testing.assert_allclose(optimizer.start, problem.space.defaults)
    looked, unit, value, _ = search(name, problem, 200)
    at = problem.evaluate(looked.start[None]).value[0]
    assert value.min() <= at <= problem.evaluate(problem.space.defaults[None]).value[0] * 2
    with pytest.raises(ClothbenchError, match="start is 'there'"):
        search(name, problem, 10, start="there")


def test_annealing_begins_with_every_point_of_the_grid():
    _, unit, value, batches = search("annealing", bowl(3), 300)
    assert batches[0] == 4**3
    assert {tuple(p) for p in (unit[:64] * 8).round(6)} == set(itertools.product((1, 3, 5, 7), repeat=3))
    optimizer, unit, value, batches = search("annealing", bowl(6), 100, gridded=2)
    assert batches[0] == 16
    assert (unit[:16, 2:] == unit[0, 2:]).all()  # one guess for what the grid leaves out
    np.testing.assert_allclose(optimizer.start, bowl(6).space.from_unit(unit[:16][np.argmin(value[:16])]))


def test_a_grid_beyond_the_budget_is_thinned():
    _, unit, _, batches = search("annealing", bowl(6), 100)
    assert 30 <= batches[0] <= 40
    line = (unit[: batches[0]] * 8).round(6)
    assert set(np.unique(line)) == {1, 3, 5, 7}
    assert len({tuple(p) for p in line}) == batches[0]


@pytest.mark.parametrize(("budget", "least"), [(40, 7), (30, 7)])
def test_annealing_moves_even_on_a_small_budget(budget, least):
    """With the settings of the suite static_dynamic: new simplices must not take all that the grid leaves."""
    *_, batches = search("annealing", bowl(6), budget, gridded=3, share=0.5)
    assert batches[:2] == [budget // 2, 6]
    assert sum(size == 1 for size in batches) >= least


def rippled(theta_space):
    """A bowl under ripples that trap a plain descent: minima all over, the deepest at the bowl's own bottom."""
    base = bowl(3)

    def evaluate(theta):
        told = base.evaluate(theta)
        unit = theta_space.to_unit(theta)
        ripple = 0.35 * (1 - np.cos(2 * np.pi * 7 * (unit - [0.62, 0.31, 0.73]))).sum(axis=1)
        return type(told)(told.value + ripple)

    return evaluate


def test_temperature_helps_out_of_local_minima():
    """Same budget, same start, ripples all the way: hot searches end lower than cold ones, on average over seeds."""
    space = bowl(3).space
    evaluate = rippled(space)

    def lowest(temperature, seed):
        optimizer = catalogue().make("optimizers", "annealing", space, seed=seed, budget=300, start="defaults",
                                     temperature=temperature)  # fmt: skip
        best = np.inf
        while not optimizer.done:
            theta = optimizer.ask()
            told = evaluate(theta)
            best = min(best, told.value.min())
            optimizer.tell(theta, told)
        return best

    hot, cold = (np.mean([lowest(t, s) for s in range(12)]) for t in (0.3, 1e-9))
    assert hot < cold


def test_nelder_mead_is_scipy_s():
    """One descent asks for the very points that scipy.optimize.minimize takes."""
    from scipy.optimize import minimize

    problem, taken = bowl(3), []

    def value_of(unit):
        taken.append(np.array(unit))
        return problem.evaluate(problem.space.from_unit(unit[None])).value[0]

    _, unit, *_ = search("nelder_mead", problem, 60, start="defaults")
    simplex = unit[:4]  # its first corner is the start, which is not asked for again
    options = {"initial_simplex": simplex, "adaptive": True, "xatol": 1e-3, "fatol": np.inf}
    minimize(value_of, simplex[0], method="Nelder-Mead", bounds=[(0, 1)] * 3, options=options)
    count = min(len(taken), 60)
    np.testing.assert_allclose(unit[:count], np.array(taken)[:count], atol=1e-9)


def test_nelder_mead_asks_for_nothing_that_it_knows_when_it_begins_anew():
    optimizer, unit, _, batches = search("nelder_mead", bowl(3), 500)
    assert optimizer.stopped == "converged"
    assert batches[0] == 17
    assert batches.count(3) >= 2  # simplices, each without its first corner
    assert 4 not in batches
    assert len(np.unique(unit, axis=0)) == len(unit)


@pytest.mark.parametrize("size", [0.01, 1e-3, 5e-4])
def test_nelder_mead_moves_from_a_small_simplex_before_it_says_that_it_converged(size):
    """The optimum is far off, and even a small simplex grows towards it."""
    problem = bowl(3)
    optimizer, unit, value, _ = search("nelder_mead", problem, 500, start="defaults", size=size)
    assert optimizer.stopped == "converged"
    assert np.abs(unit[np.argmin(value)] - [0.62, 0.31, 0.73]).max() < 0.05


@pytest.mark.parametrize(
    ("name", "budget", "told"),
    [("ga", 951, "50 generations"), ("ga", 950, "budget spent"), ("ga", 1000, "50 generations"),
     ("annealing", 100, "cooled down"), ("cma_es", 100, "budget spent"), ("cma_es", 8, "budget spent")],
)  # fmt: skip
def test_a_search_that_ends_with_its_budget_says_why_it_ended(name, budget, told):
    optimizer, unit, *_ = search(name, bowl(3), budget)
    assert optimizer.stopped == told
    assert len(unit) == min(budget, 951)


def test_an_abandoned_search_leaves_no_thread():
    import gc
    import threading

    gc.collect()  # what other tests have left
    before = threading.active_count()
    optimizer = catalogue().make("optimizers", "nelder_mead", bowl(3).space, seed=0, budget=500)
    for _ in range(8):
        theta = optimizer.ask()
        optimizer.tell(theta, bowl(3).evaluate(theta))
    del optimizer
    gc.collect()
    assert threading.active_count() == before


@pytest.mark.parametrize(
    ("name", "options", "found"),
    [
        ("annealing", {"levels": 1}, "levels is 1"),
        ("annealing", {"share": 1.5}, "share is 1.5"),
        ("nelder_mead", {"size": 0}, "size is 0"),
        ("nelder_mead", {"starts": 0}, "starts is 0"),
        ("cma_es", {"population": 2}, "population is 2"),
        ("ga", {"decoding": "gray"}, "expected one of own, linear"),
        ("ga", {"crossover": "often"}, "ga: crossover is 'often', expected a number from 0 to 1"),
        ("ga", {"generations": True}, "ga: generations is True, expected a whole number, at least 1"),
        ("least_squares", {"starts": -1}, "least_squares: starts is -1, expected a whole number, at least 0"),
        ("least_squares", {"walks": 0}, "least_squares: walks is 0, expected a whole number, at least 1"),
        ("least_squares", {"patience": 1.5}, "least_squares: patience is 1.5, expected a whole number"),
        ("least_squares", {"difference": 0}, "least_squares: difference is 0, expected a number above 0 and below 0.5"),
        ("least_squares", {"tolerance": "fine"}, "least_squares: tolerance is 'fine', expected a number"),
        ("iterative_least_squares", {"scan": 0}, "iterative_least_squares: scan is 0, expected a whole number"),
        ("iterative_least_squares", {"difference": 0}, "iterative_least_squares: difference is 0, expected a number"),
        ("iterative_least_squares", {"tolerance": -1}, "iterative_least_squares: tolerance is -1, expected a number"),
    ],
)
def test_wrong_options_are_one_line(name, options, found):
    with pytest.raises(ClothbenchError, match=found):
        search(name, bowl(3), 20, **options)


@pytest.mark.parametrize("name", ["least_squares", "iterative_least_squares"])
def test_a_metric_without_residuals_is_refused_in_the_optimizers_own_name(name):
    optimizer = catalogue().make("optimizers", name, bowl(3).space, seed=0, budget=200)
    theta = optimizer.ask()
    with pytest.raises(ClothbenchError, match=f"^{name}: this metric has no residuals"):
        optimizer.tell(theta, Evaluation(np.ones(len(theta))))


def test_bits_may_count_from_bound_to_bound():
    """Bits are drawn evenly: two thirds of a first generation lie above a third of what they count in."""
    space = ParameterSpace((Parameter("k", "k", "N/m", (1.0, 1000.0), "log", 10.0, "a stiffness", ""),))
    for decoding, low, high in (("own", 0.0, 0.25), ("linear", 0.5, 1.0)):
        optimizer = catalogue().make(
            "optimizers", "ga", space, seed=3, budget=200, population=200, generations=1, decoding=decoding
        )
        share = float(np.mean(optimizer.ask() > 333.0))
        assert low < share < high
