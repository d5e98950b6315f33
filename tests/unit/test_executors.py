"""Executors without their engines: settings, the loop over workers, and what goes to a worker and comes back."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import errno
import importlib
import os
import pickle
import queue as queues
import signal
import socket
import subprocess
import sys
import time
import types
from concurrent.futures import Future
from pathlib import Path

import numpy as np
import psutil
import pytest

from clothbench import ClothbenchError
from clothbench.core.errors import Stopped
from clothbench.engine.cells import Source, lie_here
from clothbench.engine.disagreement import outcome
from clothbench.engine.executors import settings
from clothbench.engine.executors.cells import CellWork, concluded, places, sources_of
from clothbench.engine.executors.child import Ended, _kept, in_child
from clothbench.engine.executors.drive import InOrder, answers, elsewhere
from clothbench.engine.executors.settings import executor_settings
from clothbench.engine.executors.work import Answer, Died, Owner, attended, seldom, start_of
from clothbench.engine.leases import KEPT
from clothbench.engine.limits import Limits, Watch
from clothbench.engine.pool import _first, _run_alone, _told, _told_file, by_turns, run_cells
from clothbench.engine.rows import failure
from clothbench.engine.run import keep, run_cell
from clothbench.engine.store import Store
from clothbench.engine.suite import plan
from clothbench.plugins.discovery import catalogue

BASE = {
    "study": "calibration", "model": "mass_spring", "optimizer": "ga", "metric": "node_error", "effects": [],
    "report": [], "tracker": "markers", "scene": {}, "options": {"mass_spring": {"resolution": 5}}, "bounds": {},
    "budget": 12, "seed": 0, "jobs": 1, "timeout": None, "out": "runs", "rerun": False,
}  # fmt: skip


def test_cells_that_begin_together_are_of_different_models():
    cells = [types.SimpleNamespace(model=model, key=n) for n, model in enumerate("aaabbc")]
    assert [cell.key for cell in by_turns(cells)] == [0, 3, 5, 1, 4, 2]


# --- settings -------------------------------------------------------------------------------------------------------


def test_without_an_executor_everything_stays_here():
    assert executor_settings(None) == executor_settings({}) == executor_settings("local") == {"name": "local"}


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"name": "spark"}, "setting 'executor' is 'spark', expected one of local, dask, ray, slurm"),
        ({"name": "local", "address": "tcp://x"}, "setting of executor 'local' 'address' is not known"),
        ({"name": "dask", "shared": "yes"}, "setting 'executor.shared' is 'yes', expected true or false"),
        ({"name": "dask", "address": 8786}, "setting 'executor.address' is 8786, expected one name"),
        ({"name": "slurm", "cluster": "pbs"}, "setting 'executor.cluster' is 'pbs', expected one of slurm, local"),
        ({"name": "slurm", "cores": 0}, "setting 'executor.cores' is 0, expected a whole number, at least 1"),
    ],
)
def test_what_is_wrong_in_an_executor_is_one_line(monkeypatch, given, says):
    monkeypatch.setattr(settings.importlib.util, "find_spec", lambda name: name)
    with pytest.raises(ClothbenchError) as fault:
        executor_settings(given)
    assert says in str(fault.value)
    assert "\n" not in str(fault.value)


@pytest.fixture
def ray(monkeypatch):
    """The executor's module, with as much of Ray in place of it as a test needs; restored afterwards."""
    name = "clothbench.engine.executors.ray"
    queue = types.SimpleNamespace(Empty=queues.Empty, Full=queues.Full, Queue=lambda **_: None)
    made = types.SimpleNamespace(nodes=lambda: [], remote=lambda **_: lambda function: function, shutdown=lambda: None)
    for module, stub in (("ray", made), ("ray.util", None), ("ray.util.queue", queue)):
        monkeypatch.setitem(sys.modules, module, stub)
    monkeypatch.delitem(sys.modules, name, raising=False)
    yield importlib.import_module(name)
    sys.modules.pop(name, None)


@pytest.mark.parametrize(
    ("address", "says"),
    [
        (None, "executor ray: found that Ray cannot be started on this machine (RuntimeError: no room), expected"),
        ("head:1", "setting 'executor.address' is 'head:1': found no Ray cluster there (RuntimeError: no room), exp"),
    ],
)
def test_a_ray_cluster_that_cannot_be_had_is_one_line(ray, address, says):
    def init(**_):
        raise RuntimeError("no room")

    ray.ray.init = init
    with pytest.raises(ClothbenchError) as fault:
        ray.RayWorkers({"address": address, "cores": 1, "wait": 1.0}, 0, 3)
    assert str(fault.value).startswith(says)


@pytest.mark.parametrize(("jobs", "room"), [(0, 10), (3, 3)])
def test_ray_is_given_little_more_than_its_nodes_have_cores_for(ray, jobs, room):
    """All that it is given is leased, and other commands in the folder are to have their share."""
    nodes = [(True, {"CPU": 8.0}), (True, {"CPU": 3.0}), (True, {}), (False, {"CPU": 64.0})]
    ray.ray.init = lambda **_: None
    ray.ray.nodes = lambda: [{"Alive": alive, "Resources": resources} for alive, resources in nodes]
    workers = ray.RayWorkers({"address": "head:1", "cores": 2, "wait": 1.0}, jobs, 1000)
    assert workers.room() == room
    workers.running = dict.fromkeys("ab", 0)
    assert workers.room() == room - 2


@pytest.mark.parametrize(("jobs", "room"), [(0, 1000), (3, 3), (5000, 1000)])
def test_slurm_has_no_more_jobs_than_are_stated(monkeypatch, tmp_path, jobs, room):
    """Its own bound is of each array of jobs, and there may be several."""
    pytest.importorskip("submitit")
    from clothbench.engine.executors import slurm

    begun = types.SimpleNamespace(update_parameters=lambda **_: None, map_array=lambda function, *tasks: tasks[0])
    monkeypatch.setattr(slurm.submitit, "AutoExecutor", lambda *_, **__: begun)
    asked = {"cluster": "slurm", "cores": 1, "minutes": 1, "partition": None, "memory": None, "parameters": {}}
    workers = slurm.SlurmWorkers(asked, jobs, 2000, tmp_path)
    assert workers.room() == room
    workers.begin({0: None, 1: None})
    assert workers.room() == room - 2


def test_what_slurm_says_when_it_takes_no_jobs(monkeypatch, tmp_path):
    pytest.importorskip("submitit")
    from clothbench.engine.executors import slurm

    def refused(function, *tasks):
        raise slurm.submitit.core.utils.FailedJobError("sbatch: error: invalid partition specified: nope")

    there = types.SimpleNamespace(update_parameters=lambda **_: None, map_array=refused)
    monkeypatch.setattr(slurm.submitit, "AutoExecutor", lambda *_, **__: there)
    workers = slurm.SlurmWorkers(executor_settings({"name": "slurm", "partition": "nope"}), 0, 1, tmp_path)
    with pytest.raises(ClothbenchError, match="Slurm took no jobs: sbatch: error: invalid partition specified: nope"):
        workers.begin({0: None})


@pytest.mark.parametrize("name", ["dask", "ray", "slurm"])
def test_an_engine_that_is_not_installed_is_named_with_the_command_that_does(monkeypatch, name):
    monkeypatch.setattr(settings.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ClothbenchError, match=rf"pip install 'clothbench\[{name}\]'"):
        executor_settings(name)


def test_others_share_a_folder_only_if_told(monkeypatch):
    monkeypatch.setattr(settings.importlib.util, "find_spec", lambda name: name)
    assert executor_settings("dask")["shared"]
    assert not executor_settings({"name": "dask", "address": "tcp://there:8786"})["shared"]
    assert executor_settings({"name": "ray", "address": "auto", "shared": True})["shared"]


# --- the loop over workers --------------------------------------------------------------------------------------------


class Made:
    """Workers that answer at once; some works kill theirs, so many times each."""

    def __init__(self, deaths: dict[int, int], room: int = 2):
        self.deaths, self.size, self.running, self.begun, self.most = dict(deaths), room, {}, [], 0

    def room(self):
        return self.size - len(self.running)

    def begin(self, works):
        self.running.update(works)
        self.begun += list(works)
        self.most = max(self.most, len(self.running))

    def ended(self, seconds):
        number = next(iter(self.running))
        work = self.running.pop(number)
        if self.deaths.get(number, 0):
            self.deaths[number] -= 1
            return [(number, Died("gone"))]
        return [(number, Answer(work(None, 1)))]

    def told(self):
        return [(number, 7, 0.5) for number in self.running]

    def close(self):
        pass


def test_a_work_whose_worker_dies_is_tried_once_more():
    workers, told = Made({1: 1, 2: 2}), []
    found = dict(
        answers(workers, lambda n: lambda tell, threads: n * n, InOrder(range(5)), lambda *word: told.append(word))
    )
    assert found == {0: Answer(0), 1: Answer(1), 2: Died("gone"), 3: Answer(9), 4: Answer(16)}
    assert sorted(workers.begun) == [0, 1, 1, 2, 2, 3, 4]
    assert workers.most == 2
    assert (1, 7, 0.5) in told


def test_a_study_does_itself_what_killed_two_workers_and_hears_of_other_faults():
    with pytest.warns(UserWarning, match="a worker died twice"):
        found = dict(elsewhere(Made({0: 2}), {})([lambda tell, threads: 5] * 2))
    assert found == {0: None, 1: 5}
    with pytest.raises(ClothbenchError, match=r"found models/mass_spring .*, expected 0\.0, 9; install the same there"):
        list(elsewhere(AsDone(), {"models/mass_spring": "0.0, 9"})([lambda tell, threads: 5]))


def test_answers_to_what_nobody_waits_for_any_more_are_no_others():
    """A work with a fault ends its batch; what else of it is with the workers answers in the midst of the next one."""
    pieces = elsewhere(OneByOne(), {})

    def lost(tell, threads):
        raise ClothbenchError("lost")

    with pytest.raises(ClothbenchError, match="lost"):
        list(pieces([lost, lambda tell, threads: "first"]))
    assert dict(pieces([lambda tell, threads: "second"])) == {0: "second"}
    assert dict(pieces([lambda tell, threads, k=k: k for k in range(5)])) == {k: k for k in range(5)}


class AsDone(Made):
    """Workers that do as a real one does."""

    def __init__(self):
        super().__init__({})

    def ended(self, seconds):
        return [(number, attended(self.running.pop(number), print, 1, None)) for number in list(self.running)]


class OneByOne(AsDone):
    """One of them after the other."""

    def ended(self, seconds):
        number = next(iter(self.running))
        return [(number, attended(self.running.pop(number), print, 1, None))]


# --- in a worker ------------------------------------------------------------------------------------------------------


def test_a_worker_carries_faults_and_exits_back():
    pytest.importorskip("threadpoolctl", reason="comes with the extras dask, ray and slurm")

    def bad(fault):
        def work(tell, threads):
            raise fault

        return attended(work, print, 1, None)

    there = f"worker on {socket.gethostname()}"
    assert attended(lambda tell, threads: threads, print, 3, None) == Answer(3)
    assert bad(ClothbenchError("no room")) == Answer(fault="no room")
    assert bad(SystemExit(3)) == Answer(fault=f"{there}: SystemExit: 3")
    assert bad(ValueError("odd\nand more")) == Answer(fault=f"{there}: ValueError: odd")
    assert bad(asyncio.CancelledError("now")) == Answer(fault=f"{there}: CancelledError: now")  # which is no Exception
    with pytest.raises(Stopped):
        bad(Stopped())


def test_words_cross_the_network_seldom():
    heard = []
    tell = seldom(lambda *word: heard.append(word))
    for step in range(1000):
        tell(step, 0.25)
    assert heard == [(0, 0.25)]


def test_an_owner_that_was_killed_lives_no_more():
    assert Owner().lives
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    owner = Owner(child.pid, start_of(child.pid))
    assert owner.lives
    child.kill()
    until = time.monotonic() + 10
    while owner.lives and time.monotonic() < until:  # it is a zombie now, which nobody has waited for
        time.sleep(0.01)
    assert not owner.lives
    child.communicate()
    assert not Owner(os.getpid(), 1.0).lives  # another process has the number


@pytest.mark.skipif(not psutil.LINUX, reason="other systems keep the time itself")
def test_an_owner_lives_on_when_the_clock_is_set(monkeypatch):
    """Its workers would all end, and its cells be taken by others."""
    owner = Owner()
    assert 0 < owner.began < time.time() - psutil.boot_time()
    for step in (-3600, -1, 1, 86400):
        later = int(psutil.boot_time()) + step
        with monkeypatch.context() as patched:
            patched.setattr(psutil._pslinux, "boot_time", lambda at=later: float(at))
            assert psutil.Process().create_time() == pytest.approx(owner.began + later, abs=0.01)
            assert owner.lives


# --- in a child of a worker -------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Harmful:
    """Does something to its process."""

    harm: str

    def __call__(self, tell, threads):
        tell(3, 0.5)
        {"print": print, "die": lambda _: os.kill(os.getpid(), signal.SIGKILL), "sleep": lambda _: time.sleep(600),
         "exit": sys.exit, "fork": lambda _: os.fork() or time.sleep(600)}[self.harm]("x")  # fmt: skip
        return os.getpid(), threads


@pytest.fixture
def child():
    pytest.importorskip("threadpoolctl", reason="comes with the extras dask, ray and slurm")
    told = []

    def done(harm, limits=Limits(seconds=60.0), tell=lambda *word: told.append(word)):  # noqa: B008
        return in_child(Harmful(harm), "cell", tell, 2, Watch(limits, 1))

    yield done, told
    while _kept:
        _kept.pop().close()


def ended_but(*pids):
    """Whether all processes that were begun here have ended, but for these; in a moment at most."""
    until = time.monotonic() + 10
    while time.monotonic() < until:
        begun = psutil.Process().children(recursive=True)
        with contextlib.suppress(psutil.NoSuchProcess):
            if {p.pid for p in begun if p.status() != psutil.STATUS_ZOMBIE} == set(pids):
                return True
        time.sleep(0.05)
    return False


def test_a_child_is_kept_from_work_to_work_and_prints_aside(child, capfd):
    done, _ = child
    pid, threads = done("print").value
    assert (pid != os.getpid(), threads) == (True, 2)
    assert done("exit") == Answer(fault=f"worker on {socket.gethostname()}: SystemExit: x")
    assert done("fork").value == (pid, 2)
    assert ended_but(pid)  # what it forked has gone
    assert capfd.readouterr().out == ""


def test_a_child_that_dies_is_tried_once_more_and_one_that_sleeps_is_ended(child):
    done, told = child
    with pytest.raises(Ended, match=r"the process that ran this cell died \(exit code -9\)"):
        done("die")
    with pytest.raises(Ended, match=r"took more than 2 s, the limit \(limits.seconds\), and was ended"):
        done("sleep", Limits(seconds=2.0))
    assert (3, 0.5) in told
    assert done("print").value[1] == 2


def test_a_child_ends_with_a_work_that_nobody_waits_for(child):
    done, _ = child

    class Stopped(BaseException):
        pass

    def stop(steps, value):
        raise Stopped

    with pytest.raises(Stopped):
        done("sleep", tell=stop)
    assert ended_but()


# --- cells ------------------------------------------------------------------------------------------------------------


def cell_of(recordings_folder):
    return plan({**BASE, "recordings": str(recordings_folder)}, catalogue())[0]


def test_no_cell_goes_on_where_a_run_ends_by_a_fault(recordings_folder, tmp_path):
    endless = {"budget": 10**6, "options": {**BASE["options"], "ga": {"generations": 10**5}}}
    slow = plan({**BASE, **endless, "recordings": str(recordings_folder)}, catalogue())[0]

    def full(cell, status):
        raise ClothbenchError("disk full")

    with pytest.raises(ClothbenchError, match="disk full"):
        run_cells([slow, cell_of(recordings_folder)], tmp_path / "out", jobs=2, done=full)
    assert not [p for p in psutil.Process().children(True) if "loky.backend.popen_loky_posix" in p.cmdline()]


def test_whatever_a_plugin_raises_is_the_row_of_its_cell(recordings_folder, tmp_path, monkeypatch):
    def run(*_):
        raise asyncio.CancelledError("now")  # which is no Exception

    cell = cell_of(recordings_folder)
    monkeypatch.setattr("clothbench.studies.calibration.study.run", run)
    assert run_cell(cell, tmp_path) == "error"
    assert Store(tmp_path).rows()[0]["reason"] == "CancelledError: now"


@pytest.mark.parametrize(
    ("raised", "ends"),
    [(OSError(errno.ENOSPC, "No space left on device"), True), (FileNotFoundError(errno.ENOENT, "a file"), False)],
    ids=["full", "own file"],
)
def test_a_result_for_which_there_is_no_room_ends_the_run_and_is_no_row(
    recordings_folder, tmp_path, monkeypatch, raised, ends
):
    def attach(folder):
        raise raised

    cell = cell_of(recordings_folder)
    result = failure(cell, "skipped", "as if it had run")
    monkeypatch.setattr(
        "clothbench.studies.calibration.study.run", lambda *_: dataclasses.replace(result, attach=attach)
    )
    if ends:
        with pytest.raises(ClothbenchError, match=r"cannot be written \(No space left on device\)"):
            run_cell(cell, tmp_path)
        assert Store(tmp_path).rows() == []
    else:
        assert run_cell(cell, tmp_path) == "error"


@pytest.mark.parametrize("swallows", [False, True], ids=["told", "taken for a fault of a part"])
def test_a_journal_for_which_there_is_no_room_ends_the_run_and_is_no_row(
    recordings_folder, tmp_path, monkeypatch, swallows
):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    def run(cell, context):
        with contextlib.suppress(Exception) if swallows else contextlib.nullcontext():
            context.checkpoint.keep("a", values=np.zeros(1))
        return failure(cell, "skipped", "as if it had run")

    monkeypatch.setattr(np, "savez", full)
    monkeypatch.setattr("clothbench.studies.calibration.study.run", run)
    with pytest.raises(ClothbenchError, match=r"journal.*cannot be written \(No space left on device\)"):
        run_cell(cell_of(recordings_folder), tmp_path)
    assert Store(tmp_path).rows() == []


def test_recordings_are_found_by_what_is_in_them(tmp_path):
    source = Source("a/swing.nc", "swing", "0123", "fit")
    assert source.file == "a/swing.nc"
    try:
        lie_here({"0123": "/elsewhere/0123.nc"})
        assert source.file == "/elsewhere/0123.nc"
        assert dataclasses.asdict(source)["path"] == "a/swing.nc"
    finally:
        from clothbench.engine import cells

        cells._here.clear()


def test_a_cell_from_a_worker_that_shares_nothing_is_the_one_that_is_made_here(
    recordings_folder, tmp_path, monkeypatch
):
    """Recordings go as bytes, the cell comes back as files; all tables are the same, where files lie included."""
    monkeypatch.setattr("clothbench.engine.cells._here", {})
    cell = cell_of(recordings_folder)
    assert run_cell(cell, tmp_path / "here") == "ok"
    sent = pickle.loads(pickle.dumps(CellWork(cell, places(cell, shared=False), None, False)))
    for source in sources_of(cell):
        os.unlink(source.path)
    told = []
    answer = attended(sent, lambda *word: told.append(word), 1, None)
    assert answer.fault is None
    assert told
    store, here = Store(tmp_path / "there"), Store(tmp_path / "here")
    assert concluded(store, cell, answer) == "ok"
    assert files_of(store.cell(cell.key)) == files_of(here.cell(cell.key))
    for name in ("question", "parameters", "history"):
        assert store.table(name) == here.table(name)
    assert outcome(store.rows()) == outcome(here.rows())
    with pytest.warns(UserWarning, match="computed twice"):  # the first stays, as with every other writer
        store.take(cell.key, {**answer.value.files, "rows.parquet": other_rows(here, cell.key, tmp_path)})
    assert outcome(store.rows()) == outcome(here.rows())


def files_of(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def other_rows(store: Store, key: str, tmp_path: Path) -> bytes:
    rows = [{**row, "value": 1.0} for row in store.rows()]
    return (Store(tmp_path / "other").put(key, {"rows": rows}) / "rows.parquet").read_bytes()


def test_a_worker_with_other_plugins_says_so_in_the_cells_row(recordings_folder, tmp_path):
    cell = cell_of(recordings_folder)
    cell = dataclasses.replace(cell, versions={**cell.versions, "models/mass_spring": "clothbench 0.0.1, 1"})
    done = CellWork(cell, places(cell, shared=True), tmp_path / "runs", False)(print, 1)
    assert done.status == "error"
    reason = Store(tmp_path / "runs").rows()[0]["reason"]
    assert "found models/mass_spring clothbench" in reason
    assert reason.endswith("expected clothbench 0.0.1, 1; install the same there")


def test_a_cell_that_took_two_workers_with_it_is_a_row(recordings_folder, tmp_path):
    cell, store = cell_of(recordings_folder), Store(tmp_path / "runs")
    assert concluded(store, cell, Died("worker tcp://there:1")) == "error"
    assert store.rows()[0]["reason"] == "the process that ran this cell died twice (worker tcp://there:1)"
    with pytest.raises(ClothbenchError, match="disk full"):
        concluded(store, cell, Answer(fault="disk full"))


def test_a_worker_keeps_what_another_command_finished_while_the_cell_was_in_a_queue(recordings_folder, tmp_path):
    cell, store = cell_of(recordings_folder), Store(tmp_path)
    work = CellWork(cell, places(cell, shared=True), tmp_path, False)
    keep(store, cell, failure(cell, "diverged", "the step is too long"))
    assert work(print, 1).status == KEPT
    assert [row["status"] for row in store.rows()] == ["diverged"]


def test_a_cell_that_was_stored_before_its_worker_died_is_told_as_it_was_stored(recordings_folder, tmp_path):
    cell, store = cell_of(recordings_folder), Store(tmp_path)
    keep(store, cell, failure(cell, "diverged", "the step is too long"))
    assert concluded(store, cell, Died("worker tcp://there:1")) == "diverged"
    assert _run_alone(cell, tmp_path, False, tmp_path / "told", {}, Watch(Limits(), 1)) == "diverged"


def test_cells_at_work_are_looked_at_however_often_others_end(recordings_folder):
    """A cell beyond its limit must not go on for as long as short ones end beside it."""
    cell = cell_of(recordings_folder)
    short, long = dataclasses.replace(cell, seed=1), dataclasses.replace(cell, seed=2)
    file, numbers, ended, at_work = _told_file(2), {short.key: 0, long.key: 1}, Future(), Future()
    ended.set_result("ok")
    _told(file, 1)[:] = 3, 0.5, 4321
    looked, heard = [], []
    watch = types.SimpleNamespace(look=looked.append)

    def tell(cell, steps, value):
        heard.append((cell.key, steps, value))

    assert _first({ended: short, at_work: long}, file, numbers, tell, watch) == {ended}
    assert looked == [{long.key: 4321}]
    assert heard == [(long.key, 3, 0.5)]
