"""One process of `tools/fuzz.py`: reads spoiled inputs one after the other, and tells what each came to.

What clothbench promises of any input: exit code 0, 1 or 2; of 2 one line on standard error; no traceback, no warning;
no code of the input's is run, nothing outside of the working folder is written, no process is started, and memory
stays bounded. Who started this process sees whether it still lives, and how long it takes.
"""

from __future__ import annotations

import faulthandler
import importlib
import json
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any, TextIO
from unittest.mock import patch

ROOT = Path(__file__).resolve().parents[1]
ROOM = 3 << 30  # bytes of address space beyond what the warm process has
MEMORY = 1 << 30  # bytes that an input of some kilobytes may make it hold
SETTINGS = {"suite", "words"}  # kinds that are planned and not simulated
LONGEST = 2000  # characters of what is called one line
FORBIDDEN = {"os.system", "os.exec", "os.posix_spawn", "os.spawn", "os.startfile", "subprocess.Popen", "socket.connect",
             "socket.bind", "pickle.find_class", "os.fork", "os.forkpty", "pty.spawn"}  # fmt: skip
WRITES = {"os.mkdir": 0, "os.rename": 1, "os.remove": 0, "os.rmdir": 0, "os.link": 1, "os.symlink": 1, "os.chmod": 0,
          "os.truncate": 0, "shutil.rmtree": 0}  # fmt: skip


class Guard:
    """What the interpreter is asked to do while an input is read: code, processes, and files outside of a folder."""

    def __init__(self) -> None:
        self.inside: Path | None = None
        self.seen: list[str] = []
        sys.addaudithook(self)

    def __call__(self, event: str, of: tuple[Any, ...]) -> None:
        if self.inside is None:
            return
        inside, self.inside = self.inside, None  # what is done here is nobody's deed
        try:
            if event in FORBIDDEN and not _by("numba"):
                self.seen.append(f"{event} {str(of)[:80]}")
            elif event == "open" and _writes(of) and not _allowed(of[0], inside):
                self.seen.append(f"open for writing {of[0]}")
            elif event in WRITES and not _allowed(of[WRITES[event]], inside):
                self.seen.append(f"{event} {of[WRITES[event]]}")
        finally:
            self.inside = inside


def _by(library: str) -> bool:
    """Whether a library has asked for it: numba reads its own kept kernels so."""
    frame = sys._getframe(2)
    while frame is not None:
        if f"{os.sep}{library}{os.sep}" in frame.f_code.co_filename:
            return True
        frame = frame.f_back  # type: ignore[assignment]
    return False


def _writes(of: tuple[Any, ...]) -> bool:
    path, mode, flags = of
    asked = any(letter in mode for letter in "wax+") if isinstance(mode, str) else flags & (os.O_WRONLY | os.O_RDWR)
    return isinstance(path, str | bytes | os.PathLike) and bool(asked)


def _allowed(path: Any, inside: Path) -> bool:
    if isinstance(path, int):
        return True
    place = os.path.realpath(os.fsdecode(path))
    kernels = os.path.realpath(os.environ.get("NUMBA_CACHE_DIR") or inside)  # else they lie in __pycache__
    return (
        place.startswith((f"{inside}{os.sep}", f"{kernels}{os.sep}", "/dev/null", "/dev/tty"))
        or place == str(inside)
        or "__pycache__" in place
    )


@contextmanager
def said(folder: Path) -> Iterator[dict[str, str]]:
    """What is written to standard output and standard error in here, by whom ever."""
    out: dict[str, str] = {}
    kept = [os.dup(1), os.dup(2)]
    files = [open(folder / name, "wb") for name in ("out.txt", "err.txt")]  # noqa: SIM115  # closed below
    try:
        for number, file in zip((1, 2), files, strict=True):
            os.dup2(file.fileno(), number)
        yield out
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        for number, before, file in zip((1, 2), kept, files, strict=True):
            os.dup2(before, number)
            os.close(before)
            file.close()
        for name in ("out", "err"):
            out[name] = (folder / f"{name}.txt").read_bytes().decode("utf-8", "replace")


def called(command: Any) -> int:
    """The exit code of a command, or of a reader that is called as one."""
    from clothbench import ClothbenchError
    from clothbench.cli import main

    if not callable(command):
        return main(command)
    try:
        command()
    except ClothbenchError as fault:
        print(f"clothbench: {fault}", file=sys.stderr)
        return 2
    return 0


def judged(command: Any, guard: Guard, here: Path, beside: Path) -> tuple[int | None, str | None]:
    """Exit code and what is wrong with how a command took its input, None if nothing is."""
    code: int | None = None
    fault = None
    with said(beside) as texts:
        guard.seen, guard.inside = [], here
        try:
            code = called(command)
        except SystemExit as end:  # of a parser of arguments
            code = end.code if isinstance(end.code, int) else 1
        except BaseException as escaped:
            fault = f"{type(escaped).__name__} {place_of(escaped)}: {str(escaped).splitlines()[:1]}"
            (beside / "traceback.txt").write_text(traceback.format_exc())
        finally:
            guard.inside = None
    return code, fault or wrong(code, texts, guard)


def place_of(fault: BaseException) -> str:
    """Where of clothbench an exception has come through last."""
    for frame in reversed(traceback.extract_tb(fault.__traceback__)):
        name = Path(frame.filename)
        if name.is_relative_to(ROOT) and name.parent.name != "tools":
            return f"in {name.relative_to(ROOT)}:{frame.name}"
    return "outside of clothbench"


def wrong(code: int | None, texts: dict[str, str], guard: Guard) -> str | None:
    lines = texts["err"].splitlines()
    if guard.seen:
        return guard.seen[0]
    if code not in (0, 1, 2):
        return f"exit code {code}"
    if "Traceback" in texts["err"] or "Warning" in texts["err"]:
        return f"on standard error: {next(x for x in lines if 'Traceback' in x or 'Warning' in x)[:200]}"
    if code == 2 and (len(lines) != 1 or not lines[0].startswith("clothbench: ")):
        return f"exit code 2 with {len(lines)} lines"
    if any(len(line) > LONGEST for line in lines):
        return "a line of more than 2000 characters"
    if any("\x1b" in text or "\x00" in text for text in texts.values()):
        return "control characters in what it says"
    return None


def turn(kinds: Sequence[str], number: int) -> tuple[str, int]:
    """The kind whose turn it is in rounds of these kinds, and the number of that input among those of its kind."""
    done, at = divmod(number, len(kinds))
    return kinds[at], done * kinds.count(kinds[at]) + kinds[:at].count(kinds[at])


def serve(
    kinds: Sequence[str], numbers: Iterator[int], folder: Path, bases: Path, seed: int, told: TextIO, keep: Path | None
) -> None:
    """Read inputs by their numbers; tells of each when it begins and what it came to."""
    import fuzz_inputs as inputs

    here = folder / "case"
    guard = Guard()
    known: set[str] = set()
    limits(folder)
    for number in numbers:
        shutil.rmtree(here, ignore_errors=True)
        here.mkdir()
        os.chdir(here)
        os.environ["TMPDIR"] = str(here)
        tempfile.tempdir = None
        kind, of_kind = turn(kinds, number)
        commands = inputs.KINDS[kind].make(here, bases, random.Random(f"{seed}/{kind}/{of_kind}"))
        print(json.dumps({"begun": number}), file=told, flush=True)
        reset_peak()
        before = peak()
        codes: list[int | None] = []
        fault = None
        for command in commands:
            with planned_only() if kind in SETTINGS else nullcontext():
                code, fault = judged(command, guard, here, folder)
            codes.append(code)
            if fault or (page := unsafe_page(here)):
                fault = fault or page
                break
        if not fault and peak() - before > MEMORY:
            fault = f"memory: {(peak() - before) / 1e9:.1f} GB"
        asked = str(commands[len(codes) - 1])
        if fault and keep is not None and fault not in known:
            known.add(fault)
            kept(keep / f"{kind}-{of_kind}", here, folder, f"{asked}\n{fault}\n")
        print(json.dumps({"done": number, "codes": codes, "fault": fault, "command": asked}), file=told, flush=True)


def unsafe_page(here: Path) -> str | None:
    """A page in which a text of the input's has become code."""
    import fuzz_mutations as spoil

    pages = (p.read_text(encoding="utf-8", errors="replace") for p in here.rglob("*.html"))
    return "markup of the input's in a page" if any(spoil.MARKUP in page for page in pages) else None


def kept(to: Path, here: Path, folder: Path, text: str) -> None:
    """Put an input aside with what was said of it."""
    shutil.rmtree(to, ignore_errors=True)
    shutil.copytree(here, to, symlinks=True)
    (to / "FOUND.txt").write_text(text)
    for name in ("traceback.txt", "err.txt"):
        if (folder / name).exists():
            shutil.copy(folder / name, to / f"FOUND-{name}")


def reset_peak() -> None:
    Path("/proc/self/clear_refs").write_text("5")


def peak() -> int:
    """The most memory held since `reset_peak` [bytes]."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * int(next(line for line in lines if line.startswith("VmHWM")).split()[1])


def limits(folder: Path) -> None:
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + ROOM
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 30, 1 << 30))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    log = open(folder / "crash.txt", "w")  # noqa: SIM115  # for as long as this process lives
    faulthandler.enable(log)
    faulthandler.register(signal.SIGUSR1, log)


@contextmanager
def planned_only() -> Iterator[None]:
    """Let `run` plan cells and not simulate them: settings are fuzzed, and a valid one may ask for a day's work."""
    import clothbench.cli.run as module

    with patch.object(module, "run_cells"):
        yield


def main(words: list[str]) -> None:
    named, first, count, folder, bases, seed, keep = words
    told = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    os.environ["TMPDIR"] = folder
    place = Path(bases)
    if first == "bases":
        from fuzz_bases import write_bases

        os.chdir(place)
        write_bases(place)
        return
    warm = Path(tempfile.mkdtemp(prefix="warm-", dir=folder))
    os.chdir(warm)
    kinds = named.split(",")
    with said(Path(folder)):
        warm_up(set(kinds), warm, place)
    numbers = iter(range(int(first), int(first) + int(count)))
    serve(kinds, numbers, Path(folder), place, int(seed), told, Path(keep) if keep else None)


def warm_up(kinds: set[str], here: Path, bases: Path) -> None:
    """Load what reading loads, with a valid input, so that only the input makes a difference afterwards."""
    with suppress(ImportError):  # xarray looks whether it is there when it first writes
        importlib.import_module("dask")
    from clothbench.cli import main as clothbench

    clothbench(["validate", *map(str, sorted(bases.glob("*.nc")))])
    if kinds & {"run", *SETTINGS}:
        clothbench(["run", f"recording={bases / 'nodes.nc'}", "model=mass_spring", "optimizer=ga", "metric=node_error",
                    "budget=2", "jobs=1", "rerun=false"])  # fmt: skip
    if "results" in kinds:
        clothbench(["leaderboard", "--out", str(bases / "runs")])
        shutil.copytree(bases / "runs", here / "whole")
        clothbench(["report", f"out={here / 'whole'}"])
    if "submission" in kinds:
        clothbench(["verify", str(bases / "submission"), "--recordings", str(bases / "measured")])


if __name__ == "__main__":
    main(sys.argv[1:])
