"""Work on Ray: a cluster whose head is there, or processes on this machine."""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Iterable, Mapping
from typing import Any

import ray
from ray.util.queue import Empty, Full, Queue

from clothbench.core.errors import ClothbenchError
from clothbench.core.parallel import available_cores
from clothbench.engine.executors.work import Answer, Died, Owner, Tell, Work, attended
from clothbench.plugins.discovery import one_line

WORDS = 10_000  # of workers, that are kept until somebody hears them


class RayWorkers:
    """Ray holds back what its workers have no room for. It tries nothing again by itself: that is done from here."""

    def __init__(self, executor: Mapping[str, Any], jobs: int, works: int):
        self.jobs = jobs or works
        self.cores, self.owner = executor["cores"], None if executor["address"] else Owner()
        _begin(executor, min(jobs or max(1, available_cores() // self.cores), works))
        try:
            _wait_for(self.cores, executor["wait"])
            # Its actor takes no core; should it die, only words of progress are lost.
            self.words = Queue(maxsize=WORDS, actor_options={"num_cpus": 0})
        except BaseException:
            ray.shutdown()
            raise
        self.attended = ray.remote(num_cpus=self.cores, max_retries=0)(_attended)
        self.running: dict[Any, int] = {}

    def room(self) -> int:
        """What the nodes have cores for, and as many again, which wait with Ray: so a cluster that grows by itself sees
        that there is work, and no more cells than that are kept from other commands in the same folder.
        """
        there = sum(int(node["Resources"].get("CPU", 0) // self.cores) for node in ray.nodes() if node["Alive"])
        return min(self.jobs, 2 * there) - len(self.running)

    def begin(self, works: Mapping[int, Work]) -> None:
        for number, work in works.items():
            self.running[self.attended.remote(work, number, self.words, self.cores, self.owner)] = number

    def ended(self, seconds: float) -> Iterable[tuple[int, Answer | Died]]:
        if not self.running:
            time.sleep(seconds)
            return []
        first, _ = ray.wait(list(self.running), timeout=seconds)
        return [(self.running.pop(ref), _answer(ref)) for ref in first]

    def told(self) -> Iterable[tuple[int, int, float]]:
        try:
            return self.words.get_nowait_batch(min(self.words.qsize(), WORDS))
        except (Empty, ray.exceptions.RayError):
            return []

    def close(self) -> None:
        for ref in self.running:
            ray.cancel(ref, force=True)
        self.words.shutdown(force=True)
        ray.shutdown()


def _begin(executor: Mapping[str, Any], workers: int) -> None:
    where = {"address": executor["address"]} if executor["address"] else {
        "address": "local", "num_cpus": workers * executor["cores"], "include_dashboard": False,
    }  # fmt: skip
    try:
        ray.init(**where, log_to_driver=False, logging_level=logging.CRITICAL)
    except (ConnectionError, OSError, ValueError, RuntimeError) as fault:
        if not executor["address"]:
            raise ClothbenchError(
                f"executor ray: found that Ray cannot be started on this machine ({one_line(fault)}), expected a local "
                "cluster; give executor.address=HOST:PORT of a head, or leave the executor out"
            ) from fault
        raise ClothbenchError(
            f"setting 'executor.address' is {executor['address']!r}: found no Ray cluster there ({one_line(fault)}), "
            "expected HOST:PORT of a head, or auto"
        ) from fault


def _wait_for(cores: int, seconds: float) -> None:
    """Until there is a node that can take a work."""
    until = time.monotonic() + seconds
    while not any(node["Alive"] and node["Resources"].get("CPU", 0) >= cores for node in ray.nodes()):
        if time.monotonic() > until:
            raise ClothbenchError(
                f"executor: found no node with {cores} free cores within {seconds:g} s; start some (ray start), or set "
                "executor.cores"
            )
        time.sleep(0.2)


def _answer(ref: Any) -> Answer | Died:
    try:
        return ray.get(ref)
    except (
        ray.exceptions.WorkerCrashedError, ray.exceptions.NodeDiedError, ray.exceptions.OutOfMemoryError,
        ray.exceptions.LocalRayletDiedError, ray.exceptions.ObjectLostError,
    ) as fault:  # fmt: skip
        return Died(one_line(fault))
    except ray.exceptions.RayError as fault:
        return Answer(fault=f"a Ray worker: {one_line(fault)}; expected the same clothbench there")


def _attended(work: Work, number: int, words: Queue, cores: int, owner: Owner | None) -> Answer:
    """In a worker."""
    return attended(work, _teller(number, words), cores, owner)


def _teller(number: int, words: Queue) -> Tell:
    def tell(steps: int, value: float) -> None:
        with contextlib.suppress(Full, ray.exceptions.RayError):  # nobody hears it; the work is what counts
            words.put_nowait((number, steps, value))

    return tell
