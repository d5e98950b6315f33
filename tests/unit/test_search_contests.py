"""Searches beside each other: hypervolume, and what is said of several optimizers over several seeds."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from clothbench.engine.cells import Source
from clothbench.engine.study import Results
from clothbench.engine.tables import write_table
from clothbench.studies.calibration.cell import CalibrationCell, asked
from clothbench.studies.calibration.schema import QUESTION
from clothbench.studies.calibration.searches import WORST, contests, hypervolume
from clothbench.studies.calibration.searches_page import contest_tables, searches_section


def test_hypervolume_of_known_fronts():
    assert hypervolume(np.array([[0.0, 0.0]])) == pytest.approx(1.0)
    assert hypervolume(np.array([[WORST / 2, WORST / 2]])) == pytest.approx(0.25)
    steps = np.array([[0.0, WORST / 2], [WORST / 2, 0.0], [WORST / 2, WORST / 2], [np.nan, 0.0]])
    assert hypervolume(steps) == pytest.approx(0.75)
    assert hypervolume(np.array([[2 * WORST, 0.0], [np.nan, np.nan]])) == 0.0


def results_of(tmp_path, histories, **more):
    """A store's results: histories[optimizer][seed] is the error of each evaluation; more: columns of every row."""
    rows = []
    for optimizer, runs in histories.items():
        for seed, values in enumerate(runs):
            key = "-".join(map(str, (optimizer, seed, *more.values())))
            (tmp_path / key).mkdir()
            table = pd.DataFrame({"value": values, "objective:a": values, "objective:b": values})
            write_table(tmp_path / key / "history.parquet", table)
            rows.append(
                {"suite": "s", "case": "c", "model": "m", "effects": "", "metric": "d", "objective": "d", "unit": "sd",
                 "split": "fit", "recording": None, "optimizer": optimizer, "key": key, "seed": seed, **more}
            )  # fmt: skip
    return Results(SimpleNamespace(cell=lambda key: tmp_path / key), rows)


def test_searches_are_told_apart_by_what_they_reach_and_how_soon(tmp_path):
    quick = [[2.0, 0.5, np.nan, 0.5], [1.0, 0.4, 0.4, 0.4], [1.0, 0.6, 0.6, 0.6]]
    slow = [[2.0, 2.0, 2.0, 1.0], [2.0, 2.0, 1.5, 1.5], [2.0, 2.0, 2.0, 2.0]]
    results = results_of(tmp_path, {"quick": quick, "slow": slow, "once": [[0.1]]})
    (found,) = contests(results)
    by_name = {s.optimizer: s for s in found.searches}
    assert set(by_name) == {"quick", "slow"}  # of one seed nothing can be said
    assert by_name["quick"].error[0] == pytest.approx(0.5)
    assert by_name["quick"].error[1] < 0.5 < by_name["quick"].error[2]
    assert found.goal == 1.5  # which five of 0.4, 0.5, 0.6, 1, 1.5, 2 came to, and four of a lesser one
    assert (by_name["quick"].reached, by_name["quick"].evaluations) == (3, 1.0)
    assert by_name["slow"].reached == 2
    assert by_name["slow"].evaluations == 4.0
    assert by_name["quick"].lost == pytest.approx(1 / 12)
    assert by_name["quick"].volume[0] > by_name["slow"].volume[0]
    (shown,) = contest_tables(results)
    assert list(shown.columns[0].cells) == ["quick", "slow"]
    section = searches_section(results)
    assert "1.5 sd" in section.html
    assert len(section.data["contests"][0]["data"]) == 6  # a line and a band for each


def test_evaluations_on_a_coarser_mesh_count_and_its_errors_do_not(tmp_path):
    results = results_of(tmp_path, {"quick": [[2.0, 0.5]] * 3, "slow": [[2.0, 2.0]] * 3})
    for folder in tmp_path.iterdir():
        write_table(folder / "coarse_history.parquet", pd.DataFrame({"value": [0.1, 0.1, np.nan]}))
    (found,) = contests(results)
    quick, slow = found.searches
    assert (quick.evaluations, slow.evaluations) == (4.0, 4.0)  # the goal is 2, met by the first on the finer mesh
    assert quick.error[0] == pytest.approx(0.5)
    assert quick.lost == pytest.approx(1 / 5)
    assert "on the finer mesh" in searches_section(results).html


def test_searches_of_other_budgets_or_settings_are_not_averaged(tmp_path):
    rows, runs = [], {"quick": [[1.0]] * 3, "slow": [[2.0]] * 3}
    for budget, settings in ((10, "a"), (20, "a"), (20, "b")):
        found = results_of(tmp_path, runs, budget=budget, settings=settings)
        rows += found.rows
    both = contests(Results(found.store, rows))
    assert [(c.budget, len(c.searches)) for c in both] == [("10", 2), ("20", 4)]
    assert {s.optimizer for s in both[0].searches} == {"quick", "slow"}
    assert {s.optimizer for s in both[1].searches} == {f"{o} · settings {s}" for o in runs for s in "ab"}
    assert all(s.seeds == 3 for c in both for s in c.searches)


def keep_questions(results, **more):
    """Leave beside each row's history what its cell was asked, as a run does; more: of the cell's fields."""
    told = {"options": {}, "report": (), **more}
    for row in results.rows:
        metrics = [f"metrics/{name}" for name in ("d", *told["report"])]
        used = ["models/m", f"optimizers/{row['optimizer']}", "trackers/markers", *metrics]
        cell = CalibrationCell(
            suite="s", case="c", recordings=(Source("r.nc", "r", "ab", "fit"),), model="m", effects=(), metric="d",
            tracker="markers", optimizer=row["optimizer"], seed=row["seed"],
            versions=dict.fromkeys(used, "clothbench 1"), **told,
        )  # fmt: skip
        kept = [{"question": asked(cell), "key": row["key"]}]
        write_table(results.store.cell(row["key"]) / "question.parquet", kept, QUESTION)


def test_searches_for_something_else_are_another_contest(tmp_path):
    """Other bounds are another question, and so are other options of what is simulated; those of optimizers are not."""
    runs, rows = {"quick": [[1.0]] * 3, "slow": [[2.0]] * 3}, []
    for number, (bend, step) in enumerate(((1e-3, 1), (1e-2, 1), (1e-2, 2))):
        found = results_of(tmp_path, runs, settings=f"{number}")
        options = {"m": {"dt": step}, **{name: {"size": number} for name in runs}}
        keep_questions(found, bounds={"bend": (0.0, bend)}, options=options)
        rows += found.rows
    every = contests(Results(found.store, rows))
    assert [sorted(s.optimizer for s in c.searches) for c in every] == [["quick", "slow"]] * 3


def test_a_search_that_is_told_something_is_beside_the_others(tmp_path):
    """Each cell of a run keeps the options of all its plugins, as `start` for all that take it after `prior=`."""
    results = results_of(tmp_path, {"quick": [[1.0]] * 3, "slow": [[2.0]] * 3, "plain": [[3.0]] * 3})
    keep_questions(results, options={"quick": {"population": 10, "start": "defaults"}, "slow": {"start": "defaults"}})
    (found,) = contests(results)
    assert [s.optimizer for s in found.searches] == ["plain", "quick", "slow"]


def test_what_is_only_reported_is_no_other_question(tmp_path):
    first = results_of(tmp_path, {"quick": [[1.0]] * 3})
    other = results_of(tmp_path, {"slow": [[2.0]] * 3})
    keep_questions(first, report=("e",))
    keep_questions(other)
    (found,) = contests(Results(first.store, first.rows + other.rows))
    assert len(found.searches) == 2


def test_effects_are_joined_as_in_other_tables(tmp_path):
    results = results_of(tmp_path, {"quick": [[1.0]] * 3, "slow": [[2.0]] * 3}, effects="drag,lift")
    (found,) = contests(results)
    assert found.model == "m + drag + lift"


def test_the_same_seed_again_and_other_budgets_are_no_further_seeds(tmp_path):
    """As of `budget=4,8,12` with one seed, and of one seed on recordings that were made anew."""
    runs, rows = {"quick": [[1.0]], "slow": [[2.0]]}, []
    for budget in (4, 8, 12):
        found = results_of(tmp_path, runs, budget=budget)
        rows += found.rows
    assert contests(Results(found.store, rows)) == []
    assert contests(Results(found.store, [row | {"budget": 12} for row in rows])) == []


def test_searches_that_failed_or_ended_by_the_clock_are_not_beside_the_others(tmp_path):
    results = results_of(tmp_path, {name: [[2.0, 1.0]] * 3 for name in ("quick", "slow", "late", "lost")})
    late, lost = (
        next(r for r in results.rows if r["optimizer"] == name and r["seed"] == 2) for name in ("late", "lost")
    )
    late["status"] = "timeout"
    lost |= {"split": None, "unit": None, "status": "error", "value": None}
    (found,) = contests(results)
    assert [s.optimizer for s in found.searches] == ["quick", "slow"]
    assert found.left_out == ("late", "lost")
    assert "without late, lost, of which a run failed or ended by the clock" in searches_section(results).html


def test_one_search_is_no_contest(tmp_path):
    results = results_of(tmp_path, {"quick": [[1.0]] * 5})
    assert contests(results) == []
    assert searches_section(results) is None
