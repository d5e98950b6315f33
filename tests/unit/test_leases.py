"""Leases are advice: they keep two commands off each other's cells, and nothing ever waits for one for long."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import time

import pytest

from clothbench.engine import leases
from clothbench.engine.check import check
from clothbench.engine.executors.work import start_of
from clothbench.engine.leases import Leases, Line
from clothbench.engine.store import Store
from clothbench.plugins.discovery import catalogue

HERE = socket.gethostname()


def lease_of(folder, key, host=HERE, pid=None, age=0.0):
    """A lease as another command writes it."""
    path = folder / "leases" / key
    path.parent.mkdir(parents=True, exist_ok=True)
    pid = pid or os.getpid()
    path.write_text(json.dumps({"host": host, "pid": pid, "began": start_of(pid)}))
    os.utime(path, (time.time() - age,) * 2)
    return path


def row(key):
    return {"suite": "s", "case": "c", "status": "ok", "value": 1.0, "key": key}


@pytest.fixture
def mine(tmp_path):
    with Leases(Store(tmp_path)) as held:
        yield held


def test_one_has_it_until_it_is_given_back(tmp_path):
    with Leases(Store(tmp_path)) as one, Leases(Store(tmp_path)) as other:
        assert one.take("aa")
        assert one.take("aa")
        assert not other.take("aa")
        one.give_back("aa")
        assert other.take("aa")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("host", "age", "free"), [(HERE, 0, False), ("another", 0, False), ("another", 90, True), (HERE, 90, True)]
)
def test_a_lease_without_a_sign_of_life_is_stale(tmp_path, mine, host, age, free):
    lease_of(tmp_path, "aa", host, age=age)
    assert mine.take("aa") is free


def test_the_lease_of_a_process_that_has_gone_is_stale_at_once(tmp_path, mine):
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    lease_of(tmp_path, "aa", pid=child.pid)
    assert not mine.take("aa")
    child.communicate(b"\n")
    assert mine.take("aa")


@pytest.mark.parametrize("text", ["", "[]", '{"host": 1}', "\0", '{"host": "HERE", "pid": 1e400, "began": "x"}'])
def test_what_is_no_lease_is_waited_for_and_goes_stale(tmp_path, mine, text):
    path = lease_of(tmp_path, "aa")
    path.write_text(text.replace("HERE", HERE))
    assert not mine.take("aa")
    os.utime(path, (1.0, 1.0))
    assert mine.take("aa")


def test_a_check_tells_of_those_of_commands_that_have_gone(tmp_path, mine):
    lease_of(tmp_path, "aa", "another")
    path = lease_of(tmp_path, "bb", "another", age=90)
    (found,) = check(Store(tmp_path), catalogue())
    assert (found.path, found.harmless) == (path, True)
    assert found.line == f"{path}: the lease of a command that has gone"


def test_a_folder_that_takes_no_leases_stops_nobody(tmp_path):
    (tmp_path / "leases").write_text("in the way")
    with Leases(Store(tmp_path)) as held:
        assert held.take("aa")
        held.give_back("aa")


def test_cells_of_others_come_last_and_what_they_finished_is_taken(tmp_path, mine, monkeypatch):
    monkeypatch.setattr(leases, "LOOK", 60.0)  # a busy machine may take longer than is usual for a table's first row
    store, taken = Store(tmp_path), []
    lease_of(tmp_path, "aa")
    lease = lease_of(tmp_path, "bb")
    line = Line(["aa", "bb", "cc"], mine, str, taken.append)
    assert line.begin() == "cc"
    assert line.begin() is None
    assert line
    store.put("aa", {"rows": [row("aa")]})
    lease.unlink()
    assert line.begin() is None  # it has just looked
    line._looked = 0.0
    assert line.begin() == "bb"
    assert taken == ["aa"]
    assert not line


def test_whoever_has_nothing_else_left_computes_it_anyway(tmp_path, mine, monkeypatch):
    lease_of(tmp_path, "aa")
    line = Line(["aa"], mine, str, list)
    assert line.begin() is None
    monkeypatch.setattr(leases, "PATIENCE", 0.0)
    line._looked = 0.0
    assert line.begin() == "aa"
    assert not line


def test_cells_of_others_are_begun_one_at_a_time_and_only_while_none_is_finished(tmp_path, mine):
    """Another command may hold more than it is at, as one with a queue does: they are not all done twice."""
    taken, late = [], 2 * leases.PATIENCE
    for key in ("aa", "bb", "cc", "dd"):
        lease_of(tmp_path, key)
    line = Line(["aa", "bb", "cc", "dd"], mine, str, taken.append)

    def begin(after):
        line._looked = 0.0
        line._idle -= after
        return line.begin()

    assert [begin(0.0), begin(late), begin(0.0), begin(late)] == [None, "dd", None, "cc"]
    Store(tmp_path).put("aa", {"rows": [row("aa")]})
    assert [begin(late), begin(0.0), begin(late)] == [None, None, "bb"]
    assert taken == ["aa"]
    assert not line


def test_they_cost_little(tmp_path, mine):
    line = Line([f"{number:x}" for number in range(1000)], mine, str, list)
    began = time.perf_counter()
    while line:
        mine.give_back(line.begin())
    assert time.perf_counter() - began < 3.0  # 3 ms each; a tenth of that on a machine with nothing else to do
