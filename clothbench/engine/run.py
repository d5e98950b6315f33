"""One cell: whatever goes wrong in it is its own row, with the reason."""

from __future__ import annotations

import os
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from clothbench.core.errors import ENDS, ClothbenchError
from clothbench.core.parallel import set_thread_count
from clothbench.core.progress import StageProgress
from clothbench.engine.cells import Skipped
from clothbench.engine.checkpoint import Unwritable, cannot_be_written
from clothbench.engine.rows import failure
from clothbench.engine.store import JOURNAL, Store
from clothbench.engine.study import Cell, Context, Elsewhere, Result, Study
from clothbench.plugins.discovery import catalogue, one_line

TRACEBACK = "traceback.txt"
TRACKED = "tracked"  # folder of recordings that trackers made of images, which all cells of a store share
CellProgress = Callable[[Cell, int, float], None]


def run_cell(
    cell: Cell, out: Path, *, threads: int = 0, rerun: bool = False, progress: CellProgress | None = None,
    stage: StageProgress = lambda name, done, planned: None, elsewhere: Elsewhere | None = None,
) -> str:  # fmt: skip
    """Let its study run one cell, store the result, and return its status. elsewhere: workers, see `Context`."""
    set_thread_count(threads)
    store, plugins = Store(out), catalogue()

    def told(steps: int, value: float) -> None:
        if progress is not None:
            progress(cell, steps, value)

    context = Context(plugins, store.folder / JOURNAL / cell.key, told, stage, rerun, store.folder / TRACKED, elsewhere)
    try:
        study: Study = plugins.load("studies", cell.study)
        result = _in_this_process(study, cell, context)
        context.checkpoint.require_kept()
        keep(store, cell, result, study)
        context.checkpoint.forget()
    except Skipped as reason:
        result = failure(cell, "skipped", str(reason))
        keep(store, cell, result)
    except Unwritable:  # what cannot be kept is no result, not of this cell and not of those that come after it
        raise
    except ClothbenchError as fault:  # says itself what is wrong; where in the program it came up helps nobody
        result = failure(cell, "error", str(fault))
        keep(store, cell, result)
    except ENDS:
        raise
    except BaseException as fault:
        result = failed_with(cell, one_line(fault), traceback.format_exc())
        keep(store, cell, result)
    return result.status


def _in_this_process(study: Study, cell: Cell, context: Context) -> Result:
    """What came of a cell. A process that a plugin has forked on the way, and that comes back here, ends: one of them
    tells of the cell, and takes the next one.
    """
    mine = os.getpid()
    try:
        return study.run(cell, context)
    finally:
        if os.getpid() != mine:
            os._exit(0)


def failed_with(cell: Cell, reason: str, detail: str = "") -> Result:
    """An error's row, with its traceback beside it."""
    found = failure(cell, "error", reason)
    return Result("error", found.tables, lambda folder: _write(folder, detail)) if detail else found


def _write(folder: Path, detail: str) -> None:
    (folder / TRACEBACK).write_text(detail)


def keep(store: Store, cell: Cell, result: Result, study: Study | None = None) -> None:
    with writing(store, cell):
        store.put(cell.key, result.tables, result.attach, study.tables if study else {})


# What an `attach` raises that looks for a file of its own where there is none: its cell's fault alone.
OF_A_FILE = (FileNotFoundError, FileExistsError, IsADirectoryError, NotADirectoryError)


@contextmanager
def writing(store: Store, cell: Cell) -> Iterator[None]:
    """Says what to do when a cell cannot be written."""
    try:
        yield
    except OSError as fault:
        kind = ClothbenchError if isinstance(fault, OF_A_FILE) else Unwritable
        raise kind(cannot_be_written(store.cell(cell.key), fault)) from fault
