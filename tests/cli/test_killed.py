"""What a killed process costs: its own cell, and nothing that was finished."""

import json
import os
import signal
import subprocess
import sys
import time

import psutil
import pytest

CELL = ("model=mass_spring", "optimizer=ga", "metric=node_error", "+options.mass_spring.resolution=5", "rerun=false")


def finished(folder) -> set[str]:
    return {p.parent.name for p in folder.glob("runs/cells/[0-9a-f]*/rows.parquet")}


def started(command, folder) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-m", "clothbench", *command], cwd=folder, start_new_session=True,
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip


def deadly_plugin(tmp_path):
    """A folder with an optimizer that kills its process outright, as a crash in compiled code does."""
    package = tmp_path / "site" / "deadly"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text(
        "from clothbench import Registration, hookimpl\n"
        "@hookimpl\n"
        "def clothbench_optimizers():\n"
        "    return [Registration('deadly', 'deadly.search:Deadly', 'kills its process')]\n"
    )
    (package / "search.py").write_text(
        "import os, signal\n"
        "class Deadly:\n"
        "    name, version, needs_residual = 'deadly', 1, False\n"
        "    def __init__(self, space, *, seed, budget):\n"
        "        os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    info = tmp_path / "site" / "deadly-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: deadly\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[clothbench]\ndeadly = deadly\n")
    return tmp_path / "site"


@pytest.mark.slow
def test_kill_9_in_mid_sweep_loses_only_the_running_cells(clothbench, recordings_folder, tmp_path):
    command = ["run", "-m", f"recordings={recordings_folder}", *CELL, "budget=120", "seed=range(0,8)"]
    running = started(command, tmp_path)
    deadline = time.monotonic() + 240
    while len(finished(tmp_path)) < 2 and time.monotonic() < deadline:
        time.sleep(0.05)
    os.killpg(running.pid, signal.SIGKILL)
    running.wait()
    kept = finished(tmp_path)
    assert 2 <= len(kept) < 8
    assert clothbench("store", "check", "runs").returncode == 0
    stamps = {key: (tmp_path / "runs" / "cells" / key / "rows.parquet").stat().st_mtime_ns for key in kept}
    out = clothbench(*command)
    assert out.returncode == 0, out.stderr
    assert out.stderr.count("kept:") == len(kept)
    assert stamps == {key: (tmp_path / "runs" / "cells" / key / "rows.parquet").stat().st_mtime_ns for key in kept}
    rows = json.loads(clothbench("leaderboard", "--json").stdout)
    assert len({r["key"] for r in rows}) == 8


MECHANICS = ["+suite=physical_validation", "model=mass_spring", "suite.tests=[cantilever]", "suite.meshes=[5,9]"]


@pytest.mark.parametrize("folder", ["cells", "journal"])
def test_a_full_disk_is_one_line_and_leaves_nothing_half_written(clothbench, recordings_folder, tmp_path, folder):
    """Files are limited to less than a table takes, or a batch; then they are not, and the run goes on where it stood.
    Mechanics keeps no journal.
    """
    resource = pytest.importorskip("resource", reason="only POSIX limits files")
    asked = MECHANICS if folder == "cells" else [f"recordings={recordings_folder}", *CELL, "budget=12"]
    command = ["run", *asked, "jobs=1"]
    full = subprocess.run(
        [sys.executable, "-m", "clothbench", *command], cwd=tmp_path, capture_output=True, text=True, check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (6000, 6000)),
    )  # fmt: skip
    assert full.returncode == 2
    assert full.stderr.startswith(f"clothbench: runs/{folder}/")
    assert "cannot be written (File too large)" in full.stderr
    assert full.stderr.count("\n") == 1
    assert [path for path in (tmp_path / "runs").rglob("*") if not path.is_dir()] == []
    assert finished(tmp_path) == set()
    assert clothbench(*command).returncode == 0
    assert len(finished(tmp_path)) == 1


def test_workers_do_not_outlive_the_command_that_was_killed(recordings_folder, tmp_path):
    command = ["run", f"recordings={recordings_folder}", *CELL, "budget=100000", "optimizer=[ga,annealing]"]
    running = started(command, tmp_path)
    deadline = time.monotonic() + 120
    while not list(tmp_path.glob("runs/journal/*")) and running.poll() is None and time.monotonic() < deadline:
        time.sleep(0.05)
    workers = psutil.Process(running.pid).children(recursive=True)
    assert len(workers) >= 2
    running.kill()
    running.wait()
    _, alive = psutil.wait_procs(workers, timeout=20)
    for worker in alive:
        worker.kill()
    assert not alive


@pytest.mark.slow
def test_a_worker_that_dies_spoils_its_own_cell_only(clothbench, recordings_folder, tmp_path):
    site = deadly_plugin(tmp_path)
    out = clothbench(
        "run", f"recordings={recordings_folder}", *CELL, "budget=40", "optimizer=[ga,deadly,least_squares]",
        PYTHONPATH=str(site),
    )  # fmt: skip
    assert out.returncode == 1, out.stderr
    rows = json.loads(clothbench("leaderboard", "--json").stdout)
    status = {r["optimizer"]: (r["status"], r["reason"]) for r in rows}
    assert status["ga"][0] == status["least_squares"][0] == "ok"
    assert status["deadly"][0] == "error"
    assert "process that ran this cell died" in status["deadly"][1]
