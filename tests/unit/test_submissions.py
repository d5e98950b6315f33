"""Submissions: what others simulated, scored and computed again; and what is refused."""

import dataclasses
import json
import math
import shlex
import shutil
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from clothbench_metrics.node_error import NodeError
from conftest import swinging_recording

from clothbench import ClothbenchError, read_recording, write_recording
from clothbench.cli import main
from clothbench.cli.run import composed
from clothbench.cli.submissions import suite_of
from clothbench.engine.cells import Source, digest
from clothbench.engine.run import run_cell
from clothbench.engine.store import Store
from clothbench.engine.suite import plan
from clothbench.plugins.discovery import catalogue
from clothbench.studies.calibration.cell import CalibrationCell, asked
from clothbench.submissions.kept import content_of, keep
from clothbench.submissions.packing import pack_results
from clothbench.submissions.reading import read_submission
from clothbench.submissions.site import write_site
from clothbench.submissions.submission import FILE, pack
from clothbench.submissions.verification import verify

MEASURED = [swinging_recording("sway-1"), swinging_recording("sway-2", split="held_out")]
ABOUT = {"name": "my-simulator", "by": "somebody", "about": "a rigid plate", "suite": "sway"}


def simulated(recording, away=0.003):
    """What a rigid plate does in the recorded grips, bulging by so many metres; held points stay in their grips."""
    sway = np.interp(recording.time, recording.grip_time, recording.grip_position[:, 0, 1])
    u, v = recording.material.T
    bulge = away * np.sin(np.pi * v / 0.4)
    y = sway[:, None] + bulge
    position = np.stack(np.broadcast_arrays(u, y, -v), axis=-1)
    return dataclasses.replace(recording, position=position, source="a plate")


@pytest.fixture
def folder(tmp_path):
    for recording in MEASURED:
        write_recording(simulated(recording), tmp_path / "mine" / f"{recording.name}.nc")
    return tmp_path / "mine"


def copied(recording):
    """The tracked positions themselves, but for the held points, which lie in their grips."""
    position = recording.position.copy()
    held = [0, 4]
    position[:, held] = simulated(recording).position[:, held]
    return position


def with_a_gap(recording):
    position = simulated(recording).position.copy()
    position[3, 7] = np.nan
    return position


def packed(folder, measured=MEASURED):
    return pack(folder, measured, ["node_error"], catalogue(), **ABOUT)


def rewrite(folder, stem, **changes):
    path = folder / f"{stem}.nc"
    write_recording(dataclasses.replace(read_recording(path), **changes), path)


def edit(folder, change):
    """The submission's own file with something else in it."""
    stated = json.loads((folder / FILE).read_text())
    change(stated)
    (folder / FILE).write_text(json.dumps(stated))


def test_scores_are_computed_again_and_stand_on_the_leaderboard(folder, tmp_path):
    submission = packed(folder)
    assert read_submission(folder) == submission
    found = verify(folder, MEASURED, catalogue())
    assert found.faults == ()
    store = Store(tmp_path / "runs")
    (key,) = keep(found.submission, found.found, store, catalogue())
    rows = store.rows([key])
    single = {row["recording"]: row for row in rows if row["recording"]}
    assert {name: row["value"] for name, row in single.items()} == {
        entry.recording: entry.scores["node_error"] for entry in submission.entries
    }
    row = single["sway-2"]
    assert (row["model"], row["split"], row["unit"]) == ("my-simulator", "held_out", "mm")
    assert "recomputed" in row["optimizer"]
    assert row["floor"] > 0
    assert (row["evaluations"], row["wall_s"]) == (None, None)  # nobody knows what it took
    assert len([row for row in rows if not row["recording"]]) == 2  # a mean for each split


def test_intervals_are_those_of_a_run(folder, tmp_path, monkeypatch):
    """Not below 0; and where a metric knows how sure it is, or that nobody does, that counts."""

    def rows(of):
        found = verify(folder, MEASURED, catalogue())
        return Store(tmp_path / of).rows(keep(found.submission, found.found, Store(tmp_path / of), catalogue()))

    packed(folder)
    assert all(0 <= row["low"] < row["value"] < row["high"] for row in rows("blocks"))
    monkeypatch.setattr(NodeError, "interval", lambda self, *of: (1.0, 9.0), raising=False)
    assert {(row["low"], row["high"]) for row in rows("own") if row["recording"]} == {(1.0, 9.0)}
    monkeypatch.setattr(NodeError, "interval", lambda self, *of: (math.nan, math.nan))
    assert {(row["low"], row["high"]) for row in rows("nobody")} == {(None, None)}


def test_metrics_that_not_every_split_has(folder, tmp_path):
    packed(folder)
    found = verify(folder, MEASURED, catalogue())
    fitted, held_out = found.found
    other = {name: {"drape": 1.0} for name in ("scores", "floors")}
    both = [fitted, dataclasses.replace(held_out, **other, intervals={"drape": (0.0, 3.0)}, units={"drape": "%"})]
    store = Store(tmp_path / "runs")
    keys = keep(found.submission, both, store, catalogue())
    assert {(row["metric"], row["split"]) for row in store.rows(keys)} == {("node_error", "fit"), ("drape", "held_out")}


def test_a_forged_score_and_a_file_changed_afterwards_are_refused(folder):
    packed(folder)
    edit(folder, lambda stated: stated["entries"][0]["scores"].update(node_error=1.0))
    rewrite(folder, "sway-2", source="another")
    found = verify(folder, MEASURED, catalogue())
    assert len(found.found) == 0
    assert "claimed were 1 mm" in found.faults[0]
    assert "is not the file that was handed in" in found.faults[1]


def test_a_second_simulation_and_one_under_another_name_are_refused(folder):
    packed(folder)
    edit(folder, lambda stated: stated["entries"].append(stated["entries"][1]))
    assert "sway-2.nc: is a second one of 'sway-2'" in verify(folder, MEASURED, catalogue()).faults[0]
    edit(folder, lambda stated: stated["entries"][0].update(cell="ab", recording="sway-2"))
    edit(folder, lambda stated: stated["entries"][1].update(recording="sway-1"))
    faults = verify(folder, MEASURED, catalogue()).faults
    assert "sway-1.nc: is said to be of 'sway-2', but its hash is that of 'sway-1'" in faults[0]


def with_fits(folder, *keys, recordings=MEASURED, split=None):
    """Fits that ask for these recordings, the entries being of the first of them; split: how the questions split."""
    sources = tuple(Source("", r.name, r.hash, split[r.name] if split else r.split) for r in recordings)
    question = asked(CalibrationCell("sway", "paper", sources, "plate", (), "ga", "node_error", "markers"))
    edit(folder, lambda stated: stated.update(cells=[{"key": key, "question": question} for key in keys]))
    edit(folder, lambda stated: [entry.update(cell=keys[0]) for entry in stated["entries"]])


def test_a_fit_that_is_not_handed_in_or_never_saw_its_recording_is_refused(folder):
    """One easy recording under many invented keys would be the mean."""
    packed(folder)
    edit(folder, lambda stated: stated["entries"].extend({**stated["entries"][0], "cell": f"x{k}"} for k in range(5)))
    found = verify(folder, MEASURED, catalogue())
    assert len(found.found) == 2
    assert "submission.json: entries[2].cell is 'x0', expected the key of one of the cells, or none" in found.faults[0]
    packed(folder)
    with_fits(folder, "ab" * 8)
    assert verify(folder, MEASURED, catalogue()).faults == ()
    with_fits(folder, "ab" * 8, recordings=MEASURED[:1])
    (fault,) = verify(folder, MEASURED, catalogue()).faults
    assert f"entries[1].cell is '{'ab' * 8}', whose question lacks 'sway-2'" in fault


def test_a_fit_of_which_a_recording_is_left_out_is_refused(folder):
    """Of several fits the best of each recording would be shown."""
    packed(folder)
    with_fits(folder, "ab" * 8, "cd" * 8)
    edit(folder, lambda stated: stated["entries"].append({**stated["entries"][0], "cell": "cd" * 8}))
    (fault,) = verify(folder, MEASURED, catalogue()).faults
    assert f"cell {'cd' * 8}: has no simulation of 'sway-2', which it is about" in fault


@pytest.mark.parametrize("fits", [("ab" * 8,), ("ab" * 8, "cd" * 8)])
def test_a_score_that_only_some_recordings_have_is_refused(folder, fits):
    """Its mean would be of the easy ones; also where another fit has it of the recording that one fit lacks it of."""
    pack(folder, MEASURED, ["node_error", "relative_error"], catalogue(), **ABOUT)
    with_fits(folder, *fits)
    for fit in fits[1:]:
        edit(folder, lambda stated, fit=fit: stated["entries"].extend([{**e, "cell": fit} for e in stated["entries"]]))
    assert verify(folder, MEASURED, catalogue()).faults == ()
    edit(folder, lambda stated: stated["entries"][1]["scores"].pop("node_error"))
    with pytest.raises(ClothbenchError, match=r"submission.json: sway-2.nc has no score by 'node_error', which others"):
        verify(folder, MEASURED, catalogue())


def test_results_of_another_version_are_set_aside(folder):
    packed(folder)
    edit(folder, lambda stated: stated.update(clothbench="0.0.1"))
    with pytest.raises(ClothbenchError, match=r"scored by clothbench 0\.0\.1.*set aside"):
        verify(folder, MEASURED, catalogue())


def test_other_recordings_and_a_choice_of_them_are_refused(folder):
    packed(folder)
    other = [dataclasses.replace(MEASURED[0], areal_density=0.3), MEASURED[1]]
    assert "not among those given" in verify(folder, other, catalogue()).faults[0]
    (folder / "sway-2.nc").unlink()
    with pytest.raises(ClothbenchError, match="has 1 of 2 recordings, 'sway-2' is missing"):
        packed(folder)
    assert "is not there" in verify(folder, MEASURED, catalogue()).faults[0]


@pytest.mark.parametrize(
    ("changes", "found"),
    [
        ({"position": copied(MEASURED[0])}, "expected simulated positions, not measured ones"),
        ({"position": with_a_gap(MEASURED[0])}, "position is no number at frame 3, node 7"),
        ({"position": simulated(MEASURED[0]).position + 0.01}, r"node \d is held, and lies 17.3 mm from its grip"),
        ({"time": MEASURED[0].time * 1.001}, "found time that differs from what was measured by 0.0005"),
        ({"name": "sway-3"}, "found name 'sway-3', expected that of a measured recording"),
    ],
)
def test_what_no_simulation_of_the_recording_can_be_is_refused(folder, changes, found):
    rewrite(folder, "sway-1", **changes)
    with pytest.raises(ClothbenchError, match=found):
        packed(folder)
    assert not (folder / FILE).exists()


def handed_in(folder, recordings, case):
    """A run with `suite.case=CASE` handed in, verified and kept: its own rows, and those of the leaderboard."""
    settings = composed([
        f"recordings={recordings}", "model=mass_spring", "optimizer=ga", "metric=node_error", "budget=8",
        "options.mass_spring.resolution=5", f"suite.case={case}",
    ])  # fmt: skip
    for cell in plan(settings, catalogue()):
        assert run_cell(cell, folder / "runs", rerun=False) == "ok"
    (wheel := folder / "plugin.whl").write_bytes(b"")
    known = [read_recording(path) for path in sorted(recordings.glob("*.nc"))]
    pack_results(folder / "mine", Store(folder / "runs"), [wheel], known, catalogue(), **ABOUT)
    found = verify(folder / "mine", known, catalogue())
    assert found.faults == ()
    kept = Store(folder / "kept")
    if case == "all":  # a part of it, as older versions kept it
        part = digest([found.submission.cells[0].key, "satin", True], 8)
        kept.put(content_of(found.submission) + part, {"rows": Store(folder / "runs").rows()})
    keys = keep(found.submission, found.found, kept, catalogue())
    assert keep(found.submission, found.found, kept, catalogue()) == keys
    return Store(folder / "runs").rows(), kept.rows()


@pytest.mark.parametrize(("case", "cases"), [("all", ["all"]), ("fabric", ["linen", "satin"])])
def test_a_fit_is_kept_whole_whatever_fabrics_it_is_of(tmp_path, case, cases):
    """One cell for each fit, with the means that the run itself had."""
    for number, (fabric, split) in enumerate(product(("satin", "linen"), ("fit", "held_out"))):
        moved = swinging_recording(f"sway-{number}", fabric=fabric, split=split)
        moved = dataclasses.replace(moved, position=moved.position + 1e-4 * number)
        write_recording(moved, tmp_path / "recordings" / f"sway-{number}.nc")
    ran, kept = handed_in(tmp_path, tmp_path / "recordings", case)
    assert len({row["key"] for row in kept}) == len(cases)

    def values(rows):
        return {(r["case"], r["split"], r["recording"]): pytest.approx(r["value"], rel=1e-5) for r in rows}

    assert sorted({row["case"] for row in kept}) == cases
    assert len(kept) == len(values(kept)) == len(ran)
    assert {at: value.expected for at, value in values(kept).items()} == values(ran)


def test_effects_that_move_what_is_held_are_named_and_nothing_is_packed(recordings_folder, tmp_path):
    """Such a fit is honest, but whoever checks it cannot tell it from a cloth that was driven otherwise."""
    settings = {
        "study": "calibration", "recordings": str(recordings_folder), "model": "mass_spring", "optimizer": "ga",
        "metric": "node_error", "report": [], "tracker": "markers", "scene": {}, "bounds": {}, "budget": 12, "seed": 0,
        "options": {"mass_spring": {"resolution": 5}}, "jobs": 1, "timeout": None, "out": "runs", "rerun": False,
    }  # fmt: skip
    shifted = {"effects": ["frame_translation"], "bounds": {"frame_translation.dy": [0.01, 0.02]}}
    for more in ({"effects": []}, shifted):
        (cell,) = plan({**settings, **more}, catalogue())
        assert run_cell(cell, tmp_path / "runs") == "ok"
    known = [read_recording(path) for path in sorted(recordings_folder.glob("*.nc"))]
    said = rf"^cell {cell.key}: sway-1: node \d+ is held, .* mm at most: run it without frame_translation, which moves"
    with pytest.raises(ClothbenchError, match=said):
        pack_results(tmp_path / "mine", Store(tmp_path / "runs"), [], known, catalogue(), **ABOUT)
    assert list((tmp_path / "mine").iterdir()) == []  # what was packed of the first is taken out again


@pytest.mark.parametrize(
    ("change", "found"),
    [
        (lambda s: s.update(schema=2), "schema is 2, expected 1"),
        (lambda s: s.update(name=" "), "name is ' ', expected text"),
        (lambda s: s.update(entries={}), "entries is {}, expected a list"),
        (lambda s: s["entries"][0].update(file="../../etc/passwd"), "expected a path inside the submission's folder"),
        (lambda s: s["entries"][0].update(scores={"node_error": "low"}), "expected numbers by metric"),
        (lambda s: s["entries"][0].update(scores={"node_error": 10**400}), "expected numbers by metric"),
    ],
)
def test_a_damaged_submission_is_one_line(folder, change, found):
    packed(folder)
    edit(folder, change)
    with pytest.raises(ClothbenchError, match=found):
        verify(folder, MEASURED, catalogue())


@pytest.mark.parametrize("name", ["a" * 300, "a\0b"])
def test_a_name_that_no_file_can_have_stops_no_other_submission(folder, recordings_folder, tmp_path, capsys, name):
    packed(folder, known := [read_recording(path) for path in sorted(recordings_folder.glob("*.nc"))])
    shutil.copytree(folder, tmp_path / "all" / "good")
    shutil.copytree(folder, tmp_path / "all" / "bad")
    edit(tmp_path / "all" / "bad", lambda stated: stated["entries"][0].update(file=name))
    faults = 1
    if name.isalpha():  # another one is no name of a wheel, which is told as the file is read
        edit(tmp_path / "all" / "bad", lambda s: s.update(wheels=[{"file": f"{name}.whl", "sha256": "ab"}]))
        faults = 2
    folders = [str(tmp_path / "all" / one) for one in ("bad", "good")]
    assert main(["verify", *folders, "--recordings", str(recordings_folder)]) == 1
    told = capsys.readouterr()
    assert "my-simulator" in told.out.partition(f"refused, {faults} fault")[2]
    assert len(told.err.splitlines()) == faults
    if name.isalpha():
        assert "aaa: entries.file cannot be read (File name too long); expected a file of the submission" in told.err
        assert "aaa.whl: wheels.file cannot be read (File name too long)" in told.err
    found = write_site(tmp_path / "all", tmp_path / "site", known, None, catalogue())
    assert {one.folder.name: one.grade for one in found} == {"bad": "refused", "good": "recomputed"}


def test_as_a_user_hands_in_and_checks(folder, recordings_folder, clothbench):
    given = ["--recordings", str(recordings_folder)]
    done = clothbench("submit", folder, "--name", "my-simulator", *given)
    assert done.returncode == 0, done.stderr
    assert "node_error [mm]" in done.stdout
    assert read_submission(folder).suite == "recordings"  # as the folder is called
    _, check, _ = done.stdout.rsplit("`", 2)
    done = clothbench(*shlex.split(check)[1:], "--out", "runs")
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("recomputed") == 3  # of the whole, and of each row
    rows = json.loads(clothbench("leaderboard", "--json", "--out", "runs").stdout)
    assert {row["model"] for row in rows} == {"my-simulator"}
    table = clothbench("leaderboard", "--out", "runs").stdout
    assert "my-simulator" in table
    assert "evaluations" not in table
    assert clothbench("report", "out=runs").returncode == 0
    edit(folder, lambda stated: stated["entries"][0]["scores"].update(node_error=1.0))
    done = clothbench("verify", folder, *given, "--out", "other")
    assert done.returncode == 1
    assert done.stderr.startswith("refused: ")
    assert done.stdout == f"my-simulator ({folder}): refused, 1 fault\n"


def test_a_folder_without_a_submission_is_wrong_use_and_nothing_is_checked(folder, recordings_folder, clothbench):
    packed(folder, [read_recording(path) for path in sorted(recordings_folder.glob("*.nc"))])
    done = clothbench("verify", folder, "nowhere", "--recordings", str(recordings_folder), "--out", "runs")
    assert (done.returncode, done.stdout) == (2, "")
    said = "nowhere: found no submission.json; make one with `clothbench submit nowhere --name NAME`"
    assert done.stderr == f"clothbench: {said}\n"


def test_a_suite_is_called_as_its_recordings_are(tmp_path):
    assert suite_of(["builtin:static_dynamic"]) == "static_dynamic"
    assert (
        suite_of([str(tmp_path / "linen"), str(tmp_path / "wool" / "a.nc"), "dataset:shaken"]) == "linen, wool, shaken"
    )
    assert suite_of(["pkg://somebody.cloth/waving"]) == "waving"
    assert suite_of(["."]) == Path().resolve().name


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--wheel", "plate.whl"], "--wheel is for the fits of --runs"),
        (["--runs", "runs", "--metric", "node_error"], "--metric is for simulated files"),
        (["--runs", "runs"], "--runs needs --wheel FILE"),
    ],
)
def test_options_that_do_not_apply_are_refused(folder, tmp_path, clothbench, words, said):
    (tmp_path / "runs" / "cells").mkdir(parents=True)
    done = clothbench("submit", folder, "--name", "my-simulator", *words)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith(f"clothbench: submit: {said}")
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["submit", "mine", "--name", " "], "submit: --name is ' ', expected what the model is called"),
        (["submit", "mine", "--name", "a", "--runs", "runs", "--wheel", "typo.whl"], "typo.whl: found no wheel"),
        (["verify", "mine", "--run-their-code"], "verify: --run-their-code is for --reproduce and --held-out"),
        (["verify", "mine", "--cells", "5"], "verify: --cells is for --reproduce and --held-out"),
        (["verify", "mine", "--seed", "0"], "verify: --seed is for --reproduce and --held-out"),
        (["verify", "mine", "--time-limit", "3"], "verify: --time-limit is for --reproduce and --held-out"),
        (["verify", "mine", "--verdicts", "v"], "verify: --verdicts is for --reproduce, --held-out and --out"),
    ],
)
def test_what_would_be_passed_over_is_refused_before_anything_is_done(tmp_path, monkeypatch, capsys, words, said):
    """A check that was to run a plugin must not pass without having run it."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs" / "cells").mkdir(parents=True)
    assert main([*words, "--recordings", "known"]) == 2
    assert capsys.readouterr().err.startswith(f"clothbench: {said}")


@pytest.mark.parametrize("limit", ["-1", "0", "nan", "soon"])
def test_a_time_limit_that_ends_nothing_is_refused(limit, capsys):
    assert main(["verify", "mine", "--recordings", "known", "--time-limit", limit]) == 2
    assert f"--time-limit is '{limit}', expected seconds, a number, above 0" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words",
    [
        ["verify", "mine", "--out", "s3://b/board"],
        ["verify", "mine", "--verdicts", "s3://b/board"],
        ["site", "mine", "--out", "s3://b/board"],
    ],
)
def test_a_bucket_is_refused_in_one_line(clothbench, words):
    done = clothbench(*words)
    assert (done.returncode, done.stdout) == (2, "")
    said = "found an address, expected a folder; this command takes no bucket"
    assert done.stderr == f"clothbench: s3://b/board: {said}\n"
