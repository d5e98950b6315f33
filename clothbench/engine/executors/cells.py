"""Cells as work: what a worker needs of a cell, and what it hands back."""

from __future__ import annotations

import functools
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from clothbench.core.errors import ClothbenchError
from clothbench.core.packed import Files, files_in
from clothbench.core.parallel import available_cores
from clothbench.engine.cells import Source, lie_here
from clothbench.engine.executors.child import Ended, in_child
from clothbench.engine.executors.drive import answers, opened
from clothbench.engine.executors.settings import of_this_machine
from clothbench.engine.executors.work import Answer, Died, Tell, Work, other_versions
from clothbench.engine.leases import KEPT, Leases, Line
from clothbench.engine.limits import Limits, Watch
from clothbench.engine.mirror import mirror_of, up_to_date
from clothbench.engine.rows import failure
from clothbench.engine.run import CellProgress, failed_with, keep, run_cell, writing
from clothbench.engine.store import JOURNAL, Store
from clothbench.engine.study import Cell

Places = Mapping[str, str | bytes]  # of recordings, by hash: where they lie, or what is in them


@dataclass(frozen=True)
class Finished:
    """What became of a cell. files: of its folder, where the worker does not write to the results folder itself."""

    status: str
    files: Files | None = None


@dataclass(frozen=True)
class CellWork:
    """A cell for a worker. out: the results folder, or the address of a bucket that the worker publishes in; None: it
    shares no folder, and sends back what it made.
    """

    cell: Cell
    recordings: Places
    out: Path | str | None
    rerun: bool

    def __call__(self, tell: Tell, threads: int) -> Finished:
        lie_here(placed(self.recordings))
        store = Store(self._folder())
        if reason := other_versions(self.cell.versions):
            return self.failed(reason)
        if self.out and store.has(self.cell.key):  # by another command, while this one was in a queue
            return Finished(KEPT)
        return self._finished(store, self._run(store, tell, threads))

    def failed(self, reason: str) -> Finished:
        """An error row in place of a result."""
        store, result = Store(self._folder()), failure(self.cell, "error", reason)
        keep(store, self.cell, result)
        return self._finished(store, result.status)

    def _finished(self, store: Store, status: str) -> Finished:
        return Finished(status, None if self.out else taken_out(store, self.cell.key))

    def _folder(self) -> Path:
        if isinstance(self.out, str):
            return mirror_of(self.out)
        return self.out or scratch() / "runs"

    def _run(self, store: Store, tell: Tell, threads: int) -> str:
        def told(_: Cell, steps: int, value: float) -> None:
            tell(steps, value)

        try:
            return run_cell(self.cell, store.folder, threads=threads, rerun=self.rerun, progress=told)
        except SystemExit as fault:
            result = failed_with(self.cell, f"it ended its process (exit code {fault.code})")
            keep(store, self.cell, result)
            return result.status


@dataclass(frozen=True)
class WithinLimits:
    """A cell that a worker runs in a child process, which it ends if the cell goes beyond its limits. together: how
    many cells share the memory of the worker's machine, as far as the command knows.
    """

    work: CellWork
    limits: Limits
    together: int

    def __call__(self, tell: Tell, threads: int) -> Finished:
        try:
            answer = in_child(self.work, self.work.cell.key, tell, threads, Watch(self.limits, self.together))
        except Ended as reason:
            return self.work.failed(str(reason))
        if answer.fault is not None:
            raise ClothbenchError(answer.fault)
        return answer.value


def run_cells_on(
    executor: Mapping[str, Any], cells: Sequence[Cell], out: Path, *, jobs: int, rerun: bool,
    done: Callable[[Cell, str], None], progress: CellProgress | None, limits: Limits, leases: Leases,
) -> None:  # fmt: skip
    """Run cells on the workers of an executor, `jobs` at a time (0: as many as it takes); `done(cell, status)` after.

    A cell whose worker dies is tried once more; if that dies, too, it becomes an error row. One that goes beyond its
    limits becomes one at once.
    """
    store, shared = Store(out.absolute()), executor["shared"]
    written = store.address if store.bucket is not None else store.folder if shared else None

    together = min(jobs or available_cores(), len(cells)) if of_this_machine(executor) else 1

    def work(number: int) -> Work:
        work = CellWork(cells[number], places(cells[number], shared), written, rerun)
        return WithinLimits(work, limits, together) if limits.stated else work

    def told(number: int, steps: int, value: float) -> None:
        if progress is not None:
            progress(cells[number], steps, value)

    def taken(number: int) -> None:
        done(cells[number], KEPT)

    line = Line(range(len(cells)), leases, lambda number: cells[number].key, taken)
    with opened(executor, jobs, len(cells), store.folder) as workers:
        for number, answer in answers(workers, work, line, told):
            status = concluded(store, cells[number], answer)
            leases.give_back(cells[number].key)
            done(cells[number], status)


def concluded(store: Store, cell: Cell, answer: Answer | Died) -> str:
    """Put what came of a cell in its place; its status."""
    if isinstance(answer, Answer):
        if answer.fault is not None:
            raise ClothbenchError(answer.fault)
        if answer.value.files is not None:
            with writing(store, cell):
                store.take(cell.key, answer.value.files)
        return answer.value.status
    # Its worker may have stored it, and died before it could say so.
    if (status := up_to_date(store).status(cell.key)) is not None:
        return status
    result = failed_with(cell, f"the process that ran this cell died twice ({answer.reason})")
    keep(store, cell, result)
    return result.status


# --- recordings, to a worker, and files of cells back ----------------------------------------------------------------


def sources_of(cell: Any) -> Iterator[Source]:
    """The recordings that a cell refers to by itself, or in a tuple."""
    for value in getattr(cell, "__dict__", {}).values():
        for one in value if isinstance(value, tuple) else (value,):
            if isinstance(one, Source):
                yield one


def places(cell: Cell, shared: bool) -> Places:
    """Where a worker finds the recordings of a cell; or what is in them."""
    files = {source.hash: Path(source.file) for source in sources_of(cell)}
    return {key: str(path.absolute()) if shared else path.read_bytes() for key, path in files.items()}


def placed(recordings: Places) -> dict[str, str]:
    """In a worker: where recordings lie, by hash; what was sent is put into files first."""
    return {key: value if isinstance(value, str) else str(_file(key, value)) for key, value in recordings.items()}


def _file(key: str, content: bytes) -> Path:
    path = scratch() / f"{key}.nc"
    if not path.is_file():
        path.write_bytes(content)
    return path


@functools.cache
def scratch() -> Path:
    """A folder of this process's own, which goes when it ends."""
    return Path(_scratch().name)


@functools.cache
def _scratch() -> tempfile.TemporaryDirectory:
    return tempfile.TemporaryDirectory(prefix="clothbench-")


def taken_out(store: Store, key: str) -> dict[str, bytes]:
    """The files of a cell, by their paths below its folder, which goes, and so does what it was made from."""
    files = files_in(store.cell(key))
    for gone in (store.cell(key), store.folder / JOURNAL / key):
        shutil.rmtree(gone, ignore_errors=True)
    return files
