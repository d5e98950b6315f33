"""A clean environment with wheels installed, as a stranger has it, made without a network.

What clothbench depends on comes from the environment that runs the tests, through a .pth file. Python does not
follow the .pth files that lie in a folder added so; an editable clothbench there therefore stays out of sight.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import venv
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from conftest import ROOT


@dataclass(frozen=True)
class FreshVenv:
    """An environment at `folder`, and an empty folder `away` from the repository to run in."""

    folder: Path
    away: Path

    @property
    def scripts(self) -> Path:
        return self.folder / ("Scripts" if os.name == "nt" else "bin")

    def run(self, *command: str | Path, expect: int = 0, cwd: Path | None = None) -> str:
        """Run one of the environment's commands; what it printed on standard output."""
        known = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "CLOTHBENCH", "PYTEST"))}
        done = subprocess.run(
            [self.scripts / command[0], *map(str, command[1:])], cwd=cwd or self.away, capture_output=True,
            text=True, timeout=900, check=False, env=known,
        )  # fmt: skip
        assert done.returncode == expect, f"{command}: {done.returncode}\n{done.stdout}\n{done.stderr}"
        return done.stdout

    def json(self, *command: str | Path) -> Any:
        return json.loads(self.run(*command))

    def pytest(self, folder: Path) -> str:
        return self.run("python", "-m", "pytest", "-q", "-p", "no:cacheprovider", ".", cwd=folder)


def make_venv(folder: Path, wheels: list[Path]) -> FreshVenv:
    """A virtual environment with these wheels in it and everything else as it is here."""
    venv.create(folder / "venv", with_pip=False)
    fresh = FreshVenv(folder / "venv", folder / "away")
    fresh.away.mkdir()
    (packages,) = (folder / "venv").glob("[Ll]ib/**/site-packages")
    here = [p for p in sys.path if Path(p).name in ("site-packages", "dist-packages")]
    (packages / "dependencies.pth").write_text("\n".join(here) + "\n")
    pip = [sys.executable, "-m", "pip", "--python", next(fresh.scripts.glob("python*"))]
    # --force-reinstall: pip sees the clothbench that runs these tests and would be content with it
    quiet(*pip, "install", "--no-deps", "--no-index", "--force-reinstall", "--ignore-installed", *wheels)
    where = fresh.run("python", "-c", "import clothbench; print(clothbench.__file__)")
    assert Path(where.strip()).is_relative_to(packages)
    lend_kernels(packages)
    return fresh


def lend_kernels(packages: Path) -> None:
    """Give the environment the kernels that numba has compiled here: it takes minutes, and the code is the same.

    numba knows a compiled kernel by its source's time and size.
    """
    for here in (ROOT / "clothbench", *ROOT.glob("plugins/*/clothbench_*")):
        for source in here.rglob("*.py"):
            there = packages / source.relative_to(here.parent)
            kernels = list((source.parent / "__pycache__").glob(f"{source.stem}.*.nb[ic]"))
            if kernels and there.is_file() and there.read_bytes() == source.read_bytes():
                os.utime(there, ns=(source.stat().st_atime_ns, source.stat().st_mtime_ns))
                (there.parent / "__pycache__").mkdir(exist_ok=True)
                for kernel in kernels:
                    shutil.copy2(kernel, there.parent / "__pycache__")


def wheel_of(project: Path, into: Path) -> Path:
    """Build a project's wheel with the build tools at hand."""
    quiet(sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", into / project.name, project)
    (wheel,) = (into / project.name).glob("*.whl")
    return wheel


def quiet(*command: str | Path) -> None:
    done = subprocess.run([*map(str, command)], capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
