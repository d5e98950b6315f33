"""How long it takes to list results folders of many cells: `python tools/store_sizes.py [CELLS …]` prints a table.

Makes folders of made-up cells (three rows each, as a fit with a held-out recording has), lists each as the first time,
again, and with every cell read by itself, and times the commands that show them. Times are the processor's, which
other work on the machine does not lengthen. 100,000 cells take some minutes to make, and 2 GB; `--keep FOLDER` keeps
them for another time.
"""

from __future__ import annotations

import argparse
import hashlib
import resource
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from clothbench.engine import index
from clothbench.engine.leaderboard import ROW, SYSTEM
from clothbench.engine.store import Store
from clothbench.engine.system import now, system_info
from clothbench.engine.tables import write_table

SIZES = (1_000, 10_000, 100_000)
PLACES = (("swing", "fit"), ("sway", "held_out"), (None, "held_out"))  # recording and split; the last is their total


def make(folder: Path, cells: int) -> None:
    """Fill a results folder; what is there from before stays."""
    about = {
        **dict.fromkeys(ROW), **system_info(), "study": "calibration", "suite": "made_up", "effects": "",
        "optimizer": "ga", "metric": "node_error", "objective": "node_error", "unit": "m", "status": "ok",
        "evaluations": 100, "budget": 100, "settings": "0a1b2c", "threads": 1, "finished": now(),
        "plugins": "models/mass_spring (clothbench 0.1.0, 1); metrics/node_error (clothbench 0.1.0, 1)",
    }  # fmt: skip
    for number in range(cells):
        key = hashlib.sha256(str(number).encode()).hexdigest()[:16]
        cell = folder / "cells" / key
        if cell.is_dir():
            continue
        cell.mkdir(parents=True)
        error = (number * 7919 % 1000 + 1) / 1e5
        mine = {"key": key, "seed": number, "case": f"case-{number % 100}", "model": f"model_{number % 5}"}
        mine |= {"value": error, "low": 0.9 * error, "high": 1.1 * error, "floor": 1e-3, "wall_s": 1.0 + error}
        rows = [{**about, **mine, "recording": name, "split": split} for name, split in PLACES]
        write_table(cell / "rows.parquet", rows, {**ROW, **SYSTEM})


def seconds(work: Callable[[], Any]) -> float:
    """Processor time of work, here and in processes that end with it."""
    began = used()
    work()
    return used() - began


def used() -> float:
    both = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(one.ru_utime + one.ru_stime for one in both)


def by_itself(store: Store) -> float:
    """Seconds of a listing that opens every cell."""
    few, index.FEW = index.FEW, sys.maxsize
    try:
        return seconds(store.rows)
    finally:
        index.FEW = few


def command(*words: str) -> float:
    call = [sys.executable, "-m", "clothbench", *words]
    return seconds(lambda: subprocess.run(call, check=True, stdout=subprocess.DEVNULL))


def line(folder: Path, cells: int) -> list[str]:
    """One size: times [s], and what the index takes [MB]."""
    make(folder, cells)
    store = Store(folder)
    shutil.rmtree(folder / index.INDEX, ignore_errors=True)
    alone = by_itself(store)
    times = [alone, seconds(store.rows), seconds(store.rows), command("leaderboard", "--json", "--out", str(folder))]
    times.append(command("compare", str(folder), str(folder)))
    room = sum(p.stat().st_size for p in (folder / index.INDEX).rglob("*.parquet")) / 1e6
    return [f"{cells:,}", *(f"{t:.1f}" for t in times), f"{room:.1f}"]


def main() -> None:
    options = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    options.add_argument("cells", nargs="*", type=int, default=SIZES)
    options.add_argument("--keep", type=Path, help="folder for the results folders")
    given = options.parse_args()
    heads = (
        "cells", "each by itself", "first listing", "again", "`leaderboard --json`", "`compare`, twice that",
        "index [MB]",
    )  # fmt: skip
    print(f"| {' | '.join(heads)} |\n|{'---|' * len(heads)}", flush=True)
    with tempfile.TemporaryDirectory() as made:
        for cells in given.cells:
            print(f"| {' | '.join(line((given.keep or Path(made)) / str(cells), cells))} |", flush=True)
    print(f"\nat most {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB of memory")


if __name__ == "__main__":
    main()
