"""A run on the workers of another engine: the same bits, and what a worker takes with it when it dies."""

from __future__ import annotations

import contextlib
import importlib.util
import logging
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from conftest import swinging_recording
from test_killed import CELL, deadly_plugin

from clothbench import ClothbenchError, write_recording
from clothbench.cli.improve import command
from clothbench.cli.run import composed
from clothbench.engine.executors.settings import executor_settings
from clothbench.engine.pool import run_cells
from clothbench.engine.store import Store
from clothbench.engine.suite import plan
from clothbench.plugins.discovery import catalogue

BOTH, OK = "optimizer=[ga,nelder_mead]", {"ga": "ok", "nelder_mead": "ok"}
TIMES = {"wall_s", "finished", "threads"}  # what differs from run to run


def tables(folder):
    """Every table of a store, but for when and how long."""
    found = {}
    for path in sorted(folder.glob("cells/[0-9a-f]*/*.parquet")):
        table = pq.read_table(path)
        kept = table.drop_columns([name for name in table.column_names if name in TIMES])
        found[f"{path.parent.name}/{path.stem}"] = repr(kept.to_pylist())  # by its text: NaN is not itself
    return found


def needs(module):
    if importlib.util.find_spec(module) is None:
        pytest.skip(f"{module} is not installed")


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with recordings in which all of these runs take place: their cells keep where recordings lie."""
    folder = tmp_path_factory.mktemp("cluster")
    write_recording(swinging_recording("sway-1"), folder / "recordings" / "sway-1.nc")
    return folder


def run_in(place, out, *words):
    """Run the cells in this process, or from it; which ended how, and how far which of them said to be."""
    done, told = {}, set()
    settings = composed(["recordings=recordings", *CELL, "budget=12", *words])
    with contextlib.chdir(place):
        run_cells(
            plan(settings, catalogue()), Path(out), jobs=settings["jobs"],
            executor=executor_settings(settings["executor"]),
            done=lambda cell, status: done.update({cell.optimizer: status}),
            progress=lambda cell, steps, value: told.add((cell.optimizer, 0 < steps <= 12)),
        )  # fmt: skip
    return done, told


@pytest.fixture(scope="module")
def here(place):
    """The tables of the run that all others are held against, with one thread for linear algebra as in the command."""
    needs("threadpoolctl")
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1):
        assert run_in(place, "here", BOTH, "jobs=1")[0] == OK
    return tables(place / "here")


@pytest.mark.slow
def test_dask_processes_one_of_which_a_plugin_kills(clothbench, place, here, tmp_path):
    needs("distributed")
    site = deadly_plugin(tmp_path)
    words = ("optimizer=[ga,deadly,nelder_mead]", "executor=dask", "jobs=2", "out=dask")
    out = clothbench("run", "recordings=recordings", *CELL, "budget=12", *words, cwd=place, PYTHONPATH=str(site))
    assert out.returncode == 1, out.stderr
    dead = [row for row in Store(place / "dask").rows() if row["optimizer"] == "deadly"]
    assert [row["status"] for row in dead] == ["error"]
    assert dead[0]["reason"].startswith("the process that ran this cell died twice (worker tcp://127.0.0.1:")
    found = tables(place / "dask")
    assert {name: found[name] for name in here} == here
    assert out.stderr.count("\n") == 3, out.stderr  # a line for each cell, and none of the engine's


def test_a_dask_scheduler_whose_workers_share_no_folder(place, here):
    needs("distributed")
    import distributed

    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address=":0", silence_logs=logging.CRITICAL
    ) as cluster:
        where = f"executor.address={cluster.scheduler_address}"
        done, told = run_in(place, "far", BOTH, "executor=dask", where)
    assert done == OK
    assert told == {("ga", True), ("nelder_mead", True)}
    assert tables(place / "far") == here


SEVERAL = ("optimizer=[ga,annealing,cma_es]", "metric=[node_error,relative_error]")
SHORT = ("recordings=recordings", *(w for w in CELL if not w.startswith(("optimizer=", "metric="))), *SEVERAL)


def dask(stack, *words):
    """A scheduler or a worker as a process of its own, which ends with the test."""
    command = [sys.executable, "-m", "distributed.cli.dask_" + words[0], *words[1:], "--no-dashboard"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    stack.callback(process.wait)
    stack.callback(process.kill)
    return process


def free_port():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


def dask_cluster(stack, workers):
    """Its address, its scheduler and its workers."""
    port = free_port()
    scheduler = dask(stack, "scheduler", "--host", "127.0.0.1", "--port", str(port))
    where = f"tcp://127.0.0.1:{port}"
    begun = [dask(stack, "worker", where, "--nthreads", "1", "--no-nanny") for _ in range(workers)]
    return where, scheduler, begun


def on_cluster(place, out, engine, where, kill=None):
    """Six cells on a cluster, something of which is killed as soon as one cell is finished; what the command said, and
    how it ended. All workers are at a cell then.
    """
    words = (
        *SHORT,
        "budget=200",
        f"out={out}",
        f"executor={engine}",
        f"executor.address={where}",
        "executor.shared=true",
    )
    command = subprocess.Popen(
        [sys.executable, "-m", "clothbench", "run", *words], cwd=place, text=True,
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
    )  # fmt: skip
    deadline = time.monotonic() + 120
    while kill is not None and command.poll() is None and time.monotonic() < deadline:
        if list(place.glob(f"{out}/cells/[0-9a-f]*")):
            kill()
            break
        time.sleep(0.05)
    return command.communicate(timeout=200)[1], command.returncode


@pytest.mark.slow
def test_a_dask_cluster_loses_a_worker_then_its_scheduler(place):
    """Processes of their own on the loopback address. A worker takes a try of its cell with it; the scheduler ends the
    command in one line, and the same command goes on where there is one again.
    """
    needs("distributed")
    with contextlib.ExitStack() as stack:
        where, scheduler, workers = dask_cluster(stack, 3)
        said, code = on_cluster(place, "worker-lost", "dask", where, workers[1].kill)
        assert (code, said.count("ok: ") + said.count("kept: "), said.count("\n")) == (0, 6, 6), said
        assert workers[1].poll() is not None
        said, code = on_cluster(place, "scheduler-lost", "dask", where, scheduler.kill)
        assert code == 2, said
        *lines, last = said.splitlines()
        gone = f"clothbench: executor: found no scheduler any more at {where}; finished cells are kept, run the same"
        assert last == f"{gone} command again when there is one"
        assert len(lines) < 6
        assert all("ok: " in line for line in lines), said
        kept = {path.name for path in place.glob("scheduler-lost/cells/[0-9a-f]*")}
        assert kept
        said, code = on_cluster(place, "scheduler-lost", "dask", dask_cluster(stack, 2)[0])
        assert (code, said.count("ok: ")) == (0, 6 - said.count("kept: ")), said
        assert said.count("kept: ") >= max(1, len(lines))
        assert kept <= {path.name for path in place.glob("scheduler-lost/cells/[0-9a-f]*")}
    assert tables(place / "scheduler-lost") == tables(place / "worker-lost")


def test_an_address_without_a_scheduler_is_one_line(monkeypatch):
    needs("distributed")
    from clothbench.engine.executors import dask

    monkeypatch.setattr(dask, "CONNECT", 0.2)
    with pytest.raises(
        ClothbenchError, match=r"found no Dask scheduler there \(.*\), expected tcp://HOST:PORT"
    ) as said:
        dask.DaskWorkers({"address": "tcp://127.0.0.1:9", "wait": 1.0}, 0, 1)
    assert "\n" not in str(said.value)


def test_submitit_on_this_machine(place, here):
    needs("submitit")
    done, told = run_in(place, "slurm", "optimizer=ga", "executor=slurm", "executor.cluster=local")
    assert done == {"ga": "ok"}
    assert told == {("ga", True)}
    found = tables(place / "slurm")
    assert len(found) == len(here) / 2
    assert found.items() <= here.items()
    assert not (place / "slurm" / "slurm").exists()  # jobs that ended well leave nothing


def test_what_slurm_is_told(monkeypatch, tmp_path):
    """As submitit writes it; here is no Slurm to send it to."""
    needs("submitit")
    from submitit.slurm import slurm

    from clothbench.engine.executors.slurm import SlurmWorkers

    monkeypatch.setattr("shutil.which", lambda name: f"/bin/{name}")
    stated = {"partition": "cpu", "cores": 4, "memory": 8, "minutes": 240, "parameters": {"slurm_account": "textiles"}}
    workers = SlurmWorkers(executor_settings({"name": "slurm", **stated}), 50, 200, tmp_path)
    assert workers.room() == 200  # all are begun at once, as one array of which so many run at a time
    text = slurm._make_sbatch_string("X", tmp_path, map_count=200, **workers.executor._executor.parameters)
    for line in ("partition=cpu", "cpus-per-task=4", "mem=8GB", "time=240", "account=textiles", "array=0-199%50"):
        assert f"#SBATCH --{line}\n" in text
    bad = executor_settings({"name": "slurm", "parameters": {"colour": "red"}})
    with pytest.raises(ClothbenchError, match=r"executor slurm: .*colour.*; try it with executor\.cluster=local"):
        SlurmWorkers(bad, 0, 1, tmp_path)


@pytest.mark.slow
def test_ray_on_this_machine(place, here):
    needs("ray")
    done, told = run_in(place, "ray", BOTH, "executor=ray", "jobs=2")
    assert done == OK
    assert told == {("ga", True), ("nelder_mead", True)}
    assert tables(place / "ray") == here


def ray_node(stack, *words):
    """A head or another node of a Ray cluster as a process of its own, whose helpers end with it and the test."""
    process = subprocess.Popen(
        [Path(sys.executable).with_name("ray"), "start", *words, "--num-cpus", "1", "--node-ip-address", "127.0.0.1",
         "--disable-usage-stats", "--block"],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip

    def end():
        with contextlib.suppress(ProcessLookupError):  # it was killed
            os.killpg(process.pid, signal.SIGTERM)
        process.wait()

    stack.callback(end)
    return process


@pytest.mark.slow
def test_a_ray_cluster_loses_a_node(place, monkeypatch):
    """A head and two nodes as processes of their own on the loopback address; a node takes a try of its cell along."""
    needs("ray")
    monkeypatch.setenv("RAY_AUTH_MODE", "disabled")
    with contextlib.ExitStack() as stack:
        port = free_port()
        where = f"127.0.0.1:{port}"
        ray_node(stack, "--head", "--port", str(port), "--include-dashboard", "false")
        nodes = [ray_node(stack, "--address", where) for _ in range(2)]
        said, code = on_cluster(place, "node-lost", "ray", where, lambda: os.killpg(nodes[1].pid, signal.SIGKILL))
        assert (code, said.count("ok: ") + said.count("kept: "), said.count("\n")) == (0, 6, 6), said
        assert nodes[1].wait(10) != 0
    run_in(place, "node-kept", "optimizer=[ga,annealing,cma_es]", "metric=[node_error,relative_error]", "budget=200")
    assert tables(place / "node-lost") == tables(place / "node-kept")


def test_an_executor_that_does_not_exist_is_one_line():
    with pytest.raises(ClothbenchError, match="executor/spark") as said:
        composed(["executor=spark"])
    assert "\n" not in str(said.value)


def test_improve_takes_jobs_for_an_executor_only():
    with pytest.raises(ClothbenchError, match="setting 'jobs' is for the workers of an executor"):
        command(["recordings=here", "model=mass_spring", "jobs=2"])
