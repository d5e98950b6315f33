"""Analyses of a fit on toys whose answer is known, their settings, and searches that go on where they stood."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from test_calibrate import SPACE, TIME, Toy

from clothbench import ClothbenchError, Observation, Parameter, ParameterSpace, Score
from clothbench.engine import checkpoint as checkpoints
from clothbench.engine.checkpoint import Checkpoint
from clothbench.engine.settings import last_word, named_budget
from clothbench.estimation.calibrate import batch_key, calibrate, remembered
from clothbench.estimation.fixed import Fixed, holding
from clothbench.estimation.trials import Trial
from clothbench.plugins.discovery import catalogue
from clothbench.studies.calibration import analysis
from clothbench.studies.calibration.analysis import ANALYSES, truth_of
from clothbench.studies.calibration.analysis_page import analysis_section, figures_of, sensitivity_figures
from clothbench.studies.calibration.analysis_tables import missing, spread
from clothbench.studies.calibration.cell import CalibrationCell
from clothbench.studies.calibration.schema import ANALYSIS_TABLES
from clothbench.studies.calibration.sensitivity import error_map, morris, sobol
from clothbench.studies.calibration.settings import analysis_settings, suite_settings
from clothbench.studies.calibration.transfer import confusions
from clothbench.studies.calibration.variability import parabola, perturbed, repeats, variability

BEST = np.array([1.2, 0.3])
BOX = ParameterSpace(
    tuple(Parameter(n, n, "1", (0.0, 1.0), "linear", 0.5, "of a toy", "none") for n in ("a", "b", "c"))
)


class Bowl:
    """Scores 5 + 100 (gain/1.2 − 1)² + (slope/0.3 − 1)²: gain matters ten times as much as slope."""

    name, version, unit = "bowl", 1, "mm"

    def __call__(self, observation, rollout):
        gain = rollout.position[:, 5, 0, 0]
        slope = rollout.position[:, 9, 0, 0]
        return Score(5 + 100 * (gain / 1.2 - 1) ** 2 + (slope / 0.3 - 1) ** 2, "mm")

    def floor(self, observation):
        return float("nan")


class Plain(Toy):
    """Puts its two parameters straight into two frames."""

    def run(self, theta):
        rollout = super().run(theta)
        rollout.position[:, 5, 0, 0], rollout.position[:, 9, 0, 0] = theta[:, 0], theta[:, 1]
        return rollout


def bowl_trial() -> Trial:
    seen = Observation(TIME, np.zeros((TIME.size, 1, 3)), np.ones((TIME.size, 1), bool), 1e-3, np.zeros((1, 2)))
    return Trial("toy", seen, Plain(), Bowl())


def test_variability_is_the_change_that_changes_the_error_by_one_percent():
    found, behind = variability([bowl_trial()], SPACE, BEST, 8)
    # 100 δ² = 0.05 and δ² = 0.05
    assert found[0]["percent"] == pytest.approx(100 * np.sqrt(0.05 / 100), rel=1e-6)
    assert found[1]["percent"] == pytest.approx(100 * np.sqrt(0.05), rel=1e-6)
    assert found[0]["curvature"] == pytest.approx(200.0)
    assert abs(found[0]["slope"]) < 1e-9
    assert sorted({round(r["change"], 9) for r in behind}) == [-0.2, -0.15, -0.1, -0.05, 0.05, 0.1, 0.15, 0.2]


@pytest.mark.parametrize(
    ("slope", "curvature", "expected"),
    [
        (2.0, 0.0, 2.5),
        (-2.0, 0.0, 2.5),
        (0.0, 0.4, 50.0),
        (0.0, 0.0, np.inf),
        (-1.0, 10.0, 4.1421),
        (1.0, -10.0, 4.1421),
        (0.0, -0.4, 50.0),
    ],
)
def test_the_nearest_crossing_of_the_parabola_counts(slope, curvature, expected):
    """Base 5, so 1 % is 0.05; the fifth rises by it on the left sooner than it sinks by it on the right; the last one
    sinks only.
    """
    share = np.array([-0.2, -0.1, 0.1, 0.2])
    value, *_ = parabola(share, 5 + slope * share + curvature * share**2 / 2, 5.0)
    assert value == pytest.approx(expected, rel=1e-3)


def test_what_cannot_be_perturbed_is_said():
    theta, which, share = perturbed(SPACE, np.array([0.11, 0.0]), 8)
    assert set(which) == {0}
    assert share.min() > -0.1  # below it lies the bound
    assert (theta >= SPACE.low).all()
    found, _ = variability([bowl_trial()], SPACE, np.array([0.1, 0.0]), 2)
    assert found[0]["percent"] is None
    assert "fewer than two perturbations" in found[0]["reason"]
    assert "its value is 0" in found[1]["reason"]


def test_of_an_error_of_nothing_there_is_no_percent():
    """Said to be "> 100 %", as of a parameter that changes nothing."""

    class Below(Bowl):
        def __call__(self, observation, rollout):
            return Score(super().__call__(observation, rollout).value - 5, "mm")

    found, behind = variability([dataclasses.replace(bowl_trial(), metric=Below())], SPACE, BEST, 8)
    assert {(r["percent"], r["reason"]) for r in found} == {(None, "the error is 0, of which there is no percent")}
    assert max(r["error"] for r in behind) > 1


def test_repeated_fits_begin_within_five_percent_and_find_the_same():
    fit = calibrate([bowl_trial()], catalogue().make("optimizers", "nelder_mead", SPACE, seed=1, budget=120), SPACE)

    def search(space, seed):
        walk = catalogue().make("optimizers", "nelder_mead", space, seed=seed, budget=80, start="defaults")
        return calibrate([bowl_trial()], walk, space, bounded=False)

    rows = repeats([bowl_trial()], SPACE, fit, 3, 7, search)
    assert {r["repeat"] for r in rows} == {0, 1, 2, 3}
    for name, first in zip(SPACE.names, fit.start, strict=True):
        mine = [r for r in rows if r["name"] == name]
        assert all(abs(r["start"] - first) <= 0.05 * abs(first) + 1e-12 for r in mine)
        assert len({r["start"] for r in mine}) == 4
        assert spread([r["value"] for r in mine]) < 6
    assert all(r["error"] <= r["error_start"] + 1e-9 for r in rows)


class TwoGoals(Bowl):
    """Wants a gain of 0.6 and, as much, one of 1.8."""

    def __call__(self, observation, rollout):
        gain = rollout.position[:, 5, 0, 0]
        goals = np.stack([np.abs(gain - 0.6), (gain - 1.8) ** 2 + 0.2], axis=1)
        return Score(np.sqrt((goals**2).mean(axis=1)), "mm", objectives=goals, spread=np.ones(2))


def test_the_error_of_repeated_fits_is_that_of_the_values_beside_it():
    """Which the choice from the front took; another row may have less."""
    trial, least = dataclasses.replace(bowl_trial(), metric=TwoGoals()), []

    def search(space, seed):
        walk = catalogue().make("optimizers", "annealing", space, seed=seed, budget=60, start="defaults")
        found = calibrate([trial], walk, space, bounded=False, choice="knee")
        least.append(np.nanmin(found.value) < found.error)
        return found

    rows = repeats([trial], SPACE, search(SPACE, 0), 2, 7, search)
    for n in range(3):
        mine = [row for row in rows if row["repeat"] == n]
        theta = np.array([[row["value"] for row in mine]])
        assert mine[0]["error"] == pytest.approx(remembered([trial], theta, None).value[0], abs=1e-12)
    assert any(least)


@pytest.mark.parametrize("name", ["nelder_mead", "annealing"])
def test_a_search_that_begins_at_the_defaults_has_not_looked_around(name):
    """Its repeats begin as it did, and get as many evaluations."""
    for start in ("defaults", "look"):
        search = catalogue().make("optimizers", name, SPACE, seed=0, budget=80, start=start)
        assert (calibrate([bowl_trial()], search, SPACE, bounded=False).looked == 0) == (start == "defaults")


@pytest.mark.parametrize(("option", "says"), [({"levels": None}, "levels is None"), ({"gridded": 0}, "gridded is 0")])
def test_a_grid_that_is_none_is_refused(option, says):
    with pytest.raises(ClothbenchError, match=f"annealing: {says}, expected a whole number"):
        catalogue().make("optimizers", "annealing", SPACE, seed=0, budget=80, **option)


def test_a_start_of_zero_is_moved_by_a_share_of_its_range():
    at_zero = dataclasses.replace(
        calibrate([bowl_trial()], catalogue().make("optimizers", "nelder_mead", SPACE, seed=1, budget=9), SPACE),
        start=np.array([1.0, 0.0]),
    )
    rows = repeats([bowl_trial()], SPACE, at_zero, 3, 7, lambda space, seed: at_zero)
    begun = [r["start"] for r in rows if r["name"] == "slope"]
    assert len(set(begun)) == 4
    assert max(map(abs, begun)) <= 0.05 * 2.0  # from -1 to 1


@pytest.mark.parametrize("bounds", [(0.0, 2.0), (-2.0, 0.0)])
def test_a_start_of_zero_at_a_bound_is_turned_back_into_the_range(bounds):
    space = ParameterSpace((SPACE.parameters[0], dataclasses.replace(SPACE.parameters[1], bounds=bounds)))
    fit = calibrate([bowl_trial()], catalogue().make("optimizers", "nelder_mead", space, seed=1, budget=9), space)
    fit = dataclasses.replace(fit, start=np.array([1.0, 0.0]))
    rows = repeats([bowl_trial()], space, fit, 8, 7, lambda space, seed: fit)
    begun = [abs(r["start"]) for r in rows if r["name"] == "slope"]
    assert begun[0] == 0.0
    assert 0 < min(begun[1:]) < max(begun[1:]) <= 0.05 * 2.0
    assert len(set(begun)) == 9


@pytest.mark.parametrize(("note", "stated"), [("3.5", 3.5), ("unknown", None), ("", None), ("nan", None)])
def test_a_truth_that_is_no_number_is_not_stated(note, stated):
    bench = SimpleNamespace(recordings=[SimpleNamespace(notes={"truth_bend": note})],
                            cell=SimpleNamespace(recordings=[SimpleNamespace(split="fit")]))  # fmt: skip
    assert truth_of(bench, "bend") == stated


class Sum:
    """x = 4 a + 2 b at the one node; the score is x itself; c does nothing. Members with a > 0.99 are lost."""

    parameters = BOX

    def __init__(self, lost=2.0):
        self.lost = lost

    def run(self, theta):
        rollout = Toy().run(np.ones((len(theta), 2)))
        rollout.position[:, 0, 0, 0] = 4 * theta[:, 0] + 2 * theta[:, 1]
        status = tuple("diverged" if t > self.lost else "ok" for t in theta[:, 0])
        return dataclasses.replace(rollout, status=status)


class First(Bowl):
    def __call__(self, observation, rollout):
        return Score(rollout.position[:, 0, 0, 0], "mm")


def sum_trial(lost=2.0) -> Trial:
    return dataclasses.replace(bowl_trial(), simulation=Sum(lost), metric=First())


def test_the_sensitivity_is_that_of_the_error_whoever_searched_it():
    """With two trajectories, cells of one case that differed in their search alone had μ* of 26, 85 and 77."""
    plain = CalibrationCell("s", "c", (), "m", (), "ga", "bowl", "markers")

    def asked_of(method, **changes):
        cell = dataclasses.replace(plain, **changes)
        bench = SimpleNamespace(cell=cell, space=SPACE, of_split=lambda split: [bowl_trial()])
        options = {"trajectories": 2, "samples": 4}
        return ANALYSES[method](bench, None, options, catalogue(), Checkpoint())["sensitivity"]

    for method in ("morris", "sobol"):
        same = [asked_of(method, **c) for c in ({}, {"optimizer": "cma_es"}, {"seed": 3}, {"budget": 9})]
        assert same == 4 * same[:1]
        assert asked_of(method, model="another") != same[0]
    assert plain.stream("optimizer") != dataclasses.replace(plain, seed=3).stream("optimizer")


def test_morris_finds_the_slopes_of_a_plane():
    rows = {r["name"]: r for r in morris([sum_trial()], BOX, 8, 3)}
    assert [rows[n]["main"] for n in "abc"] == pytest.approx([4.0, 2.0, 0.0], abs=1e-9)
    assert [rows[n]["total"] for n in "abc"] == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)
    assert rows["a"]["evaluations"] == 8 * 4


def test_sobol_shares_the_variance_as_a_plane_does():
    """Variances 16/12 and 4/12: 80 % and 20 %."""
    rows = {r["name"]: r for r in sobol([sum_trial()], BOX, 256, 3)}
    assert [rows[n]["main"] for n in "abc"] == pytest.approx([0.8, 0.2, 0.0], abs=0.05)
    assert [rows[n]["total"] for n in "abc"] == pytest.approx([0.8, 0.2, 0.0], abs=0.05)


def test_lost_members_take_their_block_along_and_are_counted_without_it():
    lost = []

    class Watched(Sum):
        def run(self, theta):
            rollout = super().run(theta)
            lost.extend(s for s in rollout.status if s != "ok")
            return rollout

    trial = dataclasses.replace(sum_trial(), simulation=Watched(0.9))
    rows = morris([trial], BOX, 12, 3)
    assert 0 < rows[0]["lost"] < rows[0]["evaluations"]
    assert rows[0]["lost"] == len(lost)
    assert {r["name"]: r["main"] for r in rows}["b"] == pytest.approx(2.0)
    (first, *_) = sobol([sum_trial(lost=-1.0)], BOX, 16, 3)
    assert first.get("main") is None
    assert "fewer than four blocks" in first["reason"]


def test_one_trajectory_has_no_spread():
    (first, *_) = morris([sum_trial()], BOX, 2, 3)
    assert first["main"] == pytest.approx(4.0)
    whole = iter([True] * 4 + [False] * 4)  # of the second none could be simulated

    class Half(Sum):
        def run(self, theta):
            rollout = super().run(theta)
            return dataclasses.replace(rollout, status=tuple("ok" if next(whole) else "diverged" for _ in theta))

    (first, *_) = morris([dataclasses.replace(sum_trial(), simulation=Half())], BOX, 2, 3)
    assert first.get("main") is None
    assert "fewer than two trajectories" in first["reason"]


def test_the_page_says_why_an_analysis_has_no_figure():
    tables = {name: [] for name in ANALYSIS_TABLES}
    about = {"suite": "s", "case": "A", "model": "m", "effects": "", "optimizer": "ga", "metric": "d", "objective": "d",
             "recording": "x", "split": "fit", "value": 1.0, "unit": "mm", "seed": 0, "key": "k"}  # fmt: skip
    bars = dict.fromkeys(("percent", "main", "total", "name", "method"))
    tables["variability"] = [{**bars, "key": "k", "reason": "ValueError: boom"}]
    tables["sensitivity"] = [{**bars, "key": "k", "name": "a", "method": "sobol", "reason": "the error is constant"}]
    html = analysis_section([about], tables).html
    assert "no variability: ValueError: boom" in html
    assert "no sensitivity of a: the error is constant" in html


def bars(key, method="sobol", **numbers):
    known = {"main": 0.5, "main_half": 0.1, "total": 0.6, "total_half": 0.1}
    return {"key": key, "name": "a", "method": method, "reason": "", **known, **numbers}


def test_a_sensitivity_is_drawn_once_for_all_who_searched():
    about = {"k": "linen · m · ga", "other": "linen · m · es", "fold": "satin · m · ga"}
    drawn = sensitivity_figures([bars("k"), bars("other"), bars("fold", main=0.4)], about, {})
    assert [one["title"] for one in drawn] == [
        "Sensitivity (sobol): linen · m · ga (and 1 more of the same)", "Sensitivity (sobol): satin · m · ga"
    ]  # fmt: skip


def test_whiskers_stand_where_intervals_are_known_and_effects_have_a_unit():
    (drawn,) = sensitivity_figures([bars("k", "morris", total_half=None)], {"k": "fit"}, {"k": "mm"})
    assert [one.get("error_y", {}).get("array") for one in drawn["figure"]["data"]] == [[0.1], None]
    assert drawn["figure"]["layout"]["yaxis"]["title"]["text"] == "μ* (first bar), σ [mm]"
    assert "95 % interval" in drawn["about"]


@pytest.mark.parametrize(
    ("numbers", "told"),
    [
        ({}, False),
        ({"total": 1.05}, False),
        ({"total": 1.2}, True),
        ({"total": -0.2}, True),
        ({"main": -0.05}, False),
        ({"main": -0.2}, True),
        ({"main": 1.2}, True),
        ({"total": None, "total_half": None}, False),
    ],
)
def test_shares_that_cannot_be_are_told(numbers, told):
    (drawn,) = sensitivity_figures([bars("k", **numbers)], {"k": "fit"}, {})
    assert ("too few samples" in figures_of([{**drawn, "number": 0}])) == told


def test_a_fit_without_other_fabrics_says_so():
    cell = SimpleNamespace(rivals=())
    (row,) = ANALYSES["confusion"](SimpleNamespace(cell=cell), None, {}, None, None)["confusion"]
    (line,) = missing({"map": [], "confusion": [{**row, "key": "k"}]}, {"k": "silk"})
    assert line == f"silk: not held against other fabrics: {row['reason']}"
    assert "found no other fabric" in line


def test_a_fabric_of_fewer_trials_is_not_the_nearest_for_that():
    """A and B have three trials, C two; each fits its own best."""
    fabrics, rows, found = {"A": 3, "B": 3, "C": 2}, [], []
    about = {"model": "m", "effects": "", "optimizer": "ga", "metric": "d", "objective": "d", "unit": "mm", "seed": 0}
    for (f, count), fitted in ((x, n) for x in fabrics.items() for n in range(x[1])):
        for t in range(count):
            split = "fit" if t == fitted else "held_out"
            rows.append({**about, "case": f"{f}/{fitted}", "recording": f"{f}/{t}", "split": split,
                         "value": 10.0 + fitted, "key": f"{f}{fitted}"})  # fmt: skip
        for other, most in fabrics.items():
            found += [
                {"key": f"{f}{fitted}", "fabric": f, "recorded_fabric": other, "trial": str(t),
                 "value": 10.0 if f == other else 14.0, "unit": "mm", "reason": None}
                for t in range(min(count, most))
            ]  # fmt: skip
    (matrix,) = confusions(found, rows, [])
    assert matrix.right == 3
    assert matrix.error["C"] == {"A": 14.0, "B": 14.0, "C": 10.0}


def test_the_map_covers_both_ranges():
    rows = error_map([sum_trial()], BOX, np.array([0.5, 0.5, 0.1]), ["a", "b"], 4)
    assert len(rows) == 16
    assert all(r["error"] == pytest.approx(4 * r["x"] + 2 * r["y"]) for r in rows)
    assert sorted({r["x"] for r in rows}) == pytest.approx([0, 1 / 3, 2 / 3, 1])


def test_held_parameters_are_handed_to_the_simulation():
    held = holding(Sum(), {"a": 0.25, "of another model": 1.0})
    assert held.parameters.names == ("b", "c")
    assert held.run(np.array([[0.5, 0.0]])).position[0, 0, 0, 0] == pytest.approx(4 * 0.25 + 2 * 0.5)
    whole = Sum()
    assert holding(whole, {"of another model": 1.0}) is whole
    assert isinstance(held, Fixed)


class Counted:
    def __init__(self, simulation):
        self.simulation, self.parameters, self.members = simulation, simulation.parameters, 0

    def run(self, theta):
        self.members += len(theta)
        return self.simulation.run(theta)


def test_a_stopped_search_goes_on_where_it_stood(tmp_path):
    def fit(budget_of_time, trial):
        optimizer = catalogue().make("optimizers", "annealing", SPACE, seed=2, budget=60)
        return calibrate(
            [trial], optimizer, SPACE, timeout=budget_of_time, checkpoint=Checkpoint(tmp_path / "j"), bounded=False
        )

    trials = [dataclasses.replace(bowl_trial(), simulation=Counted(Plain())) for _ in range(3)]
    stopped = fit(1e-9, trials[0])
    assert stopped.status == "timeout"
    done = fit(None, trials[1])
    assert trials[0].simulation.members > 0
    points = len(np.unique(done.theta, axis=0))  # where the search comes back to a point, it is known
    assert trials[0].simulation.members + trials[1].simulation.members == points
    again = fit(None, trials[2])
    assert trials[2].simulation.members == 0
    np.testing.assert_array_equal(again.theta, done.theta)
    np.testing.assert_array_equal(again.value, done.value)
    Checkpoint(tmp_path / "j").forget()
    assert not (tmp_path / "j").exists()


class Timed(Counted):
    """Takes a second of `clock` for every batch."""

    clock = 0.0

    def run(self, theta):
        Timed.clock += 1.0
        return super().run(theta)


def test_a_search_that_the_clock_stopped_is_the_same_after_the_run_was_killed_in_its_analyses(tmp_path, monkeypatch):
    monkeypatch.setattr(checkpoints, "uncompiled", lambda: Timed.clock)

    def fit():
        trial = dataclasses.replace(bowl_trial(), simulation=Timed(Plain()))
        optimizer = catalogue().make("optimizers", "annealing", SPACE, seed=2, budget=60)
        checkpoint = Checkpoint(tmp_path)
        return trial, checkpoint, calibrate([trial], optimizer, SPACE, timeout=9.5, checkpoint=checkpoint)

    trial, checkpoint, first = fit()
    assert first.status == "timeout"
    for share in np.linspace(0.9, 1.1, 20):
        remembered([trial], share * BEST[None], checkpoint)
    _, _, again = fit()
    assert again.status == "timeout"
    assert again.wall_s == pytest.approx(first.wall_s)
    np.testing.assert_array_equal(again.theta, first.theta)
    np.testing.assert_array_equal(again.value, first.value)


def test_what_an_earlier_version_kept_without_its_time_is_not_simulated_again(tmp_path):
    trial = dataclasses.replace(bowl_trial(), simulation=Counted(Plain()))
    Checkpoint(tmp_path).keep(batch_key(BEST[None]), value=np.array([7.0]))
    assert remembered([trial], BEST[None], Checkpoint(tmp_path)).value == 7.0
    assert trial.simulation.members == 0


@pytest.mark.parametrize("whole", [True, False])
def test_repeats_of_a_stopped_run_have_their_time_from_when_they_began(tmp_path, monkeypatch, whole):
    """As long as the fit's own, although the run that goes on has come further on its clock. whole: all is kept."""
    told = []

    def searched(*_, since, **__):
        told.append(since)
        return [first]

    monkeypatch.setattr(analysis, "searched", searched)
    monkeypatch.setattr(analysis, "stages_of", lambda *_: [])
    trial = bowl_trial()
    first = calibrate([trial], catalogue().make("optimizers", "nelder_mead", SPACE, seed=1, budget=20), SPACE)
    cell = SimpleNamespace(optimizer="nelder_mead", budget=20, stream=lambda _: 3)
    bench = SimpleNamespace(cell=cell, of_split=lambda _: [trial], space=SPACE)
    for before in (100.0, 500.0):
        checkpoint = Checkpoint(tmp_path if whole else None)
        checkpoint.before = before
        ANALYSES["repeats"](bench, first, {"count": 1}, catalogue(), checkpoint)
    assert told == pytest.approx([100.0, 100.0 if whole else 500.0], abs=50.0)


def test_a_damaged_checkpoint_is_simulated_anew(tmp_path):
    checkpoint, trial = Checkpoint(tmp_path), dataclasses.replace(bowl_trial(), simulation=Counted(Plain()))
    for _ in range(2):
        remembered([trial], BEST[None], checkpoint)
    assert trial.simulation.members == 1
    (file,) = tmp_path.glob("[0-9a-f]*.npz")
    file.write_bytes(file.read_bytes()[:40])
    remembered([trial], BEST[None], checkpoint)
    assert trial.simulation.members == 2


def test_a_named_budget_brings_its_settings():
    suite = suite_settings({"budgets": {"paper": {"budget": 600, "options": {"annealing": {"levels": 5}}}}})
    config = {"suite": suite, "budget": "paper", "options": {"annealing": {"size": 0.1}}, "analysis": {}}
    found = named_budget(config)
    assert found["budget"] == 600
    assert found["options"] == {"annealing": {"size": 0.1, "levels": 5}}
    with pytest.raises(ClothbenchError, match="expected a whole number, at least 1, or one of the suite's: paper"):
        named_budget({**config, "budget": "huge"})


def test_a_named_budget_does_not_overrule_the_command_line():
    brought = {"budget": 600, "options": {"annealing": {"levels": 5}}, "analysis": {"repeats": {"count": 5}, "map": {}}}
    given = {"suite": {"budgets": {"paper": brought}}, "analysis": {"repeats": {"count": 2}}}
    words = ["+suite=s", "budget=paper", "analysis.repeats.count=2", "~analysis.map", "seed=1"]
    left = last_word(given, words)["suite"]["budgets"]["paper"]
    assert left == {"budget": 600, "options": {"annealing": {"levels": 5}}, "analysis": {"repeats": {}}}
    assert last_word({"suite": None, "budget": 5}, ["budget=5"]) == {"suite": None, "budget": 5}


@pytest.mark.parametrize(
    ("given", "found"),
    [
        ({"magic": {}}, "analysis 'magic' is not known"),
        ({"map": {"points": 1}}, "'analysis.map.points' is 1, expected a whole number, at least 2"),
        ({"variability": {"points": 5}}, "'analysis.variability.points' is 5, expected an even number"),
        ({"variability": {"count": 3}}, "setting of 'analysis.variability' 'count' is not known"),
        ({"sobol": {"samples": 2}}, "'analysis.sobol.samples' is 2, expected a whole number, at least 4"),
        ({"sobol": {"samples": 12}}, "'analysis.sobol.samples' is 12, expected a power of two"),
        ({"map": {"parameters": ["bend", "bend"]}}, "expected two different parameters"),
        ({"sobol": 5}, "expected analysis.sobol.KEY=VALUE"),
    ],
)
def test_wrong_analyses_are_one_line(given, found):
    with pytest.raises(ClothbenchError, match=found):
        analysis_settings(given)
