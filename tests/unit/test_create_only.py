"""A folder whose file system cannot say who came first is refused before anything is computed."""

from __future__ import annotations

import contextlib
import os
import shutil
import time

import pytest

from clothbench import ClothbenchError
from clothbench.cli import main
from clothbench.core import create_only, files
from clothbench.core.create_only import require_create_only


@pytest.fixture(autouse=True)
def forgetful():
    create_only._tried.cache_clear()


def replaces(part, path):
    """A rename as file systems have it that know no folders: it succeeds, whatever is there."""
    shutil.copytree(part, path, dirs_exist_ok=True)
    shutil.rmtree(part)
    return True


def both(part, path):
    """Look, then put: two who look at once both find nothing."""
    if path.exists():
        return False
    time.sleep(0.02)
    return replaces(part, path)


def test_this_disk_is_good_and_nothing_stays_behind(tmp_path):
    require_create_only(tmp_path / "made" / "runs")
    assert os.listdir(tmp_path / "made" / "runs") == []


@pytest.mark.parametrize("rename", [replaces, both])
def test_renames_that_replace_are_refused(tmp_path, monkeypatch, rename):
    monkeypatch.setattr(create_only, "renamed", rename)
    with pytest.raises(ClothbenchError, match="16 renames to one place succeeded, expected exactly one"):
        require_create_only(tmp_path)
    assert os.listdir(tmp_path) == []


def test_locks_that_do_not_lock_are_refused(tmp_path, monkeypatch):
    def open_door(folder):
        time.sleep(0.01)
        return contextlib.nullcontext()

    monkeypatch.setattr(create_only, "alone", open_door)
    monkeypatch.setattr(create_only.time, "sleep", lambda s, sleep=time.sleep: sleep(s or 0.05))
    with pytest.raises(ClothbenchError, match="held one lock at a time, expected one at a time"):
        require_create_only(tmp_path)


def test_it_is_tried_once(tmp_path, monkeypatch):
    require_create_only(tmp_path)
    monkeypatch.setattr(create_only, "renamed", lambda part, path: pytest.fail("tried again"))
    require_create_only(tmp_path)


def test_run_and_merge_ask_first_and_a_finished_folder_is_not_asked(tmp_path, recordings_folder, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run = ["run", f"recording={recordings_folder / 'sway-1.nc'}", "model=mass_spring", "optimizer=nelder_mead"]
    run += ["metric=node_error", "budget=3", "rerun=false", "+options.mass_spring.resolution=3"]
    with monkeypatch.context() as patch:
        patch.setattr(create_only, "renamed", replaces)
        assert main(run) == 2
        said = capsys.readouterr().err
        assert said.startswith(f"clothbench: {tmp_path / 'runs'}: found a file system on which ")
        assert said.count("\n") == 1
        assert os.listdir("runs") == []
    assert main(run) == 0
    create_only._tried.cache_clear()
    monkeypatch.setattr(create_only, "renamed", replaces)
    assert main(run) == 0
    assert main(["store", "merge", "runs", "other"]) == 2
    assert os.listdir("other") == []


def test_a_folder_that_cannot_be_written_to_is_one_line(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(
        ClothbenchError, match=r"file/runs: found a folder that cannot be written to \(Not a directory\)"
    ):
        require_create_only(tmp_path / "file" / "runs")


def test_the_probe_tries_what_the_store_does():
    assert create_only.renamed is files.renamed
    assert create_only.alone is files.alone
