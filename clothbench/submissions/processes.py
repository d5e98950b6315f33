"""Ends what a stranger's plugin has started, also where it has left its session or its parent has gone."""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
import time
from collections.abc import Iterator

import psutil

from clothbench.core.errors import ClothbenchError

SUBREAPER = 36  # PR_SET_CHILD_SUBREAPER of linux/prctl.h
PATIENCE = 10.0  # s that ending them may take


@contextlib.contextmanager
def all_ended() -> Iterator[None]:
    """End whatever was started in this block, and whatever that has started.

    On Linux this process takes the place of parents that have gone (prctl(2), PR_SET_CHILD_SUBREAPER), so that all of
    them stay below it. On other systems one that has left its session, and whose parent has gone, is not found.
    """
    me = psutil.Process()
    before = set(me.children())
    _adopt(True)
    try:
        yield
    finally:
        try:
            _end(me, before)
        finally:
            _adopt(False)


def _adopt(orphans: bool) -> None:
    """Whether this process becomes the parent of those below it whose own has gone."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(SUBREAPER, int(orphans), 0, 0, 0)


def _end(me: psutil.Process, before: set[psutil.Process]) -> None:
    """Stop all that are found, so that they start no others, then kill them; until there are none."""
    until = time.monotonic() + PATIENCE
    while found := _below(me, before):
        if time.monotonic() > until:
            raise ClothbenchError(f"process {found[0].pid} of the plugin cannot be ended; end it by hand")
        for act in (psutil.Process.suspend, psutil.Process.kill):
            for one in found:
                with contextlib.suppress(psutil.Error):
                    act(one)
        for one in found:
            with contextlib.suppress(ChildProcessError):
                os.waitpid(one.pid, os.WNOHANG)
        time.sleep(0.01)


def _below(me: psutil.Process, before: set[psutil.Process]) -> list[psutil.Process]:
    """The processes below this one, but for those that were there before."""
    out = []
    for child in set(me.children()) - before:
        with contextlib.suppress(psutil.NoSuchProcess):
            out += [child, *child.children(recursive=True)]
    return out
