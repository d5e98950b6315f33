"""`clothbench suggest` as a user meets it: a table, a document, motions for a robot; and one line for what is wrong."""

from __future__ import annotations

import csv
import dataclasses
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from conftest import swinging_recording

from clothbench import Camera, write_recording
from clothbench.cli.commands import main
from clothbench.cli.suggest import apart_now, of_recordings
from clothbench.core.files import read_json
from clothbench.datasets.depth_folder import camera_of
from clothbench.engine.store import Store
from clothbench.plugins.discovery import catalogue
from clothbench.recordings.nodes import read_recording
from clothbench.studies.calibration.cell import asked_and_fitted, set_up
from clothbench.suggest.experiments import fastest
from clothbench.suggest.settings import PLACEMENTS
from clothbench.suggest.source import verdict_in

QUICK = ("model=mass_spring", "resolution=5", "durations=0.4", "draws=0", "best=2", "grips=as recorded,level side")


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("suggest")
    write_recording(swinging_recording("sway-1"), folder / "rec" / "sway-1.nc")
    return folder


@pytest.fixture(scope="module")
def told(place) -> tuple[Path, dict]:
    """The folder that was filled, and the document."""
    out = place / "found"
    assert main(["suggest", str(place / "rec"), *QUICK, f"out={out}", "max_speed=0.3"]) == 0
    return out, json.loads((out / "suggest.json").read_text())


def test_the_document(told):
    out, found = told
    assert (found["schema"], found["model"], found["base"], found["rank"]) == (
        1, "mass_spring", ["linear_drag"], "information",
    )  # fmt: skip
    assert set(found["parameters"]) == {"k1", "k2", "zeta", "linear_drag.coefficient"}
    nats = [one["information_nats"] for one in found["experiments"]]
    assert len(nats) > 3
    assert nats == sorted(nats, reverse=True)
    assert {one["grips"] for one in found["left_out"]} == {
        "level side"
    }  # a clamp a twelfth of the width deep, and a mesh of five nodes
    assert "raise the resolution" in found["left_out"][0]["reason"]
    for one in found["experiments"]:
        assert one["max_speed_m_s"] <= 0.3 + 1e-9
        for name, promised in one["parameters"].items():
            known = found["parameters"][name]
            assert 0 < promised["factor_least"] <= promised["factor"] * (1 + 1e-9)
            assert promised["factor"] <= promised["factor_most"] * (1 + 1e-9)
            assert promised["low"] <= known["value"] <= promised["high"]
        assert one["information_nats"] > 0  # more never tells less, but the mesh may pull more there
        assert max(promised["factor"] for promised in one["parameters"].values()) > 1
    written = sorted(path.relative_to(out).as_posix() for path in (out / "experiments").rglob("*.*"))
    assert written == [f"experiments/{k}/{name}" for k in (1, 2) for name in ("expected.nc", "motion.csv")]


def test_the_motion_is_what_the_recording_says(told):
    out, found = told
    expected = read_recording(out / "experiments" / "1" / "expected.nc")
    assert expected.motion == found["experiments"][0]["name"]
    assert "simulated" in expected.sensor
    with (out / "experiments" / "1" / "motion.csv").open(newline="") as file:
        head, *rows = csv.reader(file)
    assert head[0] == "t [s]"
    table = np.array(rows, dtype=float)
    assert table.shape[1] == 1 + 3 * len(expected.grip_material)
    assert table[:, 1:].reshape(len(table), -1, 3) == pytest.approx(expected.grip_position[: len(table)], abs=1e-6)
    assert table[0, 1:] == pytest.approx(table[-1, 1:], abs=1e-6)
    stated = [found["experiments"][0][f"max_{name}"] for name in ("speed_m_s", "acceleration_m_s2")]
    assert fastest(expected.grip_position) == pytest.approx(stated, rel=1e-6)
    lasts = found["experiments"][0]["duration_s"]
    assert expected.time[-1] <= lasts < table[-1, 0]


def test_the_table_and_a_parameter_that_is_asked_for(told, place, capsys):
    """A second call takes the fit that is stored, and ranks by what is asked for."""
    out = Path(shutil.copytree(told[0], place / "by-zeta"))
    kept = {path: path.stat().st_mtime_ns for path in (out / "fits").rglob("*.npz")}
    assert main(["suggest", str(place / "rec"), *QUICK, f"out={out}", "rank=zeta"]) == 0
    assert kept
    assert {path: path.stat().st_mtime_ns for path in (out / "fits").rglob("*.npz")} == kept
    said = capsys.readouterr().out
    assert "experiments by zeta" in said
    assert "motion.csv" in said
    found = json.loads((out / "suggest.json").read_text())
    factors = [one["parameters"]["zeta"]["factor"] for one in found["experiments"]]
    assert factors == sorted(factors, reverse=True)


def test_one_camera_sees_it(told, place, capsys):
    """The best of the placements for each experiment, in the table, in the document and as a file that import reads."""
    out, by_markers = place / "seen", {one["name"]: one["information_nats"] for one in told[1]["experiments"]}
    asked = ["cameras=side,front,three-quarter", "camera.kind=depth", "camera.noise=0.4", "max_speed=0.3"]
    assert main(["suggest", str(place / "rec"), *QUICK, f"out={out}", *asked]) == 0
    said = capsys.readouterr().out
    assert "seen by one depth camera: 1280 x 720 px, 60° across, noise 0.4 px and 1.5 mm at 1 m" in said
    assert re.search(r"front +│ +100 %", said)
    found = json.loads((out / "suggest.json").read_text())
    assert found["settings"]["cameras"] == ["side", "front", "three-quarter"]
    for one in found["experiments"]:
        names, nats = ([camera[key] for camera in one["cameras"]] for key in ("name", "information_nats"))
        assert set(names) == {"side", "front", "three-quarter"}
        assert (one["camera"], one["information_nats"]) == (names[0], nats[0])
        assert nats == sorted(nats, reverse=True)
        assert nats[0] < 1.05 * by_markers[one["name"]]  # markers on both sides of the sheet, whose noise is 1 mm
        for camera in one["cameras"]:
            assert 0 <= camera["points_seen"] <= 1
            assert set(camera["factors"]) == set(found["parameters"])
    swings = [one for one in found["experiments"] if "swing across" in one["name"]]
    assert swings
    assert all(one["cameras"][-1]["name"] == "side" for one in swings)  # which sees a stiff sheet edge-on
    files = [f"experiments/{k}/{name}" for k in (1, 2) for name in ("camera.json", "expected.nc", "motion.csv")]
    assert sorted(path.relative_to(out).as_posix() for path in (out / "experiments").rglob("*.*")) == files
    stated, best = read_json(out / files[0], "a camera"), found["experiments"][0]["cameras"][0]
    assert (stated["name"], stated["kind"]) == (best["name"], "depth")
    camera = camera_of(stated, out / files[0])
    assert camera.place == pytest.approx(np.array(best["position_m"]))
    pixel, _ = camera.project(read_recording(out / "experiments" / "1" / "expected.nc").position)
    assert (pixel > 0).all()
    assert (pixel < [1280, 720]).all()


def test_recordings_in_one_camera_s_picture_are_followed_by_one_like_it(tmp_path, capsys):
    camera = Camera.looking_at((0.4, -1.2, 0.9), (0.0, 0.0, 0.8), (640, 480), 1.2)
    write_recording(dataclasses.replace(swinging_recording("sway-1"), sight=camera), tmp_path / "rec" / "sway-1.nc")
    asked = ["suggest", str(tmp_path / "rec"), *QUICK, f"out={tmp_path / 'found'}"]
    assert main(asked) == 0
    across = np.degrees(2 * np.arctan(320 / camera.matrix[0, 0]))
    assert f"seen by one colour camera: 640 x 480 px, {across:.3g}° across, noise " in capsys.readouterr().out
    found = json.loads((tmp_path / "found" / "suggest.json").read_text())
    assert found["settings"]["cameras"] == list(PLACEMENTS)
    seen = read_recording(tmp_path / "rec" / "sway-1.nc")
    pixels = seen.noise_sigma * camera.matrix[0, 0] / camera.in_view(seen.position)[..., 2].mean()
    assert found["settings"]["camera"]["noise"] == pytest.approx(pixels, rel=0.02)

    assert main([*asked, "camera.noise=2"]) == 0  # the places are those that recordings in a picture always have
    told = json.loads((tmp_path / "found" / "suggest.json").read_text())["settings"]
    assert (told["cameras"], told["camera"]["noise"]) == (list(PLACEMENTS), 2.0)
    assert main([*asked, "cameras=front", "camera.noise=2"]) == 0
    told = json.loads((tmp_path / "found" / "suggest.json").read_text())["settings"]
    assert (told["cameras"], told["camera"]["noise"], told["camera"]["size"]) == (["front"], 2.0, [640, 480])
    assert main([*asked, "cameras=none"]) == 0
    told = json.loads((tmp_path / "found" / "suggest.json").read_text())
    assert told["settings"]["cameras"] is None
    assert told["experiments"][0]["camera"] is None


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["model=mass_spring", "cameras=sideways"], "setting 'cameras' names 'sideways', expected some of front, "),
        (["model=mass_spring", "camera.noise=1"], "found camera.noise= and no cameras=; say where it may stand"),
        (["model=mass_spring", "max_sped=1"], "found 'max_sped=1', expected"),
        ([], "found no model=…, expected clothbench suggest RECORDINGS model=NAME"),
        (["model=mass_spring", "rank=k9"], "setting 'rank' is 'k9', expected one of information, tie, k1"),
        (["model=mass_spring", "rank=tie"], "nothing is tied; name two effects with tied=ONE,OTHER"),
        (["model=mass_spring", "grips=three corners"], "setting 'grips' names 'three corners', expected some of"),
        (["model=mass_spring", "tied=quadratic_drag"], "expected two effects or more, as tied=ONE,OTHER"),
        (["model=mass_spring", "tied=quadratic_drag,linear_drag"], "'linear_drag' is in the base already"),
        (["model=mass_spring", "verdict=nowhere"], "verdict=nowhere: found no verdict.json"),
        (["model=mass_spring", "out=rec/found"], "lies in rec, where what is only expected would be taken for"),
    ],
)
def test_one_line_for_what_is_wrong(words, said, told, place, monkeypatch, capsys):
    monkeypatch.chdir(place)
    there = [f"out={told[0]}"] if not any(word.startswith("out=") for word in words) else []
    assert main(["suggest", "rec", "resolution=5", *there, *words]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert said in line


def test_neither_a_recording_nor_a_cell(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["suggest", "nothing"]) == 2
    assert "nothing: no such file or folder, and runs: found no cells" in capsys.readouterr().err
    assert main(["suggest", "nothing", "model=mass_spring"]) == 2
    assert "nothing: no such file or folder, and runs: found no cells" in capsys.readouterr().err


def verdict(place: Path, told: tuple[Path, dict], **changes) -> Path:
    """A folder with the verdict that two kinds of drag are tied, with amounts as they may be."""
    parameters = {name: {"value": p["value"]} for name, p in told[1]["parameters"].items()}
    parameters |= {"quadratic_drag.normal": {"value": 0.6}, "quadratic_drag.tangential": {"value": 0.02}}
    effect = {"name": "quadratic_drag", "tied_with": ["drag_crisis"], "by_recording": None}
    found = {
        "model": "mass_spring", "base": ["linear_drag"], "effects": [{**effect, **changes.pop("effect", {})}],
        "parameters": parameters, "recordings": {"fit": ["sway-1"], "held_out": []},
    }  # fmt: skip
    (folder := place / "verdict").mkdir(exist_ok=True)
    (folder / "verdict.json").write_text(json.dumps({**found, **changes}))
    return folder


def test_what_a_verdict_found_tied(place, told):
    folder, out = verdict(place, told), place / "tied"
    quick = [word for word in QUICK if not word.startswith(("model", "best"))]
    assert main(["suggest", str(place / "rec"), *quick, f"verdict={folder}", f"out={out}", "best=1"]) == 0
    found = json.loads((out / "suggest.json").read_text())
    assert (found["effects"], found["rank"]) == (["quadratic_drag"], "tie")
    assert found["parameters"]["quadratic_drag.normal"]["value"] == 0.6  # as the verdict has it
    assert [(tie["one"], tie["other"]) for tie in found["ties"]] == [("quadratic_drag", "drag_crisis")]
    least = [one["ties"][0]["sigma_least"] for one in found["experiments"]]
    assert least == sorted(least, reverse=True)
    assert all(0 <= one["ties"][0]["sigma_least"] <= one["ties"][0]["sigma"] for one in found["experiments"])


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"recordings": {"fit": ["other"], "held_out": []}}, "found a verdict on other, expected one on sway-1"),
        ({"settings": {"bounds": {"a": 3}}}, "verdict.json: is no verdict of this version (TypeError: cannot unpack"),
        ({"effect": {"by_recording": [1]}}, "'quadratic_drag' has amounts of its own in each recording"),
        ({"model": "inextensible"}, "found model=mass_spring, and a verdict on inextensible; leave model= out"),
    ],
)
def test_a_verdict_that_does_not_fit(changes, said, place, told, capsys):
    folder = verdict(place, told, **changes)
    words = ["resolution=5", f"verdict={folder}", f"out={told[0]}"]
    assert main(["suggest", str(place / "rec"), *words, *(["model=mass_spring"] if "model" in changes else [])]) == 2
    assert said in capsys.readouterr().err.splitlines()[-1]


def test_ranges_and_mesh_are_those_of_the_verdict(place, told):
    settings = {"bounds": {"quadratic_drag.normal": [0.0, 8.0], "k1": [1.0, 500.0]}, "resolution": 5}
    document = verdict_in(verdict(place, told, settings=settings))
    problem = of_recordings(str(place / "rec"), {}, document, place / "as-judged", catalogue())
    space = problem.space(("quadratic_drag",))
    assert dict(zip(space.names, (p.bounds for p in space), strict=True))["quadratic_drag.normal"] == (0.0, 8.0)
    assert problem.evidence.cases[0].scene.resolution == (5, 5)
    own = of_recordings(str(place / "rec"), {"bounds.k1": "[2,400]"}, document, place / "as-judged", catalogue())
    assert own.bounds["k1"] == (2.0, 400.0)  # what is said has the last word


@pytest.mark.parametrize(
    ("one", "said"),
    [
        ({"sigma_now": 1.04, "sigma_other_better": 0.0}, "1.0 σ apart now"),
        ({"sigma_now": 0.0, "sigma_other_better": 37.64}, "wind fits better by 37.6 σ now"),
    ],
)
def test_which_of_two_fits_better_is_said(one, said):
    assert apart_now({"one": "drag", "other": "wind", **one}) == said


def test_a_cell_of_a_run(place, monkeypatch, capsys):
    """The fit is the cell's own, and nothing is searched."""
    monkeypatch.chdir(place)
    run = ["run", "recording=rec/sway-1.nc", "model=mass_spring", "optimizer=least_squares", "metric=node_error"]
    assert main([*run, "+options.mass_spring.resolution=5", "budget=12", "jobs=1"]) == 0
    key = next(p.name for p in (place / "runs" / "cells").iterdir() if p.is_dir())
    capsys.readouterr()
    assert (
        main(["suggest", key[:8], "durations=0.4", "draws=0", "best=1", "grips=as recorded", "out=of_cell", "--json"])
        == 0
    )
    found = json.loads(capsys.readouterr().out)
    assert set(found["parameters"]) == {"k1", "k2", "zeta"}
    assert found == json.loads((place / "of_cell" / "suggest.json").read_text())
    assert not (place / "of_cell" / "fits").exists()
    (place / "elsewhere").mkdir()
    monkeypatch.chdir(place / "elsewhere")
    asked = ["suggest", key[:8], f"--runs={place / 'runs'}", "durations=0.4", "draws=0", "best=1", "grips=as recorded"]
    assert main([*asked, "out=again", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["experiments"] == found["experiments"]
    away = (place / "rec" / "sway-1.nc").rename(place / "elsewhere" / "moved.nc")
    try:
        assert main(asked) == 2
        assert "is not there any more; say where it lies with recordings=PATH" in capsys.readouterr().err
        assert main([*asked, "recordings=moved.nc", "out=moved", "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["experiments"] == found["experiments"]
    finally:
        away.rename(place / "rec" / "sway-1.nc")


def test_a_cell_keeps_all_that_was_fitted(place, monkeypatch, capsys):
    """Also the model's own physics that `improve` would switch off: what is left is what the cell left."""
    monkeypatch.chdir(place)
    run = ["run", "recording=rec/sway-1.nc", "model=baraff_witkin", "optimizer=least_squares", "metric=node_error"]
    assert main([*run, "+options.baraff_witkin.resolution=5", "budget=30", "jobs=1", "out=whole", "seed=3"]) == 0
    capsys.readouterr()
    asked = ["durations=0.4", "draws=0", "best=1", "grips=as recorded", "out=of_whole", "--json"]
    assert main(["suggest", "sway-1", *asked, "--runs=whole"]) == 0
    found = json.loads(capsys.readouterr().out)
    cell, fitted = asked_and_fitted(Store(place / "whole"), next((place / "whole" / "cells").iterdir()).name)
    values = {row["name"]: row["value"] for row in fitted}
    assert {name: p["value"] for name, p in found["parameters"].items()} == pytest.approx(values)
    (trial,) = set_up(cell, catalogue()).trials
    away = trial.observation.differences(trial.simulation.run(np.array([list(values.values())])).position)
    rms = np.sqrt(np.mean(away[:, trial.observation.visible] ** 2))
    assert found["left_mm"] == pytest.approx(1e3 * rms, rel=1e-6)
