"""Runs whose results go into an object store: the tables of a folder, whoever computes them, and found again."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time

import pytest
from test_killed import CELL, started
from test_two_commands import CELL as SHORT
from test_two_commands import EIGHT

from clothbench.engine.bucket import Bucket

RUN = ("recordings=recordings", *CELL, "budget=12", "optimizer=[ga]")


def rows_of(clothbench, out):
    told = clothbench("leaderboard", "--json", "--out", out)
    assert told.returncode == 0, told.stderr
    return [{**row, "wall_s": None} for row in json.loads(told.stdout)]


@pytest.mark.slow
def test_runs_in_a_bucket_are_those_in_a_folder_and_are_found_from_elsewhere(clothbench, s3, recordings_folder):
    assert clothbench("run", *RUN, "out=folder").returncode == 0
    expected = rows_of(clothbench, "folder")
    out = clothbench("run", *RUN, f"out={s3}")
    assert out.returncode == 0, out.stderr
    assert f"clothbench leaderboard --out {s3}" in out.stdout
    assert len(Bucket(s3).names("cells")) == 1
    assert Bucket(s3).names("errors") == []
    assert rows_of(clothbench, s3) == expected
    assert clothbench("compare", "folder", s3).returncode == 0
    elsewhere = clothbench("run", *RUN, f"out={s3}", CLOTHBENCH_CACHE="elsewhere")
    assert elsewhere.returncode == 0
    assert elsewhere.stderr.count("kept:") == 1
    assert clothbench("report", f"out={s3}").stdout.startswith("page: ")


def test_a_dask_worker_that_shares_nothing_publishes_by_itself(s3, recordings_folder, tmp_path, monkeypatch):
    """The worker has a cache of its own; the command finds in the bucket what it made."""
    pytest.importorskip("distributed", reason="distributed is not installed")
    import logging

    import distributed
    from test_cluster import run_in

    from clothbench.engine.mirror import pull, results_folder
    from clothbench.engine.store import Store

    monkeypatch.setenv("CLOTHBENCH_CACHE", str(tmp_path / "worker"))
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address=":0", silence_logs=logging.CRITICAL
    ) as cluster:
        monkeypatch.setenv("CLOTHBENCH_CACHE", str(tmp_path / "command"))
        out = results_folder(s3)
        where = f"executor.address={cluster.scheduler_address}"
        done, _ = run_in(tmp_path, out, "optimizer=ga", "executor=dask", where)
    assert done == {"ga": "ok"}
    store = Store(out)
    assert store.rows() == []
    assert pull(store) == {}
    assert [row["status"] for row in store.rows()] == ["ok"] * len(store.rows()) != []
    assert list((tmp_path / "worker").glob("stores/*/cells/*/rows.parquet"))


@pytest.mark.slow
def test_two_machines_in_one_bucket_compute_every_cell_once(s3, recordings_folder, tmp_path):
    words = [f"recordings={recordings_folder}", f"out={s3}", *SHORT, *EIGHT]
    both = [
        subprocess.Popen(
            [sys.executable, "-m", "clothbench", "run", *words], cwd=tmp_path, stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE, text=True, env={**os.environ, "CLOTHBENCH_CACHE": str(tmp_path / name)},
        )
        for name in ("one", "other")
    ]  # fmt: skip
    said = [process.communicate()[1] for process in both]
    assert [process.returncode for process in both] == [0, 0], said
    computed = [text.count("ok: ") for text in said]
    assert (min(computed) > 0, sum(computed)) == (True, 8), said
    assert [text.count("kept: ") for text in said] == [8 - count for count in computed]
    assert Bucket(s3).names("leases") == []


@pytest.mark.slow
def test_kill_9_in_mid_sweep_and_another_machine_goes_on(clothbench, s3, recordings_folder, tmp_path):
    command = ["run", "-m", f"recordings={recordings_folder}", *CELL, "budget=120", "seed=range(0,6)", f"out={s3}"]
    running = started(command, tmp_path)
    deadline = time.monotonic() + 240
    while len(Bucket(s3).names("cells")) < 2 and time.monotonic() < deadline:
        time.sleep(0.1)
    os.killpg(running.pid, signal.SIGKILL)
    running.wait()
    kept = Bucket(s3).names("cells")
    assert 2 <= len(kept) < 6
    out = clothbench(*command, CLOTHBENCH_CACHE="elsewhere")
    assert out.returncode == 0, out.stderr
    assert out.stderr.count("kept:") == len(kept)
    assert len(Bucket(s3).names("cells")) == 6
    assert clothbench("store", "check", s3).returncode == 0
