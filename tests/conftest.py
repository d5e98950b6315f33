"""What all tests share: small recordings made on the spot, and the way to the measured data where it is at hand."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from object_store import machine, s3, s3_server  # noqa: F401

from clothbench import Recording, write_recording

ROOT = Path(__file__).parents[1]
PEERS = {"mujoco", "newton"}  # simulators of others, which take up to a hundred times as long for a step as our models


@pytest.hookimpl(tryfirst=True)  # before tests are chosen by their marks
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Whatever is asked of a peer is slow."""
    for item in items:
        if isinstance(item, pytest.Function) and PEERS & set(re.findall(r"\w+", item.name.partition("[")[2])):
            item.add_marker(pytest.mark.slow)


@pytest.fixture(autouse=True)
def _as_wide_as_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tables heed COLUMNS, and whoever runs tests may have set it: processes of pytest-xdist have."""
    monkeypatch.delenv("COLUMNS", raising=False)


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The measured data, or a skip with the reason."""
    stated = os.environ.get("CLOTHBENCH_DATA")
    folder = Path(stated) if stated else ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("the measured data are not here; set CLOTHBENCH_DATA to their folder")
    return folder


def swinging_recording(name: str = "swing", **changes) -> Recording:
    """Half a second of a 5 × 5 lattice on a sheet that two corners move sideways; rigid, so no model fits it well."""
    time = np.linspace(0.0, 0.5, 11)
    grip_time = np.linspace(0.0, 0.5, 26)
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(0, 0.2, 5), np.linspace(0, 0.2, 5)))
    flat = np.stack([u, 0 * u, -v], axis=1)
    sway = 0.02 * np.sin(2 * np.pi * time) ** 2
    held = np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 0.0]])
    moved = 0.02 * np.sin(2 * np.pi * grip_time) ** 2
    noise = np.random.default_rng(7).normal(0, 1e-3, (11, 25, 3))
    content = {
        "name": name, "time": time, "material": np.stack([u, v], axis=1), "grip_time": grip_time,
        "position": flat + sway[:, None, None] * [0, 1, 0] + noise, "grip_material": held[:, :2],
        "grip_position": held + moved[:, None, None] * [0, 1, 0], "cloth_width": 0.2, "cloth_height": 0.2,
        "areal_density": 0.2, "noise_sigma": 1e-3, "fabric": "paper", "motion": "sway", "split": "fit",
    }  # fmt: skip
    return Recording(**{**content, **changes})


@pytest.fixture
def recording() -> Recording:
    return swinging_recording()


@pytest.fixture
def recordings_folder(tmp_path: Path) -> Path:
    """Two recordings of one cloth, one to fit and one held out."""
    folder = tmp_path / "recordings"
    write_recording(swinging_recording("sway-1"), folder / "sway-1.nc")
    write_recording(swinging_recording("sway-2", split="held_out"), folder / "sway-2.nc")
    return folder


Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def clothbench(tmp_path: Path) -> Run:
    """Run the command as a user would: `clothbench("run", …)` in an empty folder; the process and all it said. A
    PYTHONPATH comes before that of the tests.
    """

    def call(*arguments: str, cwd: Path = tmp_path, **environment: str) -> subprocess.CompletedProcess[str]:
        if "PYTHONPATH" in environment:
            paths = environment["PYTHONPATH"], os.environ.get("PYTHONPATH", "")
            environment["PYTHONPATH"] = os.pathsep.join(filter(None, paths))
        return subprocess.run(
            [sys.executable, "-m", "clothbench", *map(str, arguments)], cwd=cwd, capture_output=True, text=True,
            timeout=600, env={**os.environ, **environment}, check=False,
        )  # fmt: skip

    return call
