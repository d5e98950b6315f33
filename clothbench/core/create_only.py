"""Whether a file system keeps what the store rests on: of many who put a folder in one place, one comes first."""

from __future__ import annotations

import functools
import os
import tempfile
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

from clothbench.core.errors import ClothbenchError
from clothbench.core.files import alone, renamed

AT_ONCE = 16
T = TypeVar("T")


def require_create_only(folder: str | os.PathLike[str]) -> None:
    """Make a folder, if there is none, and try it out: some milliseconds, once in a process for each folder and disk.

    Raises a ClothbenchError, one line, where it cannot be written to, where a rename replaces a folder that holds
    something, or where locks do not lock (some network and user-space file systems).
    """
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _tried(folder.resolve(), folder.stat().st_dev)
    except OSError as fault:
        raise ClothbenchError(
            f"{folder}: found a folder that cannot be written to ({fault.strerror or fault}), expected one of yours; "
            "give another with out=FOLDER"
        ) from fault


@functools.cache
def _tried(folder: Path, disk: int) -> None:
    # The name is one that `half_written` knows, should this process be killed here.
    with tempfile.TemporaryDirectory(dir=folder, prefix=".new.", ignore_cleanup_errors=True) as made:
        place = Path(made)
        if (first := _renames(place)) != 1:
            _refuse(folder, f"{first} of {AT_ONCE} renames to one place succeeded", "exactly one")
        if (together := _locks(place)) != 1:
            _refuse(folder, f"{together} of {AT_ONCE} held one lock at a time", "one at a time")


def _refuse(folder: Path, found: str, expected: str) -> None:
    raise ClothbenchError(
        f"{folder}: found a file system on which {found}, expected {expected}, or commands that share the folder would "
        "lose results; give one on a local disk, or a network file system with POSIX renames and locks, with out=FOLDER"
    )


def _renames(place: Path) -> int:
    """How many of those who put a folder in one place at once came first there, and are still there."""
    parts = [place / str(number) for number in range(AT_ONCE)]
    for part in parts:
        part.mkdir()
        (part / part.name).touch()
    ready = threading.Barrier(AT_ONCE)

    def put(part: Path) -> bool:
        ready.wait()
        return renamed(part, place / "there")

    won = [part.name for part, first in zip(parts, at_once(put, parts), strict=True) if first]
    there = [path.name for path in (place / "there").iterdir()]
    return len(won) if won == there else AT_ONCE


def _locks(place: Path) -> int:
    """The most who were inside of one lock together."""
    inside, most = 0, 0

    def enter(_: int) -> None:
        nonlocal inside, most
        with alone(place):
            inside += 1
            most = max(most, inside)
            time.sleep(0)  # let another one in, if it can come in
            inside -= 1

    at_once(enter, list(range(AT_ONCE)))
    return most


def at_once(work: Callable[[T], object], what: list[T]) -> list[object]:
    """What comes of `AT_ONCE` of them, each in a thread of its own, all at the same time."""
    with ThreadPoolExecutor(AT_ONCE) as threads:
        return list(threads.map(work, what))
