"""A work in a child process of the worker: whatever it does there, the worker is left to tell of it, and to end it.

The child is kept for the works after it, as the processes of a run without an executor are.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any

import psutil

from clothbench.core.output import keep_on
from clothbench.engine.executors.work import SELDOM, Answer, Owner, Tell, Work, attended
from clothbench.engine.limits import Watch, end, end_forks
from clothbench.plugins.discovery import one_line

IDLE = 300.0  # s without a work, after which a child ends
TRIES = 2  # of a work whose child dies by itself
START = 120.0  # s that a child has to begin a work, before its limits count anyway
BEGUN, GONE = "begun", object()


class Ended(Exception):
    """A work went beyond a limit, or its processes died; the reason, in a line."""


def in_child(work: Work, name: str, tell: Tell, threads: int, watch: Watch) -> Answer:
    """Do a work in a child of this process. name: under which `watch` knows it. Raises `Ended`."""
    for _ in range(TRIES):
        if _kept and not _kept[0].lives:
            _kept.pop().close()
        if not _kept:
            _kept.append(_Child())
        child = _kept[0]
        try:
            answer = child.answer(work, name, tell, threads, watch)
        except BaseException:  # nobody waits for it any more
            _kept.pop().close()
            raise
        if answer is not None:
            return answer
        _kept.pop().close()
        if reason := watch.ended.get(name):
            raise Ended(reason)
    raise Ended(f"the process that ran this cell died ({child.last_word})")


_kept: list[_Child] = []  # the child of this process, if there is one; works come one at a time


class _Child:
    """A process that does works; they go in by one pipe, out of which words and answers come."""

    def __init__(self) -> None:
        self.folder = tempfile.TemporaryDirectory(prefix="clothbench-", ignore_cleanup_errors=True)
        paths = os.pathsep.join(path for path in sys.path if path)
        self.pipe, there = Pipe()
        with there:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "clothbench.engine.executors.child", str(there.fileno())],
                pass_fds=[there.fileno()], stdin=subprocess.DEVNULL, stdout=2,
                env={**os.environ, "PYTHONPATH": paths, "TMPDIR": self.folder.name},
            )  # fmt: skip

    @property
    def lives(self) -> bool:
        return self.process.poll() is None

    @property
    def last_word(self) -> str:
        return f"exit code {self.process.wait()}"

    def answer(self, work: Work, name: str, tell: Tell, threads: int, watch: Watch) -> Answer | None:
        """What came of a work; None if the process died, or was ended by `watch`."""
        with contextlib.suppress(ConnectionError):  # that it has gone is seen below
            self.pipe.send((work, threads, Owner()))
        word, began, sent = None, False, time.monotonic()
        looked = sent
        while (said := self._said()) is not GONE:
            if isinstance(said, Answer):
                return said
            if said == BEGUN:
                began = True
            elif said is not None:
                word = said
            if (now := time.monotonic()) - looked >= SELDOM:
                looked = now
                if began or now - sent > START:
                    watch.look({name: self.process.pid})
                if word is not None:
                    tell(*word)  # again and again: the engine says there that nobody waits for the work
        return None

    def _said(self) -> Any:
        """Its next word or its answer; None if it says nothing for a while, `GONE` if it has ended."""
        try:
            if self.pipe.poll(SELDOM):
                return self.pipe.recv()
        except (EOFError, ConnectionError):
            return GONE
        return None if self.lives else GONE  # a fork of it may still hold the pipe

    def close(self) -> None:
        """End it and all that it has started."""
        with contextlib.suppress(psutil.Error):
            end(self.process.pid)
        self.process.kill()
        self.process.wait()
        self.pipe.close()
        self.folder.cleanup()


# --- in the child ----------------------------------------------------------------------------------------------------


def main(handle: int) -> None:
    """Do works until nobody has any more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of Ctrl+C the command hears
    keep_on()
    mine = os.getpid()
    with Connection(handle) as pipe:

        def tell(steps: int, value: float) -> None:
            if os.getpid() == mine:
                pipe.send((steps, value))

        while (asked := _next(pipe)) is not None:
            pipe.send(BEGUN)
            answer = asked if isinstance(asked, Answer) else attended(asked[0], tell, *asked[1:])
            end_forks()
            pipe.send(answer)


def _next(pipe: Connection) -> Any:
    """Work, threads and owner; the answer to a work that cannot be read here; None if nobody has any more."""
    try:
        return pipe.recv() if pipe.poll(IDLE) else None
    except EOFError:
        return None
    except Exception as fault:
        return Answer(fault=f"worker on {socket.gethostname()}: {one_line(fault)}; expected the same clothbench there")


if __name__ == "__main__":
    main(int(sys.argv[1]))
