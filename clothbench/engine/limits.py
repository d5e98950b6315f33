"""What a cell may take of time and memory, and who sees to it: the process that gives out the cells, or a cluster's
worker, from outside, since a plugin may sleep, fill the memory or fork, and then hears nobody.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import psutil

from clothbench.core.errors import ClothbenchError
from clothbench.engine.settings import known_words, mapping, number

GB = 1e9
SHARE = 0.9  # of the machine's memory that all cells at work together may have, where no limit is stated
LEAST = 1 * GB  # that every cell may have, then: one loads libraries of a third of that, most of it shared
CHILDREN = 8  # looks from one at the children of a process to the next: finding them is dear


@dataclass(frozen=True)
class Limits:
    """seconds: that a cell may take, None: as many as it wants; memory: bytes, None: its share of the machine."""

    seconds: float | None = None
    memory: float | None = None

    @classmethod
    def of(cls, given: Any) -> Limits:
        """From the setting `limits`; a wrong one raises a ClothbenchError."""
        stated = mapping("limits", given)
        known_words("setting of 'limits'", stated, {"seconds", "memory"})
        told = {name: number(f"limits.{name}", value, 0.0) for name, value in stated.items() if value is not None}
        if "memory" in told and told["memory"] * GB > 2**60:
            raise ClothbenchError(f"setting 'limits.memory' is {stated['memory']!r}, expected GB")
        return cls(told.get("seconds"), told["memory"] * GB if "memory" in told else None)

    @property
    def stated(self) -> bool:
        return self != Limits()


class Watch:
    """Ends the processes of cells that go beyond their limits. ended: why, by the cell's key."""

    def __init__(self, limits: Limits, workers: int):
        self.seconds = limits.seconds
        self.memory = limits.memory or max(LEAST, SHARE * psutil.virtual_memory().total / max(1, workers))
        self.ended: dict[str, str] = {}
        self._begun: dict[tuple[str, int], float] = {}
        self._looks = 0

    def look(self, pids: Mapping[str, int]) -> None:
        """Look at cells at work. pids: of the process that runs each, by the cell's key."""
        self._looks += 1
        for key, pid in pids.items():
            began = self._begun.setdefault((key, pid), time.monotonic())
            with contextlib.suppress(psutil.NoSuchProcess):
                if reason := self._beyond(psutil.Process(pid), time.monotonic() - began):
                    self.ended[key] = reason
                    end(pid)

    def _beyond(self, process: psutil.Process, took: float) -> str | None:
        if self.seconds is not None and took > self.seconds:
            return f"took more than {self.seconds:g} s, the limit (limits.seconds), and was ended"
        held = process.memory_info().rss
        if self._looks % CHILDREN == 0:
            held += sum(memory_of(child) for child in process.children(recursive=True))
        if held > self.memory:
            limit = f"the limit (limits.memory) is {self.memory / GB:.3g}"
            return f"held {held / GB:.3g} GB of memory, {limit}, and was ended"
        return None


def memory_of(process: psutil.Process) -> int:
    """Bytes that a process holds, 0 if it has gone."""
    try:
        return process.memory_info().rss
    except psutil.NoSuchProcess:
        return 0


def end(pid: int) -> None:
    """Kill a process and what it has started."""
    process = psutil.Process(pid)
    for one in [process, *process.children(recursive=True)]:
        with contextlib.suppress(psutil.NoSuchProcess):
            one.kill()


def end_forks() -> None:
    """End what the cell that has just been run here has forked. Programs that it started are another matter: a
    simulator may keep one for all cells.
    """
    me = psutil.Process(os.getpid())
    for child in me.children(recursive=True):
        with contextlib.suppress(psutil.NoSuchProcess):
            if child.cmdline() == me.cmdline():
                child.kill()
