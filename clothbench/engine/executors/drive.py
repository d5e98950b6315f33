"""The one loop over workers: works go out, answers come in, and what a dead worker was at is tried again."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from clothbench.core.errors import ClothbenchError
from clothbench.engine.executors.work import Answer, Died, Tell, Work, Workers, other_versions
from clothbench.engine.study import Elsewhere

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


def elsewhere(workers: Workers, versions: Mapping[str, str]) -> Elsewhere:
    """Workers as a study knows them; versions: of the plugins that they have to have, as cells state them."""
    begun = 0  # works of earlier batches: one that ended with a fault leaves some with the workers, which answer late

    def pieces(works: Sequence[Work]) -> Iterator[tuple[int, Any]]:
        nonlocal begun
        first, begun = begun, begun + len(works)
        checked = {first + k: AsInstalled(work, versions) for k, work in enumerate(works)}
        for number, answer in answers(workers, checked.__getitem__, InOrder(checked), lambda *_: None):
            if isinstance(answer, Died):
                warnings.warn(f"a worker died twice ({answer.reason}); what it was at is done here", stacklevel=2)
            elif answer.fault is not None:
                raise ClothbenchError(answer.fault)
            yield number - first, answer.value if isinstance(answer, Answer) else None

    return pieces


@dataclass(frozen=True, eq=False)
class AsInstalled:
    """A work that is refused where other versions of plugins are installed."""

    work: Work
    versions: Mapping[str, str]

    def __call__(self, tell: Tell, threads: int) -> Any:
        if reason := other_versions(self.versions):
            raise ClothbenchError(reason)
        return self.work(tell, threads)


class Waiting(Protocol):
    """Numbers of works that wait to be begun."""

    def begin(self) -> int | None:
        """The next one; None if none may be begun now."""
        ...

    def again(self, number: int) -> None:
        """It is to be begun once more."""
        ...


class InOrder:
    """These, one after the other."""

    def __init__(self, numbers: Iterable[int]):
        self.numbers = list(numbers)[::-1]

    def __bool__(self) -> bool:
        return bool(self.numbers)

    def begin(self) -> int | None:
        return self.numbers.pop() if self.numbers else None

    def again(self, number: int) -> None:
        self.numbers.append(number)


def answers(
    workers: Workers, work: Callable[[int], Work], line: Waiting, told: Callable[[int, int, float], None]
) -> Iterator[tuple[int, Answer | Died]]:
    """(number, what came of it) of works as they end; one whose worker dies is tried `TRIES` times."""
    running, tries = set[int](), Counter[int]()
    while line or running:
        chosen = []
        for _ in range(workers.room() if line else 0):
            if (number := line.begin()) is None:
                break
            chosen.append(number)
        if chosen:
            workers.begin({number: work(number) for number in chosen})
            running.update(chosen)
        ended = list(workers.ended(WATCH))
        for number, steps, value in workers.told():
            if number in running:
                told(number, steps, value)
        for number, answer in ended:
            if number not in running:  # of works that nobody waits for any more
                continue
            running.remove(number)
            tries[number] += 1
            if isinstance(answer, Died) and tries[number] < TRIES:
                line.again(number)
            else:
                yield number, answer
