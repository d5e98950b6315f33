"""What executors and a bucket cost: `python tools/executor_times.py [--workers 1 2 3]` prints a table.

Twelve short cells (two models, three optimizers, two metrics) on one shaken sheet, computed by each executor on this
machine with one, two and three workers, with the results in a folder; and by `local` and `dask` with the results in a
bucket of an S3 server that runs here (moto, in a process of its own). After each run the rows and all other tables, but
for times, must be those of the first. Wall times are of the whole command, its start and its page included.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pyarrow.parquet as pq

from clothbench.core.files import sha256
from clothbench.engine.mirror import results_folder

RECORDING = Path(__file__).parents[1] / "suites" / "embedded" / "shake_nodes"
TIMES = {"wall_s", "finished", "threads", "seconds"}  # what differs from run to run
RUNS = (
    ("`local`, a folder", ("executor=local",), False),
    ("`local`, a bucket", ("executor=local",), True),
    ("`dask`, a folder", ("executor=dask",), False),
    ("`dask`, a bucket", ("executor=dask",), True),
    ("`slurm`, `cluster=local`, a folder", ("executor=slurm", "executor.cluster=local"), False),
)
WORDS = [
    "model=[mass_spring,mass_spring_verlet]", "optimizer=[ga,nelder_mead,cma_es]",
    "metric=[node_error,relative_error]", "rerun=false",
]  # fmt: skip


@contextmanager
def server(port: int) -> Iterator[None]:
    """An S3 on the loopback address; the environment says how it is reached."""
    os.environ |= {
        "AWS_ENDPOINT_URL": f"http://127.0.0.1:{port}", "AWS_ACCESS_KEY_ID": "anybody", "AWS_SECRET_ACCESS_KEY": "s",
        "AWS_DEFAULT_REGION": "us-east-1",
    }  # fmt: skip
    command = [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)]
    running = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield
    finally:
        running.terminate()
        running.wait()


def make_bucket(name: str) -> None:
    import boto3
    from botocore.config import Config

    patient = Config(retries={"max_attempts": 10})  # the server is starting
    boto3.client("s3", config=patient).create_bucket(Bucket=name)


def wall_time(words: list[str], out: str) -> float:
    """Seconds of one command; one that does not end well ends this one."""
    began = time.perf_counter()
    subprocess.run(
        [sys.executable, "-m", "clothbench", "run", *words, f"out={out}"], check=True, stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )  # fmt: skip
    return time.perf_counter() - began


def contents(folder: Path) -> dict[str, str]:
    """Every file of a store's cells: tables without times, by their text, and all else by its bytes."""
    found = {}
    for path in sorted(path for path in (folder / "cells").rglob("*") if path.is_file()):
        if path.suffix == ".parquet":
            table = pq.read_table(path)
            kept = table.drop_columns([name for name in table.column_names if name in TIMES])
            found[str(path.relative_to(folder))] = repr(kept.to_pylist())
        else:
            found[str(path.relative_to(folder))] = sha256(path)
    return found


def measured(words: list[str], workers: list[int], place: Path) -> dict[str, tuple[list[float], int, int]]:
    """Of each executor: wall times by number of workers, files that are those of the first run, files in all."""
    times: dict[str, list[float]] = {name: [] for name, *_ in RUNS}
    equal = dict.fromkeys(times, 0)
    expected: dict[str, str] = {}
    for n in workers:
        for number, (name, executor, bucket) in enumerate(RUNS):
            out = f"s3://times/{number}-{n}" if bucket else str(place / f"{number}-{n}")
            times[name].append(wall_time([*words, *executor, f"jobs={n}"], out))
            found = contents(results_folder(out))
            expected = expected or found
            equal[name] += sum(found.get(key) == value for key, value in expected.items())
            print(f"{name}, {n} workers: {times[name][-1]:.1f} s", file=sys.stderr, flush=True)
    return {name: (times[name], equal[name], len(expected) * len(workers)) for name in times}


def main() -> int:
    asked = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    asked.add_argument("--workers", type=int, nargs="+", default=[1, 2, 3], metavar="N")
    asked.add_argument("--evaluations", type=int, default=30, metavar="N", help="of each cell (default: 30)")
    asked.add_argument("--port", type=int, default=5555, help="of the S3 server (default: 5555)")
    given = asked.parse_args()
    place = Path(tempfile.mkdtemp(prefix="clothbench-"))
    os.environ["CLOTHBENCH_CACHE"] = str(place / "cache")
    words = [f"recording={sorted(RECORDING.glob('*.nc'))[0]}", *WORDS, f"budget={given.evaluations}"]
    with server(given.port):
        make_bucket("times")
        wall_time([*words, "optimizer=ga"], str(place / "first"))  # compiles what is compiled once
        told = measured(words, given.workers, place)
    print(f"| | {' | '.join(f'{n} workers' for n in given.workers)} | files equal |")
    print(f"|{'---|' * (len(given.workers) + 2)}")
    for name, (took, equal, of) in told.items():
        print(f"| {name} | {' | '.join(f'{s:.0f} s' for s in took)} | {equal} of {of} |")
    shutil.rmtree(place, ignore_errors=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
