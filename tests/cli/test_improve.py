"""`clothbench improve` as a user meets it: a planted clock offset is found, and all that lies in the folder then."""

from __future__ import annotations

import dataclasses
import json
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from conftest import swinging_recording
from test_commands import only_line

from clothbench import ClothbenchError, Recording, write_recording
from clothbench.cli.idle import say_split
from clothbench.cli.improve import remarks, settings_of
from clothbench.engine.suite import plan
from clothbench.engine.tables import read_table
from clothbench.plugins.discovery import catalogue
from clothbench.recordings.scenes import scene_of
from clothbench.studies.improve.prepare import prepare
from clothbench.studies.improve.schema import IMPROVE_TABLES

DELAY = 0.05  # s, between camera and grips, which the model is not told
KEYS = {
    "schema", "model", "verdict", "effects", "error_mm", "unexplained_mm", "hint", "candidates", "evaluations",
    "wall_s", "seed", "recordings",
}  # fmt: skip
SMALL = ("model=mass_spring", "resolution=5", "base=")


def improve(folder: Path, *settings: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "clothbench", "improve", *settings]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=600, check=False)


def planted(number: int, split: str) -> Recording:
    """A swatch moved to and fro, in each recording another way; the truth has a finer mesh, and a delay."""
    plugins = catalogue()
    time, grip_time = np.linspace(0.0, 0.44, 12), np.linspace(0.0, 0.44, 23)
    rate, size, angle = ((1.3, 0.030, 0.3), (1.7, 0.025, 1.2), (1.0, 0.035, 0.9), (1.5, 0.030, 0.6))[number]
    way = size * np.sin(2 * np.pi * rate * grip_time)[:, None, None] ** 2 * [np.cos(angle), np.sin(angle), 0.0]
    held = np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 0.0]])
    blank = swinging_recording(
        f"sway-{number}", split=split, time=time, position=np.zeros((12, 25, 3)), grip_time=grip_time,
        grip_position=held + way, noise_sigma=5e-4,
    )  # fmt: skip
    scene = dataclasses.replace(scene_of(blank), resolution=(7, 7), start=None)
    effects = [plugins.make("effects", "clock_offset")]
    simulation = plugins.make("models", "mass_spring").prepare(scene, effects)
    truth = {"k1": 80.0, "k2": 4.0, "zeta": 0.3, "clock_offset.delay": DELAY}
    theta = [truth.get(p.name, p.default if p.null is None else p.null) for p in simulation.parameters]
    position = simulation.run(np.array([theta])).position[0]
    position = position + np.random.default_rng(number).normal(0.0, 5e-4, position.shape)
    position[5:8, 7] = np.nan
    return dataclasses.replace(blank, position=position)


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    """A folder with four planted recordings in `rec`, the last one held out; two of them also in `two`."""
    folder = tmp_path_factory.mktemp("improve")
    for number, split in enumerate(("fit", "fit", "fit", "held_out")):
        write_recording(planted(number, split), folder / "rec" / f"sway-{number}.nc")
        if number in (0, 3):
            write_recording(planted(number, split), folder / "two" / f"sway-{number}.nc")
    return folder


@pytest.fixture(scope="module")
def done(place) -> tuple[Path, subprocess.CompletedProcess[str]]:
    """The folder that the command filled, and what it said."""
    (place / "found" / "tables").mkdir(parents=True)
    (place / "found" / "notes.txt").write_text("mine")
    (place / "found" / "tables" / "own.parquet").write_text("mine")
    (place / "found" / "rerun").mkdir()
    (place / "found" / "rerun" / "static_dynamic_fleece-0123abcd.rrd").write_text("of a run")
    ran = improve(place, "recordings=rec", *SMALL, "candidates=clock_offset,gravity_tilt", "out=found")
    assert ran.returncode == 0, ran.stderr
    return place / "found", ran


@pytest.fixture(scope="module")
def verdict(done) -> dict:
    return json.loads((done[0] / "verdict.json").read_text())


def test_the_verdict_names_the_planted_effect_with_its_amount(verdict):
    assert verdict["schema"] == 1
    assert set(verdict) >= KEYS
    assert verdict["settings"] == {"bounds": {}, "resolution": 5, "split_by_seed": False}
    assert (verdict["verdict"], [e["name"] for e in verdict["effects"]]) == ("attributed", ["clock_offset"])
    delay = verdict["effects"][0]["parameters"]["delay"]
    assert delay["low"] <= DELAY <= delay["high"]
    assert delay["unit"] == "s"
    error = verdict["error_mm"]["held_out"]
    assert error["after"] < error["before"] / 2
    assert set(error) >= {"before", "after", "ci95", "per_recording"}
    assert verdict["recordings"] == {"fit": ["sway-0", "sway-1", "sway-2"], "held_out": ["sway-3"]}
    assert {c["name"] for c in verdict["candidates"]} == {"clock_offset", "gravity_tilt"}


def test_every_table_can_be_read_and_says_the_same(done, verdict):
    tables = {name: read_table(done[0] / "tables" / f"{name}.parquet").to_pylist() for name in IMPROVE_TABLES}
    other = {"curves", "drapes", "captures", "asymmetries"}  # tables of other kinds of evidence
    if verdict["balance"] is None:
        other |= {"kernel"}
    assert {name for name, rows in tables.items() if not rows} == other
    error = {r["recording"]: r for r in tables["errors"]}
    assert list(error) == ["sway-0", "sway-1", "sway-2", "sway-3"]
    assert error["sway-3"]["after"] == pytest.approx(verdict["error_mm"]["held_out"]["after"])
    for name in ("frames", "nodes"):
        for recording, row in error.items():
            mine = [r for r in tables[name] if r["recording"] == recording and r["coordinates"]]
            for fit in ("before", "after"):
                square = sum(r["coordinates"] * r[fit] ** 2 for r in mine) / sum(r["coordinates"] for r in mine)
                assert square**0.5 == pytest.approx(row[fit]), (name, recording, fit)
    assert {r["against"] for r in tables["against"]} == {"speed", "acceleration", "height"}
    assert {r["fit"] for r in tables["parameters"] if r["name"] == "clock_offset.delay"} == {"after"}
    assert [r["name"] for r in tables["candidates"] if r["named"]] == ["clock_offset"]


def test_the_page_is_self_contained_and_says_what_was_found(done):
    text = (done[0] / "index.html").read_text()
    own = re.sub(r"<script>.*?</script>", "", text, flags=re.DOTALL)  # plotly.js names addresses that it never asks
    assert not re.search(r"https?://|\b(src|href)=\"(?!#)", own)
    for word in ("attributed", "clock_offset", "gravity_tilt", "explains no more than chance", "What remains"):
        assert word in own
    content = json.loads(re.search(r'id="found">(.*?)</script>', text, re.DOTALL)[1])
    blocks = {block["id"]: block["views"] for block in content["blocks"]}
    assert set(blocks) >= {"errors", "frames", "map", "directions", "against"}
    assert next(iter(blocks["frames"])) == "sway-3 (held out)"
    assert [len(view) for view in blocks["map"].values()] == [2] * 5
    for name in blocks:
        assert f'id="{name}-0"' in own


def test_rerun_files_lie_beside_what_others_left(done):
    folder, ran = done
    files = [*(f"sway-{n}.rrd" for n in range(4)), "static_dynamic_fleece-0123abcd.rrd"]
    assert sorted(p.name for p in (folder / "rerun").iterdir()) == sorted(files)
    assert all((folder / "rerun" / f"sway-{n}.rrd").read_bytes()[:4] == b"RRF2" for n in range(4))
    assert sorted(p.name for p in folder.iterdir()) == [
        "cells",
        "index.html",
        "journal",
        "notes.txt",
        "rerun",
        "tables",
        "verdict.json",
    ]
    assert sorted(p.stem for p in (folder / "tables").iterdir()) == sorted([*IMPROVE_TABLES, "own"])
    for word in ("verdict: attributed", "index.html", "tables", "rerun", "clothbench view sway-3 --out found"):
        assert word in ran.stdout
    assert "calibrate" in ran.stderr


def test_view_knows_the_recordings_of_the_folder(done, clothbench):
    out = clothbench("view", "sway-9", "--out", str(done[0]))
    assert out.returncode == 2
    assert "no recording 'sway-9'; there are: sway-0, sway-1, sway-2, sway-3" in only_line(out.stderr)


@pytest.mark.slow
def test_a_killed_run_goes_on_and_ends_the_same(place, verdict):
    words = ["recordings=rec", *SMALL, "candidates=clock_offset,gravity_tilt", "out=again"]
    command = [sys.executable, "-m", "clothbench", "improve", *words]
    process = subprocess.Popen(command, cwd=place, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    unfinished = place / "again" / "journal"
    until = time.monotonic() + 120
    while len(list(unfinished.glob("*/*.npz"))) < 3 and process.poll() is None and time.monotonic() < until:
        time.sleep(0.02)
    process.kill()
    process.wait()
    assert not (place / "again" / "verdict.json").exists()
    assert len(list(unfinished.glob("*/*.npz"))) >= 3
    ran = improve(place, *words)
    assert ran.returncode == 0, ran.stderr
    assert not list(unfinished.iterdir())
    again = json.loads((place / "again" / "verdict.json").read_text())
    assert again | {"wall_s": 0} == verdict | {"wall_s": 0}


def test_a_finished_run_is_not_run_again(place, done):
    stamp = (done[0] / "verdict.json").stat().st_mtime_ns
    ran = improve(place, "recordings=rec", *SMALL, "candidates=clock_offset,gravity_tilt", "out=found")
    assert ran.returncode == 0, ran.stderr
    assert "kept" in ran.stderr
    assert (done[0] / "verdict.json").stat().st_mtime_ns == stamp


def test_what_the_recordings_do_not_say_belongs_to_the_question(tmp_path):
    unknown = dataclasses.replace(planted(0, "fit"), areal_density=float("nan"))
    wide = dataclasses.replace(unknown, name="wide", cloth_width=2 * unknown.cloth_width)
    for recording in (unknown, wide):
        write_recording(recording, tmp_path / f"{recording.name}.nc")
    words = [f"recordings={tmp_path}", "model=mass_spring", "base=", "resolution=9"]
    cells = [plan(settings_of([*words, f"areal_density={d}"]), catalogue())[0] for d in ("0.1", "0.3")]
    assert cells[0].key != cells[1].key
    light = prepare(cells[0], catalogue())
    assert [case.scene.resolution for case in light.evidence.cases] == [(9, 9), (9, 5)]
    assert [case.scene.resolution for case in light.refined().evidence.cases] == [(17, 17), (17, 9)]


def test_one_recording_is_named_by_recording_alone(tmp_path):
    write_recording(planted(0, "fit"), tmp_path / "one.nc")
    words = [f"recording={tmp_path / 'one.nc'}", *SMALL]
    (cell,) = plan(settings_of(words), catalogue())
    assert [source.name for source in cell.recordings] == [planted(0, "fit").name]
    for more, said in (
        (f"recordings={tmp_path}", "expected one of them"),
        ("areal_density=0.3", "as all 1 do; leave it out"),
        ("areal_density=300", "if g/m² were meant, give 0.3"),
    ):
        with pytest.raises(ClothbenchError, match=said):
            plan(settings_of([*words, more]), catalogue())


def test_recordings_of_several_weights_are_refused_and_several_fabrics_told(tmp_path):
    one, other = planted(0, "fit"), planted(3, "held_out")
    words = [f"recordings={tmp_path}", *SMALL]

    def planned(*more, **changes):
        for recording in (one, dataclasses.replace(other, **changes)):
            write_recording(recording, tmp_path / f"{recording.name}.nc")
        return plan({**(said := settings_of(words)), "suite": {**said["suite"], **dict(more)}}, catalogue())

    said = r"attribute 'areal_density': found 0\.\d+, 0\.31 among 2 recordings, .*suite\.case=fabric"
    with pytest.raises(ClothbenchError, match=said):
        planned(areal_density=0.31)
    assert len(planned(("select", one.name), areal_density=0.31)) == 1
    with pytest.raises(ClothbenchError, match=r"setting 'suite\.select' is empty"):
        planned(("select", []))
    (cell,) = planned(fabric="")
    assert not any("one cloth" in line for line in remarks(cell, catalogue(), all_tried=False))
    (cell,) = planned(fabric="satin")  # one cloth may be called otherwise in each session
    assert any(line.startswith("paper, satin are taken for one cloth") for line in remarks(cell, catalogue(), False))


def test_run_says_what_it_holds_out_where_no_recording_states_a_split(tmp_path, capsys):
    for number in (0, 3):
        write_recording(planted(number, ""), tmp_path / f"sway-{number}.nc")
    words = [f"recordings={tmp_path}", *SMALL, "candidates=gravity_tilt"]
    (cell,) = plan(settings_of(words), catalogue())
    (held,) = cell.of_split("held_out")
    said = f"no recording states a split; held out by seed 0: {held.name}"
    say_split([cell, dataclasses.replace(cell, model="other")])
    assert capsys.readouterr().err == f"clothbench: {said}\n"
    say_split([cell, dataclasses.replace(cell, case="other")])
    assert capsys.readouterr().err.splitlines() == [f"clothbench: {c}: {said}" for c in (cell.case, "other")]
    say_split([dataclasses.replace(cell, split_by_seed=False)])
    assert capsys.readouterr().err == ""


def test_a_split_that_the_seed_draws_is_told_and_kept(place):
    """By `run` as by `improve`, and in the verdict."""
    for number in (0, 3):
        write_recording(planted(number, ""), place / "bare" / f"sway-{number}.nc")
    words = ["model=mass_spring", "suite.resolution=5", "suite.base=[]", "suite.candidates=[gravity_tilt]"]
    command = [sys.executable, "-m", "clothbench", "run", "+suite=improve", "recordings=bare", *words, "out=bare-out"]
    ran = subprocess.run(command, cwd=place, capture_output=True, text=True, timeout=600, check=False)
    assert ran.returncode == 0, ran.stderr
    assert "clothbench: no recording states a split; held out by seed 0: sway-" in ran.stderr
    (cell,) = (place / "bare-out" / "cells").iterdir()
    settings = json.loads((cell / "verdict.json").read_text())["settings"]
    assert settings == {"bounds": {}, "resolution": 5, "split_by_seed": True}
    assert (
        "No recording states a split; which of them are held out was drawn with seed 0."
        in (cell / "index.html").read_text()
    )


def test_a_recording_that_the_model_cannot_simulate_is_refused_before_a_fit(tmp_path):
    """Held out as well as to fit: the model must not simulate the whole rectangle instead."""
    pytest.importorskip("mujoco")
    for number, split in ((0, "fit"), (3, "held_out")):
        write_recording(planted(number, split), tmp_path / f"{number}.nc")
    settings = settings_of([f"recordings={tmp_path}", "model=mujoco", "base=", "resolution=5"])
    assert plan(settings, catalogue())
    for number, split in ((3, "held_out"), (0, "fit")):
        triangle = dataclasses.replace(planted(number, split), outline=np.array([[0.0, 0.0], [0.2, 0.0], [0.1, 0.2]]))
        write_recording(triangle, tmp_path / f"{number}.nc")
        with pytest.raises(ClothbenchError, match=rf"{number}\.nc: model 'mujoco': the model simulates whole"):
            plan(settings, catalogue())


def test_json_is_the_document_and_nothing_else(place):
    ran = improve(place, "recordings=two", *SMALL, "candidates=gravity_tilt", "--json", "out=plain", "seed=3")
    assert ran.returncode == 0, ran.stderr
    found = json.loads(ran.stdout)
    assert found == json.loads((place / "plain" / "verdict.json").read_text())
    assert (found["verdict"], found["effects"], found["seed"]) == ("unexplained", [], 3)
    assert found["error_mm"]["held_out"]["before"] == found["error_mm"]["held_out"]["after"]
    assert "for which no effect can be named" in (place / "plain" / "index.html").read_text()


def test_run_asks_the_same_question_as_improve(place, clothbench):
    """The suite is one door more to the same cell: after `improve`, `run` finds it finished."""
    ran = improve(place, "recordings=two", *SMALL, "candidates=gravity_tilt", "out=doors")
    assert ran.returncode == 0, ran.stderr
    words = ["model=mass_spring", "suite.resolution=5", "suite.base=[]", "suite.candidates=[gravity_tilt]"]
    command = [sys.executable, "-m", "clothbench", "run", "+suite=improve", "recordings=two", *words, "out=doors"]
    ran = subprocess.run(command, cwd=place, capture_output=True, text=True, timeout=600, check=False)
    assert ran.returncode == 0, ran.stderr
    assert "[1/1]" in ran.stderr
    assert "kept" in ran.stderr
    assert "verdict: unexplained" in ran.stdout
    assert len(list((place / "doors" / "cells").iterdir())) == 1


def test_rows_and_page_of_the_store_say_what_the_verdict_says(done, verdict, clothbench):
    listed = clothbench("leaderboard", "--out", str(done[0]), "--json")
    rows = {(r["effects"], r["split"]): r for r in json.loads(listed.stdout)}
    assert set(rows) == {("", "fit"), ("", "held_out"), ("clock_offset", "fit"), ("clock_offset", "held_out")}
    for effects, when in (("", "before"), ("clock_offset", "after")):
        for split in ("fit", "held_out"):
            row = rows[effects, split]
            assert row["value"] * 1e3 == pytest.approx(verdict["error_mm"][split][when])
            assert (row["unit"], row["metric"], row["model"]) == ("m", "rms_error", "mass_spring")
    assert clothbench("report", f"out={done[0]}").returncode == 0
    page = (done[0] / "report.html").read_text()
    (done[0] / "report.html").unlink()
    for word in ("What does mass_spring lack?", "clock_offset", f"cells/{verdict['key']}/index.html"):
        assert word in page


def test_a_fault_of_the_model_is_one_line_and_exit_1(place, tmp_path):
    """A model that fails in mid-run leaves no verdict, but its traceback in the store."""
    code = "from clothbench_models.mass_spring_simulation import SpringSimulation as S; from clothbench.cli.commands "
    code += "import main; import sys; S.run = lambda *_: 1 / 0; sys.exit(main(sys.argv[1:]))"
    words = ["improve", f"recordings={place / 'two'}", *SMALL, "candidates=gravity_tilt", "out=failed"]
    ran = subprocess.run(
        [sys.executable, "-c", code, *words], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert ran.returncode == 1, ran.stderr
    assert "ZeroDivisionError: division by zero; see failed/cells/" in ran.stderr
    assert not (tmp_path / "failed" / "verdict.json").exists()
    assert list((tmp_path / "failed").glob("cells/*/traceback.txt"))


@pytest.mark.parametrize(
    ("settings", "found"),
    [
        (("model=mass_spring",), "found no recordings=…"),
        (("recordings=rec", "modle=mass_spring"), "'modle=mass_spring', did you mean 'model'? expected recordings="),
        (("recordings", "model=mass_spring"), "'recordings', expected recordings="),
        (("recordings=nowhere", *SMALL), "nowhere: no such file or folder"),
        (("recordings=.", *SMALL), "found no recordings, expected files ending in .nc"),
        (("recordings=rec", "model=mass_sping"), "did you mean 'mass_spring'"),
        (
            ("recordings=rec", "model=[mass_spring"),
            "found model=[mass_spring, expected NAME or [NAME,NAME]; write both",
        ),
        (("recordings=rec", *SMALL, "candidates=clock_ofset"), "did you mean 'clock_offset'"),
        (("recordings=rec", *SMALL, "seed=x"), "'seed' is 'x', expected a whole number, at least 0"),
        (("recordings=rec", *SMALL, "resolution=2"), "'resolution' is 2, expected a whole number, at least 5"),
        (("recordings=rec", *SMALL, "scene.thickness=0.01"), "setting 'scene.thickness': of the scene the loop takes"),
        (("recordings=rec", *SMALL, "scene.obstacles=[{shape:plane}]"), "setting 'scene.obstacles': of the scene the"),
        (("recordings=rec", *SMALL, "choice=knee"), "setting 'choice': the loop compares residuals"),
        (("recordings=rec", *SMALL[:2], "damping=typo"), "no effect named 'typo'; there are: "),
        (("recordings=rec", *SMALL, "out=file"), "setting 'out': file cannot be written to"),
        (("recordings=rec", *SMALL, "candidates="), "candidates is '', expected names of effects"),
        (
            ("recordings=rec", *SMALL[:2], "base=linear_drag", "candidates=linear_drag"),
            "'linear_drag' is in the base already",
        ),
        (("recordings=rec", "model=kirchhoff_love"), "expected one that moves and takes effects"),
        (("recordings=twice", *SMALL), "sway-1.nc: found the name 'sway-0', which twice/sway-0.nc has too"),
        (("recordings=bad", *SMALL), "bad.nc: found a file that starts with"),
        (("recordings=rec/sway-3.nc", *SMALL), "found only held-out recordings, expected at least one to fit"),
    ],
)
def test_wrong_use_is_one_line_and_exit_2(place, tmp_path, settings, found):
    shutil.copytree(place / "rec", tmp_path / ("rec" if "recordings=." not in settings else ".rec"))
    (tmp_path / "file").write_text("mine")
    if "recordings=bad" in settings:
        shutil.copytree(place / "rec", tmp_path / "bad")
        (tmp_path / "bad" / "bad.nc").write_text("no NetCDF")
    if "recordings=twice" in settings:
        (tmp_path / "twice").mkdir()
        for number in range(2):
            shutil.copy(place / "rec" / "sway-0.nc", tmp_path / "twice" / f"sway-{number}.nc")
    before = sorted(tmp_path.rglob("*"))
    ran = improve(tmp_path, *settings)
    assert ran.returncode == 2, ran.stderr
    assert found in only_line(ran.stderr)
    assert ran.stdout == ""
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.slow
def test_several_models_are_judged_by_what_they_have_in_common(place):
    """Both lack the planted clock offset, which is then common; each model's own page lies in its cell."""
    models = "model=[mass_spring, mass_spring_verlet]"
    words = ("recordings=rec", models, "resolution=5", "base=", "candidates=clock_offset,gravity_tilt", "out=both")
    ran = improve(place, *words, "rerun=false")
    assert ran.returncode == 0, ran.stderr
    found = json.loads((place / "both" / "verdict.json").read_text())
    assert [one["name"] for one in found["models"]] == ["mass_spring", "mass_spring_verlet"]
    assert (found["verdict"], [e["name"] for e in found["effects"]]) == ("attributed", ["clock_offset"])
    assert set(found) >= KEYS
    assert "verdict in common: attributed" in ran.stdout
    page = (place / "both" / "index.html").read_text()
    for one in found["models"]:
        assert set(one) >= {"name", "verdict", "effects", "error_mm", "own"}
        assert f"cells/{one['key']}/index.html" in page
        assert (place / "both" / "cells" / one["key"] / "index.html").is_file()
    again = improve(place, *words, "rerun=false")
    assert again.returncode == 0
    assert again.stderr.count("kept, these recordings were judged with the same settings before") == 2
