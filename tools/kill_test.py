"""What a results folder survives: `python tools/kill_test.py [--kills N] [--seed N] [--out FILE.md]` prints a table.

A sweep of short cells is killed again and again (SIGKILL, at random moments, the command or one of its workers, one
command or two in the same folder). After each round, no finished cell may have changed or gone and `clothbench store
check` may find no fault; what was resumed to its end must be, number by number, what an undisturbed sweep found. So it
is with a Dask cluster (`--dask N` kills; the command, the scheduler or one of two workers). Then the same sweep meets a
full disk, a folder that it may not write to, a clock that jumps, and a second command in its
folder; each must end in one clear line or in the right result, and leave nothing half-written.

Ctrl+C ends the killing early: the table is then of the kills so far. As root on Linux, disks are small file systems in
memory; else the size of files is limited, and rights are taken away.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import hashlib
import multiprocessing
import os
import random
import resource
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from clothbench.engine.check import check
from clothbench.engine.disagreement import outcome
from clothbench.engine.leaderboard import finished
from clothbench.engine.store import Store
from clothbench.plugins.discovery import catalogue
from clothbench.recordings.nodes import Recording, write_recording

# What a command imports; it is forked from a process that has done so, and then begins at once.
IMPORTED = (
    "clothbench.cli.run", "clothbench.report.page", "clothbench.studies.calibration.study",
    "clothbench.studies.calibration.run", "clothbench.studies.calibration.film_rerun", "clothbench_models.mass_spring",
    "clothbench_models.mass_spring_verlet",
)  # fmt: skip
OPTIMIZERS = ("ga", "annealing", "nelder_mead", "cma_es")
MODELS = ("mass_spring", "mass_spring_verlet")
METRICS = ("node_error", "relative_error")
HEAD = (
    "# Kills, full disks and jumping clocks", "",
    "A sweep of 16 short cells under `python tools/kill_test.py`: what was finished before each mishap, and what the "
    "sweep came to in the end beside one that nothing happened to.", "",
)  # fmt: skip
JUMPY = """
import random, sys, time
real, chance = time.time, random.Random(sys.argv[1])
time.time = lambda: real() + chance.choice((0, -86400 * 400, 86400 * 400, -5, 5))
sys.argv[:2] = ["clothbench"]
from clothbench.cli import main
sys.exit(main(sys.argv[1:]))
"""
AT_ONCE = multiprocessing.get_context("forkserver")
PAGE = 4096  # bytes, of which a file system in memory gives a file whole ones
GONE = 90.0  # s within which a command ends whose scheduler was killed
Outcomes = dict[str, list[float | str]]


@dataclass
class Sweep:
    """A sweep in a folder of its own, and what is known of it. lost: finished cells that changed or went."""

    words: list[str]
    out: Path
    kept: dict[str, str] = field(default_factory=dict)
    lost: set[str] = field(default_factory=set)
    faults: list[str] = field(default_factory=list)

    def begin(self, *before: str, **how: Any) -> subprocess.Popen[str]:
        call = [sys.executable, *(before or ("-m", "clothbench")), *self.words, f"out={self.out}"]
        return subprocess.Popen(call, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, **how)

    def end(self, *before: str, **how: Any) -> tuple[int, str]:
        """Let it run to its end: exit code, and the last line that it said."""
        running = self.begin(*before, **how)
        said = running.communicate()[0].strip().splitlines()
        return running.returncode, said[-1] if said else ""

    def look(self) -> None:
        """Hold every finished cell against what it was, and check the folder."""
        now = {}
        for rows in sorted(self.out.glob("cells/[0-9a-f]*/rows.parquet")):
            if Store(self.out).has(rows.parent.name):
                now[rows.parent.name] = hashlib.sha256(rows.read_bytes()).hexdigest()
        self.lost |= {key for key, digest in self.kept.items() if now.get(key) != digest}
        self.kept |= now
        self.faults += [found.line for found in check(Store(self.out), catalogue()) if not found.harmless]

    def outcomes(self) -> Outcomes:
        """Of every finished cell the values of its rows and of its parameters."""
        out: Outcomes = {}
        for path in sorted(self.out.glob("cells/[0-9a-f]*")):
            rows = Store(self.out).table("rows", [path.name])
            if finished(rows):
                fitted = [{"status": p["name"], **p} for p in Store(self.out).table("parameters", [path.name])]
                out[path.name] = outcome(rows) + outcome(fitted)
        return out

    def left(self) -> int:
        """Files and folders that were never put in their place."""
        return sum(found.harmless and "half-written" in found.line for found in check(Store(self.out), catalogue()))


def recordings(folder: Path) -> Path:
    """Two recordings of half a second: a small sheet that two corners move."""
    moments, u, v = np.linspace(0, 0.5, 11), *(a.ravel() for a in np.meshgrid(*[np.linspace(0, 0.2, 5)] * 2))
    sway = 0.02 * np.sin(2 * np.pi * moments) ** 2
    for number, split in enumerate(("fit", "held_out")):
        noise = np.random.default_rng(number).normal(0, 1e-3, (11, 25, 3))
        held = np.array([[0.0, 0, 0], [0.2, 0, 0]])
        sheet = np.stack([u, 0 * u, -v], axis=1)
        towards = sway[:, None, None] * [0, 1, 0]
        recording = Recording(
            name=f"sway-{number}", time=moments, material=np.stack([u, v], axis=1), position=sheet + towards + noise,
            grip_time=moments, grip_material=held[:, :2], grip_position=held + towards, cloth_width=0.2,
            cloth_height=0.2, areal_density=0.2, noise_sigma=1e-3, fabric="paper", motion="sway", split=split,
        )  # fmt: skip
        write_recording(recording, folder / f"sway-{number}.nc")
    return folder


def listed(words: tuple[str, ...]) -> str:
    return f"[{','.join(words)}]"


# --- kills ----------------------------------------------------------------------------------------------------------


@dataclass
class Tally:
    """What was killed: commands, workers, schedulers; and what came of it."""

    commands: int = 0
    workers: int = 0
    schedulers: int = 0
    rounds: int = 0
    sweeps: int = 0
    resumed: int = 0  # rounds that began with finished cells, and with others missing
    wrong: set[str] = field(default_factory=set)  # cells whose numbers are not those of the undisturbed sweep
    lost: set[str] = field(default_factory=set)
    faults: list[str] = field(default_factory=list)
    left: int = 0

    @property
    def kills(self) -> int:
        return self.commands + self.workers + self.schedulers


Round = Callable[[Sweep, Tally, int, float, random.Random], None]


def killed_sweeps(
    make: Callable[[], Sweep], expected: Outcomes, kills: int, pause: float, chance: random.Random, of_round: Round
) -> Tally:
    """Kill until that has happened often enough, in one folder after the other, and let the last sweep end. of_round:
    begins what is killed, `killed_round` or `cluster_round`.
    """
    tally = Tally()
    while tally.kills < kills:
        sweep = make()
        tally.sweeps += 1
        while len(sweep.outcomes()) < len(expected) and tally.kills < kills:
            tally.resumed += bool(sweep.kept)
            try:
                of_round(sweep, tally, kills, pause, chance)
            except KeyboardInterrupt:
                kills = tally.kills
            sweep.look()
            print(f"{tally.kills} kills, {len(sweep.kept)} of {len(expected)} cells", file=sys.stderr, flush=True)
        code, said = sweep.end()
        sweep.look()
        if code:
            sweep.faults.append(f"resumed: exit code {code}, {said}")
        tally.wrong |= {key for key, found in expected.items() if sweep.outcomes().get(key) != found}
        tally.lost |= sweep.lost
        tally.faults += sweep.faults
        tally.left += sweep.left()
    return tally


def killed_round(sweep: Sweep, tally: Tally, kills: int, pause: float, chance: random.Random) -> None:
    """One command or two, with workers or without, and kills until all have ended. pause: mean time between [s]."""
    count, jobs = chance.choice((1, 1, 2)), chance.choice((1, 1, 2))
    words = [*sweep.words, f"jobs={jobs}", f"out={sweep.out}"]
    running = [AT_ONCE.Process(target=command, args=(words,)) for _ in range(count)]
    for process in running:
        process.start()
    tally.rounds += 1
    try:
        kill_some(running, tally, kills, pause, chance)
    finally:
        for process in running:
            process.kill()  # what is still at work when there have been kills enough
            process.join()


def kill_some(running: list[Any], tally: Tally, kills: int, pause: float, chance: random.Random) -> None:
    while any(process.is_alive() for process in running) and tally.kills < kills:
        time.sleep(chance.expovariate(1 / pause))
        alive = [process for process in running if process.is_alive()]
        if not alive:
            break
        victim = chance.choice(alive)
        workers = workers_of(victim.pid)
        if workers and chance.random() < 0.7:
            with contextlib.suppress(psutil.NoSuchProcess):
                chance.choice(workers).kill()
                tally.workers += 1
        else:
            victim.kill()
            tally.commands += 1


def cluster_round(sweep: Sweep, tally: Tally, kills: int, pause: float, chance: random.Random) -> None:
    """A command with a Dask cluster, and kills until it has ended: of the command, of a worker, in whose place another
    is begun, or of the scheduler, without which the command has to end by itself, with exit code 2.
    """
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        where = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    scheduler = dask("scheduler", "--host", "127.0.0.1", "--port", where.rpartition(":")[2])
    workers = [dask("worker", where, "--nthreads", "1", "--no-nanny") for _ in range(2)]
    asked = ["executor=dask", f"executor.address={where}", "executor.shared=true"]
    running = AT_ONCE.Process(target=command, args=([*sweep.words, *asked, f"out={sweep.out}"],))
    running.start()
    tally.rounds += 1
    try:
        while running.is_alive() and tally.kills < kills:
            time.sleep(chance.expovariate(1 / pause))
            victim = chance.choice(("command", "worker", "worker", "scheduler"))
            if not running.is_alive():
                break
            if victim == "command":
                running.kill()
                tally.commands += 1
            elif victim == "worker":
                chance.choice([worker for worker in workers if worker.poll() is None]).kill()
                workers.append(dask("worker", where, "--nthreads", "1", "--no-nanny"))
                tally.workers += 1
            else:
                scheduler.kill()
                tally.schedulers += 1
                running.join(GONE)
                if running.exitcode not in (0, 2):  # 0: it had all answers by then
                    sweep.faults.append(f"the scheduler was killed: exit code {running.exitcode}")
                break
    finally:
        running.kill()
        running.join()
        for process in (scheduler, *workers):
            process.kill()
            process.wait()


def dask(kind: str, *words: str) -> subprocess.Popen[bytes]:
    """A scheduler or a worker, as a process of its own."""
    call = [sys.executable, "-m", f"distributed.cli.dask_{kind}", *words, "--no-dashboard"]
    return subprocess.Popen(call, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def command(words: list[str]) -> None:
    """`clothbench WORDS`, in a process of its own."""
    from clothbench.cli import main as clothbench

    silence = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(silence, stream)
    sys.exit(clothbench(words))


def workers_of(pid: int | None) -> list[psutil.Process]:
    """The processes that a command has started."""
    try:
        return psutil.Process(pid).children(recursive=True)
    except psutil.NoSuchProcess:
        return []


# --- other disturbances ---------------------------------------------------------------------------------------------


@contextlib.contextmanager
def small_disk(folder: Path, size: str) -> Iterator[Callable[[str], None] | None]:
    """A file system in memory at `folder`, and what remounts it; None where that is not permitted."""
    folder.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", folder], check=False, capture_output=True
    )
    if mounted.returncode:
        yield None
        return

    def again(options: str) -> None:
        subprocess.run(["mount", "-o", f"remount,{options}", folder], check=True)

    try:
        yield again
    finally:
        subprocess.run(["umount", folder], check=True)


def size_of(folder: Path) -> int:
    """What the files of a folder take on a disk of pages [bytes]."""
    return sum(-(-path.stat().st_size // PAGE) * PAGE for path in folder.rglob("*"))


def full_disk(make: Callable[[], Sweep], expected: Outcomes, room: int) -> list[str]:
    """The disk fills in mid-sweep, with `room` for so many bytes; then there is room again."""
    sweep = make()
    with small_disk(sweep.out, str(room)) as remount:
        if remount is None:
            limit = 4096  # bytes that a file may have; tables are larger
            code, said = sweep.end(preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)))
            name = f"files limited to {limit} bytes, then not"
        else:
            code, said = sweep.end()
            name = f"full disk ({room / 1000:.0f} kB), then room"
        sweep.look()
        left, before = sweep.left(), len(sweep.kept)
        if remount is not None:
            remount("size=200m")
        well = code == 2 and not left and (remount is None or 0 < before < len(expected))
        return judged(name, sweep, expected, f"exit {code} after {before} cells: {said}", well)


def read_only(make: Callable[[], Sweep], expected: Outcomes) -> list[str]:
    """A finished folder that nobody may write to is still listed; an empty one is refused."""
    sweep = make()
    with small_disk(sweep.out, "50m") as remount:
        if remount is not None:
            remount("ro")
        else:
            sweep.out.chmod(0o500)
        code, said = sweep.end()
        empty = not list(sweep.out.iterdir())
        remount("rw") if remount is not None else sweep.out.chmod(0o700)
        return judged("read-only folder, then not", sweep, expected, f"exit {code}: {said}", code == 2 and empty)


def jumping_clock(make: Callable[[], Sweep], expected: Outcomes) -> list[str]:
    """Half of the cells from years ago and from years to come; then a clock that jumps at every look."""
    sweep = make()
    sweep.end()
    sweep.look()
    for number, key in enumerate(sorted(sweep.kept)):
        if number % 2:
            shutil.rmtree(sweep.out / "cells" / key)
        else:
            moment = time.time() + (-1) ** (number // 2) * 4e8
            for path in (sweep.out / "cells" / key).rglob("*"):
                os.utime(path, (moment, moment))
    sweep.kept.clear()
    sweep.look()
    code, _ = sweep.end("-c", JUMPY, "28")
    return judged("clock that jumps by 400 days", sweep, expected, f"exit {code}", code == 0)


def two_commands(make: Callable[[], Sweep], expected: Outcomes) -> list[str]:
    sweep = make()
    both = [sweep.begin(), sweep.begin()]
    texts = [command.communicate()[0] for command in both]
    codes = [command.returncode for command in both]
    warned = sum(text.count("computed twice") for text in texts)
    said = f"exit {codes[0]} and {codes[1]}, {warned} disagreements"
    return judged("two commands in one folder", sweep, expected, said, codes == [0, 0] and not warned)


def judged(name: str, sweep: Sweep, expected: Outcomes, said: str, well: bool) -> list[str]:
    """Let the sweep end undisturbed; a line of the table."""
    if len(sweep.outcomes()) < len(expected):
        code, last = sweep.end()
        if code:
            sweep.faults.append(f"resumed: exit code {code}, {last}")
    sweep.look()
    wrong = sum(sweep.outcomes().get(key) != found for key, found in expected.items())
    for line in sweep.faults:
        print(f"{name}: {line}", file=sys.stderr)
    good = well and not (sweep.lost or sweep.faults or wrong)
    said = said.replace(str(sweep.out), "OUT").replace("|", "/")
    return [name, str(len(sweep.lost)), str(len(sweep.faults)), equal(wrong, expected), said, "yes" if good else "NO"]


def equal(wrong: int, expected: Outcomes) -> str:
    return f"{len(expected) - wrong} of {len(expected)} cells"


# --- the table ------------------------------------------------------------------------------------------------------


def main() -> int:
    options = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    options.add_argument("--kills", type=int, default=100)
    options.add_argument(
        "--dask", type=int, default=0, help="kills on a Dask cluster besides; slow, each round begins one"
    )
    options.add_argument("--seed", type=int, default=0, help="of victims and moments")
    options.add_argument("--pause", type=float, default=2.0, help="mean time between two kills [s]")
    options.add_argument("--only-kills", action="store_true", help="no full disk, read-only folder, clock")
    options.add_argument("--out", type=Path, help="also write the table to this Markdown file")
    given = options.parse_args()
    with tempfile.TemporaryDirectory(prefix="kills-") as made:
        table, good = lines(Path(made), given)
    print("\n".join(table))
    if given.out:
        given.out.write_text("\n".join([*HEAD, *table]) + "\n", encoding="utf-8")
    return 0 if good else 1


def lines(folder: Path, given: argparse.Namespace) -> tuple[list[str], bool]:
    """The table in Markdown, and whether all of it is well."""
    words = [
        "run", f"recordings={recordings(folder / 'recordings')}", f"model={listed(MODELS)}",
        f"optimizer={listed(OPTIMIZERS)}", f"metric={listed(METRICS)}", "scene.resolution=[5,5]", "budget=12",
        "rerun=false",
    ]  # fmt: skip
    numbers = iter(range(10**6))

    def make() -> Sweep:
        return Sweep(words, folder / f"runs-{next(numbers)}")

    undisturbed = make()
    began = time.monotonic()
    code, said = undisturbed.end()
    took = time.monotonic() - began
    if code:
        raise SystemExit(f"the undisturbed sweep failed: {said}")
    expected = undisturbed.outcomes()
    print(f"undisturbed: {len(expected)} cells in {took:.0f} s", file=sys.stderr, flush=True)
    rows, room = [], size_of(undisturbed.out / "cells") // 3
    disturbances = (functools.partial(full_disk, room=room), read_only, jumping_clock, two_commands)
    for disturbed in () if given.only_kills else disturbances:
        rows.append(disturbed(make, expected))
        print(" | ".join(rows[-1]), file=sys.stderr, flush=True)
    AT_ONCE.set_forkserver_preload(list(IMPORTED))
    killed = []
    for kills, of_round, what in ((given.kills, killed_round, "kills"), (given.dask, cluster_round, "kills with Dask")):
        if kills:
            tally = killed_sweeps(make, expected, kills, given.pause, random.Random(given.seed), of_round)
            killed.append(tallied(what, tally, expected))
    rows[:0] = killed
    heads = (
        "what happened",
        "finished cells lost",
        "faults in the folder",
        "equal to undisturbed",
        "what it said",
        "well",
    )
    table = [f"| {' | '.join(heads)} |", f"|{'---|' * len(heads)}", *(f"| {' | '.join(row)} |" for row in rows)]
    return table, all(row[-1] == "yes" for row in rows)


def tallied(what: str, tally: Tally, expected: Outcomes) -> list[str]:
    """A line of the table."""
    for line in tally.faults:
        print(f"{what}: {line}", file=sys.stderr)
    well = not (tally.lost or tally.faults or tally.wrong)
    schedulers = f", {tally.schedulers} of schedulers" if tally.schedulers else ""
    name = f"{tally.kills} {what} ({tally.commands} of commands, {tally.workers} of workers{schedulers})"
    said = f"{tally.rounds} rounds, {tally.resumed} resumed, {tally.sweeps} sweeps; {tally.left} half-written left over"
    same = equal(len(tally.wrong), expected)
    return [name, str(len(tally.lost)), str(len(tally.faults)), same, said, "yes" if well else "NO"]


if __name__ == "__main__":
    sys.exit(main())
