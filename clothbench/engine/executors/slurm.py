"""Work on Slurm by submitit, a job for each; or by submitit's own processes on this machine."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import submitit

from clothbench.core.errors import ClothbenchError
from clothbench.core.files import whole_file
from clothbench.core.parallel import available_cores
from clothbench.engine.executors.work import Answer, Died, Tell, Work, attended
from clothbench.plugins.discovery import one_line

FOLDER = "slurm"  # below the results folder: scripts, logs and words of jobs, which nodes and command share


class SlurmWorkers:
    """A job for each work; those that are begun together are one array of jobs."""

    def __init__(self, executor: Mapping[str, Any], jobs: int, works: int, folder: Path):
        logging.getLogger("submitit").setLevel(logging.CRITICAL)
        self.folder, self.cores = folder / FOLDER, executor["cores"]
        here = executor["cluster"] == "local"  # submitit begins there at once whatever it is given
        self.most = max(1, available_cores() // self.cores) if here and not jobs else (jobs or works)
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
        tasks = [(work, str(self._words(number)), self.cores) for number, work in works.items()]
        jobs = self.executor.map_array(_attended, *map(list, zip(*tasks, strict=True)))
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
        for job in self.running.values():
            job.cancel(check=False)

    def _words(self, number: int) -> Path:
        return self.folder / f"{os.getpid()}-{number}.told"

    def _answer(self, number: int) -> Answer | Died:
        """What came of a job. Its files go; of one that failed they stay, for its log says why."""
        job = self.running.pop(number)
        self._words(number).unlink(missing_ok=True)
        try:
            answer = job.result()
        except Exception as fault:
            return Died(f"job {job.job_id}: {_why(fault)}; see {job.paths.stderr}")
        for path in self.folder.glob(f"{job.job_id}_*"):
            path.unlink(missing_ok=True)
        return answer


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


def _attended(work: Work, words: str, cores: int) -> Answer:
    """In a job."""
    return attended(work, _teller(Path(words)), cores)


def _teller(words: Path) -> Tell:
    def tell(steps: int, value: float) -> None:
        with whole_file(words) as part:
            part.write_text(f"{steps} {value!r}")

    return tell
