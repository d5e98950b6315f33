"""A fresh environment with the wheels of a submission, in which its plugins are run.

This keeps accidents apart, not attacks: the plugin runs with the rights of whoever started the command. It gets an
environment without variables but a few, a home and a working folder of its own, no network where `unshare` can take it
away, and a time limit. When a fit is done, or out of time, all processes that it has started are ended.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import shutil
import signal
import subprocess
import sys
import sysconfig
import tempfile
import venv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from clothbench.core.errors import ClothbenchError
from clothbench.core.files import file_names
from clothbench.recordings.nodes import Recording, read_recording, write_recording
from clothbench.studies.calibration.cell import CalibrationCell, asked
from clothbench.submissions.again import blank
from clothbench.submissions.processes import all_ended

TOLD = (
    "PATH",
    "LANG",
    "LC_ALL",
    "TZ",
    "LD_LIBRARY_PATH",
    "OPENBLAS_CORETYPE",
    "OPENBLAS_NUM_THREADS",
    "CLOTHBENCH_THREADS",
)


@dataclass(frozen=True)
class Sandbox:
    """folder: that it lies in; limit: s that one fit may take."""

    folder: Path
    limit: float

    @cached_property
    def python(self) -> Path:
        return self.folder / "venv" / ("Scripts" if os.name == "nt" else "bin") / "python"

    @cached_property
    def fence(self) -> list[str]:
        """The beginning of a command that has no network; empty where that cannot be had."""
        for words in (["unshare", "--net"], ["unshare", "--user", "--map-root-user", "--net"]):
            if (
                shutil.which(words[0])
                and not subprocess.run([*words, "true"], capture_output=True, check=False).returncode
            ):
                return words
        return []

    def install(self, wheels: Sequence[Path]) -> None:
        """The wheels, in front of everything that is installed here; what else they need, pip fetches as wheels."""
        venv.create(self.folder / "venv", with_pip=False)
        place = Path(sysconfig.get_path("purelib", vars={"base": str(self.folder / "venv"), "platbase": ""}))
        place.mkdir(parents=True, exist_ok=True)
        own = sysconfig.get_path("stdlib")
        here = [path for path in sys.path if path and Path(path).is_dir() and not _is_of(path, own)]
        (place / "verifier.pth").write_text("\n".join(here) + "\n", encoding="utf-8")
        # First what the wheels need, then they themselves, by this Python: once they lie there, starting the other one
        # runs what they bring (.pth), which is not to happen before it has been fenced in.
        pip = [sys.executable, "-m", "pip", "--disable-pip-version-check"]
        # By whole paths: a name that begins with "-" would be an option of pip, and tell it what else to fetch and run.
        paths = [str(wheel.absolute()) for wheel in wheels]
        for how in (
            ["--python", str(self.python), "install", "--only-binary=:all:"],
            ["install", "--no-deps", "--no-index", "--upgrade", "--target", str(place)],
        ):
            done = subprocess.run([*pip, *how, "--quiet", *paths], capture_output=True, text=True, check=False)
            if done.returncode:
                said = next(
                    (line for line in done.stderr.splitlines() if line.startswith("ERROR")), done.stderr.strip()
                )
                for wheel in wheels:
                    said = said.replace(f"{wheel.absolute().parent}/", "")
                raise ClothbenchError(f"{wheels[0]}: cannot be installed (pip: {said}); expected wheels of this Python")

    def fitted(
        self, cell: CalibrationCell, shown: Mapping[str, Recording], simulate: Sequence[Recording]
    ) -> dict[str, tuple[Path, Recording]]:
        """Fit a cell again, and simulate: by the recordings' names the file, and what it says.

        shown: recordings that it is fitted to, by hash; of those to `simulate` the plugin is told all but positions.
        """
        place = Path(tempfile.mkdtemp(dir=self.folder))
        sources = []
        for name, source in zip(file_names([s.name for s in cell.recordings]), cell.recordings, strict=True):
            path = ""
            if source.split == "fit":
                path = str(write_recording(shown[source.hash], place / "fit" / f"{name}.nc"))
            sources.append(dataclasses.replace(source, path=path))
        names = file_names([r.name for r in simulate])
        paths = [
            str(write_recording(blank(r), place / "simulate" / f"{name}.nc"))
            for name, r in zip(names, simulate, strict=True)
        ]
        job = {"question": asked(dataclasses.replace(cell, recordings=tuple(sources))), "simulate": paths}
        (place / "job.json").write_text(json.dumps(job), encoding="utf-8")
        self._run(place)
        found = {}
        for name, recording in zip(names, simulate, strict=True):
            left = place / "out" / f"{name}.nc"
            if not left.is_file() or left.is_symlink():
                raise ClothbenchError(f"{cell.label}: the plugin left no simulation of {recording.name!r}")
            found[recording.name] = (left, read_recording(left))
        return found

    def _run(self, place: Path) -> None:
        (place / "out").mkdir()
        (place / "home").mkdir()
        told = {name: os.environ[name] for name in TOLD if name in os.environ}
        told |= {"HOME": str(place / "home"), "TMPDIR": str(place / "home"), "PYTHONDONTWRITEBYTECODE": "1"}
        words = [*self.fence, self.python, "-m", "clothbench.submissions.again", place / "job.json", place / "out"]
        heard = place / "stderr"  # a file: who outlives the fit may hold a pipe open
        with all_ended(), heard.open("wb") as stderr, subprocess.Popen(
            [str(word) for word in words], cwd=place / "home", env=told, start_new_session=True,
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=stderr,
        ) as process:  # fmt: skip
            try:
                process.wait(timeout=self.limit)
            except subprocess.TimeoutExpired:
                raise ClothbenchError(
                    f"took longer than {self.limit:g} s and was ended; more with --time-limit"
                ) from None
            finally:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
        if process.returncode:
            lines = _end_of(heard).strip().splitlines() or [f"ended with {process.returncode} and said nothing"]
            raise ClothbenchError(f"could not be run: {lines[-1]}")


def _end_of(file: Path, size: int = 2000) -> str:
    """The last bytes of a file, as text."""
    with file.open("rb") as stream:
        stream.seek(max(0, file.stat().st_size - size))
        return stream.read(size).decode(errors="replace")


def _is_of(path: str, standard: str) -> bool:
    """Whether a folder is of Python's own library, and not of what has been installed into it."""
    return Path(path).is_relative_to(standard) and Path(path).name not in ("site-packages", "dist-packages")


def require_posix() -> None:
    """Refuse systems on which a plugin cannot be ended."""
    if os.name != "posix":
        raise ClothbenchError("running somebody's plugin needs a POSIX system, which can end the processes it starts")


@contextlib.contextmanager
def sandbox(wheels: Sequence[Path], limit: float) -> Iterator[Sandbox]:
    """A fresh environment with these wheels; it is gone afterwards."""
    if not wheels:
        raise ClothbenchError(
            "found no wheels, expected those of its plugins; pack them with `clothbench submit FOLDER --name NAME "
            "--runs RUNS --wheel FILE`"
        )
    with tempfile.TemporaryDirectory(prefix="clothbench-", ignore_cleanup_errors=True) as folder:
        made = Sandbox(Path(folder), limit)
        made.install(wheels)
        yield made
