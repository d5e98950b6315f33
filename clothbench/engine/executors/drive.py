"""The one loop over the workers of an engine: works go out, answers come in, what a dead worker was at is tried again."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from clothbench.engine.executors.work import Answer, Died, Work, Workers

WATCH = 0.5  # s between two looks at how far works are
TRIES = 2  # of a work whose worker dies


@contextmanager
def opened(executor: Mapping[str, Any], jobs: int, works: int, folder: Path) -> Iterator[Workers]:
    """The workers of an executor, for so many works, `jobs` at a time (0: as many as it takes). folder: where an engine
    may keep files, if it must. However this ends, nothing goes on in a worker afterwards.
    """
    workers = _begun(executor, jobs, works, folder)
    try:
        yield workers
    finally:
        workers.close()


def _begun(executor: Mapping[str, Any], jobs: int, works: int, folder: Path) -> Workers:
    if executor["name"] == "dask":
        from clothbench.engine.executors.dask import DaskWorkers

        return DaskWorkers(executor, jobs, works)
    if executor["name"] == "ray":
        from clothbench.engine.executors.ray import RayWorkers

        return RayWorkers(executor, jobs, works)
    from clothbench.engine.executors.slurm import SlurmWorkers

    return SlurmWorkers(executor, jobs, works, folder)


def answers(
    workers: Workers, work: Callable[[int], Work], count: int, jobs: int, told: Callable[[int, int, float], None]
) -> Iterator[tuple[int, Answer | Died]]:
    """(number, what came of it) of `work(0)`, `work(1)` … as they end. A work whose worker died is tried `TRIES` times."""
    waiting, running, tries = list(range(count))[::-1], set[int](), Counter[int]()
    while waiting or running:
        room = min(workers.room(), (jobs or math.inf) - len(running), len(waiting))
        chosen = [waiting.pop() for _ in range(int(room))]
        if chosen:
            workers.begin({number: work(number) for number in chosen})
            running.update(chosen)
        for number, answer in workers.ended(WATCH):
            running.discard(number)
            tries[number] += 1
            if isinstance(answer, Died) and tries[number] < TRIES:
                waiting.append(number)
            else:
                yield number, answer
        for number, steps, value in workers.told():
            if number in running:
                told(number, steps, value)
