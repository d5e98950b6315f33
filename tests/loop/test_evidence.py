"""Evidence, cell and finding: what the loop must not know, what a key must, and what is written from the finding."""

from __future__ import annotations

import ast
import dataclasses
import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from test_curves import problem_of, runs

from clothbench.core.errors import ClothbenchError
from clothbench.core.files import file_names
from clothbench.core.observation import Observation
from clothbench.core.parameters import Parameter, ParameterSpace
from clothbench.engine.cells import Source
from clothbench.engine.checkpoint import Checkpoint
from clothbench.plugins.discovery import catalogue
from clothbench.studies import improve as room
from clothbench.studies.improve.cell import ImproveCell
from clothbench.studies.improve.document import document_in, noise_stated, verdict_document
from clothbench.studies.improve.files import publish, require_own_page, rerun_files, write_files
from clothbench.studies.improve.fitting import fit, search_settings
from clothbench.studies.improve.loop import improve
from clothbench.studies.improve.page import page_html, sections
from clothbench.studies.improve.problem import residuals
from clothbench.studies.improve.run import leaderboard_rows
from clothbench.studies.improve.schema import IMPROVE_TABLES
from clothbench.studies.improve.sheet_tables import summary
from clothbench.studies.improve.sheets import SheetCase, SheetEvidence, noise_of
from clothbench.studies.improve.tables import drift_rows, finding_tables

FOLDER = Path(room.__file__).parent
WRITERS = ("document", "tables", "sheet_tables", "page", "words", "figures", "rerun_file", "files")
SOURCE = Source("here/a.nc", "a", "1234", "fit")
CELL = ImproveCell(
    (SOURCE,), "nodes", "springs", ("drag",), ("lag",), "eyes", "descent", versions={"models/springs": "1"}
)


def imports(name: str) -> set[str]:
    tree = ast.parse((FOLDER / f"{name}.py").read_text())
    return {node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}


def test_the_stages_know_no_kind_of_evidence():
    knowing = {
        p.stem
        for p in FOLDER.glob("*.py")
        if {f"{room.__name__}.{k}" for k in ("curves", "drapes", "sheets")} & imports(p.stem)
    }
    assert knowing == {"prepare"}


def test_no_plugin_is_named():
    plugins = {p.name for p in catalogue().plugins if p.kind != "studies"}
    for path in FOLDER.glob("*.py"):
        texts = {n.value for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.Constant)}
        named = plugins & {text for text in texts if isinstance(text, str)}
        assert not named - {"markers"}, path  # what Plotly calls its dots


def test_what_is_written_simulates_nothing_and_loads_no_plugin():
    strange = {f"{room.__name__}.{name}" for name in ("problem", "fitting", "held_out", "rounds", "loop", "refinement")}
    for name in WRITERS:
        assert not imports(name) & strange, name
        assert not any(m.startswith(("clothbench.estimation", "clothbench.plugins")) for m in imports(name)), name


@pytest.mark.parametrize(
    "change",
    [
        {"versions": {"models/springs": "2"}},
        {"optimizer": "genes"},
        {"tracker": "camera"},
        {"options": {"descent": {"walks": 1}}},
        {"bounds": {"k": (1.0, 2.0)}},
        {"scene": {"resolution": 9}},
        {"recordings": (dataclasses.replace(SOURCE, split="held_out"),)},
        {"seed": 1},
        {"timeout": 9.0},
    ],
)
def test_a_key_holds_all_that_an_answer_depends_on(change):
    assert dataclasses.replace(CELL, **change).key != CELL.key


def test_a_key_holds_nothing_else():
    moved = dataclasses.replace(SOURCE, path="there/b.nc")
    assert dataclasses.replace(CELL, recordings=(moved,), options={"unused": {"a": 1}}).key == CELL.key


def test_what_is_kept_of_an_unfinished_run_is_of_its_question_only(tmp_path):
    problem = dataclasses.replace(
        problem_of(runs(3, lambda e: 20 * e)), checkpoint=Checkpoint(tmp_path), question="one"
    )
    fit(problem, (), None, 3)
    kept = set(tmp_path.iterdir())
    fit(problem, (), None, 3)
    assert set(tmp_path.iterdir()) == kept
    fit(dataclasses.replace(problem, question="another"), (), None, 3)
    assert len(set(tmp_path.iterdir()) - kept) == 2  # the search, and the fit that it ended in


def test_a_run_that_did_not_come_to_its_end_has_no_residual_whatever_it_left():
    """As `evaluate` has it: a stranger's model may leave positions."""
    trial = problem_of(runs(3, lambda e: 20 * e)).trials((), "fit")[0]
    theta = trial.simulation.parameters.defaults[None]
    stopped = dataclasses.replace(trial.simulation.run(theta), status=("timeout",))
    left = dataclasses.replace(trial, simulation=SimpleNamespace(run=lambda _: stopped))
    assert np.isfinite(residuals(trial, theta)).all()
    assert np.isnan(residuals(left, theta)).all()


def test_recordings_are_filed_under_a_name_each():
    for names in (("a b", "a b-3", "a_b"), ("x", "x-3", "x"), ("x", "x-2", "x-3", "x", "x-2")):
        found = file_names(names)
        assert len(set(found)) == len(names)


def verdict_cell(store: Path, key: str, *recordings: str) -> Path:
    """The folder of a finished cell, as far as it is published."""
    cell = store / "cells" / key
    (cell / "rerun").mkdir(parents=True)
    said = {"key": key, "model": key, "recordings": {"fit": recordings, "held_out": []}}
    (cell / "verdict.json").write_text(json.dumps(said))
    for name in ("index.html", "rows.parquet", *(f"{table}.parquet" for table in IMPROVE_TABLES)):
        (cell / name).write_text(key)
    for name in file_names(recordings):
        (cell / "rerun" / f"{name}.rrd").write_text(key)
    return cell


def test_only_what_an_earlier_verdict_left_makes_way_for_a_new_one(tmp_path):
    others = ("rerun/static_dynamic_fleece-0123abcd.rrd", "tables/mine.parquet", "tables/rows.parquet", "notes.txt")
    for name in others:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("not of improve")
    one = verdict_cell(tmp_path, "aa", "case/a [1]", "case/a_1_", "b")
    (one / "gone.parquet").write_text("a table that later versions do not have")
    publish(one, tmp_path)
    (tmp_path / "tables" / "gone.parquet").write_text("as an earlier version published it")
    found = rerun_files(tmp_path)
    assert list(found) == ["case/a [1]", "case/a_1_", "b"]
    assert len(set(found.values())) == 3
    publish(verdict_cell(tmp_path, "bb", "b", "c"), tmp_path)
    assert {name: path.read_text() for name, path in rerun_files(tmp_path).items()} == {"b": "bb", "c": "bb"}
    expected = {*others, "rerun/b.rrd", "rerun/c.rrd", *(f"tables/{name}.parquet" for name in IMPROVE_TABLES)}
    assert {f"{p.parent.name}/{p.name}" for folder in ("rerun", "tables") for p in (tmp_path / folder).iterdir()} == (
        expected - {"notes.txt"}
    )
    assert all((tmp_path / name).read_text() == "not of improve" for name in others)
    common = {"key": "cc", "model": "aa", "models": [{"key": "aa"}, {"key": "bb"}]}
    (tmp_path / "verdict.json").write_text(json.dumps(common))
    publish(verdict_cell(tmp_path, "dd", "d"), tmp_path)
    assert sorted(p.name for p in (tmp_path / "rerun").iterdir()) == ["d.rrd", "static_dynamic_fleece-0123abcd.rrd"]


def test_a_page_of_another_command_is_not_replaced(tmp_path):
    require_own_page(tmp_path)
    (tmp_path / "index.html").write_text("<title>clothbench: submissions</title>")
    with pytest.raises(ClothbenchError, match=r"index.html: found a page that improve did not make, .* another out="):
        require_own_page(tmp_path)
    (tmp_path / "index.html").write_text("<title>clothbench: improve mass_spring</title>")  # without its verdict yet
    require_own_page(tmp_path)


def test_options_and_bounds_reach_the_search():
    options = {"least_squares": {"walks": 2, "tolerance": 1e-3}}
    problem = dataclasses.replace(
        problem_of(runs(3, lambda e: 0 * e)), options=options, bounds={"stiffness": (30.0, 90.0)}
    )
    first, again = search_settings(problem, first=True), search_settings(problem, first=False)
    assert (first["walks"], first["tolerance"], first["starts"]) == (2, 1e-3, problem.evidence.search.starts)
    assert first["patience"] == again["patience"] == problem.evidence.search.patience
    assert (again["walks"], again["tolerance"]) == (problem.evidence.search.restart_walks, 1e-3)
    assert fit(problem, (), None, 3).theta[0] == pytest.approx(30.0)


def test_another_optimizer_is_told_only_what_it_has_a_setting_for():
    problem = dataclasses.replace(problem_of(runs(3, lambda e: 0 * e)), optimizer="nelder_mead")
    assert not set(search_settings(problem, first=True)) & {"difference", "walks"}


@pytest.mark.parametrize("name", catalogue().names("optimizers"))
def test_a_fit_from_a_known_point_is_never_worse_than_that_point(name):
    """Whatever the optimizer does: the point is nearly the best there is, and the search is short."""
    problem = problem_of(runs(0, lambda e: 0.05 * np.expm1(9 * e)))
    best = fit(problem, ("strain_locking",), np.array([20.0, 0.05, 9.0]), 20)
    problem = dataclasses.replace(
        problem, optimizer=name, options={name: {"start": "look"}} if name == "cma_es" else {}
    )
    again = fit(problem, ("strain_locking",), best.theta, 1)
    assert again.rms <= best.rms * (1 + 1e-9)


def test_a_search_from_a_known_point_begins_there_where_the_optimizer_can():
    problem = dataclasses.replace(
        problem_of(runs(3, lambda e: 0 * e)), optimizer="nelder_mead", options={"nelder_mead": {"start": "look"}}
    )
    first, again = search_settings(problem, first=True), search_settings(problem, first=False)
    assert (first["start"], again["start"]) == ("look", "defaults")
    assert "starts" not in again


def test_a_finding_is_all_that_is_needed_to_write(tmp_path, monkeypatch):
    """Nothing can be simulated any more, and no plugin loaded."""
    finding = improve(problem_of(runs(0, lambda e: 0.05 * np.expm1(9 * e))), ["strain_locking", "load_offset"])

    def gone(*_, **__):
        raise AssertionError("asked for")

    monkeypatch.setattr("clothbench.plugins.discovery.Catalogue.make", gone)
    monkeypatch.setattr("clothbench.plugins.discovery.Catalogue.load", gone)
    monkeypatch.setattr("clothbench.modelling.curves.CurveSimulation.run", gone)
    write_files(tmp_path, finding, finding_tables(finding))
    assert document_in(tmp_path) == json.loads(json.dumps(verdict_document(finding)))
    assert (tmp_path / "index.html").is_file()
    with pytest.raises(dataclasses.FrozenInstanceError):
        finding.verdict = "complete"


def test_a_name_that_the_verdict_dropped_is_shown_as_dropped():
    finding = improve(problem_of(runs(0, lambda e: 0.05 * np.expm1(9 * e))), ["strain_locking", "load_offset"])
    assert [row["name"] for row in finding_tables(finding)["candidates"] if row["named"]] == ["strain_locking"]
    dropped = dataclasses.replace(finding, verdict="unexplained", dropped="it falls through", final=finding.calibrated)
    tables, document = finding_tables(dropped), verdict_document(dropped)
    for rows in (tables["candidates"], document["candidates"]):
        assert {row["name"]: row["why_not"] for row in rows}["strain_locking"] == "it falls through"
    assert not any(row["named"] for row in tables["candidates"])
    assert ">named</span>" not in page_html(document, tables)


def test_what_is_tied_keeps_what_its_own_round_said_of_it():
    """It is tried again beside what was named, and then explains nothing more."""
    finding = improve(problem_of(runs(0, lambda e: 0.05 * np.expm1(9 * e))), ["strain_locking", "load_offset"])
    first = next(found for found in finding.rounds if found.named)
    rival = dataclasses.replace(first.candidates[0], name="rival", p_value=0.005, why_not="")
    tied = dataclasses.replace(first, candidates=(*first.candidates, rival), named=(*first.named, "rival"))
    again = dataclasses.replace(rival, p_value=0.87, why_not="explains no more than chance would (p = 0.87)")
    later = dataclasses.replace(first, candidates=(again,), named=())
    document = verdict_document(dataclasses.replace(finding, rounds=(tied, later)))
    assert document["effects"][0]["tied_with"] == ["rival"]
    entry = next(one for one in document["candidates"] if one["name"] == "rival")
    assert (entry["p_value"], entry["why_not"]) == (0.005, finding.dropped)


def test_an_error_on_what_is_held_out_that_is_no_number_says_why():
    finding = improve(problem_of(runs(0, lambda e: 0.05 * np.expm1(9 * e))), ["strain_locking", "load_offset"])
    assert {row["status"] for row in leaderboard_rows(CELL, finding)} == {"ok"}
    name, before, _ = finding.held_out[0]
    lost = dataclasses.replace(finding, held_out=((name, before, np.nan), *finding.held_out[1:]))
    after = leaderboard_rows(CELL, lost)[-1]
    assert (after["split"], after["value"], after["status"]) == ("held_out", None, "diverged")
    assert after["reason"] == f"{name}, held out, could not be simulated"


def test_a_page_over_stored_verdicts_says_where_each_was_computed(tmp_path):
    finding = improve(problem_of(runs(0, lambda e: 0.05 * np.expm1(9 * e))), ["strain_locking", "load_offset"])
    (tmp_path / "one").mkdir()
    write_files(tmp_path / "one", finding, finding_tables(finding))
    row = {"key": "one", "clothbench": "0.0.9", "cpu": "an old machine", "cores": 64}
    (section,) = sections(SimpleNamespace(keys=["one"], rows=[row], store=SimpleNamespace(cell=tmp_path.joinpath)))
    assert "clothbench 0.0.9 · an old machine, 64 cores" in section.html


def test_noise_is_told_from_motion_though_frames_are_missing():
    """1 mm, of cloth that swings by 0.2 m once in a second, at 30 frames a second."""
    random, time = np.random.default_rng(1), np.arange(0.0, 6.0, 1 / 30)
    phase, material = random.uniform(0, 6, 100), random.random((100, 2))

    def seen(time: np.ndarray) -> float:
        away = 0.2 * np.sin(2 * np.pi * time[:, None] + phase)
        position = np.stack([0 * away, away, 0 * away], axis=2) + random.normal(0, 1e-3, (len(time), 100, 3))
        return noise_of(Observation(time, position, np.ones((len(time), 100), bool), np.nan, material))

    for stamps in (time, time[random.random(len(time)) > 0.25], np.sort(time + random.uniform(-0.2, 0.2, 180) / 30)):
        assert seen(stamps) == pytest.approx(1e-3, rel=0.15)


@pytest.mark.parametrize("rate", [10, 15, 30, 60, 120])
def test_noise_is_told_from_motion_that_is_fast_beside_the_frames(rate):
    """1 mm, of cloth that swings by 0.2 m once in a second; third differences alone told 8 mm at 10 frames a second."""
    random, time = np.random.default_rng(1), np.arange(60) / rate
    away = 0.2 * np.sin(2 * np.pi * time[:, None] + random.uniform(0, 6, 64))
    position = np.stack([0 * away, away, 0 * away], axis=2) + random.normal(0, 1e-3, (60, 64, 3))
    seen, material = np.ones((60, 64), bool), random.random((64, 2))
    assert noise_of(Observation(time, position, seen, np.nan, material)) == pytest.approx(1e-3, rel=0.04)
    assert noise_of(Observation(time, position, seen, 3e-3, material)) == 3e-3  # as it is stated


@pytest.mark.parametrize("nodes", [1, 4, 25])
def test_the_least_of_several_orders_is_not_told_too_low(nodes):
    random, count = np.random.default_rng(7), 100 if nodes < 25 else 30
    told = [noise_in(random.normal(0, 1e-3, (40, nodes, 3))) for _ in range(count)]
    assert np.mean(np.square(told)) ** 0.5 == pytest.approx(1e-3, rel=0.03)


def test_a_verdict_says_whether_its_noise_is_stated():
    material, time = np.zeros((4, 2)), np.arange(60) / 30
    position = np.random.default_rng(0).normal(0, 1e-3, (60, 4, 3))

    def stated(*sigmas: float, noise: float) -> bool | None:
        seen = [Observation(time, position, np.ones((60, 4), bool), sigma, material) for sigma in sigmas]
        cases = tuple(SheetCase(f"r{k}", "fit", None, one, None) for k, one in enumerate(seen))
        return noise_stated(SimpleNamespace(evidence=SheetEvidence(cases), noise=noise))

    assert stated(1e-3, 1e-3, noise=1e-3) is True
    told = noise_in(position)
    assert stated(np.nan, np.nan, noise=told) is False
    assert stated(1e-3, np.nan, noise=np.hypot(1e-3, told) / 2**0.5) is False
    assert stated(np.nan, np.nan, noise=5e-3) is None  # between repeats
    finding = improve(problem_of(runs(0, lambda e: 0.05 * np.expm1(9 * e))), ["load_offset"])
    assert verdict_document(finding)["error"]["noise_stated"] is None  # between runs


def test_a_verdict_that_nothing_is_missing_has_no_law_of_what_is():
    finding = improve(problem_of(runs(0, lambda e: 0.05 * np.expm1(9 * e))), ["load_offset"])
    past = SimpleNamespace(shares={"velocity": 0.99}, lag=[0.0], value=[0.1], low=[0.0], high=[0.2])
    law = SimpleNamespace(formula="f = −1.27 v_n n", p_value=0.005, alike=())
    finding = dataclasses.replace(finding, balance=SimpleNamespace(past=past, law=law, recordings=(5, 5)))
    for word, formula in (("unexplained", law.formula), ("complete", None)):
        document = verdict_document(dataclasses.replace(finding, verdict=word))
        assert document["balance"]["formula"] == formula
        assert document["description"] is None
        assert ("sparsest law" in page_html(document, finding_tables(finding))) == (word != "complete")


def noise_in(position: np.ndarray) -> float:
    """Told of positions (T, N, 3) at 30 frames a second that state none."""
    frames, nodes = position.shape[:2]
    seen, material = np.ones((frames, nodes), bool), np.random.default_rng(0).random((nodes, 2))
    return noise_of(Observation(np.arange(frames) / 30, position, seen, np.nan, material))


@pytest.mark.parametrize("frames", [4, 5, 6, 8, 20, 150])
def test_noise_is_the_rms_over_coordinates_also_of_a_sensor_that_sees_depth_worse(frames):
    random, sigma = np.random.default_rng(frames), np.array([0.5e-3, 0.5e-3, 3e-3])
    position = random.normal(0, sigma, (frames, 2000, 3))
    assert noise_in(position) == pytest.approx(np.sqrt(np.mean(sigma**2)), rel=0.06)


def test_nodes_written_without_noise_do_not_count_in_it():
    position = np.random.default_rng(0).normal(0, 1e-3, (150, 16, 3))
    position[:, :4] = 0.1 * np.sin(np.arange(150) / 30)[:, None, None]  # held, and moved exactly
    assert noise_in(position) == pytest.approx(1e-3, rel=0.05)
    assert noise_in(0 * position) == 0.0


@pytest.mark.parametrize("away", [0.0, 0.05])
@pytest.mark.parametrize("sigma", [0.05e-3, 0.1e-3, 0.3e-3])
def test_noise_of_what_is_rounded_is_no_less_than_its_rounding(away, sigma):
    """Of a sheet at rest most coordinates stay what they are from frame to frame."""
    random, grid = np.random.default_rng(1), 1e-3
    motion = away * np.sin(0.7 * 2 * np.pi * np.arange(150) / 30)[:, None, None] * np.array([1, 0.05, 0.3])
    position = random.random((1, 25, 3)) + motion + random.normal(0, sigma, (150, 25, 3))
    told = noise_in(np.round(position / grid) * grid)
    assert told >= 0.999 * grid / np.sqrt(12)
    assert told == pytest.approx(np.hypot(sigma, grid / np.sqrt(12)), rel=0.4)


def test_a_run_out_of_time_begins_no_further_round_and_says_so():
    finding = improve(problem_of(runs(0, lambda e: 0.05 * np.expm1(9 * e))), ["strain_locking"], timeout=1e-9)
    assert finding.timed_out
    assert (finding.rounds, finding.verdict) == ((), "unexplained")
    assert "time ran out" in finding.hint


def test_where_no_node_is_seen_four_times_on_end_noise_is_not_known():
    time, seen = np.arange(8) / 30.0, (np.arange(8) % 3 > 0)[:, None]
    assert np.isnan(noise_of(Observation(time, np.zeros((8, 1, 3)), seen, np.nan, np.zeros((1, 2)))))


def test_noise_of_single_recordings_is_no_drift():
    """The joint interval is that of a mean: single values lie outside it, which is no drift."""
    random = np.random.default_rng(0)
    space = ParameterSpace((Parameter("a", "a", "1", (0.0, 1.0), "linear", 0.1, "a", ""),))
    joint = SimpleNamespace(space=space, theta=np.array([0.5]), low=np.array([0.49]), high=np.array([0.51]))

    def drifting(values):
        alone = {
            f"r{k}": SimpleNamespace(theta=np.array([v]), at_bound=np.array([False])) for k, v in enumerate(values)
        }
        return [row["outside"] for row in drift_rows(SimpleNamespace(calibrated=joint, alone=alone))]

    noise = [any(drifting(0.5 + 0.05 * random.standard_normal(6))) for _ in range(400)]
    assert np.mean(noise) == pytest.approx(0.05, abs=0.03)
    assert drifting([0.5, 0.51, 0.49, 0.505, 0.9, 0.495]) == [False] * 4 + [True, False]
    assert drifting([0.5, 0.5, 0.5]) == [False] * 3


def drift_of(alone, joint):
    """Which values (N, P) of N recordings, fitted alone from `joint` (P,), are told to stand out."""
    units = [Parameter(f"p{k}", "p", "1", (0.0, 1.0), "linear", 0.1, "p", "") for k in range(len(joint))]
    whole = SimpleNamespace(space=ParameterSpace(tuple(units)), theta=joint, low=joint - 0.01, high=joint + 0.01)
    each = {f"r{k}": SimpleNamespace(theta=theta, at_bound=np.zeros(len(joint), bool)) for k, theta in enumerate(alone)}
    rows = drift_rows(SimpleNamespace(calibrated=whole, alone=each))
    return np.array([row["outside"] for row in rows]).reshape(alone.shape)


def test_searches_that_did_not_move_are_no_spread_for_others_to_stand_out_of():
    """A start that three kept, were it their estimate, would make any other value stand out."""
    joint, start = np.array([0.5]), np.array([0.45])  # another round came to a better fit of all together
    assert not drift_of(np.array([joint, joint, joint, [0.6]]), joint).any()
    assert not drift_of(np.array([start, start, start, [0.6]]), joint).any()
    alone = np.array([joint, [0.51], [0.49], [0.505], [0.9], [0.495]])
    assert drift_of(alone, joint).ravel().tolist() == [False] * 4 + [True, False]


def test_of_many_parameters_one_stands_out_by_chance_in_five_of_a_hundred():
    random = np.random.default_rng(0)
    told = [drift_of(0.5 + 0.05 * random.standard_normal((6, 8)), np.full(8, 0.5)).any() for _ in range(300)]
    assert np.mean(told) == pytest.approx(0.05, abs=0.03)


def test_squares_by_direction_add_up_on_a_sheared_sheet_with_gaps():
    random = np.random.default_rng(0)
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(0, 0.3, 5), np.linspace(0, 0.3, 5)))
    position = np.tile(np.stack([u + 0.5 * v, 0 * u, -v], axis=1), (20, 1, 1))
    visible = random.random(position.shape[:2]) > 0.2
    seen = Observation(np.arange(20) / 30, np.where(visible[..., None], position, np.nan), visible, 1e-3,
                       np.stack([u, v], axis=1))  # fmt: skip
    residual = np.tile([3e-3, 0.0, 4e-3], visible.sum())  # 5 mm at every node
    found = summary(SheetCase("a", "fit", None, seen, None), residual)
    assert np.hypot(np.hypot(found.normal, found.warp), found.weft) == pytest.approx(5e-3)
    assert found.normal == pytest.approx(0.0)
