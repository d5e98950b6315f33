"""Input that means harm: `python tools/fuzz.py [--seconds N] [--kind K …] [--seed N] [--out FILE.md] [--keep FOLDER]`.

Valid inputs of every kind that clothbench reads are spoiled by a seed, in their structure and in their bytes, and given
to the commands that read them, in processes with bounded memory. `tools/fuzz_child.py` says what is promised of any
input; here is seen to it that a process neither dies nor hangs. Prints a table; exit code 1 if anything was found.

`--kind K --number N --keep FOLDER` does one input again and puts it into the folder. The same seed, kind and number are
the same input, as long as these tools and the libraries that write the valid files stay the same.
"""

from __future__ import annotations

import argparse
import json
import os
import queue
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psutil
from fuzz_child import turn

CHILD = Path(__file__).with_name("fuzz_child.py")
BATCH = 2000  # inputs of one process
QUICK = 4  # turns of a quick kind to one of a slow kind, where they take turns
SLICE = 60.0  # s at a time for each kind
CPU, WALL = 15.0, 240.0  # s for one input: of a processor, and by the clock of a machine that has others to serve


@dataclass
class Tally:
    """What came of the inputs of one kind. codes: how often which exit code; finds: first number by what was found."""

    done: int = 0
    seconds: float = 0.0
    codes: dict[str, int] = field(default_factory=dict)
    finds: dict[str, tuple[int, str, int]] = field(default_factory=dict)

    def found(self, what: str, number: int, command: str) -> None:
        first, asked, times = self.finds.get(what, (number, command, 0))
        self.finds[what] = (first, asked, times + 1)


@dataclass
class Reader:
    """One child that reads inputs of one kind, or of several in turn, from a number on. tallies: of each kind."""

    kinds: Sequence[str]
    tallies: dict[str, Tally]
    folder: Path
    bases: Path
    seed: int
    keep: Path | None = None

    def read(self, first: int, until: float, count: int = BATCH) -> int:
        """Let it read until a moment of the monotonic clock; the number that comes next."""
        self.folder.mkdir(parents=True, exist_ok=True)
        words = [",".join(self.kinds), str(first), str(count), str(self.folder), str(self.bases), str(self.seed),
                 str(self.keep or "")]  # fmt: skip
        with open(self.folder / "stderr.txt", "w", encoding="utf-8") as said:
            child = subprocess.Popen(
                [sys.executable, str(CHILD), *words], stdout=subprocess.PIPE, stderr=said, text=True
            )
        lines: queue.Queue[str] = queue.Queue()
        pump = threading.Thread(target=_pump, args=(child, lines), daemon=True)
        pump.start()
        began = time.monotonic()
        try:
            return self._follow(child, lines, first, until, first + count)
        finally:
            for kind in self.kinds:  # what each took by itself is not known
                self.tallies[kind].seconds += (time.monotonic() - began) / len(self.kinds)
            child.kill()
            child.wait()
            pump.join()

    def _follow(self, child: subprocess.Popen[str], lines: queue.Queue[str], first: int, until: float, end: int) -> int:
        number, since, cpu = first, time.monotonic(), cpu_of(child.pid)
        begun = False
        while number < end:
            try:
                told = json.loads(lines.get(timeout=0.5) or "null")
            except queue.Empty:
                told = None
                if child.poll() is None:
                    if begun and (cpu_of(child.pid) - cpu > CPU or time.monotonic() - since > WALL):
                        return self._lost("hang", number, self._where(child))
                    continue
            if told is None:
                child.wait()
                if number == first and not begun:
                    raise SystemExit(f"{self.kinds[0]}: did not start: {(self.folder / 'stderr.txt').read_text()}")
                return self._lost(f"died of {signal_name(child.returncode)}", number, self._log())
            if "begun" in told:
                number, since, cpu, begun = told["begun"], time.monotonic(), cpu_of(child.pid), True
                continue
            kind, of_kind = turn(self.kinds, number)
            tally = self.tallies[kind]
            tally.done += 1
            for code in told["codes"]:
                tally.codes[str(code)] = tally.codes.get(str(code), 0) + 1
            if told["fault"]:
                tally.found(told["fault"], of_kind, told["command"])
            number, begun = number + 1, False
            if time.monotonic() > until:
                break
        return number

    def _lost(self, what: str, number: int, where: str) -> int:
        """An input that its reader did not survive."""
        kind, of_kind = turn(self.kinds, number)
        self.tallies[kind].done += 1
        self.tallies[kind].found(f"{what} {where}", of_kind, "")
        if self.keep is not None:
            shutil.copytree(self.folder / "case", self.keep / f"{kind}-{of_kind}", dirs_exist_ok=True, symlinks=True)
        return number + 1

    def _where(self, child: subprocess.Popen[str]) -> str:
        os.kill(child.pid, signal.SIGUSR1)
        time.sleep(1)
        return self._log()

    def _log(self) -> str:
        """The innermost line of clothbench's, or any, that the reader was at."""
        log = self.folder / "crash.txt"
        lines = (
            [x.strip() for x in log.read_text().splitlines() if x.strip().startswith("File")] if log.exists() else []
        )
        lines += [x.strip() for x in (self.folder / "stderr.txt").read_text().splitlines()[-1:]]  # not of clothbench's
        mine = [x for x in lines if "/clothbench" in x and "/tools/" not in x]
        return (mine or lines or ["at a place not known"])[0].replace(str(CHILD.parents[1]), "")


def _pump(child: subprocess.Popen[str], lines: queue.Queue[str]) -> None:
    assert child.stdout is not None
    with child.stdout:
        for line in child.stdout:
            lines.put(line)
    lines.put("")


def cpu_of(pid: int) -> float:
    """Seconds of a processor that a process has had."""
    try:
        times = psutil.Process(pid).cpu_times()
    except psutil.NoSuchProcess:
        return 0.0
    return times.user + times.system


def signal_name(code: int) -> str:
    return signal.Signals(-code).name if code < 0 else f"exit code {code}"


def make_bases(folder: Path) -> Path:
    """The valid inputs, made in a process of their own."""
    bases = folder / "bases"
    bases.mkdir(parents=True)
    words = ["", "bases", "0", str(folder), str(bases), "0", ""]
    made = subprocess.run([sys.executable, str(CHILD), *words], check=False, capture_output=True, text=True)
    if made.returncode:
        raise SystemExit(f"the valid inputs could not be made:\n{made.stderr}")
    return bases


def fuzz(
    kinds: Sequence[str], seconds: float, seed: int, folder: Path, keep: Path | None = None, most: int | None = None,
    number: int = 0, told: Callable[[dict[str, Tally]], None] = lambda _: None, together: bool = False,
) -> dict[str, Tally]:  # fmt: skip
    """Read spoiled inputs of all kinds in turn, for so long or until there were `most` of each. told: after each kind's
    turn. together: one process reads all kinds, which spares a short run the start of one for each, and more of those
    that are read quickly.
    """
    bases = make_bases(folder)
    tallies = {kind: Tally() for kind in kinds}
    next_one = dict.fromkeys([rounds(kinds)] if together else [(kind,) for kind in kinds], number)
    end = time.monotonic() + seconds

    def left(group: tuple[str, ...]) -> int:
        return BATCH if most is None else number + most * len(group) - next_one[group]

    while (groups := [group for group in next_one if left(group)]) and time.monotonic() < end:
        for group in groups:
            until = min(end, time.monotonic() + SLICE)
            reader = Reader(group, tallies, folder / group[0], bases, seed, keep)
            next_one[group] = reader.read(next_one[group], until, left(group))
            told(tallies)
            if time.monotonic() > end:
                break
    return tallies


def table(tallies: dict[str, Tally]) -> list[str]:
    out = ["| input | read | a second | exit 0, 1, 2 | finds |", "|---|---|---|---|---|"]
    for kind, tally in tallies.items():
        codes = ", ".join(str(tally.codes.get(code, 0)) for code in "012")
        rate = tally.done / tally.seconds if tally.seconds else 0.0
        out.append(f"| {kind} | {tally.done} | {rate:.1f} | {codes} | {len(tally.finds)} |")
    return out


def finds(tallies: dict[str, Tally]) -> list[str]:
    return [
        f"{kind} {number} ({times} times): {what}   {command}"
        for kind, tally in tallies.items()
        for what, (number, command, times) in sorted(tally.finds.items())
    ]


def main() -> int:
    options = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    options.add_argument("--seconds", type=float, default=600.0)
    options.add_argument("--kind", nargs="+", help="only these (default: all)")
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--number", type=int, help="only this input of each kind")
    options.add_argument("--out", type=Path, help="also write table and finds to this file")
    options.add_argument("--keep", type=Path, help="folder for the inputs that something was found with")
    given: Any = options.parse_args()
    kinds = given.kind or kinds_known()

    def told(tallies: dict[str, Tally]) -> None:
        if given.out:
            given.out.write_text("\n".join([*table(tallies), "", *finds(tallies)]) + "\n", encoding="utf-8")

    one = None if given.number is None else 1
    with tempfile.TemporaryDirectory(prefix="fuzz-") as made:
        tallies = fuzz(kinds, given.seconds, given.seed, Path(made), given.keep, one, given.number or 0, told)
    print("\n".join([*table(tallies), "", *finds(tallies)]))
    return 1 if any(tally.finds for tally in tallies.values()) else 0


def rounds(kinds: Sequence[str]) -> tuple[str, ...]:
    """Whose turn it is in a round: each slow kind's once, each other one's QUICK times."""
    from fuzz_inputs import KINDS

    return tuple(kind for kind in kinds for _ in range(1 if KINDS[kind].slow else QUICK))


def kinds_known() -> list[str]:
    from fuzz_inputs import KINDS

    return list(KINDS)


if __name__ == "__main__":
    sys.exit(main())
