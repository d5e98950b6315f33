"""What a run shows while it lasts: on a terminal, and on the page that is watched."""

import os
import pty
import re
import signal
import subprocess
import sys
import time

import pytest

CELL = ("model=mass_spring", "metric=node_error", "+options.mass_spring.resolution=5", "rerun=false")
WIDE = {"COLUMNS": "180", "LINES": "40", "TERM": "xterm"}


def on_a_terminal(folder, *arguments: str) -> str:
    """What the command says on standard error, if that is a terminal."""
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-m", "clothbench", *arguments], cwd=folder, stdout=subprocess.DEVNULL, stderr=theirs,
        env={**os.environ, **WIDE},
    )  # fmt: skip
    os.close(theirs)
    said = b""
    while True:
        try:
            part = os.read(ours, 65536)
        except OSError:  # so Linux says that the other end has been closed
            break
        if not part:
            break
        said += part
    os.close(ours)
    assert process.wait(timeout=60) == 0, said.decode()
    return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", said.decode())


@pytest.mark.slow
def test_cells_in_processes_of_their_own_say_how_far_they_are(recordings_folder, tmp_path):
    cells = ("optimizer=[ga,annealing]", "budget=400", "jobs=2")
    said = on_a_terminal(tmp_path, "run", f"recordings={recordings_folder}", *CELL, *cells)
    assert re.search(r"annealing[^\r\n]* \d+/400 [^\r\n]*evaluations best [\d.e-]+", said), said[-3000:]
    assert re.search(r"about \d+ (s|min \d+ s) left", said)
    assert "2/2" in said


def test_a_sweep_says_which_job_it_is_at(recordings_folder, tmp_path):
    jobs = ("optimizer=ga", "budget=60", "seed=1,2,3")
    said = on_a_terminal(tmp_path, "run", "-m", f"recordings={recordings_folder}", *CELL, *jobs)
    for number in (1, 2, 3):
        assert f"job {number} of 3 · evaluations" in said
    assert re.search(r"60/60 [^\r\n]* left [^\r\n]*best|\d+/60 [^\r\n]* left [^\r\n]*best", said)


def stopped(process: subprocess.Popen) -> int:
    process.send_signal(signal.SIGINT)
    return process.wait(timeout=60)


def test_a_watched_page_follows_the_run_and_ends_clean(clothbench, recordings_folder, tmp_path):
    page, beside = tmp_path / "runs" / "report.html", tmp_path / "runs" / "report.state.js"
    watching = subprocess.Popen(
        [sys.executable, "-m", "clothbench", "report", "--watch"], cwd=tmp_path, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    try:
        wait_for(lambda: beside.is_file() and "no results here yet" in page.read_text())
        first = beside.read_text()
        out = clothbench("run", f"recordings={recordings_folder}", *CELL, "optimizer=ga", "budget=20")
        assert out.returncode == 0, out.stderr
        wait_for(lambda: beside.read_text() != first)
        (state,) = re.findall(r'"(\w+)"', beside.read_text())
        wait_for(lambda: f'data-watched="{state}"' in page.read_text())  # also after the run has written its own
    finally:
        code = stopped(watching)
    said, told = watching.communicate()
    assert code == 0, told
    assert said.startswith("page: runs/report.html")
    assert "1 cells" in told or "1 cell" in told
    assert not beside.exists()
    assert "data-watched" not in page.read_text()


def test_a_watched_bucket_shows_what_another_machine_publishes(clothbench, s3, recordings_folder, tmp_path):
    watching = subprocess.Popen(
        [sys.executable, "-m", "clothbench", "report", "--watch", f"out={s3}"], cwd=tmp_path, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, env={**os.environ, "CLOTHBENCH_CACHE": "watcher"},
    )  # fmt: skip
    try:
        assert watching.stdout is not None
        page = tmp_path / watching.stdout.readline().removeprefix("page: ").partition("   (")[0]
        wait_for(lambda: page.is_file() and "no results here yet" in page.read_text())
        out = clothbench("run", f"recordings={recordings_folder}", *CELL, "optimizer=ga", "budget=20", f"out={s3}")
        assert out.returncode == 0, out.stderr
        wait_for(lambda: "no results here yet" not in page.read_text())
    finally:
        code = stopped(watching)
    _, told = watching.communicate()
    assert code == 0, told
    assert "1 cells" in told


def wait_for(condition, seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not come"
        time.sleep(0.1)
