"""The Rerun file of a fit holds what was seen and simulated, at the right times, and small."""

from __future__ import annotations

import dataclasses
import json
import shutil
import signal
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import numpy as np
import pytest

from clothbench.cli import view
from clothbench.core.errors import ClothbenchError
from clothbench.core.rollout import Rollout
from clothbench.display import rerun as rerun_file
from clothbench.engine.cells import Source
from clothbench.engine.leaderboard import ROW, SYSTEM
from clothbench.engine.run import run_cell
from clothbench.engine.store import Store
from clothbench.estimation.calibrate import best_rollout, calibrate
from clothbench.plugins.discovery import catalogue
from clothbench.recordings.nodes import Recording, grips_at, write_recording
from clothbench.recordings.scenes import scene_of
from clothbench.studies.calibration import film_rerun
from clothbench.studies.calibration import rerun_file as fit_file
from clothbench.studies.calibration.cell import Bench, CalibrationCell, set_up
from clothbench.studies.calibration.film_rerun import about, best_rows, write_best

TRUTH = np.array([[60.0, 1.0, 0.1]])


def swing(folder: Path, name: str, split: str) -> Recording:
    """A small sheet swung by two corners, seen at 25 nodes with noise and a gap; by `mass_spring`."""
    lines = np.linspace(0, 0.2, 5)
    material = np.stack([a.ravel() for a in np.meshgrid(lines, lines)], axis=1)
    time, clock = np.linspace(0, 0.5, 11), np.linspace(0, 0.5, 51)
    grip = np.zeros((51, 2, 3))
    grip[:, 1, 0], grip[..., 1] = 0.15, 0.03 * np.sin(8 * clock)[:, None]
    blank = Recording(
        name=name, time=time, material=material, position=np.zeros((11, 25, 3)), grip_time=clock,
        grip_material=np.array([[0.0, 0.0], [0.2, 0.0]]), grip_position=grip, cloth_width=0.2, cloth_height=0.2,
        areal_density=0.2, noise_sigma=1e-3, split=split,
    )  # fmt: skip
    scene = dataclasses.replace(scene_of(blank), start=None)
    position = catalogue().make("models", "mass_spring", resolution=5).prepare(scene).run(TRUTH).position[0].copy()
    position += np.random.default_rng(len(name)).normal(0, 1e-3, position.shape)
    position[3, 7:9] = np.nan
    recording = dataclasses.replace(blank, position=position)
    return dataclasses.replace(recording, path=str(write_recording(recording, folder / f"{name}.nc")))


def small_cell(folder: Path) -> CalibrationCell:
    recordings = [swing(folder, "swing-1", "fit"), swing(folder, "swing-22", "held_out")]
    sources = tuple(Source(r.path, r.name, r.hash, r.split) for r in recordings)
    return CalibrationCell(
        suite="small", case="cotton <b>", recordings=sources, model="mass_spring", effects=(),
        optimizer="ga", metric="node_error",
        tracker="markers", report=("relative_error",), budget=10,
        options={"mass_spring": {"resolution": 5}},
    )  # fmt: skip


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> tuple[Bench, list[Rollout]]:
    cell = small_cell(tmp_path_factory.mktemp("recordings"))
    bench = set_up(cell, catalogue())
    optimizer = catalogue().make("optimizers", "ga", bench.space, seed=cell.stream("optimizer"), budget=cell.budget)
    fit = calibrate(bench.of_split("fit"), optimizer, bench.space)
    return bench, [best_rollout(trial, fit) for trial in bench.trials]


def printed(path: Path) -> str:
    """The file's chunks as the `rerun` tool lists them."""
    command = [sys.executable, "-m", "rerun", "rrd", "print", str(path)]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def test_file_holds_every_recording(fitted, tmp_path):
    bench, rollouts = fitted
    path = tmp_path / "fit.rrd"
    fit_file.write_rerun(path, bench, rollouts)
    listed = printed(path)
    for root in ("/fit/swing-1", "/held_out/swing-22"):
        for entity in ("seen", "simulated", "away", "grips", "error/simulated", "error/noise_floor"):
            assert f"{root}/{entity} " in listed
    for component in (
        "Mesh3D:vertex_positions",
        "Mesh3D:vertex_normals",
        "Mesh3D:triangle_indices",
        "Arrows3D:vectors",
    ):
        assert component in listed
    assert path.stat().st_size < 1_000_000
    assert not list(tmp_path.glob(".*"))


def test_stopped_rollout_and_unseen_frames_leave_gaps(fitted, tmp_path):
    bench, rollouts = fitted
    position = rollouts[0].position.copy()
    position[:, 5:] = np.nan
    stopped = dataclasses.replace(rollouts[0], position=position, status=("diverged",))
    nothing = dataclasses.replace(rollouts[1], position=np.full_like(rollouts[1].position, np.nan))
    path = tmp_path / "fit.rrd"
    fit_file.write_rerun(path, bench, [stopped, nothing])
    meshes = [line for line in printed(path).splitlines() if "Mesh3D:vertex_positions" in line]
    assert len(meshes) == 1
    assert "with 5 rows" in meshes[0]


def test_triangles_cover_an_irregular_sheet_without_slivers():
    lines = np.linspace(0, 0.3, 7)
    material = np.stack([a.ravel() for a in np.meshgrid(lines, lines)], axis=1)
    material += np.random.default_rng(0).normal(0, 2e-4, material.shape)
    triangles = rerun_file.triangulate(material)
    corner = material[triangles]
    p, q = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    area = np.abs(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]).sum() / 2
    assert area == pytest.approx(0.09, rel=0.01)
    assert len(triangles) == 72


def test_points_on_a_line_have_no_triangles():
    assert rerun_file.triangulate(np.array([[0.0, 0.0], [0.1, 0.0], [0.2, 0.0]])).shape == (0, 3)
    assert rerun_file.triangulate(np.array([[0.0, 0.0], [0.1, 0.0]])).shape == (0, 3)


def test_normals_of_a_turning_sheet():
    flat = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0]])
    upright = flat[:, [0, 2, 1]]
    triangles = np.array([[0, 1, 3], [0, 3, 2]])
    normals = rerun_file.vertex_normals(np.stack([flat, upright, flat * 0]), triangles)
    np.testing.assert_allclose(normals[0], [[0, 0, 1]] * 4, atol=1e-12)
    np.testing.assert_allclose(normals[1], [[0, -1, 0]] * 4, atol=1e-12)
    assert not normals[2].any()


def test_grips_are_shown_at_the_frames_times(fitted):
    bench, _ = fitted
    recording = bench.recordings[0]
    shown = grips_at(recording, recording.time)
    np.testing.assert_allclose(shown, recording.grip_position[::5], atol=1e-12)


@pytest.mark.parametrize(
    ("cell", "expected"),
    [
        ("ab", "several cells .* ab12, ab34"),
        ("", "found an empty name of a cell, expected a case, a recording or the beginning of a key"),
        ("ff", "no case, no recording and no cell .* ab12, ab34, cd56"),
        ("cd", "cell cd56 has neither fit.rrd nor films"),
    ],
)
def test_view_names_what_there_is(tmp_path, cell, expected):
    for key in ("ab12", "ab34", "cd56"):
        (tmp_path / "cells" / key).mkdir(parents=True)
    with pytest.raises(ClothbenchError, match=expected) as fault:
        view.open_viewer(tmp_path, cell)
    assert "\n" not in str(fault.value)


def test_the_best_cell_is_one_of_those_in_the_same_unit():
    about = {"suite": "s", "case": "linen", "recording": None, "metric": "node_error", "split": "fit"}
    rows = [about | {"key": key, "value": value, "unit": unit} for key, value, unit in (
        ("a", 9.0, "mm"), ("b", 1.1, "cm"), ("c", 8.0, "mm"))]  # fmt: skip
    assert list(view.cells_of(rows, "linen")) == ["c", "a", "b"]
    assert view.cells_of(rows, "") == {}


def test_a_fit_of_several_recordings_is_known_by_their_mean():
    def rows_of(key, *values):
        about = {"suite": "s", "case": "linen", "metric": "node_error", "split": "fit", "unit": "mm", "key": key}
        mean = [about | {"recording": None, "value": sum(values) / len(values)}] if len(values) > 1 else []
        return [*mean, *(about | {"recording": f"r{i}", "value": v} for i, v in enumerate(values))]

    rows = [*rows_of("a", 1.0, 9.0), *rows_of("b", 2.0, 2.0), *rows_of("failed", 0.1)]  # this one has no mean
    assert list(view.cells_of(rows, "linen")) == ["b", "a", "failed"]
    assert list(view.cells_of(rows, "r0")) == ["failed", "a", "b"]


def test_view_of_an_empty_folder_says_what_to_run(tmp_path):
    with pytest.raises(ClothbenchError, match="clothbench run"):
        view.open_viewer(tmp_path, "ab")


def test_view_opens_the_viewer_and_returns_its_exit_code(tmp_path, monkeypatch):
    (tmp_path / "cells" / "ab12").mkdir(parents=True)
    file = tmp_path / "cells" / "ab12" / "fit.rrd"
    file.touch()
    called = []

    def run(command, **_):
        called.append(command)
        return subprocess.CompletedProcess(command, 3)

    monkeypatch.setattr(view.subprocess, "run", run)
    monkeypatch.setattr(view, "has_display", lambda: True)
    assert view.open_viewer(tmp_path, "ab") == 3
    assert called == [[sys.executable, "-m", "rerun", str(file)]]


@pytest.fixture(scope="module")
def run_without_rerun(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A results folder of a cell that wrote no Rerun file, as the default run does."""
    folder = tmp_path_factory.mktemp("runs")
    assert run_cell(small_cell(tmp_path_factory.mktemp("recordings")), folder, rerun=False) == "ok"
    return folder


def test_the_best_fit_of_each_case_has_a_small_file(run_without_rerun, tmp_path, monkeypatch):
    """With all that is to be seen of it; it is written once, and `view` takes it."""
    folder = tmp_path / "runs"
    shutil.copytree(run_without_rerun, folder)
    store = Store(folder)
    keys = [path.name for path in (folder / "cells").iterdir()]
    (path,) = write_best(store, keys)
    assert path.parent == folder / "rerun"
    assert path.stat().st_size < 400_000
    listed = printed(path)
    for entity in ("seen", "fitted", "off", "error/fitted", "error/noise"):
        assert f"/fit/swing-1/{entity} " in listed
        assert f"/held_out/swing-22/{entity} " in listed
    for component in (
        "/about ",
        "Mesh3D:vertex_colors",
        "TimePanelBlueprint:loop_mode",
        "TimePanelBlueprint:play_state",
    ):
        assert component in listed
    before = path.stat().st_mtime_ns
    assert write_best(store, keys) == [path]
    assert path.stat().st_mtime_ns == before
    assert view.fitted(folder, "swing-1", tmp_path) == path


def test_the_best_is_the_least_error_on_all_that_was_fitted():
    row = {"suite": "s", "case": "c", "metric": "m", "objective": "m", "split": "fit", "recording": None}
    rows = [
        {**row, "key": "a", "value": 2.0}, {**row, "key": "b", "value": 1.0}, {**row, "key": "c", "value": None},
        {**row, "key": "a", "value": 0.1, "recording": "one"}, {**row, "key": "a", "value": 0.2, "split": "held_out"},
        {**row, "key": "a", "value": 0.3, "metric": "another"}, {**row, "key": "d", "value": 0.4},
        {**row, "key": "e", "value": 0.01, "metric": "of another unit", "objective": "of another unit"},
    ]  # fmt: skip
    best = {at: r["key"] for at, r in best_rows(rows, ["a", "b", "c", "e"]).items()}
    assert best == {("s", "c", "m"): "b", ("s", "c", "of another unit"): "e"}


def test_errors_of_several_metrics_are_not_compared(tmp_path, monkeypatch, capsys):
    """Of two cells by millimetres and one by a number without a unit, which is less than either."""
    errors = (("a" * 16, "node_error", 3.0), ("b" * 16, "node_error", 2.0), ("c" * 16, "relative_error", 0.1))

    def kept(key, metric, value):
        row = {**dict.fromkeys({**ROW, **SYSTEM}), "study": "calibration", "suite": "s", "case": "c", "seed": 0,
               "model": "m", "optimizer": "o", "metric": metric, "objective": metric, "split": "fit", "key": key,
               "value": value, "status": "ok", "effects": ""}  # fmt: skip
        Store(tmp_path).put(key, {"rows": [row]})
        films = tmp_path / "cells" / key / "films"
        films.mkdir(exist_ok=True)
        (films / "0.npz").touch()

    for one in errors:
        kept(*one)
    assert view.best_cell_of(tmp_path, "c") == "b" * 16
    assert "further: aaaaaaaa, cccccccc" in capsys.readouterr().out
    assert view.find_cell(tmp_path, "c").name == "b" * 16  # as export and suggest ask, whose output is their own
    out, remark = capsys.readouterr()
    assert out == ""
    assert remark == "clothbench: c: cell bbbbbbbb (c · m · o · node_error); further: aaaaaaaa, cccccccc\n"
    others = [{"key": f"{n:x}" * 16, "case": "many", "value": n, "metric": "m", "objective": "m"} for n in range(11)]
    row = {**dict.fromkeys({**ROW, **SYSTEM}), "suite": "s", "model": "m", "optimizer": "o", "split": "fit"}
    monkeypatch.setattr(view, "fit_rows", lambda out: [row | other for other in others])
    assert view.best_cell_of(tmp_path, "many") == "0" * 16
    assert "further: 11111111, " in (said := capsys.readouterr().out)
    assert said.endswith("77777777, 88888888 and 2 more\n")
    monkeypatch.setattr(film_rerun, "write_film_rerun", lambda path, *_: path.touch())
    names = [path.name[-12:] for path in write_best(Store(tmp_path), [key for key, _, _ in errors])]
    assert names == ["cccccccc.rrd", "bbbbbbbb.rrd"]
    kept("d" * 16, "node_error", 1.0)
    write_best(Store(tmp_path), ["d" * 16])
    assert sorted(path.name[-12:] for path in (tmp_path / "rerun").iterdir()) == ["cccccccc.rrd", "dddddddd.rrd"]


def test_cases_of_one_file_name_leave_each_other_their_files(tmp_path, monkeypatch):
    def kept(key, case, value):
        row = {**dict.fromkeys({**ROW, **SYSTEM}), "study": "calibration", "suite": "s", "case": case, "seed": 0,
               "model": "m", "optimizer": "o", "metric": "node_error", "objective": "node_error", "split": "fit",
               "key": key, "value": value, "status": "ok", "effects": ""}  # fmt: skip
        Store(tmp_path).put(key, {"rows": [row]})
        films = tmp_path / "cells" / key / "films"
        films.mkdir(exist_ok=True)
        (films / "0.npz").touch()

    monkeypatch.setattr(film_rerun, "write_film_rerun", lambda path, *_: path.touch())
    for key, case in (("a" * 16, "raw silk"), ("b" * 16, "raw_silk"), ("c" * 16, "raw/silk")):
        kept(key, case, 2.0)
    (tmp_path / "rerun").mkdir()
    (tmp_path / "rerun" / f"s_raw_silk-{'e' * 8}.rrd").touch()  # of a cell that is no longer there
    made = write_best(Store(tmp_path), [letter * 16 for letter in "abc"])
    assert sorted((tmp_path / "rerun").iterdir()) == sorted(made)
    kept("d" * 16, "raw_silk", 1.0)
    write_best(Store(tmp_path), ["d" * 16])
    assert sorted(path.name[-12:-4] for path in (tmp_path / "rerun").iterdir()) == [8 * k for k in "acd"]


def test_what_a_cell_came_to_stands_beside_it_in_words(run_without_rerun):
    store = Store(run_without_rerun)
    said = about(store.rows(), store.table("parameters"))
    assert said.startswith("# cotton <b> · mass_spring · ga · node_error")
    for line in ("| swing-1 | ", "| all held out | ", "| parameter | value | 95 % | true |", "N/m"):
        assert line in said


@pytest.mark.parametrize("name", ["cotton <b>", "small · cotton <b>", "swing-1", "swing-22"])
def test_view_takes_the_names_that_the_page_shows(run_without_rerun, name, monkeypatch, capsys):
    called = []

    class Child:
        pid = 0

        def __init__(self, command, **_):
            called.append((command, Path(command[3]).stat().st_size))

        def wait(self):
            return 0

    monkeypatch.setattr(view.subprocess, "Popen", Child)
    monkeypatch.setattr(view, "end_group", lambda child: None)
    monkeypatch.setattr(view, "has_display", lambda: False)
    assert view.open_viewer(run_without_rerun, name) == 0
    ((command, size),) = called
    assert command[4:7] == ["--serve-web", "--bind", "127.0.0.1"]
    assert size > 10_000
    said = capsys.readouterr().out
    data, page = (command[command.index(word) + 1] for word in ("--port", "--web-viewer-port"))
    assert f"http://127.0.0.1:{page}?url=rerun%2Bhttp%3A%2F%2F127.0.0.1%3A{data}%2Fproxy" in said
    assert not Path(command[3]).exists()


def test_view_finds_what_run_and_improve_left_in_one_folder(run_without_rerun, tmp_path, capsys):
    """A name that both know is the verdict's, and the cell of the run stands beside it; other names are the run's."""
    folder, made = tmp_path / "runs", tmp_path / "made"
    shutil.copytree(run_without_rerun, folder)
    made.mkdir()
    (key,) = (path.name for path in (folder / "cells").iterdir())
    (best,) = write_best(Store(folder), [key])
    (folder / "rerun" / "swing-1.rrd").touch()
    document = {"key": "e" * 16, "recordings": {"fit": ["swing-1"], "held_out": ["swing-9"]}}
    (folder / "verdict.json").write_text(json.dumps(document))
    row = Store(folder).rows()[0] | {
        "study": "improve", "case": "cotton <b>", "metric": "rms_error", "objective": "rms_error", "value": 0.0,
        "recording": None, "key": "e" * 16,
    }  # fmt: skip
    Store(folder).put("e" * 16, {"rows": [row]})
    (folder / "cells" / ("e" * 16) / "verdict.json").write_text("{}")
    assert view.file_of(folder, "swing-1", made) == folder / "rerun" / "swing-1.rrd"
    assert f"as improve judged it; as clothbench run fitted it: clothbench view {key}" in capsys.readouterr().out
    for name in (key, "swing-22", "cotton <b>"):
        assert view.file_of(folder, name, made) == best
        assert "a fit of clothbench run; the verdict of improve here is on: swing-1" in capsys.readouterr().out
    with pytest.raises(ClothbenchError, match=r"found no case, .* swing-1, swing-22; of improve: swing-1"):
        view.file_of(folder, "swing-9", made)
    with pytest.raises(ClothbenchError, match="is of improve: view one of its recordings with --out"):
        view.file_of(folder, "eeee", made)


def test_the_web_viewer_answers_on_the_loopback_address(run_without_rerun):
    command = [sys.executable, "-m", "clothbench", "view", "swing-1", "--web", "--out", str(run_without_rerun)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            said = process.stdout.readline()
            address = said.split()[1]
            deadline = time.monotonic() + 120
            while True:
                try:
                    with urllib.request.urlopen(address, timeout=5) as answer:
                        assert b"html" in answer.read(2000).lower()
                    break
                except OSError:
                    assert time.monotonic() < deadline
                    time.sleep(0.2)
        finally:
            process.send_signal(signal.SIGINT)
            try:
                process.wait(60)
            except subprocess.TimeoutExpired:
                process.kill()
                raise
    assert process.returncode == 0
    with pytest.raises(OSError, match="refused"):
        urllib.request.urlopen(address, timeout=5)
