"""The progress bar of a run: cells done of those planned, the time left, and what is being searched."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from clothbench.core.progress import FileProgress
from clothbench.engine.study import Cell


class CellBar:
    """A bar on standard error; where that is no terminal, one line per finished cell instead."""

    def __init__(self, cells: Sequence[Cell]):
        self.total, self.count = len(cells), 0
        console = Console(stderr=True)
        self.live = console.is_terminal
        self.bar = Progress(
            TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
            TextColumn("left"), TimeRemainingColumn(), TextColumn("{task.fields[note]}"),
            console=console, disable=not self.live,
        )  # fmt: skip
        # With one cell the bar counts its evaluations or simulations, which is what there is to wait for.
        self.single = cells[0] if len(cells) == 1 else None
        steps = self.single.budget if self.single else self.total
        self.task = self.bar.add_task(self.single.counts if self.single else "cells", total=steps, note="")

    def __enter__(self) -> CellBar:
        self.bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.bar.stop()

    def tell(self, cell: Cell, evaluations: int, best: float) -> None:
        """Word from inside a cell: so many evaluations, the best value so far; or simulations, and the last value."""
        note = f"{cell.value_word} {best:.4g}"
        if self.single:
            self.bar.update(self.task, completed=evaluations, note=note)
        else:
            self.bar.update(self.task, note=f"{cell.label}: {evaluations} {cell.counts}, {note}")

    def done(self, cell: Cell, status: str) -> None:
        self.count += 1
        note = f"{status}: {cell.label}"
        self.bar.update(self.task, completed=self.single.budget if self.single else self.count, note=note)
        if not self.live:
            print(f"[{self.count}/{self.total}] {note}", file=sys.stderr)


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
