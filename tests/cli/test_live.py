"""What a run shows while it lasts: on a terminal, and on the page that is watched."""

import os
import pty
import re
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

import pytest

from clothbench.engine.progress import CellBar, Sweep

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


@pytest.fixture
def clock(monkeypatch) -> list[float]:
    """The time [s] that progress is told, as its one element."""
    now = [0.0]
    monkeypatch.setattr("clothbench.engine.progress.time", SimpleNamespace(monotonic=lambda: now[0]))
    return now


def made_up(count: int, budget: int | None) -> list[SimpleNamespace]:
    """Cells as progress sees them."""
    return [
        SimpleNamespace(key=str(k), label=f"cell {k}", budget=budget, counts="evaluations", value_word="best")
        for k in range(count)
    ]


def test_what_is_left_is_reckoned_without_what_is_compiled_first(clock, capsys):
    """Each cell takes 10 s for 100 evaluations, told in tenths; before the first, 60 s went into compiling."""
    cells = made_up(5, budget=100)
    with CellBar(cells) as bar:
        bar.done(cells[0], "kept")
        clock[0] = 60.0
        for cell in cells[1:]:
            for tenth in range(1, 11):
                clock[0] += 1.0
                bar.tell(cell, 10 * tenth, 1.0)
            bar.done(cell, "ok")
    said = capsys.readouterr().err.splitlines()
    assert said == [
        "[1/5] kept: cell 0", "[2/5] ok: cell 1 (about 30 s left)", "[3/5] ok: cell 2 (about 20 s left)",
        "[4/5] ok: cell 3 (about 10 s left)", "[5/5] ok: cell 4",
    ]  # fmt: skip


def test_of_cells_that_say_nothing_the_second_is_the_first_to_tell_what_is_left(clock, capsys):
    """The first took 60 s longer than the others."""
    clock[0] = 60.0
    cells = made_up(3, budget=None)
    with CellBar(cells) as bar:
        for cell in cells:
            clock[0] += 10.0
            bar.done(cell, "ok")
    said = capsys.readouterr().err.splitlines()
    assert said == ["[1/3] ok: cell 0", "[2/3] ok: cell 1 (about 10 s left)", "[3/3] ok: cell 2"]


@pytest.mark.parametrize("sweep", [False, True])
def test_the_first_words_of_cells_side_by_side_are_no_pace(clock, sweep):
    """Of two workers each cell takes 10 s, told in tenths; it had been 8 s that are left when both had told a tenth."""
    clock[0] = 61.0
    cells = made_up(8, budget=100)
    with CellBar(cells, Sweep(jobs=1, passed=1) if sweep else None, at_once=2) as bar:
        left = []
        for tenth in range(1, 11):
            for cell, late in zip(cells, (0.0, 0.1), strict=False):
                clock[0] = 60.0 + tenth + late
                bar.tell(cell, 10 * tenth, 1.0)
            left.append(bar.bar.tasks[0].fields["left"])
        bar.done(cells[0], "ok")
        bar.tell(cells[2], 10, 1.0)  # of a cell after the first that ended, whose share was done at the pace
    assert left == ["", *(f"about {40 - tenth} s left" for tenth in range(2, 11))]
    assert bar.bar.tasks[0].fields["left"] == "about 28 s left"


def test_of_cells_side_by_side_that_say_nothing_as_many_have_to_end_as_run_at_once(clock, capsys):
    cells = made_up(6, budget=None)
    with CellBar(cells, at_once=2) as bar:
        for cell, clock[0] in zip(cells, (70.0, 71.0, 80.0, 81.0, 90.0, 91.0), strict=True):
            bar.done(cell, "ok")
    said = [line.partition("ok: ")[2] for line in capsys.readouterr().err.splitlines()]
    assert said == [
        "cell 0", "cell 1", "cell 2 (about 15 s left)", "cell 3 (about 7 s left)", "cell 4 (about 5 s left)", "cell 5",
    ]  # fmt: skip


def test_a_sweep_reckons_the_jobs_that_are_left_in_the_same_way(clock):
    clock[0], sweep = 60.0, Sweep(jobs=3, passed=1)
    assert sweep.left(0.1) is None
    clock[0] = 69.0
    assert sweep.left(1.0) == pytest.approx(20.0)
    sweep.done, sweep.passed, clock[0] = 1, 2, 75.0
    assert sweep.left(0.5) == pytest.approx(15 * 1.5 / 1.4)
    assert Sweep().left(0.5) is None  # nobody knows how many jobs there are


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
