"""Reproduced and verified: a submission with its plugin, run again in a fresh environment; and what is refused."""

import dataclasses
import json
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import psutil
import pytest
from conftest import ROOT, swinging_recording

from clothbench import ClothbenchError, read_recording, write_recording
from clothbench.core.files import sha256
from clothbench.plugins.discovery import catalogue
from clothbench.submissions.again import blank
from clothbench.submissions.grades import cells_of, choose, held_out, reproduce, require_new
from clothbench.submissions.reading import read_submission
from clothbench.submissions.sandbox import Sandbox
from clothbench.submissions.submission import FILE
from clothbench.submissions.unpublished import by_fabric, require_unpublished
from clothbench.submissions.verification import verify

sys.path.append(str(ROOT / "tests" / "plugin"))

from plate_wheel import MODEL, wheel_of_plate


def known():
    return [swinging_recording("sway-1"), swinging_recording("sway-2", split="held_out")]


def unpublished():
    """The same cloth another time: its noise is another one."""
    out = []
    for number, recording in enumerate(known()):
        noise = np.random.default_rng(number).normal(0, 1e-3, recording.position.shape)
        out.append(dataclasses.replace(recording, name=f"secret-{number}", position=recording.position + noise))
    return out


@pytest.fixture(scope="module")
def stranger(tmp_path_factory):
    """An environment with the plugin, two fits of it, and what was packed of them."""
    folder = tmp_path_factory.mktemp("stranger")
    for recording in known():
        write_recording(recording, folder / "recordings" / f"{recording.name}.nc")
    wheel = wheel_of_plate(folder)
    place = Sandbox(folder, limit=120.0)
    place.install([wheel])
    words = ["recordings=recordings", "model=plate", "optimizer=least_squares", "metric=node_error", "rerun=false"]
    hand_in = ["submit", "mine", "--runs", "runs", "--wheel", wheel, "--name", "plate", "--recordings", "recordings"]
    code = "import clothbench.cli.commands as c, sys; sys.exit(c.main({}) or c.main({}))"
    code = code.format(["run", *words, "jobs=1", "budget=20"], [str(word) for word in hand_in])
    done = subprocess.run([place.python, "-c", code], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return folder, place


@pytest.fixture
def mine(stranger, tmp_path):
    return shutil.copytree(stranger[0] / "mine", tmp_path / "mine")


def test_nothing_of_a_wheel_is_run_while_it_is_installed(tmp_path):
    wheel = wheel_of_plate(tmp_path)
    with zipfile.ZipFile(wheel, "a") as archive:
        archive.writestr("plate.pth", f"import pathlib; pathlib.Path({str(tmp_path / 'ran')!r}).touch()\n")
    place = Sandbox(tmp_path, limit=120.0)
    place.install([wheel])
    assert not (tmp_path / "ran").exists()
    subprocess.run([place.python, "-c", "import clothbench_plate.model"], check=True)
    assert (tmp_path / "ran").exists()


def test_a_wheels_name_is_no_option_of_pip(tmp_path, monkeypatch):
    """In the folder itself `-revil.whl` would be read as `-r evil.whl`, a list of what else to fetch and run."""
    monkeypatch.chdir(tmp_path)
    Path("-revil.whl").write_bytes(b"")
    (tmp_path / "evil.whl").write_text("surely-not-there==1\n")
    with pytest.raises(ClothbenchError) as fault:
        Sandbox(tmp_path / "place", limit=120.0).install([Path("-revil.whl")])
    assert "surely-not-there" not in str(fault.value)
    assert "-revil.whl: cannot be installed" in str(fault.value)
    assert str(tmp_path) not in str(fault.value)


@pytest.mark.slow
def test_a_wheel_that_cannot_be_installed_is_a_fault_without_a_place(mine, stranger, clothbench, tmp_path):
    (wheel,) = (mine / "wheels").iterdir()
    wheel.write_bytes(b"no wheel")
    edit(mine, lambda stated: stated["wheels"][0].update(sha256=sha256(wheel)))
    given = ["--recordings", str(stranger[0] / "recordings"), "--verdicts", "verdicts"]
    done = clothbench("verify", mine, *given, "--run-their-code", "--reproduce")
    assert done.returncode == 1
    (verdict,) = (path.read_text() for path in Path(tmp_path, "verdicts").glob("*.json"))
    assert "cannot be installed" in verdict
    assert json.loads(verdict)["grade"] == "refused"
    assert str(mine) not in verdict


def edit(folder, change):
    stated = json.loads((folder / FILE).read_text())
    change(stated)
    (folder / FILE).write_text(json.dumps(stated))


def found_in(folder, place):
    found = verify(folder, known(), catalogue())
    assert found.faults == ()
    chosen = choose(folder, found.submission, 2, seed=1)
    faults = reproduce(folder, found.submission, found.found, chosen, place, catalogue())
    assert faults.keys() <= set(chosen.keys)
    return [fault for said in faults.values() for fault in said]


def test_what_is_packed_says_all_and_names_no_place(stranger):
    submission = read_submission(stranger[0] / "mine")
    assert [entry.recording for entry in submission.entries] == ["sway-1", "sway-2"]
    assert {entry.cell for entry in submission.entries} == {submission.cells[0].key}
    assert str(stranger[0]) not in (stranger[0] / "mine" / FILE).read_text()
    assert submission.wheels[0].sha256 == sha256(stranger[0] / "mine" / submission.wheels[0].file)


def test_the_choice_is_drawn_afterwards_and_can_be_repeated(mine):
    submission = read_submission(mine)
    several = dataclasses.replace(
        submission, cells=tuple(dataclasses.replace(submission.cells[0], key=f"{k:016x}") for k in range(40))
    )
    first = choose(mine, several, 3, None)
    assert first.seed != choose(mine, several, 3, None).seed
    assert choose(mine, several, 3, first.seed) == first
    edit(mine, lambda stated: stated.update(about="the same, handed in anew"))
    assert choose(mine, several, 3, first.seed).keys != first.keys


def test_edited_scores_are_refused_without_running_anything(mine):
    edit(mine, lambda stated: stated["entries"][1]["scores"].update(node_error=0.7))
    assert "claimed were 0.7 mm" in verify(mine, known(), catalogue()).faults[0]


def test_another_wheel_than_was_handed_in_is_refused(mine):
    wheel_of_plate(mine / "wheels", MODEL.replace("0.02)", "0.03)"))
    assert "is not the file that was handed in" in verify(mine, known(), catalogue()).faults[0]


def test_settings_that_do_not_give_the_numbers_are_refused(stranger, mine):
    def other(stated):
        question = json.loads(stated["cells"][0]["question"])
        stated["cells"][0]["question"] = json.dumps(question | {"bounds": {"bulge": [0.015, 0.02]}})

    edit(mine, other)
    first, *_ = found_in(mine, stranger[1])
    assert "sway-1: node_error is" in first
    assert "when run again, handed in were 1.5" in first


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"model": "sheet"}, "could not be run: no model named 'sheet'"),
    ],
)
def test_what_cannot_be_run_is_one_line(stranger, mine, change, said):
    def other(stated):
        question = json.loads(stated["cells"][0]["question"])
        stated["cells"][0]["question"] = json.dumps(question | change)

    edit(mine, other)
    (fault,) = found_in(mine, stranger[1])
    assert said in fault
    assert len(fault.splitlines()) == 1


def swapped(place, model):
    """The same environment with another text in place of the plugin's."""
    (module,) = place.folder.glob("venv/lib/*/site-packages/clothbench_plate/model.py")
    before = module.read_text()
    module.write_text(model)
    return lambda: module.write_text(before)


@pytest.mark.parametrize(
    ("harm", "limit", "said"),
    [
        ("import time; time.sleep(600)", 2.0, "took longer than 2 s and was ended"),
        ("import os; os._exit(3)", 120.0, "ended with 3 and said nothing"),
    ],
)
def test_a_plugin_that_hangs_or_leaves_is_one_line(stranger, mine, harm, limit, said):
    back = swapped(stranger[1], f"{harm}\n{MODEL}")
    try:
        (fault,) = found_in(mine, dataclasses.replace(stranger[1], limit=limit))
    finally:
        back()
    assert said in fault


LEAVES = """
import os
from pathlib import Path
if os.fork() == 0:
    os.setsid()
    if os.fork() == 0:
        Path(os.environ["HOME"], "..", "out", "left").write_text(str(os.getpid()))
        os.execlp("sleep", "sleep", "600")
    os._exit(0)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not say whose child it was")
def test_what_has_left_its_session_and_its_parent_is_ended(stranger, mine):
    back = swapped(stranger[1], LEAVES + MODEL)
    try:
        assert found_in(mine, stranger[1]) == []
    finally:
        back()
    (left,) = stranger[0].glob("*/out/left")
    assert not psutil.pid_exists(int(left.read_text()))


SPY = """
import json, os
from pathlib import Path
Path(os.environ["HOME"], "..", "out", "told.json").write_text(json.dumps(dict(os.environ)))
"""


def test_an_honest_submission_is_reproduced_and_told_no_token_and_no_position(stranger, mine, monkeypatch):
    monkeypatch.setenv("GITHUB_TOKEN", "sekret")
    place = dataclasses.replace(stranger[1], folder=stranger[0])
    back = swapped(place, SPY + MODEL)
    try:
        assert found_in(mine, place) == []
    finally:
        back()
    told = [json.loads(path.read_text()) for path in stranger[0].glob("*/out/told.json")]
    assert len(told) == 1
    assert "sekret" not in str(told)
    shown = blank(known()[1])
    assert shown.visible.sum() == 1
    assert np.array_equal(shown.grip_position, known()[1].grip_position)


def test_verified_on_recordings_that_nobody_else_has(stranger, mine):
    submission = read_submission(mine)
    (found,) = held_out(mine, submission, by_fabric(unpublished()), stranger[1], catalogue())
    assert found.measured.name == "secret-1"
    assert 1.5 < found.scores["node_error"] < 3.0
    with pytest.raises(ClothbenchError, match="the submission was fitted to it"):
        require_new(mine, submission, by_fabric(known()))


def test_a_stand_ins_truth_is_not_told(stranger, mine, tmp_path):
    """Neither that of recordings to fit nor that of those to score on; where the camera stood is."""
    truth = {"notes": {"truth_bend": "0.0008", "camera_place": "0.0 -2.0 0.5"}, "declared_effects": "quadratic_drag"}
    secret = [dataclasses.replace(recording, **truth) for recording in unpublished()]
    (tmp_path / "place").mkdir()
    (tmp_path / "place" / "venv").symlink_to(stranger[0] / "venv")
    place = Sandbox(tmp_path / "place", stranger[1].limit)
    held_out(mine, read_submission(mine), by_fabric(secret), place, catalogue())
    shown = [read_recording(path) for path in (tmp_path / "place").glob("*/*/*.nc")]
    assert len(shown) == 3  # to fit, to simulate, and what came of it
    assert {(tuple(one.notes.items()), one.declared_effects) for one in shown} == {
        ((("camera_place", "0.0 -2.0 0.5"),), "")
    }


def altered(recording, **changes):
    return dataclasses.replace(recording, name="secret", fabric="silk", source="another", **changes)


@pytest.mark.parametrize(
    "copy",
    [
        lambda r: altered(r),
        lambda r: altered(r, time=r.time[2:] - r.time[2], position=r.position[2:] + 1e-9),
        lambda r: altered(r, material=r.material[::-2], position=r.position[:, ::-2]),
    ],
    ids=["renamed", "later", "fewer points"],
)
def test_a_published_recording_is_known_by_what_was_measured(copy):
    with pytest.raises(ClothbenchError, match=r"is published \('sway-1'\)"):
        require_unpublished([copy(known()[0])], known())
    require_unpublished(unpublished(), known())


@pytest.mark.slow
def test_held_out_faults_are_found_before_a_plugin_is_installed(stranger, mine, clothbench, tmp_path):
    words = ["verify", mine, "--recordings", str(stranger[0] / "recordings"), "--run-their-code", "--held-out"]
    write_recording(altered(known()[0]), tmp_path / "renamed" / "a.nc")
    write_recording(unpublished()[0], tmp_path / "alone" / "a.nc")
    (tmp_path / "bad").mkdir()
    (tmp_path / "bad" / "a.nc").write_text("no recording")
    for folder, said in (
        ("renamed", "is published ('sway-1')"),
        ("alone", "found 1 recordings to fit and 0 to score on of fabric 'paper'"),
        ("bad", "a.nc"),
        ("nowhere", "nowhere: no such file or folder"),
    ):
        done = clothbench(*words, folder)
        assert (done.returncode, done.stdout) == (2, "")
        assert said in done.stderr
        assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize(
    ("change", "found"),
    [
        (lambda s: s["wheels"][0].update(file="../x.whl"), "expected a path inside the submission's folder"),
        (lambda s: s["wheels"][0].update(file="x.tar.gz"), "expected the name of a wheel"),
        (lambda s: s["wheels"][0].update(file="wheels/-revil.whl"), "wheels.file is 'wheels/-revil.whl', expected"),
        (
            lambda s: s["wheels"][0].update(file="-revil.whl"),
            "wheels.file is '-revil.whl', expected the name of a wheel",
        ),
        (lambda s: s["cells"][0].update(question=3), r"cells\[0\].question is 3, expected text"),
        (lambda s: s.update(cells={}), "cells is {}, expected a list"),
        (lambda s: s["entries"][0].update(cell=3), "cell is 3, expected the key"),
    ],
)
def test_a_damaged_submission_is_one_line(mine, change, found):
    edit(mine, change)
    with pytest.raises(ClothbenchError, match=found):
        read_submission(mine)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"seed": "x"}, "the question's seed is 'x', expected a whole number from 0 on"),
        ({"seed": 2**70}, "the question's seed is 1180591620717411303424, expected a whole number"),
        ({"case": 3}, "the question's case is 3, expected text"),
        ({"effects": [["a"]]}, "the question's effects is (['a'],), expected a list of names"),
        ({"bounds": {"bulge": "ab"}}, "the question's bounds is {'bulge': ('a', 'b')}, expected pairs of numbers"),
        (None, "found no question of a calibration (KeyError 'recordings')"),
    ],
)
def test_a_broken_question_is_a_fault_of_that_submission_only(stranger, mine, clothbench, tmp_path, change, said):
    shutil.copytree(mine, tmp_path / "good")

    def other(stated):
        question = json.loads(stated["cells"][0]["question"])
        stated["cells"][0]["question"] = "{}" if change is None else json.dumps(question | change)

    edit(mine, other)
    assert any(said in fault for fault in verify(mine, known(), catalogue()).faults)
    if change in ({"seed": "x"}, None):
        for more in ([], ["--out", "board"]):
            done = clothbench("verify", mine, "good", "--recordings", str(stranger[0] / "recordings"), *more)
            assert done.returncode == 1
            (fault,) = done.stderr.splitlines()
            assert said in fault
            assert "plate (good): recomputed" in done.stdout


def test_a_recording_that_the_fit_used_is_not_held_out_whatever_its_file_states(stranger, mine, clothbench, tmp_path):
    """A suite splits as it likes (`each`, `together`): here both were fitted."""
    shutil.move(mine, tmp_path / "submissions" / "mine")

    def other(stated):
        question = json.loads(stated["cells"][0]["question"])
        for source in question["recordings"]:
            source["split"] = "fit"
        stated["cells"][0]["question"] = json.dumps(question)

    edit(tmp_path / "submissions" / "mine", other)
    given = ["--recordings", str(stranger[0] / "recordings")]
    done = clothbench("verify", "submissions/mine", *given, "--out", "board")
    assert done.returncode == 0, done.stderr
    assert "sway-2: shown under fit: a fit used it, though its file holds it out" in done.stdout
    rows = json.loads(clothbench("leaderboard", "--json", "--out", "board").stdout)
    assert {row["split"] for row in rows} == {"fit"}
    assert clothbench("site", "submissions", *given, "--out", "site").returncode == 0
    text = (tmp_path / "site" / "index.html").read_text()
    assert "fitted to 1 that are held out by their files" in text
    assert "held out</h2>" not in text


def test_a_fit_that_is_handed_in_twice_is_a_fault(mine):
    edit(mine, lambda stated: stated["cells"].append(stated["cells"][0]))
    assert "is there twice, expected every fit once" in verify(mine, known(), catalogue()).faults[0]


@pytest.mark.parametrize("name", ["held-out", "wheels", "ab", "\x1b[2J"])
def test_a_fit_has_a_key_and_no_name_that_a_verdict_uses_otherwise(mine, name):
    """A fit called "held-out" that passes would take away what went wrong on unpublished recordings."""
    edit(mine, lambda stated: stated["cells"][0].update(key=name))
    edit(mine, lambda stated: [entry.update(cell=name) for entry in stated["entries"]])
    (fault,) = verify(mine, known(), catalogue()).faults
    assert f"submission.json: cells: key is {name!r}, expected 16 hexadecimal digits" in fault
    with pytest.raises(ClothbenchError, match="expected 16 hexadecimal digits"):
        cells_of(mine, read_submission(mine))


@pytest.mark.slow
def test_as_a_verifier_does_it(stranger, mine, clothbench, tmp_path):
    put_aside(tmp_path)
    given = ["--recordings", str(stranger[0] / "recordings")]
    assert clothbench("verify", mine, *given, "--out", "board").returncode == 0
    done = clothbench("verify", mine, *given, "--reproduce")
    assert (done.returncode, done.stdout) == (2, "")
    assert "--run-their-code" in done.stderr
    done = clothbench(
        "verify", mine, *given, "--reproduce", "--held-out", "secret", "--run-their-code", "--verdicts", "verdicts",
        "--out", "board",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "plate: reproduced, 1 of 1 cells by seed" in done.stdout
    (verdict,) = (json.loads(path.read_text()) for path in Path(tmp_path, "verdicts").glob("*.json"))
    assert (verdict["grade"], verdict["sha256"]) == ("verified", sha256(mine / FILE))
    kept = "".join(path.read_text() for path in Path(tmp_path, "verdicts").glob("*"))
    rows = json.loads(clothbench("leaderboard", "--json", "--out", "board").stdout)
    assert "secret" not in kept + json.dumps(rows)
    shown = {(row["recording"], row["split"], row["optimizer"].partition(", ")[2]) for row in rows}
    assert len(rows) == len(shown) == 5
    assert {(split, grade) for recording, split, grade in shown if not recording} == {
        ("fit", "submitted, reproduced"), ("held_out", "submitted, reproduced"), ("held_out", "submitted, verified")
    }  # fmt: skip
    done = clothbench("verify", mine, *given, "--out", "board", "--verdicts", "verdicts")
    assert [line.split()[-2] for line in done.stdout.splitlines() if "node_error" in line] == [
        "reproduced", "reproduced", "verified"
    ]  # fmt: skip
    assert json.loads(clothbench("leaderboard", "--json", "--out", "board").stdout) == rows


def put_aside(folder):
    for recording in unpublished():
        write_recording(recording, folder / "secret" / f"{recording.name}.nc")


@pytest.mark.slow
def test_forged_public_scores_get_no_grade_from_unpublished_recordings(stranger, mine, clothbench, tmp_path):
    put_aside(tmp_path)
    shutil.move(mine, tmp_path / "submissions" / "mine")

    def other(stated):
        question = json.loads(stated["cells"][0]["question"])
        stated["cells"][0]["question"] = json.dumps(question | {"bounds": {"bulge": [0.015, 0.02]}})

    edit(tmp_path / "submissions" / "mine", other)
    given = ["--recordings", str(stranger[0] / "recordings"), "--verdicts", "verdicts"]
    run = ["verify", "submissions/mine", *given, "--run-their-code", "--out", "board"]
    done = clothbench(*run, "--held-out", "secret")
    assert done.returncode == 0, done.stderr
    assert "plate (submissions/mine): recomputed, 2 of 2 recordings" in done.stdout
    assert clothbench("site", "submissions", *given, "--out", "site").stdout.startswith("submissions/mine: recomputed")
    unpublished, held_out = (tmp_path / "site" / "index.html").read_text().split("<h2 id=")[2:4]
    assert (unpublished.count(">verified<"), held_out.count(">verified<")) == (1, 0)
    done = clothbench(*run, "--reproduce")
    assert done.returncode == 1
    assert "when run again, handed in were 1.5" in done.stderr
    assert clothbench("site", "submissions", *given, "--out", "site").stdout.startswith("submissions/mine: refused")
    assert list((tmp_path / "board" / "cells").iterdir()) == []


@pytest.mark.slow
def test_what_went_wrong_on_unpublished_recordings_is_told_to_the_verifier_only(stranger, mine, clothbench, tmp_path):
    put_aside(tmp_path)

    def other(stated):
        question = json.loads(stated["cells"][0]["question"])
        stated["cells"][0]["question"] = json.dumps(question | {"model": "secret-1"})

    edit(mine, other)
    given = ["--recordings", str(stranger[0] / "recordings"), "--verdicts", "verdicts", "--out", "board"]
    done = clothbench("verify", mine, *given, "--run-their-code", "--held-out", "secret")
    assert done.returncode == 1
    assert "no model named 'secret-1'" in done.stderr
    (verdict,) = Path(tmp_path, "verdicts").glob("*.json")
    assert json.loads(verdict.read_text())["grade"] == "refused"
    assert "secret" not in verdict.read_text()
    again = clothbench("verify", mine, *given)  # without running anything: what was found stands
    assert again.returncode == 1
    assert "refused: it could not be fitted to unpublished recordings" in again.stderr
