"""What goes to a worker and what comes back, whichever engine carries it."""

from __future__ import annotations

import functools
import os
import socket
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import psutil

from clothbench.core.errors import ENDS, ClothbenchError
from clothbench.engine.cells import plugin_versions
from clothbench.plugins.discovery import catalogue, one_line

SELDOM = 0.5  # s, between two words of a worker on how far it is

Tell = Callable[[int, float], None]  # steps done so far, and the value that they have come to
_one_at_a_time = threading.Lock()


class Work(Protocol):
    """Plain data that says what is to be done; called by a worker, with the number of threads that it may use."""

    def __call__(self, tell: Tell, threads: int) -> Any: ...


@dataclass(frozen=True)
class Answer:
    """What came of a work; or `fault`, one line, which is no fault of its own, so that no other would fare better."""

    value: Any = None
    fault: str | None = None


@dataclass(frozen=True)
class Died:
    """The worker has gone, and with it what it was at."""

    reason: str


class Workers(Protocol):
    """The workers of an engine. Works go by a number; each is begun at once or waits with the engine."""

    def room(self) -> int:
        """How many more works they take now."""
        ...

    def begin(self, works: Mapping[int, Work]) -> None: ...

    def ended(self, seconds: float) -> Iterable[tuple[int, Answer | Died]]:
        """What has ended since it was last asked, as soon as something has, or after so many seconds."""
        ...

    def told(self) -> Iterable[tuple[int, int, float]]:
        """(number, steps, value) of works that said how far they are since it was last asked."""
        ...

    def close(self) -> None:
        """Give up what has not ended, and every process that was begun for it."""
        ...


def start_of(pid: int) -> float:
    """When a process began [s]: what tells it from a later one of the same number, whatever is done to the clock."""
    if not psutil.LINUX:
        return psutil.Process(pid).create_time()
    # Linux counts from when the machine was started, and psutil adds that time, which moves with the clock. It is asked
    # for first, since older psutil adds what it was last asked for.
    started = psutil.boot_time()
    return round(psutil.Process(pid).create_time() - started, 2)


@dataclass(frozen=True)
class Owner:
    """A command whose workers are of this machine, and are to end with it, however it ends."""

    pid: int = field(default_factory=os.getpid)
    began: float = field(default_factory=lambda: start_of(os.getpid()))

    @property
    def lives(self) -> bool:
        try:
            return start_of(self.pid) == self.began and psutil.Process(self.pid).status() != psutil.STATUS_ZOMBIE
        except psutil.NoSuchProcess:
            return False


@functools.cache
def end_with(owner: Owner) -> None:
    """In a worker: end as soon as the command has been killed, not when the work is done."""

    def watch() -> None:
        while owner.lives:
            time.sleep(SELDOM)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def attended(work: Work, tell: Tell, threads: int, owner: Owner | None) -> Answer:
    """In a worker: do a work, one at a time in each process. owner: of the worker, if that is of the same machine.

    Linear algebra keeps to one thread as it does in the command, whatever the worker was started with: its sums, and so
    all bits that come of them, depend on that.
    """
    from threadpoolctl import threadpool_limits

    if owner is not None:
        end_with(owner)
    with _one_at_a_time, threadpool_limits(1):
        try:
            return Answer(work(seldom(tell), threads))
        except ClothbenchError as fault:
            return Answer(fault=str(fault))
        except ENDS:
            raise
        except BaseException as fault:  # a plugin must not end a worker, by sys.exit or otherwise
            return Answer(fault=f"worker on {socket.gethostname()}: {one_line(fault)}")


def seldom(tell: Tell) -> Tell:
    """Tells no more than one thing in `SELDOM` seconds: what is told crosses a network."""
    last = -SELDOM

    def told(steps: int, value: float) -> None:
        nonlocal last
        if (now := time.monotonic()) - last >= SELDOM:
            last = now
            tell(int(steps), float(value))

    return told


def other_versions(wanted: Mapping[str, str]) -> str | None:
    """Why this worker's plugins are not those of the command; None where they are the same."""
    for name, version in wanted.items():
        kind, _, plugin = name.partition("/")
        try:
            found = plugin_versions([(kind, plugin)], catalogue())[name]
        except ClothbenchError:
            found = "none"
        if found != version:
            return f"worker on {socket.gethostname()}: found {name} {found}, expected {version}; install the same there"
    return None
