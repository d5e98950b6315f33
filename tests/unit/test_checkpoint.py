"""What is remembered between a run that was stopped and the one that goes on."""

import errno
import re
import time

import numpy as np
import pytest

from clothbench.core import kernels
from clothbench.engine.checkpoint import Checkpoint, Unwritable


def test_arrays_come_back_to_the_bit(tmp_path):
    checkpoint = Checkpoint(tmp_path / "unfinished")
    values = np.random.default_rng(0).normal(size=(3, 4))
    checkpoint.keep("a" * 16, values=values, count=np.array(7))
    known = Checkpoint(tmp_path / "unfinished").recall("a" * 16)
    assert known is not None
    assert (known["values"] == values).all()
    assert int(known["count"]) == 7


def test_a_part_has_all_that_is_kept_of_it_by_its_own_keys(tmp_path):
    whole = Checkpoint(tmp_path)
    whole.keep("b" * 16, values=np.ones(2))
    whole.part("x").keep("a" * 16, values=np.zeros(3))
    assert list(whole.part("x").everything()) == ["a" * 16]
    assert list(whole.everything()) == ["b" * 16, "x-" + "a" * 16]


def test_the_time_of_stopped_runs_counts(tmp_path):
    checkpoint = Checkpoint(tmp_path)
    checkpoint.before = 100.0
    checkpoint.keep("a" * 16, values=np.zeros(3))
    assert 100.0 < Checkpoint(tmp_path).seconds < 110.0


def test_compiling_is_no_time_of_the_work_whenever_it_is_done(tmp_path, monkeypatch):
    """As between two stages of one search, and in a run that is stopped."""
    spent, began = [0.0], time.perf_counter()
    monkeypatch.setattr(kernels, "compiled_for", lambda: spent[0])
    monkeypatch.setattr(time, "perf_counter", lambda began=began: began + 100.0 + spent[0])
    checkpoint = Checkpoint(tmp_path)
    spent[0] = 50.0
    assert (checkpoint.seconds, checkpoint.part("coarse").seconds) == (0.0, 0.0)
    checkpoint.keep("a" * 16, values=np.zeros(3))
    assert Checkpoint(tmp_path).seconds == 0.0


def test_unknown_and_damaged_are_computed_again(tmp_path):
    checkpoint = Checkpoint(tmp_path)
    assert checkpoint.recall("b" * 16) is None
    (tmp_path / f"{'b' * 16}.npz").write_bytes(b"half a file")
    assert checkpoint.recall("b" * 16) is None


def test_without_a_folder_nothing_is_kept():
    checkpoint = Checkpoint()
    checkpoint.keep("c" * 16, values=np.zeros(3))
    assert checkpoint.recall("c" * 16) is None
    checkpoint.forget()


def test_forgotten_leaves_nothing(tmp_path):
    checkpoint = Checkpoint(tmp_path / "unfinished")
    checkpoint.keep("d" * 16, values=np.zeros(3))
    checkpoint.forget()
    assert not (tmp_path / "unfinished").exists()


def test_a_file_beyond_what_the_system_grants_is_one_line_and_leaves_nothing(tmp_path):
    resource = pytest.importorskip("resource", reason="limits of POSIX")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, hard))
    try:
        with pytest.raises(Unwritable, match=rf"^{re.escape(str(tmp_path))}: found that it cannot be written \(File"):
            Checkpoint(tmp_path).keep("a" * 16, values=np.random.default_rng(0).normal(size=10_000))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert not list(tmp_path.iterdir())


def test_what_a_part_could_not_keep_its_whole_knows_and_other_faults_are_told_as_they_are(tmp_path, monkeypatch):
    def savez(*_, **__):
        raise OSError(code, "as it is")

    monkeypatch.setattr(np, "savez", savez)
    whole, code = Checkpoint(tmp_path), errno.EIO
    with pytest.raises(OSError, match="as it is"):
        whole.keep("a" * 16, values=np.zeros(3))
    whole.require_kept()
    code = errno.EROFS
    with pytest.raises(Unwritable):
        whole.part("coarse").keep("a" * 16, values=np.zeros(3))
    with pytest.raises(Unwritable, match=r"Read-only file system.*; nothing half-written is left: make room"):
        whole.require_kept()
