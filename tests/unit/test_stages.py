"""A search that ends on a finer mesh: how it is shared out, what it leaves, and how far the mesh widens intervals."""

import dataclasses
import json
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from conftest import swinging_recording

from clothbench import ClothbenchError, Parameter, ParameterSpace, read_recording, write_recording
from clothbench.core.protocols import Score
from clothbench.engine.checkpoint import Checkpoint
from clothbench.engine.leaderboard import FINISHED
from clothbench.engine.settings import checked, last_word, named_budget
from clothbench.engine.store import Store
from clothbench.engine.suite import plan
from clothbench.estimation.calibrate import Fit
from clothbench.plugins.discovery import catalogue
from clothbench.studies.calibration import analysis
from clothbench.studies.calibration.cell import asked, asked_again, asked_and_fitted, set_up
from clothbench.studies.calibration.run import _status
from clothbench.studies.calibration.stages import searched, shared_out, stages_of, with_mesh
from clothbench.submissions.again import again
from clothbench.submissions.packing import require_ended

BASE = {
    "study": "calibration", "model": "mass_spring", "optimizer": "annealing", "metric": "node_error", "effects": [],
    "report": [], "tracker": "markers", "scene": {"spacing": 0.1}, "options": {}, "bounds": {}, "budget": 12,
    "seed": 0, "jobs": 1, "timeout": None, "out": "runs", "rerun": False, "finer": {"spacing": 0.05},
}  # fmt: skip


def cell_of(folder, **changes):
    return plan({**BASE, "recordings": str(folder), **changes}, catalogue())[0]


def test_the_cell_is_judged_on_the_finer_mesh_and_begins_on_the_other(recordings_folder):
    cell = cell_of(recordings_folder)
    assert cell.finer == {"spacing": 0.05, "share": 0.25}
    assert shared_out(12, cell) == [9, 3]
    assert shared_out(2, dataclasses.replace(cell, finer={"spacing": 0.05, "share": 0.9})) == [1, 1]
    coarse, fine = stages_of(set_up(cell, catalogue()), catalogue())
    assert [stage.cell.judged["spacing"] for stage in (coarse, fine)] == [0.1, 0.05]
    assert cell.key not in {coarse.cell.key, dataclasses.replace(cell, finer={**cell.finer, "share": 0.5}).key}
    assert asked_again(asked(cell)).key == cell.key


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"finer": {"spacing": 0.1}}, "'finer.spacing' is 0.1 m, expected less than scene.spacing, 0.1 m"),
        ({"finer": {"share": 0.5}}, "'finer.spacing' is None, expected a number above 0"),
        ({"finer": {"spacing": 0.05, "share": 1.0}}, "'finer.share' is 1, expected a number below 1"),
        ({"finer": {"spacing": 0.05, "factor": 2}}, "setting of 'finer' 'factor' is not known"),
        ({"scene": {}}, "found no 'scene.spacing' for it to be finer than"),
        ({"budget": 1}, "'budget' is 1, expected at least 2 evaluations, one on each mesh"),
        ({"optimizer": "ga"}, "optimizer 'ga' cannot begin at a given start"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(recordings_folder, changes, said):
    with pytest.raises(ClothbenchError, match=said):
        cell_of(recordings_folder, **changes)


def test_a_named_budget_may_bring_it_and_further_recordings_but_overrules_nobody():
    brought = {"budget": 60, "finer": {"spacing": 0.05}, "recordings": ["builtin:drape"]}
    config = {"suite": {"budgets": {"paper": brought}}, "budget": "paper", "finer": {}, "recordings": None}
    found = named_budget(config)
    assert (found["finer"], found["recordings"]) == ({"spacing": 0.05}, ["builtin:drape"])
    left = last_word(config, ["budget=paper", "recordings=mine", "finer.spacing=0.01"])["suite"]["budgets"]["paper"]
    assert left == {"budget": 60, "finer": {}}
    assert checked({**BASE, "finer": None}, catalogue(), frozenset())["finer"] == {}


def test_intervals_reach_as_much_further_as_the_mesh_may_still_move_the_parameter(recordings_folder):
    space = ParameterSpace((Parameter("a", "a", "1", (1.0, 100.0), "log", 10.0, "", ""),
                            Parameter("b", "b", "1", (0.0, 1.0), "linear", 0.5, "", "")))  # fmt: skip
    nothing, none = np.full(2, np.nan), np.zeros(2, bool)
    whole = {"space": space, "at_bound": none, "theta": np.zeros((1, 2)), "value": np.zeros(1), "condition": 1.0,
             "status": "ok", "stopped": "", "wall_s": 0.0}  # fmt: skip
    coarse = Fit(best=np.array([20.0, 0.5]), low=nothing, high=nothing, start=np.array([3.0, 0.1]), looked=7, **whole)
    fine = Fit(best=np.array([10.0, 0.5]), low=np.array([9.0, 0.4]), high=np.array([11.0, 0.6]), **whole)
    cell = dataclasses.replace(cell_of(recordings_folder), scene={"spacing": 0.03}, finer={"spacing": 0.02})
    found = with_mesh(coarse, fine, cell)
    # h falls to two thirds and halves a; to first order what is left is twice that step: a factor of 4 each way.
    assert np.allclose(found.low, [9.0 / 4, 0.4])
    assert np.allclose(found.high, [44.0, 0.6])
    assert (found.start == coarse.start).all()
    assert found.looked == 7


def test_both_meshes_ask_the_same_question_and_neither_takes_the_others_answer(tmp_path):
    whole = Checkpoint(tmp_path)
    part = whole.part("coarse")
    part.keep("question", value=np.array([1.0]))
    assert whole.recall("question") is None
    whole.keep("question", value=np.array([2.0]))
    again = Checkpoint(tmp_path)
    assert [one.recall("question")["value"][0] for one in (again, again.part("coarse"))] == [2.0, 1.0]
    assert again.seconds > 0
    assert again.part("coarse").seconds >= again.before
    again.forget()
    assert not tmp_path.exists()


def test_trials_that_are_fitted_together(tmp_path):
    for trial in ("sway-1", "sway-2", "sway-long"):
        made = swinging_recording(f"silk/{trial}", fabric="silk", notes={"experiment": "sway"})
        write_recording(made, tmp_path / f"{trial}.nc")
    suite = {"name": "s", "case": "experiment", "together": ["*-1", "*-2"]}
    (cell,) = plan({**BASE, "recordings": str(tmp_path), "suite": suite}, catalogue())
    assert cell.case == "silk/sway"
    assert [s.split for s in cell.recordings] == ["fit", "fit", "held_out"]
    with pytest.raises(ClothbenchError, match=r"'suite.together' .* matches none"):
        plan({**BASE, "recordings": str(tmp_path), "suite": {**suite, "together": ["velvet"]}}, catalogue())
    with pytest.raises(ClothbenchError, match="both say what is fitted"):
        plan({**BASE, "recordings": str(tmp_path), "suite": {**suite, "each": ["*"]}}, catalogue())


def test_a_run_leaves_both_histories_and_temperatures_and_can_be_done_again(clothbench, recordings_folder, tmp_path):
    words = ("scene.spacing=0.1", "+finer.spacing=0.05", "model=mass_spring", "optimizer=annealing",
             "metric=node_error", "budget=24", "rerun=false", "+options.annealing.share=0.2")  # fmt: skip
    done = clothbench("run", f"recordings={recordings_folder}", *words)
    assert done.returncode == 0, done.stderr
    rows = json.loads(clothbench("leaderboard", "--json").stdout)
    assert {row["evaluations"] for row in rows} == {24}
    (folder,) = (recordings_folder.parent / "runs" / "cells").iterdir()
    coarse, fine = (pd.read_parquet(folder / f"{name}.parquet") for name in ("coarse_history", "history"))
    assert [len(coarse), len(fine)] == [18, 6]
    # Corners of the first simplex are asked for before anything cools, and what follows cools.
    warm = coarse.temperature.dropna()
    assert 0 < len(warm) < len(coarse)
    assert warm.is_monotonic_decreasing
    parameters = pd.read_parquet(folder / "parameters.parquet")
    assert (parameters.low <= parameters.value).all()
    assert (parameters.value <= parameters.high).all()
    assert parameters.condition.nunique() == 1  # of the one fit
    assert parameters.condition[0] > 1
    page = (recordings_folder.parent / "runs" / "report.html").read_text()
    assert f"Condition of the fit: {parameters.condition[0]:.2g}; above" in page
    # Whoever checks a submission of it comes to the same parameters, and so to the same motion.
    cell, found = asked_and_fitted(Store(recordings_folder.parent / "runs"), folder.name)
    path = cell.recordings[0].file
    (tmp_path / "job.json").write_text(json.dumps({"question": asked(cell), "simulate": [str(path)]}))
    again(tmp_path / "job.json", tmp_path / "out")
    (moved,) = (read_recording(file).position for file in (tmp_path / "out").iterdir())
    theta = np.array([[row["value"] for row in found]])
    np.testing.assert_allclose(moved, set_up(cell, catalogue()).trials[0].simulation.run(theta).position[0], atol=1e-12)


def test_what_the_clock_stops_on_the_coarse_mesh_is_the_cells_own_result(clothbench, recordings_folder):
    words = ("scene.spacing=0.1", "finer.spacing=0.05", "model=mass_spring", "optimizer=annealing", "metric=node_error",
             "budget=24", "rerun=false", "timeout=1e-6")  # fmt: skip
    done = clothbench("run", f"recordings={recordings_folder}", *words)
    assert "timeout" in done.stdout
    (folder,) = (recordings_folder.parent / "runs" / "cells").iterdir()
    for table in folder.glob("*.parquet"):
        assert {*pd.read_parquet(table).get("key", [])} <= {folder.name}, table.name
    assert clothbench("store", "check", "runs").returncode == 0
    with pytest.raises(ClothbenchError, match="was stopped by the clock, which no other machine does"):
        require_ended(Store(recordings_folder.parent / "runs"), folder.name)


def test_repeats_walk_as_long_as_the_fit_on_both_meshes(recordings_folder, monkeypatch):
    cell = cell_of(recordings_folder, budget=24, options={"annealing": {"share": 0.3}})
    bench = set_up(cell, catalogue())
    coarse, fine = searched(stages_of(bench, catalogue()), catalogue(), Checkpoint(), bench.space, 24, 4)
    assert [coarse.evaluations, fine.evaluations] == [18, 6]
    assert coarse.looked > 1
    again = []

    def watched(*given, **more):
        again.append(searched(*given, **more))
        return again[-1]

    monkeypatch.setattr(analysis, "searched", watched)
    analysis.ANALYSES["repeats"](bench, with_mesh(coarse, fine, cell), {"count": 1}, catalogue(), Checkpoint())
    assert [[fit.evaluations for fit in fits] for fits in again] == [[18 - coarse.looked, 6]]


def test_another_search_of_the_cell_has_time_of_its_own(recordings_folder):
    cell = cell_of(recordings_folder, optimizer="nelder_mead", finer={}, timeout=50.0)
    bench, late = set_up(cell, catalogue()), Checkpoint()
    late.before = 100.0
    found = [
        searched([bench], catalogue(), late, bench.space, 12, 4, bounded=False, since=since)[0]
        for since in (0.0, late.seconds)
    ]
    assert [fit.status for fit in found] == ["timeout", "ok"]
    assert [fit.seed for fit in found] == [4, 4]


@pytest.mark.parametrize(("searched_by", "status"), [(True, "error"), (False, "skipped")])
def test_a_further_metric_without_a_number_leaves_the_cell_finished(searched_by, status):
    whole, nothing = SimpleNamespace(status=("ok",), reasons=()), Score(np.array([np.nan]), "m")
    found, reason = _status(SimpleNamespace(status="ok", stopped=""), nothing, whole, searched_by, None)
    assert (found, found in FINISHED) == (status, not searched_by)
    assert "could not be computed" in reason


def test_whatever_an_optimizer_says_of_its_end_is_one_line_of_a_row():
    whole, found = SimpleNamespace(status=("ok",), reasons=()), Score(np.array([1.0]), "m")
    for said, kept in (("converged", "converged"), ("two\nlines", "two lines"), (3, "3")):
        assert _status(SimpleNamespace(status="ok", stopped=said), found, whole, True, None) == ("ok", kept)
