"""Suites become cells: splits, keys, and settings that are refused."""

import dataclasses
import math
from importlib.resources import files
from types import SimpleNamespace

import flat_video
import numpy as np
import pytest
import yaml
from conftest import swinging_recording

from clothbench import ClothbenchError, write_recording, write_video
from clothbench.engine.cells import Source, resplit
from clothbench.engine.run import run_cell
from clothbench.engine.settings import OF_SEARCHES, last_word
from clothbench.engine.store import Store
from clothbench.engine.suite import plan, suites_folder
from clothbench.plugins.discovery import catalogue

BASE = {
    "study": "calibration", "model": "mass_spring", "optimizer": "ga", "metric": "node_error", "effects": [],
    "report": [], "tracker": "markers", "scene": {}, "options": {}, "bounds": {}, "budget": 10, "seed": 0, "jobs": 1,
    "timeout": None, "out": "runs", "rerun": False,
}  # fmt: skip


def cells(recordings, **changes):
    return plan({**BASE, "recordings": str(recordings), **changes}, catalogue())


def test_the_product_of_models_optimizers_and_metrics(recordings_folder):
    found = cells(recordings_folder, optimizer=["ga", "least_squares"], metric=["node_error", "relative_error"])
    assert len(found) == 4
    assert len({c.key for c in found}) == 4
    assert [s.split for s in found[0].recordings] == ["fit", "held_out"]


def test_the_key_depends_on_the_question_and_not_on_where_files_lie(recordings_folder, tmp_path):
    first = cells(recordings_folder)[0]
    moved = tmp_path / "elsewhere"
    recordings_folder.rename(moved)
    assert cells(moved)[0].key == first.key
    for change in ({"seed": 1}, {"budget": 11}, {"effects": ["added_mass"]}, {"options": {"ga": {"population": 9}}},
                   {"bounds": {"k1": [1, 50]}}, {"scene": {"air_density": 1.0}}):  # fmt: skip
        assert cells(moved, **change)[0].key != first.key
    assert cells(moved, options={"least_squares": {"starts": 5}})[0].key == first.key  # not used here
    newer = {**first.versions, "models/mass_spring": "clothbench 0.1.0, 99"}
    assert dataclasses.replace(first, versions=newer).key != first.key


def test_settings_are_others_where_the_question_is(recordings_folder):
    first = cells(recordings_folder)[0]
    changes = [{"fixed": {"zeta": 0.2}}, {"start": {"k1": 2.0}}, {"choice": "knee"}, {"timeout": 5.0},
               {"finer": {"spacing": 0.01, "share": 0.25}}]  # fmt: skip
    told = [dataclasses.replace(first, **change).settings for change in changes]
    assert len({first.settings, *told}) == 6
    assert dataclasses.replace(first, seed=3).settings == first.settings


def test_recordings_without_a_split_are_split_alike_whatever_the_seed(tmp_path):
    """So that the seeds of a search are repetitions on one question."""
    for k in range(6):
        write_recording(swinging_recording(f"r{k}", split=""), tmp_path / f"r{k}.nc")
    splits = [[s.split for s in cells(tmp_path, seed=seed)[0].recordings] for seed in (0, 1, 2)]
    assert splits[0].count("held_out") == 2
    assert splits == 3 * splits[:1]


@pytest.mark.parametrize("seed", range(4))
def test_the_order_in_which_files_are_named_is_no_other_split(seed):
    folder = [Source(f"there/r{k}.nc", f"r{k}", str(k), "") for k in range(7)]
    held = {s.name for s in resplit(folder, seed) if s.split == "held_out"}
    first = np.random.default_rng(seed).permutation(7)[:2]  # as in stored results: a folder's come by path
    assert held == {f"r{k}" for k in first}
    for named in (folder[::-1], folder[3:] + folder[:3]):
        found = resplit(named, seed)
        assert [s.name for s in found] == [s.name for s in named]
        assert {s.name for s in found if s.split == "held_out"} == held


def test_cases_and_selection(tmp_path):
    for fabric in ("silk", "wool"):
        for k in (1, 2):
            write_recording(swinging_recording(f"{fabric}-{k}", fabric=fabric), tmp_path / f"{fabric}-{k}.nc")
    assert [c.case for c in cells(tmp_path)] == ["silk", "wool"]
    assert [c.case for c in cells(tmp_path, suite={"name": "s", "case": "all"})] == ["all"]
    assert [c.case for c in cells(tmp_path, suite={"name": "s", "select": "silk*"})] == ["silk"]


def test_recordings_of_one_name_are_told_apart_by_their_cases(tmp_path):
    for fabric in ("silk", "wool"):
        for name in ("swing", "sway"):
            recording = swinging_recording(name, fabric=fabric, split="fit" if name == "swing" else "held_out")
            write_recording(recording, tmp_path / f"{fabric}-{name}.nc")
    for suite in ({}, {"each": ["swing"]}, {"together": ["swing"]}):
        planned = cells(tmp_path, suite={"name": "s", **suite})
        assert [cell.case for cell in planned] == [f"{f}/swing" if "each" in suite else f for f in ("silk", "wool")]
        for fabric, cell in zip(("silk", "wool"), planned, strict=True):
            assert [s.name for s in cell.recordings if s.split == "fit"] == [f"{fabric}/swing"]
    run_cell(planned[0], tmp_path / "runs")
    store = Store(tmp_path / "runs")
    assert {row["recording"] for row in store.rows()} == {None, "silk/swing", "silk/sway"}
    assert {row["recording"] for row in store.table("trace")} == {"silk/swing", "silk/sway"}
    with pytest.raises(ClothbenchError, match=r"wool-sway\.nc: found the name 'sway', which .*silk-sway\.nc has too"):
        cells(tmp_path, suite={"name": "s", "case": "all"})
    write_recording(swinging_recording("sway", fabric="silk", noise_sigma=2e-3), tmp_path / "silk-again.nc")
    with pytest.raises(ClothbenchError, match=r"found the name 'sway', which .*silk-again\.nc of case 'silk' has too"):
        cells(tmp_path)


@pytest.mark.parametrize(
    ("change", "found"),
    [
        ({"modle": "x"}, "setting 'modle' is not known"),
        ({"scene": {"wind": 1}}, "setting of 'scene' 'wind' is not known"),
        ({"suite": {"name": "s", "cases": "x"}}, "setting of 'suite' 'cases' is not known"),
        ({"suite": {"name": "s", "case": "colour"}}, "'suite.case' is 'colour'"),
        (
            {"suite": {"name": "s", "select": "zzz"}},
            r"'suite.select' \['zzz'\] matches none of 2 recordings: \w+-\d, \w+-\d$",
        ),
        ({"suite": {"name": "s", "select": []}}, "'suite.select' is empty; give some, for example"),
        ({"model": "mass_sping"}, "did you mean 'mass_spring'"),
        ({"model": []}, "setting 'model' is empty"),
        ({"budget": 0}, "expected a whole number, at least 1"),
        ({"timeout": 10**400}, "setting 'timeout' is 1000+, expected a number above 0"),
        ({"recordings": "nowhere"}, "no such file or folder"),
        ({"recordings": None}, "no recordings named"),
    ],
)
def test_wrong_settings_are_one_line(recordings_folder, change, found):
    with pytest.raises(ClothbenchError, match=found):
        plan({**BASE, "recordings": str(recordings_folder), **change}, catalogue())


def test_what_a_study_refuses_it_refuses_before_it_plans():
    """Its `plan` need not ask for that; what is called `check` may be anything."""
    asked = []

    class Asks:
        name, against, suite_words, tables = "asks", "nothing", frozenset(), {}

        def plan(self, settings, plugins, progress=None):
            asked.append("plan")
            return []

        def check(self):
            raise AssertionError

    class Refuses(Asks):
        def refuse_settings(self, settings):
            asked.append(settings["seed"])

    def planned(study):
        plan({**BASE, "study": "asks", "seed": 3}, SimpleNamespace(plugins=(), load=lambda kind, name: study))

    planned(Asks())
    planned(Refuses())
    assert asked == ["plan", 3, "plan"]


def test_a_weight_that_nobody_knows_is_asked_for_before_anything_is_tracked(tmp_path):
    """Of pictures as of nodes, by both studies."""
    write_video(flat_video.video(), tmp_path / "run.nc")
    assert math.isnan(flat_video.video().areal_density)
    searched = {"tracker": "sift_graph", "recordings": str(tmp_path)}
    improved = {"study": "improve", "optimizer": "least_squares", "metric": None, "budget": 400} | searched
    for settings in (searched, improved):
        with pytest.raises(ClothbenchError, match=r"run\.nc: attribute 'areal_density' is not known; state what to"):
            plan({**BASE, **settings}, catalogue())
        assert plan({**BASE, **settings, "scene": {"areal_density": 0.1}}, catalogue())


@pytest.mark.parametrize(
    ("plugins", "options", "found"),
    [
        (
            {"metric": "silhouette"},
            {"quantity": ["mismatch", "iou"]},
            r"quantity is \['mismatch', 'iou'\], expected one",
        ),
        ({"metric": "node_error"}, {"unit": ["cm"]}, r"unit is \['cm'\], expected one of mm, cm, m, px"),
        ({"metric": "relative_error"}, {"origin": ["a", "b", "c"]}, r"origin is \['a', 'b', 'c'\], expected centre"),
        ({"metric": "relative_error"}, {"quantity": "sum"}, "quantity is 'sum', expected one of percent, squares"),
        ({"metric": "profile"}, {"join": float("inf")}, "join is inf, expected metres"),
        (
            {"model": "mass_spring"},
            {"precision": ["single"]},
            r"precision is \['single'\], expected one of double, single",
        ),
        ({"model": "mass_spring"}, {"strain_limit": True}, "strain_limit is True, expected a number above 0"),
        ({"model": "mass_spring"}, {"step_scale": None}, "step_scale is None, expected a number above 0"),
        ({"optimizer": "ga"}, {"decoding": []}, r"decoding is \[\], expected one of"),
    ],
)
def test_an_option_of_the_wrong_type_is_one_line(recordings_folder, plugins, options, found):
    with pytest.raises(ClothbenchError, match=found):
        cells(recordings_folder, **plugins, options=dict.fromkeys(plugins.values(), options))


def test_bounds_of_a_suite_may_be_of_models_that_are_not_run(recordings_folder):
    suite = {"bounds": {"theta": [0.0, 1e-4], "linear_drag": {"coefficient": [0.0, 5.0]}, "k1": [10.0, 20.0]}}
    for words in (["seed=1"], ["bounds.k1=[10,20]"]):
        (cell,) = cells(recordings_folder, **last_word(suite, words))
        assert cell.bounds["k1"] == (10.0, 20.0)
    for word in ("bounds.theta=[0,1]", "+bounds={theta:[0,1]}", "++bounds.linear_drag.coefficient=[0,5]"):
        with pytest.raises(ClothbenchError, match=r"no parameter '(theta|linear_drag\.coefficient)'; there"):
            cells(recordings_folder, **last_word(suite, [word]))
    with pytest.raises(ClothbenchError, match="no parameter 'thata'"):  # which no plugin has
        cells(recordings_folder, **last_word({"bounds": {"thata": [0.0, 1e-4]}}, []))


def test_a_list_of_one_resolution_is_that_number(recordings_folder):
    from clothbench.modelling import grid_shape
    from clothbench.recordings.kinds import read_sheet
    from clothbench.recordings.scenes import scene_of

    scene = scene_of(read_sheet(next(recordings_folder.glob("*.nc"))))
    assert grid_shape(scene, [5]) == grid_shape(scene, 5)


@pytest.mark.parametrize(("fabric", "remedy"), [("paper", "suite.select"), ("", r"states no fabric.*suite\.case=all")])
def test_only_held_out_recordings_cannot_be_fitted(tmp_path, fabric, remedy):
    write_recording(swinging_recording(split="held_out", fabric=fabric), tmp_path / "a.nc")
    with pytest.raises(ClothbenchError, match=f"found only held-out recordings.*{remedy}"):
        cells(tmp_path)


def test_the_built_in_suites_are_where_the_code_looks():
    assert {p.stem for p in (suites_folder() / "suite").glob("*.yaml")} >= {"static_dynamic", "iri_swing"}


def test_the_hybrid_evolution_runs_beside_a_plain_one_on_the_drapes():
    """As the paper compares them; on two of the fabrics of the suite `drape`, each with the same genes."""
    drape, searches = (
        yaml.safe_load((suites_folder() / "suite" / f"{name}.yaml").read_text(encoding="utf-8"))
        for name in ("drape", "drape_searches")
    )
    assert {*drape["optimizer"], "simple_ea"} <= {*searches["optimizer"]}
    assert searches["suite"]["textile"].items() <= drape["suite"]["textile"].items()
    assert {*searches["suite"]["select"]} == {f"{fabric}/*" for fabric in searches["suite"]["textile"]}
    same = ("study", "model", "metric", "tracker", "budget")
    assert [searches[key] for key in same] == [drape[key] for key in same]


def test_what_steers_no_search_is_held_against_the_defaults_of_every_run():
    """Two places state them: the settings of a run, and what studies without a search take as left out."""
    defaults = yaml.safe_load(files("clothbench.conf").joinpath("run.yaml").read_text(encoding="utf-8"))
    assert {key: defaults[key] for key in OF_SEARCHES} == OF_SEARCHES
