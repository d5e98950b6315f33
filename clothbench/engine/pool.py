"""Many cells: which are missing, and how they share the cores without sharing their faults."""

from __future__ import annotations

import atexit
import functools
import os
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from pathlib import Path
from typing import Any, Literal

import numpy as np

from clothbench.core.output import keep_on
from clothbench.core.parallel import available_cores, share_cores
from clothbench.engine.executors.cells import run_cells_on
from clothbench.engine.executors.settings import LOCAL
from clothbench.engine.leases import KEPT, Leases, Line
from clothbench.engine.limits import Limits, Watch, end_forks
from clothbench.engine.run import CellProgress, failed_with, keep, run_cell
from clothbench.engine.store import Store
from clothbench.engine.study import Cell
from clothbench.plugins.discovery import OWN, catalogue

WATCH = 0.5  # s between two looks at whether the parent still lives, or at how far the cells are


def run_cells(
    cells: Sequence[Cell],
    out: Path,
    *,
    jobs: int = 0,
    rerun: bool = False,
    done: Callable[[Cell, str], None],
    progress: CellProgress | None = None,
    executor: Mapping[str, Any] | None = None,
    limits: Limits | None = None,
) -> None:
    """Run every cell that the store lacks, `jobs` processes at a time (0: one per core); `done(cell, status)` after.

    executor: as `executor_settings` has it, whose workers are to run them; None: processes of this machine.

    A single cell runs in this process with all cores; several run in a pool of processes that share the cores, anew
    whenever one of them has nothing more to do: the last cell has all of them. A cell of a stranger's plugins, or one
    with a limit, never runs in this process: whatever it does there, this one is left to tell of it.
    """
    store, limits = Store(out), limits or Limits()
    kept = store.finished(dict.fromkeys(c.key for c in cells))
    missing = [c for c in cells if c.key not in kept]
    if missing:
        store.require_create_only()
    for cell in cells:
        if cell.key in kept:
            done(cell, KEPT)
    if missing:
        with Leases(store) as leases:
            _run_missing(missing, out, jobs, rerun, done, progress, executor, limits, leases)


def _run_missing(
    cells: Sequence[Cell], out: Path, jobs: int, rerun: bool, done: Callable[[Cell, str], None],
    progress: CellProgress | None, executor: Mapping[str, Any] | None, limits: Limits, leases: Leases,
) -> None:  # fmt: skip
    workers = min(jobs or available_cores(), len(cells))
    here = not limits.stated and all(map(_of_our_own, cells))
    if executor and executor["name"] != LOCAL:
        run_cells_on(
            executor, cells, out, jobs=jobs, rerun=rerun, done=done, progress=progress, limits=limits, leases=leases
        )
        return
    one_by_one = here and (len(cells) == 1 or jobs == 1)
    order = cells if one_by_one else by_turns(cells)
    line = Line(order, leases, lambda cell: cell.key, lambda cell: done(cell, KEPT))

    def ended(cell: Cell, status: str) -> None:
        leases.give_back(cell.key)
        done(cell, status)

    if one_by_one:
        while line:
            if (cell := line.begin()) is not None:
                ended(cell, run_cell(cell, out, rerun=rerun, progress=progress))
            elif line:
                time.sleep(WATCH)
    else:
        _run_in_processes(cells, line, out, workers, rerun, ended, progress, limits)


def by_turns(cells: Sequence[Cell]) -> list[Cell]:
    """The cells, their models taking turns: cells that begin together compile what they are made of, each a model of
    its own then rather than all of them the same one.
    """
    before: Counter[str] = Counter()
    turn = []
    for cell in cells:
        turn.append(before[cell.model])
        before[cell.model] += 1
    return [cells[number] for number in sorted(range(len(cells)), key=turn.__getitem__)]


def _of_our_own(cell: Cell) -> bool:
    """Whether only built-in plugins have a part in a cell."""
    versions = [*cell.versions.values(), catalogue().find("studies", cell.study).distribution]
    return all(version.split(" ")[0] == OWN for version in versions)


def _run_in_processes(
    cells: Sequence[Cell], line: Line[Cell], out: Path, workers: int, rerun: bool, done: Callable[[Cell, str], None],
    progress: CellProgress | None, limits: Limits,
) -> None:  # fmt: skip
    """Keep `workers` processes busy. line: of the cells, those that wait to be begun.

    If one dies, the cells that were running are tried again, each alone: the one that kills its process a second
    time is the culprit and becomes an error row. One that was ended because it went beyond a limit becomes one at once.
    """
    from loky.process_executor import BrokenProcessPool

    running: dict[Future, Cell] = {}
    told, numbers = _told_file(len(cells)), {c.key: n for n, c in enumerate(cells)}
    running_now = _counter(_count_file())
    executor, watch = _pool(workers), Watch(limits, workers)
    try:
        while line or running:
            try:
                while len(running) < workers and (cell := line.begin()) is not None:
                    try:
                        running[executor.submit(_run_and_tell, cell, out, rerun, told, numbers[cell.key])] = cell
                    except BrokenProcessPool:
                        line.again(cell)
                        raise
                running_now[0] = len(running)
                for future in _first(running, told, numbers, progress, watch):
                    status = future.result()
                    done(running.pop(future), status)
            except BrokenProcessPool:
                suspects = list(running.values())
                running.clear()
                running_now[0] = 1
                for cell in suspects:
                    if cell.key in watch.ended:
                        done(cell, _failed(cell, out, watch.ended[cell.key]))
                    elif any(suspect.key in watch.ended for suspect in suspects) and not Store(out).has(cell.key):
                        line.again(cell)  # its process went down with another's that was ended
                    else:
                        done(cell, _run_alone(cell, out, rerun, told, numbers, watch))
                executor = _pool(workers)
    except BaseException:
        # Whoever stopped this command, or hears of a fault, is not to wait for cells that nobody waits for any more;
        # their leases are still held here.
        executor.shutdown(kill_workers=True)
        raise


def _first(
    running: Mapping[Future, Cell], told: Path, numbers: Mapping[str, int], progress: CellProgress | None, watch: Watch
) -> Iterable[Future]:
    """Those that have ended, as soon as one has; or none after a while. However often that is, `progress` hears how far
    the others are, and `watch` sees to it that they keep to their limits.
    """
    if not running:  # others are at all that is left
        time.sleep(WATCH)
    ended = wait(list(running), timeout=WATCH, return_when=FIRST_COMPLETED).done
    pids = {}
    for future, cell in running.items():
        if future in ended:
            continue
        steps, value, pid = _told(told, numbers[cell.key], "r")
        if steps > 0 and progress is not None:
            progress(cell, int(steps), float(value))
        if pid > 0:
            pids[cell.key] = int(pid)
    watch.look(pids)
    return ended


def _run_and_tell(cell: Cell, out: Path, rerun: bool, told: Path, number: int) -> str:
    """In a worker: run a cell, and leave word of how far it is for the process that asked for it."""
    mine = _told(told, number)
    mine[:] = 0, 0, os.getpid()

    def tell(_: Cell, steps: int, value: float) -> None:
        mine[:2] = steps, value

    try:
        return run_cell(cell, out, rerun=rerun, progress=tell)
    finally:
        mine[2] = 0  # what this process does from now on is another cell's
        end_forks()


def _told(path: Path, number: int, mode: Literal["r", "r+"] = "r+") -> np.memmap:
    """Steps, value and process (3,) of the cell of that number, as all processes see them."""
    return np.memmap(path, np.float64, mode, offset=24 * number, shape=3)


def _told_file(cells: int) -> Path:
    """Where workers leave word of their cells; a file, for the reason of `_count_file`."""
    path = _shared_file()
    np.memmap(path, np.float64, "w+", shape=3 * cells).flush()
    return path


def _run_alone(cell: Cell, out: Path, rerun: bool, told: Path, numbers: Mapping[str, int], watch: Watch) -> str:
    from loky.process_executor import BrokenProcessPool

    if (status := Store(out).status(cell.key)) is not None:  # it had finished just before its neighbour died
        return status
    executor = _pool(1)
    try:
        future = executor.submit(_run_and_tell, cell, out, rerun, told, numbers[cell.key])
        while not _first({future: cell}, told, numbers, None, watch):
            pass
        return future.result()
    except BrokenProcessPool as fault:
        reason = str(fault).strip().splitlines()[0] if str(fault).strip() else "no word from it"
        return _failed(cell, out, watch.ended.get(cell.key, f"the process that ran this cell died ({reason})"))
    except BaseException:
        executor.shutdown(kill_workers=True)
        raise


def _failed(cell: Cell, out: Path, reason: str) -> str:
    """Put an error in the store for a cell whose process could not; its status."""
    result = failed_with(cell, reason)
    keep(Store(out), cell, result)
    return result.status


def _pool(workers: int):
    from loky import get_reusable_executor

    return get_reusable_executor(
        max_workers=workers, timeout=300, kill_workers=True, initializer=_begin, initargs=(os.getpid(), _count_file())
    )


@functools.cache
def _count_file() -> Path:
    """Where this process tells its workers how many of them are at work; a file, since a worker may be killed at any
    time and must leave no lock behind.
    """
    path = _shared_file()
    np.memmap(path, np.int64, "w+", shape=1).flush()
    return path


def _shared_file() -> Path:
    """An empty file that goes when this process ends."""
    handle, name = tempfile.mkstemp(prefix="clothbench-")
    os.close(handle)
    atexit.register(Path(name).unlink, missing_ok=True)
    return Path(name)


def _counter(path: Path, mode: Literal["r", "r+"] = "r+") -> np.memmap:
    """The number of workers at work (1,), as all processes see it."""
    return np.memmap(path, np.int64, mode, shape=1)


def _begin(parent: int, count_file: Path) -> None:
    """In a worker, before its first cell. What plugins print goes to standard error: the other may be a document."""
    os.dup2(2, 1)
    keep_on()
    running_now = _counter(count_file, "r")
    share_cores(lambda: int(running_now[0]))
    _end_with(parent)


def _end_with(parent: int) -> None:
    """End as soon as the process that gives this one work has been killed, not when its cell is done."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def failed(statuses: Iterable[str]) -> bool:
    """Whether a run ends with exit code 1: a cell that was skipped for a stated reason is no failure."""
    return any(s in ("error", "diverged", "timeout") for s in statuses)
