"""Work on Dask's `distributed`: a scheduler that is there, or a cluster of processes on this machine."""

from __future__ import annotations

import collections
import contextlib
import functools
import logging
import os
import time
import uuid
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import distributed

from clothbench.core.errors import ClothbenchError, Stopped
from clothbench.core.parallel import available_cores
from clothbench.engine.executors.work import Answer, Died, Owner, Tell, Work, attended
from clothbench.plugins.discovery import one_line

CONNECT = 15.0  # s until a scheduler that does not answer is given up
LOOK = 0.1  # s between two looks at whether it is found again
FETCH = 10.0  # s until an answer that does not come is asked for again
CLOSE = 10.0  # s for a cluster to close in good order


class DaskWorkers:
    """One work at a time for each worker process. Each is sent to one process and to no other, so that it is known what
    dies with it, and is tried again from here: a scheduler's own tries are as many as its settings say.
    """

    def __init__(self, executor: Mapping[str, Any], jobs: int, works: int):
        for name in ("distributed", "distributed.client", "asyncio"):  # a worker's death is told in its cell's row
            logging.getLogger(name).setLevel(logging.CRITICAL)
        self.running: dict[int, tuple[distributed.Future, str]] = {}
        self.words: collections.deque[tuple[int, int, float]] = collections.deque()
        self.topic = f"clothbench-{uuid.uuid4().hex}"
        self.idle: list[str] = []
        self.jobs = jobs or works
        self.wait, self.seen = executor["wait"], time.monotonic()
        self.owner = None if executor["address"] else Owner()
        self.cluster = None if executor["address"] else _cluster(min(jobs or available_cores(), works))
        self.where = executor["address"] or self.cluster.scheduler_address  # type: ignore[union-attr]
        try:
            self.client = _client(executor["address"] or self.cluster, executor["wait"])
        except BaseException:
            if self.cluster is not None:
                self.cluster.close()
            raise
        self.client.subscribe_topic(self.topic, lambda event: self.words.append(tuple(event[1])))

    def room(self) -> int:
        busy = {place for _, place in self.running.values()}
        self.idle = [place for place in self._there() if place not in busy]
        return max(0, min(len(self.idle), self.jobs - len(self.running)))

    def begin(self, works: Mapping[int, Work]) -> None:
        for (number, work), place in zip(works.items(), self.idle, strict=False):
            with self._reached():
                future = self.client.submit(
                    _attended, work, number, self.topic, self.owner, key=f"{self.topic}-{uuid.uuid4().hex}",
                    workers=[place], allow_other_workers=False, retries=0, pure=False,
                )  # fmt: skip
            self.running[number] = future, place

    def ended(self, seconds: float) -> Iterable[tuple[int, Answer | Died]]:
        futures = [future for future, _ in self.running.values()]
        if futures:
            with self._reached(), contextlib.suppress(TimeoutError, distributed.CancelledError):
                distributed.wait(futures, timeout=seconds, return_when="FIRST_COMPLETED")
        else:
            time.sleep(seconds)
        there = self._there()
        out = []
        for number, (future, place) in list(self.running.items()):
            with self._reached():
                answer = _answer(future, place, place in there)
            if answer is not None:
                del self.running[number]
                future.cancel(force=True)
                out.append((number, answer))
        return out

    def told(self) -> Iterable[tuple[int, int, float]]:
        return [self.words.popleft() for _ in range(len(self.words))]

    def close(self) -> None:
        with contextlib.suppress(Exception):  # the scheduler may have gone, and all that it kept
            self.client.unsubscribe_topic(self.topic)
            self.client.cancel([future for future, _ in self.running.values()], force=True)
        with contextlib.suppress(Exception):
            self.client.close(timeout=CLOSE)
        if self.cluster is not None:  # a worker that is not ready to end by then is ended with this process
            with contextlib.suppress(TimeoutError):
                self.cluster.close(timeout=CLOSE)

    def _there(self) -> list[str]:
        """Addresses of the workers that the scheduler knows; others may come when all have gone, but not for ever.

        A client that has lost its scheduler looks for it for `CONNECT`, then it is closed.
        """
        while self.client.status == "connecting":
            time.sleep(LOOK)
        with self._reached():
            there = list(self.client.scheduler_info(n_workers=-1)["workers"])
        if there:
            self.seen = time.monotonic()
        elif time.monotonic() - self.seen > self.wait:
            raise ClothbenchError(
                f"executor: found no worker any more for {self.wait:g} s; finished cells are kept, start workers and "
                "run the same command again"
            )
        return there

    @contextlib.contextmanager
    def _reached(self) -> Iterator[None]:
        """Makes one line of whatever the client raises when its scheduler has gone."""
        try:
            yield
        except Exception as fault:
            if self.client.status == "running" and not isinstance(fault, OSError):
                raise
            raise ClothbenchError(
                f"executor: found no scheduler any more at {self.where}; finished cells are kept, run the same command "
                "again when there is one"
            ) from fault


def _cluster(workers: int) -> distributed.LocalCluster:
    threads = max(1, available_cores() // workers)
    return distributed.LocalCluster(
        n_workers=workers,
        threads_per_worker=threads,
        processes=True,
        dashboard_address=":0",
        silence_logs=logging.CRITICAL,
    )


def _client(address: Any, wait: float) -> distributed.Client:
    try:
        client = distributed.Client(address, timeout=CONNECT)
    except (OSError, ValueError) as fault:
        raise ClothbenchError(
            f"setting 'executor.address' is {address!r}: found no Dask scheduler there ({one_line(fault)}), "
            "expected tcp://HOST:PORT of one"
        ) from fault
    try:
        client.wait_for_workers(1, timeout=wait)
    except TimeoutError:
        client.close()
        raise ClothbenchError(
            f"executor: found no worker within {wait:g} s; start some: dask worker {address}"
        ) from None
    return client


def _answer(future: distributed.Future, place: str, there: bool) -> Answer | Died | None:
    """What came of a work; None if it is still running, or if its answer is still on the way."""
    if future.status == "finished":
        try:
            return future.result(timeout=FETCH)
        except (TimeoutError, distributed.CancelledError):  # the answer may have gone with its worker
            return None if there else Died(f"worker {place}")
    if future.status == "error":
        fault = future.exception()
        if isinstance(fault, distributed.scheduler.KilledWorker):
            return Died(f"worker {place}")
        return Answer(fault=f"worker {place}: {one_line(fault)}; expected the same clothbench there")
    if future.status in ("cancelled", "lost") or not there:
        return Died(f"worker {place}")
    return None


def _attended(work: Work, number: int, topic: str, owner: Owner | None) -> Answer:
    """In a worker."""
    if owner is not None:
        speak_aside()
    worker = distributed.get_worker()
    key = worker.get_current_task()
    return attended(work, _teller(worker, key, number, topic), worker.state.nthreads, owner)


@functools.cache
def speak_aside() -> None:
    """What plugins print goes to standard error, in a worker whose standard output is the command's."""
    os.dup2(2, 1)


def _teller(worker: distributed.Worker, key: Any, number: int, topic: str) -> Tell:
    def tell(steps: int, value: float) -> None:
        task = worker.state.tasks.get(key)
        if task is None or task.state == "cancelled":  # the command was stopped, or its connection has gone
            raise Stopped
        worker.log_event(topic, [number, steps, value])

    return tell
