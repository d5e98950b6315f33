"""Leases: which cells another live command is at. They are advice and never more: what they save is work done twice.

RUNS/leases/KEY    host and process of the command that is at a cell; gone when it is done with it

In the mirror of a bucket they tell commands of this machine from each other; those of others by leases in the bucket
(`clothbench.engine.bucket_leases`).

A cell that is leased elsewhere is put to the end. Whoever has nothing else left waits for as long as others finish
theirs. A lease only says that a command lives, not that it gets on; so where nothing is finished for a while, one of
their cells is computed here, too, and after as long again the next. What is published first stays, as ever.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Generic, TypeVar

import psutil

from clothbench.core.errors import ClothbenchError
from clothbench.core.files import read_json
from clothbench.engine.bucket_leases import BucketLeases
from clothbench.engine.executors.work import Owner
from clothbench.engine.mirror import pull_result
from clothbench.engine.store import Store

LEASES = "leases"
KEPT = "kept"  # what is said of a cell that was finished by an earlier run, or is by another command
RENEW = 15.0  # s between two signs of life of a command
STALE = 60.0  # s without one, after which it counts as gone
PATIENCE = 60.0  # s in which others finish no cell, after which a command with nothing else left begins one of theirs
LOOK = 0.5  # s between two looks at what others are at

# What reading a lease may raise that is just being written, or is none.
UNREADABLE = (OSError, ClothbenchError, psutil.Error, KeyError, TypeError, ValueError, OverflowError)

T = TypeVar("T")


class Leases:
    """The leases that a command holds in a folder. Whatever goes wrong with one, the cell is run."""

    def __init__(self, store: Store):
        self.store, self.folder = store, store.folder / LEASES
        self.mine = json.dumps({"host": socket.gethostname(), **vars(Owner())})
        self.held: set[str] = set()
        self.shared = BucketLeases(store.bucket, self.mine) if store.bucket is not None else None
        self._ended = threading.Event()

    def __enter__(self) -> Leases:
        threading.Thread(target=self._renew, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        for key in [*self.held, *(self.shared.held if self.shared is not None else ())]:
            self.give_back(key)
        with contextlib.suppress(OSError):  # others are at work
            self.folder.rmdir()

    def take(self, key: str) -> bool:
        """Take the lease of a cell; False if another live command has it. If the bucket has a result of it by now, that
        is brought here.
        """
        if key in self.held:  # and the cell is tried again
            return True
        if not self._take_here(key):
            return False
        if self.shared is not None:
            if not self.shared.take(key):
                self.give_back(key)
                return False
            with contextlib.suppress(ClothbenchError, OSError):
                pull_result(self.store, key)
        return True

    def _take_here(self, key: str) -> bool:
        with contextlib.suppress(OSError):
            for _ in range(2):
                try:
                    with (self.folder / key).open("x") as file:
                        file.write(self.mine)
                    self.held.add(key)
                    return True
                except FileNotFoundError:
                    self.folder.mkdir(parents=True, exist_ok=True)
                except FileExistsError:
                    if live(self.folder / key):
                        return False
                    self._clear(key)
        return True

    def _clear(self, key: str) -> None:
        """Delete the lease of a command that has gone, here and in the bucket."""
        if self.shared is not None:
            self.shared.clear(key, (self.folder / key).read_text(errors="replace"))
        (self.folder / key).unlink(missing_ok=True)

    def give_back(self, key: str) -> None:
        if key in self.held:
            self.held.discard(key)
            with contextlib.suppress(OSError):
                (self.folder / key).unlink(missing_ok=True)
        if self.shared is not None:
            self.shared.give_back(key)

    def _renew(self) -> None:
        while not self._ended.wait(RENEW):
            for key in list(self.held):
                with contextlib.suppress(OSError):
                    os.utime(self.folder / key)
            if self.shared is not None:
                self.shared.renew()


class Line(Generic[T]):
    """Cells that wait to be begun, in their order, those that others are at last. taken: told of each that somebody
    else has finished meanwhile.
    """

    def __init__(self, cells: Iterable[T], leases: Leases, key: Callable[[T], str], taken: Callable[[T], None]):
        self.waiting, self.elsewhere = deque(cells), deque[T]()
        self.leases, self.key, self.taken = leases, key, taken
        self._looked = self._idle = -math.inf

    def __bool__(self) -> bool:
        return bool(self.waiting or self.elsewhere)

    def begin(self) -> T | None:
        """The next one to begin, its lease taken; None if there is none, or if others are at all that is left."""
        while self.waiting:
            cell = self.waiting.popleft()
            if not self.leases.take(self.key(cell)):
                self.elsewhere.append(cell)
            elif not self._finished(cell):
                self._idle = -math.inf
                return cell
        return self._left()

    def again(self, cell: T) -> None:
        """To be begun once more, before all others."""
        self.waiting.appendleft(cell)

    def _left(self) -> T | None:
        """One of those that others are at, if they have given it back, or do not come to an end with any of them.

        Of the latter it is one at a time, and the last: an engine with a queue holds leases of cells that it has yet to
        begin, and goes through them in order.
        """
        now = time.monotonic()
        if now - self._looked < LOOK:
            return None
        self._looked, self._idle = now, self._idle if self._idle > -math.inf else now
        for _ in range(len(self.elsewhere)):
            cell = self.elsewhere.popleft()
            if self._finished(cell):
                self._idle = now
            elif self.leases.take(self.key(cell)):
                if not self._finished(cell):  # it was, between the two
                    self._looked = -math.inf
                    return cell
            else:
                self.elsewhere.append(cell)
        if self.elsewhere and now - self._idle > PATIENCE:
            self._idle = now
            return self.elsewhere.pop()
        return None

    def _finished(self, cell: T) -> bool:
        """Whether there is a result of it by now; its lease is given back then."""
        key = self.key(cell)
        if not (self.leases.store.cell(key).exists() and self.leases.store.has(key)):
            return False
        self.leases.give_back(key)
        self.taken(cell)
        return True


def live(lease: Path) -> bool:
    """Whether the command that holds a lease has lately given a sign of life; that of one of this machine has to be a
    process that lives.
    """
    try:
        if abs(time.time() - lease.stat().st_mtime) > STALE:
            return False
        held = read_json(lease, "a lease")
        return held["host"] != socket.gethostname() or Owner(int(held["pid"]), float(held["began"])).lives
    except FileNotFoundError:
        return False
    except UNREADABLE:
        return True
