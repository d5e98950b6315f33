"""Recordings of a finished cell are found by their content, wherever they and the working directory have moved."""

from __future__ import annotations

import dataclasses
import shutil

import pytest
from conftest import swinging_recording

from clothbench import ClothbenchError, write_recording
from clothbench.cli.run import composed
from clothbench.cli.suggest import asked
from clothbench.engine.cells import Source
from clothbench.engine.suite import plan, suites_folder
from clothbench.plugins.discovery import catalogue
from clothbench.recordings.nodes import find_recordings, read_recording
from clothbench.studies.calibration.moved import found_again, hashes

OTHER = swinging_recording(cloth_width=0.3)


@pytest.fixture
def project(tmp_path):
    """A folder with one recording in `taken`, and `runs` beside it."""
    write_recording(swinging_recording(), tmp_path / "project" / "taken" / "swing.nc")
    (tmp_path / "project" / "runs").mkdir()
    return tmp_path / "project"


def source(path: object) -> Source:
    return Source(str(path), "swing", swinging_recording().hash, "fit")


def place(path: object, results, named=None) -> str:
    return found_again([source(path)], "ab", results, named or {}, "--recordings PATH")[0].path


def test_a_cell_keeps_paths_that_hold_everywhere_and_the_key_does_not_hang_on_them(project, monkeypatch):
    words = ["recording=taken/swing.nc", "model=mass_spring", "optimizer=ga", "metric=node_error"]
    monkeypatch.chdir(project)
    (cell,) = plan(composed(words), catalogue())
    assert [s.path for s in cell.recordings] == [str(project / "taken" / "swing.nc")]
    typed = dataclasses.replace(cell, recordings=(dataclasses.replace(cell.recordings[0], path="taken/swing.nc"),))
    assert typed.key == cell.key
    assert typed.stream("optimizer") == cell.stream("optimizer")
    shutil.move(project / "taken", project / "moved")
    assert plan(composed([words[0].replace("taken", "moved"), *words[1:]]), catalogue())[0].key == cell.key


def test_a_recording_is_found_where_it_lay_or_beside_the_results(project, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    runs, taken = project / "runs", project / "taken" / "swing.nc"
    assert place(taken, runs) == str(taken)
    assert place("taken/swing.nc", runs) == str(taken)  # as older versions kept it, from the folder of the run
    assert place("taken/swing.nc", project / "deeper" / "runs") == str(taken)
    assert place("/nowhere/project/taken/swing.nc", runs) == str(taken)  # recordings and results moved together
    write_recording(OTHER, tmp_path / "taken" / "swing.nc")  # of that name in this working directory
    assert place("taken/swing.nc", runs) == str(taken)


def test_what_is_shipped_is_found_in_another_installation(tmp_path):
    path = find_recordings([suites_folder() / "embedded" / "static_dynamic"])[0]
    of = read_recording(path)
    elsewhere = f"/venv/clothbench/suites/{path.relative_to(suites_folder())}"
    (found,) = found_again([Source(elsewhere, of.name, of.hash, "fit")], "ab", tmp_path, {}, "--recordings PATH")
    assert found.path == str(path)


def test_a_recording_that_is_nowhere_is_one_line(project, tmp_path):
    runs, taken = project / "runs", project / "taken" / "swing.nc"
    moved = tmp_path / "archive" / "one.nc"
    moved.parent.mkdir()
    taken.rename(moved)
    with pytest.raises(
        ClothbenchError, match=r"fitted to 'swing' here, and it is not there any more; say where it lies"
    ):
        place(taken, runs)
    write_recording(OTHER, taken)
    with pytest.raises(ClothbenchError, match="another recording lies there now; say where it lies with --recordings"):
        place(taken, runs)
    with pytest.raises(ClothbenchError, match="there now, and is none of the 1 named; say"):
        place(taken, runs, hashes([str(project / "taken")]))
    taken.write_text("no recording")
    assert place(taken, runs, hashes([str(moved.parent)])) == str(moved)


def test_recordings_beside_recordings_are_refused_by_suggest(project):
    with pytest.raises(ClothbenchError, match=r"found recordings=elsewhere beside .*; leave one of them out"):
        asked(str(project / "taken"), {"recordings": "elsewhere"}, project / "runs", project / "out", catalogue())
