"""Work on Slurm by submitit, a job for each; or by submitit's own processes on this machine."""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import time
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import psutil
import submitit

from clothbench.core.errors import ClothbenchError
from clothbench.core.files import whole_file
from clothbench.core.parallel import available_cores
from clothbench.engine.executors.work import Answer, Died, Owner, Tell, Work, attended
from clothbench.plugins.discovery import one_line

FOLDER = "slurm"  # below the results folder: scripts, logs and words of jobs, which nodes and command share
ARRAY = 1000  # jobs in an array; more are refused where Slurm's MaxArraySize is as it comes


class SlurmWorkers:
    """A job for each work; those that are begun together are one array of jobs."""

    def __init__(self, executor: Mapping[str, Any], jobs: int, works: int, folder: Path):
        logging.getLogger("submitit").setLevel(logging.CRITICAL)
        self.folder, self.cores = folder / FOLDER, executor["cores"]
        self.owner = Owner() if executor["cluster"] == "local" else None
        # On this machine submitit begins at once whatever it is given. Slurm has a queue, takes all as one array, and
        # is told how many of it may run; but that holds for one array only, so that of more works than one array takes
        # no more are begun than may run.
        if self.owner:
            self.most = jobs or max(1, available_cores() // self.cores)
        else:
            self.most = works if works <= ARRAY else min(jobs or ARRAY, ARRAY)
        self.running: dict[int, submitit.Job] = {}
        self.heard: dict[int, str] = {}
        try:
            self.executor = submitit.AutoExecutor(self.folder, cluster=executor["cluster"])
            self.executor.update_parameters(**_parameters(executor, jobs))
        except (RuntimeError, ValueError, TypeError, NameError) as fault:
            raise ClothbenchError(
                f"executor slurm: {one_line(fault)}; try it with executor.cluster=local where there is no Slurm"
            ) from fault

    def room(self) -> int:
        return self.most - len(self.running)

    def begin(self, works: Mapping[int, Work]) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        tasks = [(work, str(self._words(number)), self.cores, self.owner) for number, work in works.items()]
        try:
            with _unheard(signal.SIGINT):  # of Ctrl+C the command hears, and ends its jobs
                jobs = self.executor.map_array(_attended, *map(list, zip(*tasks, strict=True)))
        except submitit.core.utils.FailedJobError as fault:
            raise ClothbenchError(
                f"executor slurm: Slurm took no jobs: {_why(fault)}; see executor.partition, executor.memory, "
                "executor.minutes and executor.parameters"
            ) from fault
        self.running.update(zip(works, jobs, strict=True))

    def ended(self, seconds: float) -> Iterable[tuple[int, Answer | Died]]:
        until = time.monotonic() + seconds
        while not (done := [n for n, job in self.running.items() if job.done()]) and time.monotonic() < until:
            time.sleep(seconds / 10)
        return [(number, self._answer(number)) for number in done]

    def told(self) -> Iterable[tuple[int, int, float]]:
        out = []
        for number in self.running:
            words = self._words(number)
            text = words.read_text() if words.is_file() else ""
            if text != self.heard.get(number, ""):
                self.heard[number] = text
                steps, value = text.split()
                out.append((number, int(steps), float(value)))
        return out

    def close(self) -> None:
        for number, job in self.running.items():
            if self.owner is None:
                job.cancel(check=False)
            else:
                _kill(int(job.job_id))
            self._clear(number, job)
        with contextlib.suppress(OSError):  # something is left in it, or it was never made
            self.folder.rmdir()

    def _words(self, number: int) -> Path:
        return self.folder / f"{os.getpid()}-{number}.told"

    def _answer(self, number: int) -> Answer | Died:
        """What came of a job. Its files go; of one that failed they stay, for its log says why."""
        job = self.running.pop(number)
        try:
            answer = job.result()
        except Exception as fault:
            return Died(f"job {job.job_id}: {_why(fault)}; see {job.paths.stderr}")
        self._clear(number, job)
        return answer

    def _clear(self, number: int, job: submitit.Job) -> None:
        for path in (self._words(number), *self.folder.glob(f"{job.job_id}_*")):
            path.unlink(missing_ok=True)


def _parameters(executor: Mapping[str, Any], jobs: int) -> dict[str, Any]:
    """What submitit is told of every job; for others than Slurm it passes over what has "slurm_" before it."""
    out = {
        "name": "clothbench", "cpus_per_task": executor["cores"], "timeout_min": executor["minutes"],
        "slurm_partition": executor["partition"], "mem_gb": executor["memory"], "slurm_array_parallelism": jobs or None,
    }  # fmt: skip
    return {name: value for name, value in out.items() if value is not None} | executor["parameters"]


def _why(fault: Exception) -> str:
    lines = [line.strip() for line in str(fault).splitlines() if line.strip(" -=")]
    return lines[-1] if isinstance(fault, submitit.core.utils.FailedJobError) and lines else one_line(fault)


@contextlib.contextmanager
def _unheard(number: signal.Signals) -> Iterator[None]:
    """Processes that are begun in here do not hear a signal."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {number})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _kill(pid: int) -> None:
    """End a job of this machine: the process that watches it, and all below."""
    with contextlib.suppress(psutil.NoSuchProcess):
        watching = psutil.Process(pid)
        for process in (watching, *watching.children(recursive=True)):
            with contextlib.suppress(psutil.NoSuchProcess):
                process.kill()


def _attended(work: Work, words: str, cores: int, owner: Owner | None) -> Answer:
    """In a job."""
    return attended(work, _teller(Path(words)), cores, owner)


def _teller(words: Path) -> Tell:
    def tell(steps: int, value: float) -> None:
        with whole_file(words) as part:
            part.write_text(f"{steps} {value!r}")

    return tell
