"""Threads over whole rollouts: compiled loops release the interpreter's lock, so plain threads keep all cores busy."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from clothbench.core.errors import ClothbenchError

_threads = 0
_share: Callable[[], int] | None = None
_places: tuple[int, threading.Semaphore] | None = None
_lock = threading.Lock()
_inside = threading.local()  # `place`: whether this thread has one


def available_cores() -> int:
    """Cores this process may run on (macOS and Windows know only how many there are)."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def thread_count() -> int:
    """How many threads a batch may use: as set, else this process's share of the cores where several have one, else
    CLOTHBENCH_THREADS, else all cores this process may run on.
    """
    stated = os.environ.get("CLOTHBENCH_THREADS", "0")
    if not stated.isdecimal():
        raise ClothbenchError(f"CLOTHBENCH_THREADS is {stated!r}, expected a whole number")
    return _threads or (_share() if _share else 0) or int(stated) or available_cores()


def set_thread_count(count: int) -> None:
    """Set the number of threads for this process; 0 goes back to the default."""
    global _threads
    _threads = count


def share_cores(processes: Callable[[], int]) -> None:
    """Let this process use its share of the cores from now on, by how many `processes` there are at the time."""
    global _share

    def share() -> int:
        return max(1, available_cores() // max(1, processes()))

    _share = share


def for_each(work: Callable[[Any], None], items: Sequence[Any]) -> None:
    """Call `work(item)` for all items on up to `thread_count()` threads; the first exception is raised here.

    Inside such a work it calls them in turn: who has a place and waits for others to get one may wait for ever.
    """
    if _in_place():
        for item in items:
            work(item)
        return

    def in_turn(item: Any) -> None:
        with _slots():
            _inside.place = True
            try:
                work(item)
            finally:
                _inside.place = False

    if (threads := min(thread_count(), len(items))) <= 1:
        for item in items:
            in_turn(item)
        return
    with ThreadPoolExecutor(threads) as pool:
        for _ in pool.map(in_turn, items):
            pass


def side_by_side(work: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
    """[work(item), …] with all items begun at once, for work that itself comes down to `for_each`.

    The cores stay busy where each item alone has too few members for them; what runs at a time is bounded all the
    same, since calls of `for_each` share `thread_count()` places.
    """
    if len(items) <= 1 or thread_count() == 1 or _in_place():
        return [work(item) for item in items]
    with ThreadPoolExecutor(min(len(items), 4 * thread_count())) as pool:
        return list(pool.map(work, items))


def _in_place() -> bool:
    return getattr(_inside, "place", False)


def _slots() -> threading.Semaphore:
    """As many places as threads may run; made anew when that number changes."""
    global _places
    count = thread_count()
    with _lock:
        if _places is None or _places[0] != count:
            _places = (count, threading.Semaphore(count))
        return _places[1]
