"""A work in a child process of the worker: whatever it does there, the worker is left to tell of it, and to end it.

The child is kept for the works after it, as the processes of a run without an executor are.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import queue
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from typing import IO, Any

from clothbench.engine.executors.work import SELDOM, Answer, Owner, Tell, Work, attended
from clothbench.engine.limits import Watch, end, end_forks
from clothbench.plugins.discovery import one_line

IDLE = 300.0  # s without a work, after which a child ends
TRIES = 2  # of a work whose child dies by itself


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
    """A process that does works; they go in by its standard input, and words and answers come out of its output."""

    def __init__(self) -> None:
        self.folder = tempfile.TemporaryDirectory(prefix="clothbench-", ignore_cleanup_errors=True)
        paths = os.pathsep.join(path for path in sys.path if path)
        self.process = subprocess.Popen(
            [sys.executable, "-m", "clothbench.engine.executors.child"], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": paths, "TMPDIR": self.folder.name},
        )  # fmt: skip
        self.said: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self.hearing = threading.Thread(target=self._hear, daemon=True)
        self.hearing.start()

    @property
    def lives(self) -> bool:
        return self.process.poll() is None

    @property
    def last_word(self) -> str:
        return f"exit code {self.process.wait()}"

    def answer(self, work: Work, name: str, tell: Tell, threads: int, watch: Watch) -> Answer | None:
        """What came of a work; None if the process died, or was ended by `watch`."""
        assert self.process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            _put(self.process.stdin, (work, threads, Owner()))
        steps, value, looked = 0, 0.0, time.monotonic()
        while True:
            with contextlib.suppress(queue.Empty):
                said = self.said.get(timeout=SELDOM)
                if said is None or isinstance(said, Answer):
                    return said
                steps, value = said
            if time.monotonic() - looked >= SELDOM:
                looked = time.monotonic()
                watch.look({name: self.process.pid})
                if steps:
                    tell(steps, value)  # again and again: the engine says there that nobody waits for the work
            if not self.lives and self.said.empty():  # a fork of it may still hold the pipe
                return None

    def close(self) -> None:
        """End it and all that it has started."""
        with contextlib.suppress(Exception):
            end(self.process.pid)
        self.process.kill()
        self.process.wait()
        with contextlib.suppress(BrokenPipeError):
            self.process.stdin.close()  # type: ignore[union-attr]
        self.hearing.join(SELDOM)  # what has detached itself from the child may still hold its output
        self.folder.cleanup()

    def _hear(self) -> None:
        assert self.process.stdout is not None
        with self.process.stdout, contextlib.suppress(Exception):
            while True:
                self.said.put(pickle.load(self.process.stdout))
        self.said.put(None)


def _put(stream: IO[bytes], what: Any) -> None:
    pickle.dump(what, stream)
    stream.flush()


# --- in the child ----------------------------------------------------------------------------------------------------


def main() -> None:
    """Do works until nobody has any more. What plugins print goes to standard error, and they have nothing to read."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of Ctrl+C the command hears
    works, said = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    mine = os.getpid()

    def tell(steps: int, value: float) -> None:
        if os.getpid() == mine:
            _put(said, (steps, value))

    while (asked := _next(works)) is not None:
        answer = asked if isinstance(asked, Answer) else attended(asked[0], tell, *asked[1:])
        end_forks()
        _put(said, answer)


def _next(works: IO[bytes]) -> Any:
    """Work, threads and owner; the answer to a work that cannot be read here; None if nobody has any more."""
    idle = threading.Timer(IDLE, os._exit, (0,))
    idle.daemon = True
    idle.start()
    try:
        return pickle.load(works)
    except EOFError:
        return None
    except Exception as fault:
        return Answer(fault=f"worker on {socket.gethostname()}: {one_line(fault)}; expected the same clothbench there")
    finally:
        idle.cancel()


if __name__ == "__main__":
    main()
