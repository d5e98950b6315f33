"""Several objectives at once: the front, the choice from it, and how they reach fits and searches."""

from types import SimpleNamespace

import numpy as np
import pytest
from clothbench_optimizers.evolution import HybridEa, SimpleEa

from clothbench import ClothbenchError, Evaluation, Score
from clothbench.estimation.front import chosen, on_front
from clothbench.studies.calibration import run
from clothbench.studies.calibration.front_page import parallel
from clothbench.studies.calibration.plan import choice_of
from clothbench.studies.calibration.tables import fit_and_least
from clothbench.testing.toys import bowl, partly_lost


def test_the_front_is_what_nothing_beats_in_all():
    rows = np.array([[1, 4], [2, 2], [4, 1], [3, 3], [2, 2], [np.nan, 0]], dtype=float)
    assert on_front(rows).tolist() == [True, True, True, False, True, False]


def test_the_front_agrees_with_pymoos():
    from pymoo.util.nds.non_dominated_sorting import NonDominatedSorting

    rows = np.random.default_rng(2).random((200, 3))
    theirs = NonDominatedSorting().do(rows, only_non_dominated_front=True)
    assert set(np.flatnonzero(on_front(rows))) == set(theirs)


def test_nearest_and_knee_are_different_choices():
    bend = np.array([[0.0, 1.0], [0.15, 0.2], [1.0, 0.0], [0.05, 0.05 + 1]])
    value = np.array([0.7, 0.5, 0.1, 9.0])
    assert chosen(bend, value, "nearest") == 2
    assert chosen(bend, value, "knee") == 1
    assert chosen(bend[:, :1], bend[:, 0], "knee") == 0
    assert chosen(np.full((3, 2), np.nan), np.array([np.nan, 3.0, 2.0]), "knee") == 2


def test_the_knee_lies_farthest_below_the_line_between_the_extremes():
    """(0.05, 0.5) by 0.45/√2, (0.45, 0.45) by 0.1/√2, whatever the units."""
    rows = np.array([[0.0, 1.0], [0.05, 0.5], [0.45, 0.45], [1.0, 0.0]])
    for scale, shift in (([1.0, 1.0], 0.0), ([1e3, 1e-3], 0.0), ([1.0, 20.0], 5.0)):
        assert chosen(shift + rows * scale, np.ones(4), "knee") == 1


def test_the_nearest_of_several_recordings_is_on_the_front():
    """Two recordings, two evaluations: the first has the less mean of roots of squares, the second both objectives."""
    each = np.array([[[1.0, 1.0], [0.0, 1.9]], [[1.0, 1.0], [1.9, 0.0]]])
    value, objectives = np.sqrt((each**2).mean(axis=2)).mean(axis=0), each.mean(axis=0)
    assert (value.argmin(), chosen(objectives, value, "nearest")) == (0, 1)


def test_a_front_without_its_fit_is_shown_without_it():
    rows = [{"objective": "dc", "evaluation": 1, "chosen": False, "distance": 1.0}]
    assert fit_and_least(rows) == []


def test_the_names_of_the_outer_objectives_have_room():
    rows = [{"objective": o, "evaluation": 1, "chosen": True, "spreads": 1.0} for o in ("drape", "unevenness")]
    assert parallel(rows)["layout"]["xaxis"]["range"] == [-0.5, 1.5]


def test_an_unknown_choice_is_refused():
    assert choice_of(None) == "nearest"
    with pytest.raises(ClothbenchError, match="expected one of nearest, knee"):
        choice_of("best")


def two_goals(unit):
    """Distances to two points: the front is the line between them."""
    return np.stack([np.linalg.norm(unit - goal, axis=1) for goal in (0.3, 0.7)], axis=1)


def searched(factory, seed, budget=160):
    """What a search finds of two goals, and how many times it asked: objectives (E, 2)."""
    space, found = bowl(3).space, []
    search = factory(space, seed=seed, budget=budget)
    while not search.done:
        theta = search.ask()
        goals = two_goals(space.to_unit(theta))
        found.append(goals)
        search.tell(theta, Evaluation(goals.sum(axis=1), residual=goals, objectives=goals))
    return np.concatenate(found)


def test_a_front_s_distances_are_the_mean_of_those_of_its_recordings(monkeypatch):
    """Two recordings, both 1 mm off, whose cloth differs by 10 mm and by 1 mm from itself."""
    scores = [Score(np.ones(1), "mm", objectives=np.ones((1, 1)), spread=np.array([s])) for s in (10.0, 1.0)]
    monkeypatch.setattr(run, "evaluate", lambda trials, theta: (None, scores[: len(trials)]))
    monkeypatch.setattr(run, "objectives_of", lambda metric: [SimpleNamespace(name="d", unit="mm")])
    for count, spreads in ((2, 0.55), (1, 0.1)):
        sources = [SimpleNamespace(split="fit")] * count
        trials = [SimpleNamespace(metric=None)] * count
        bench = SimpleNamespace(cell=SimpleNamespace(recordings=sources, key="k"), trials=trials,
                                of_split=lambda split, trials=trials: trials)  # fmt: skip
        fit = SimpleNamespace(objectives=np.array([[spreads]]), value=np.ones(1), theta=np.zeros((1, 1)),
                              best=np.zeros(1), front=np.array([0]))  # fmt: skip
        (found,) = run._front_of(bench, fit, scores[:count])
        assert (found["distance"], found["spreads"]) == (pytest.approx(1.0), spreads)


@pytest.mark.parametrize("factory", [SimpleEa, HybridEa])
def test_evolution_spreads_over_the_front(factory):
    found = np.array([searched(factory, seed) for seed in range(3)])
    assert found.shape == (3, 160, 2)
    ends = np.sqrt(3) * 0.4
    for rows in found:
        front = rows[on_front(rows)]
        assert (front.sum(axis=1) < 1.35 * ends).any()  # near the line
        assert np.ptp(front[:, 0]) > 0.5 * ends  # and not in one place


def test_local_search_gets_nearer_with_as_many_evaluations():
    """Over ten seeds, the best sum of two squares: a bowl in six parameters."""
    problem = bowl(6)

    def best(factory, seed):
        search, lowest = factory(problem.space, seed=seed, budget=150), np.inf
        while not search.done:
            theta = search.ask()
            evaluation = problem.evaluate(theta)
            lowest = min(lowest, evaluation.value.min())
            search.tell(theta, evaluation)
        return lowest

    hybrid, simple = (np.array([best(f, seed) for seed in range(10)]) for f in (HybridEa, SimpleEa))
    assert np.median(hybrid) < 0.5 * np.median(simple)
    assert (hybrid < simple).sum() >= 9


def test_lost_runs_are_counted_and_the_border_is_crossed_less():
    problem, lost = partly_lost(), {}
    for factory in (HybridEa, SimpleEa):
        lost[factory] = []
        for seed in range(5):
            search = factory(problem.space, seed=seed, budget=200)
            while not search.done:
                theta = search.ask()
                search.tell(theta, problem.evaluate(theta))
            assert search.stopped == f"budget spent, {search.lost} runs lost"
            lost[factory].append(search.lost)
    assert max(lost[HybridEa]) < 0.15 * 200
    assert np.mean(lost[HybridEa]) <= 1.3 * np.mean(lost[SimpleEa])


@pytest.mark.parametrize("factory", [SimpleEa, HybridEa])
def test_a_lost_run_is_worse_than_any_other_in_whatever_unit(factory):
    problem, value = partly_lost(), np.empty(0)
    search = factory(problem.space, seed=0, budget=200)
    while not search.done:
        theta = search.ask()
        found = problem.evaluate(theta)
        value = 5e6 * (1 + found.value)
        search.tell(theta, Evaluation(value, found.residual))
    assert np.isnan(value).mean() < 0.2  # of the last generation


@pytest.mark.parametrize(
    ("options", "says"),
    [({"population": 3}, "population is 3"), ({"local": 0}, "local is 0"), ({"radius": 1.0}, "radius is 1.0")],
)
def test_wrong_options_are_refused(options, says):
    with pytest.raises(ClothbenchError, match=says):
        HybridEa(bowl(3).space, seed=0, budget=100, **options)
