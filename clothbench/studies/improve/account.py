"""The account of a run of the loop: which stage it is in, and what each one took."""

from __future__ import annotations

import time

from clothbench.core.progress import StageProgress


class Account:
    """Tells the caller which stage the loop is in, and adds up what each one takes: seconds and simulated sets."""

    def __init__(self, progress: StageProgress):
        self.progress = progress
        self.spent: dict[str, list] = {}
        self.now, self.since = "", time.perf_counter()

    def stage(self, name: str, done: int, planned: int) -> None:
        self.progress(name, done, planned)
        self.stop()
        self.now = name

    def stop(self) -> None:
        """The stage that runs is over, or goes on: its time so far counts."""
        now = time.perf_counter()
        if self.now:
            self._entry()[0] += now - self.since
        self.since = now

    def count(self, evaluations: int) -> None:
        """So many parameter sets were searched in the stage that runs, on all fit recordings each."""
        self._entry()[1] += evaluations

    def _entry(self) -> list:
        return self.spent.setdefault(self.now, [0.0, 0])

    @property
    def table(self) -> tuple[tuple[str, float, int], ...]:
        """(stage, s, evaluations) in the order in which they began."""
        return tuple((name, float(seconds), int(count)) for name, (seconds, count) in self.spent.items())

    @property
    def evaluations(self) -> int:
        return sum(count for _, _, count in self.table)
