"""A set of files takes its place all together, or not at all."""

from __future__ import annotations

import errno
import os
import shutil

import pytest

from clothbench.core.errors import ClothbenchError
from clothbench.core.files import remove_folder, whole_file, whole_files, whole_folder


def test_files_take_their_place_beside_what_is_there(tmp_path):
    (tmp_path / "tables").mkdir()
    for name in ("notes.txt", "tables/old.parquet", "tables/rows.parquet", "tables/mine.txt"):
        (tmp_path / name).write_text("old")
    with whole_files(tmp_path, instead_of=("tables/*.parquet",)) as part:
        (part / "tables").mkdir()
        (part / "tables" / "rows.parquet").write_text("new")
        (part / "verdict.json").write_text("new")
        assert (tmp_path / "tables" / "rows.parquet").read_text() == "old"
    found = {str(p.relative_to(tmp_path)): p.read_text() for p in tmp_path.rglob("*") if p.is_file()}
    assert found == {
        "notes.txt": "old", "tables/mine.txt": "old", "tables/rows.parquet": "new", "verdict.json": "new",
    }  # fmt: skip


def half_written(folder):
    with whole_files(folder, instead_of=("*.json",)) as part:
        (part / "verdict.json").write_text("half")
        (part / "index.html").write_text("half")
        raise ZeroDivisionError


def test_a_fault_leaves_everything_as_it_was(tmp_path):
    (tmp_path / "verdict.json").write_text("old")
    with pytest.raises(ZeroDivisionError):
        half_written(tmp_path)
    assert [p.name for p in tmp_path.rglob("*")] == ["verdict.json"]
    assert (tmp_path / "verdict.json").read_text() == "old"


@pytest.mark.parametrize("whole", [whole_file, whole_folder, whole_files])
def test_a_full_disk_says_what_could_not_be_written(tmp_path, whole):
    """The system names no file when a write finds no room."""
    with pytest.raises(OSError, match="No space left") as found, whole(tmp_path / "result"):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert found.value.filename == str(tmp_path / "result")
    assert [p for p in tmp_path.rglob("*") if p.name != "result"] == []


@pytest.mark.parametrize("whole", [whole_file, whole_folder, whole_files])
def test_a_place_that_cannot_be_written_to_is_named_as_it_was_asked_for(tmp_path, whole):
    """And not by a hidden name of our own, or by what the system trips over."""
    (tmp_path / "file").touch()
    (tmp_path / "folder" / "inside").mkdir(parents=True)
    places = [tmp_path / "file" / "result", *([tmp_path / "folder"] if whole is whole_file else [])]
    for place in places:
        with (
            pytest.raises(OSError, match=r"cannot be written to \(.+\); give a folder of yours") as found,
            whole(place),
        ):
            pass
        assert found.value.filename == str(place)
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["file", "folder", "inside"]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes of this system have no names")
def test_a_pipe_is_not_replaced_and_a_link_only_where_nobody_asked_for_it(tmp_path):
    (tmp_path / "deep").mkdir()
    (target := tmp_path / "deep" / "cloth.xml").write_text("old")
    os.mkfifo(pipe := tmp_path / "pipe")
    for name, goal in (("link", target), ("dangling", tmp_path / "deep" / "none_yet"), ("to-pipe", pipe)):
        (tmp_path / name).symlink_to(goal)
    for place, asked in ((pipe, False), (pipe, True), (tmp_path / "to-pipe", True)):
        with (
            pytest.raises(ClothbenchError, match=f"^{place}: found a device, pipe or socket, expected a file, or none"),
            whole_file(place, asked=asked),
        ):
            pass
    assert pipe.is_fifo()
    for name in ("link", "dangling"):
        with whole_file(tmp_path / name, asked=True) as part:
            assert part.parent == target.parent
            part.write_text("new")
        assert (tmp_path / name).is_symlink()
        assert (tmp_path / name).read_text() == "new"
    assert target.read_text() == "new"
    for name in ("link", "to-pipe"):
        with whole_file(tmp_path / name) as part:
            part.write_text("newer")
        assert not (tmp_path / name).is_symlink()
    assert target.read_text() == "new"
    assert sorted(p.name for p in target.parent.iterdir()) == ["cloth.xml", "none_yet"]


@pytest.mark.skipif(not os.path.exists("/dev/fd"), reason="open files of this system have no names")
def test_a_pipe_without_a_name_and_a_link_to_itself_are_refused(tmp_path):
    """What this process may write to can be a pipe, as /dev/fd/1 often is; a link to itself had been replaced."""
    ours, theirs = os.pipe()
    (loop := tmp_path / "loop").symlink_to(loop)
    (beside := tmp_path / "beside").symlink_to(tmp_path / "file" / "none")
    (tmp_path / "file").touch()
    try:
        for place, found in ((f"/dev/fd/{theirs}", "a device, pipe or socket"), (loop, "a link that leads back to it")):
            with pytest.raises(ClothbenchError, match=f"^{place}: found {found}"), whole_file(place, asked=True):
                pass
    finally:
        os.close(ours)
        os.close(theirs)
    with pytest.raises(OSError, match="cannot be written to") as fault, whole_file(beside, asked=True):
        pass
    assert fault.value.filename == str(beside)
    with whole_file(loop) as part:  # of which nobody has asked
        part.write_text("new")
    assert loop.read_text() == "new"


def test_a_folder_that_may_not_be_changed_is_named_when_something_is_to_be_removed_from_it(tmp_path, monkeypatch):
    (tmp_path / "cell").mkdir()

    def denied(prefix, dir):
        raise PermissionError(errno.EACCES, "Permission denied", f"{dir}/{prefix}abcdefgh")

    monkeypatch.setattr("clothbench.core.files.tempfile.mkdtemp", denied)
    with pytest.raises(PermissionError, match=r"cannot be written to \(Permission denied\)") as found:
        remove_folder(tmp_path / "cell")
    assert found.value.filename == str(tmp_path)


def test_a_folder_that_goes_while_it_is_replaced_leaves_its_place_free(tmp_path):
    (tmp_path / "cell").mkdir()
    (tmp_path / "cell" / "old").touch()

    def gone():
        shutil.rmtree(tmp_path / "cell")
        return False

    with whole_folder(tmp_path / "cell", gone) as part:
        (part / "new").touch()
    assert [path.name for path in (tmp_path / "cell").iterdir()] == ["new"]
    assert [path.name for path in tmp_path.iterdir()] == ["cell"]
