"""What a run shows while it lasts: cells done of those planned, what each of them is at, and the time left."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from clothbench.core.progress import FileProgress
from clothbench.display.names import duration
from clothbench.engine.study import Cell

Moment = tuple[float, float]  # s of `time.monotonic()`, and how many jobs were done then
ROUNDING = 1e-9  # of a job, by which sums of shares may differ


@dataclass
class Sweep:
    """Where a sweep stands. jobs: how many there are, 0 if that is not known; done: of those that had something to run;
    passed: of those that were begun, this one included; first: when its pace is reckoned from, and how much was done.

    What came before that tells nothing of the rest: kernels are compiled then, once for all cells.
    """

    jobs: int = 0
    done: int = 0
    passed: int = 0
    first: Moment | None = None

    @property
    def name(self) -> str:
        """ "job 3 of 8" """
        return f"job {self.passed} of {self.jobs}" if self.jobs else f"job {self.passed}"

    def left(self, share: float, least: float = 0.0, anew: bool = False) -> float | None:
        """Seconds until its end, with such a share of this job done; None if nobody can know, as before more than none
        and `least` of a job was done at the pace. anew: whether that is reckoned from now on, not from the first time.
        """
        if not self.jobs:
            return None
        now = (time.monotonic(), self.done + share)
        if self.first is None or anew:
            self.first = now
        took, more = now[0] - self.first[0], now[1] - self.first[1]
        return took * (self.jobs - self.passed + 1 - share) / more if more > max(least - ROUNDING, 0.0) else None


class CellBar:
    """Bars on standard error, one for all cells and one for each that is at work; where that is no terminal, one line
    per finished cell instead. With one cell there is one bar, which counts what the cell counts. sweep: of whose jobs
    this is one; at_once: how many cells run side by side, at most.
    """

    def __init__(self, cells: Sequence[Cell], sweep: Sweep | None = None, at_once: int = 1):
        self.total, self.count, self.kept, self.sweep, self.at_once = len(cells), 0, 0, sweep, at_once
        self.pace = sweep or Sweep(jobs=1, passed=1)
        self.shares: dict[str, float] = {}  # of each cell at work that has told it, how much of it is done
        self.silent = True  # whether none has
        self.rows: dict[str, TaskID] = {}
        console = Console(stderr=True)
        self.live = console.is_terminal
        self.bar = Progress(
            TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
            TextColumn("{task.fields[left]}"), TextColumn("{task.fields[note]}"),
            console=console, disable=not self.live,
        )  # fmt: skip
        self.single = cells[0] if len(cells) == 1 else None
        word = self.single.counts if self.single else "cells"
        self.whole = self.bar.add_task(
            f"{sweep.name} · {word}" if sweep else word, total=self.single.budget if self.single else self.total,
            left="", note=self.single.label if self.single else "",
        )  # fmt: skip

    def __enter__(self) -> CellBar:
        self.bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.bar.stop()

    def tell(self, cell: Cell, steps: int, value: float) -> None:
        """Word from inside a cell: so many evaluations, the best value so far; or simulations, and the last value."""
        anew = bool(cell.budget) and cell.key not in self.shares and self.count == self.kept and not self.pace.done
        if cell.budget:
            self.shares[cell.key], self.silent = min(steps / cell.budget, 1.0), False
        note, left = f"{cell.value_word} {value:.4g}", self._left(anew)
        if self.single:
            self.bar.update(self.whole, completed=steps, note=f"{note} · {cell.label}", left=left)
            return
        if cell.key not in self.rows:
            self.rows[cell.key] = self.bar.add_task(f"  {cell.label}", total=cell.budget, left=cell.counts, note="")
        self.bar.update(self.rows[cell.key], completed=steps, note=note)
        self.bar.update(self.whole, left=left)

    def done(self, cell: Cell, status: str) -> None:
        """A cell has ended, with this status, or was "kept" from an earlier run."""
        self.count += 1
        self.kept += status == "kept"
        self.shares.pop(cell.key, None)
        if (row := self.rows.pop(cell.key, None)) is not None:
            self.bar.remove_task(row)
        note, left = f"{status}: {cell.label}", "" if status == "kept" else self._left()
        completed = self.single.budget if self.single else self.count
        self.bar.update(self.whole, completed=completed, note=note, left=left)
        if not self.live:
            where = f"{self.sweep.name} " if self.sweep else ""
            print(f"{where}[{self.count}/{self.total}] {note}{f' ({left})' if left else ''}", file=sys.stderr)
        if self.sweep and self.count == self.total:
            self.sweep.done += self.kept < self.total

    def _left(self, anew: bool = False) -> str:
        """ "about 4 min 10 s left": of the sweep, or of this run. anew: whether a cell has told how far it is for the
        first time, before any has ended: how far it had come until then, others ahead of it, is no pace.

        Cells that tell nothing end in groups, as many as run side by side: a part of a group is no pace either.
        """
        asked = self.total - self.kept
        done = self.count - self.kept + sum(self.shares.values())
        if not asked:
            return ""
        rest = self.pace.left(done / asked, min(self.at_once, asked) / asked if self.silent else 0.0, anew)
        return f"about {duration(rest)} left" if rest else ""


@contextmanager
def counting(what: str) -> Iterator[FileProgress]:
    """A bar on standard error for work that counts itself: gives `told(done, planned, name)`."""
    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[name]}"),
    )
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task(what, total=None, name="")
        yield lambda done, planned, name: bar.update(task, completed=done, total=planned, name=name)
