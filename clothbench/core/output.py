"""Standard output and error whose reader may go away, as `| head` does: what they are told then goes to nowhere, and
the work goes on.
"""

from __future__ import annotations

import codecs
import contextlib
import os
import sys
from collections.abc import Iterator
from typing import Any


def takes_all_letters() -> bool:
    """Whether standard output can write every letter; where it is not in UTF-8, another one would take its place."""
    stated = getattr(sys.stdout, "encoding", None) or "utf-8"  # a text in memory has none
    return codecs.lookup(stated).name == "utf-8"


class Lasting:
    """A stream of this process that outlives its reader; all else is the stream's own."""

    def __init__(self, stream: Any):
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        try:
            return self._stream.write(text)
        except BrokenPipeError:
            self._to_nowhere()
            return len(text)

    def flush(self) -> None:
        try:
            self._stream.flush()
        except BrokenPipeError:  # what is still to go out goes with the next word
            self._to_nowhere()

    def _to_nowhere(self) -> None:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self._stream.fileno())
        os.close(nowhere)


def keep_on() -> None:
    """From now on no print of this process fails because nobody reads it."""
    for name in ("stdout", "stderr"):
        if (stream := getattr(sys, name)) is not None:  # none where it was closed
            setattr(sys, name, Lasting(stream))


@contextlib.contextmanager
def kept_on() -> Iterator[None]:
    """The same for a while; what was printed has gone out at its end, so that Python finds nothing left to say."""
    before = sys.stdout, sys.stderr
    keep_on()
    mine = [stream for stream in (sys.stdout, sys.stderr) if stream is not None]
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before
        for stream in mine:
            with contextlib.suppress(OSError):  # a full disk: Python says so when it ends
                stream.flush()
