"""A stranger's plugin, small enough for tests: a rigid plate in its grips, as a wheel that is made on the spot."""

from __future__ import annotations

import zipfile
from base64 import urlsafe_b64encode
from hashlib import sha256
from pathlib import Path

HOOKS = """
from clothbench import Registration, hookimpl


@hookimpl
def clothbench_models():
    return [Registration("plate", "clothbench_plate.model:Plate", "a rigid plate that bulges between its grips")]
"""
MODEL = """
import numpy as np

from clothbench import Parameter, ParameterSpace, Rollout


class Plate:
    name, version, capabilities = "plate", 1, frozenset({"dynamic", "static"})
    parameters = ParameterSpace((Parameter("bulge", "b", "m", (0.0, 0.02), "linear", 0.01, "how far it bulges", "me"),))

    def prepare(self, scene, effects=()):
        return Simulation(scene)


class Simulation:
    parameters = Plate.parameters

    def __init__(self, scene):
        self.scene = scene

    def run(self, theta):
        theta, scene = self.parameters.check(theta), self.scene
        u, v = scene.points.T
        sway = scene.grips_at(scene.times)[:, 0, 1]
        y = sway[None, :, None] + theta[:, :1, None] * np.sin(np.pi * v / scene.height / 2)
        position = np.stack(np.broadcast_arrays(u, y, -v), axis=-1)
        return Rollout(scene.times, position, ("ok",) * len(theta), np.ones(len(theta), int), len(u))
"""


def wheel_of_plate(folder: Path, model: str = MODEL, version: str = "1.0") -> Path:
    """FOLDER/clothbench_plate-VERSION-py3-none-any.whl."""
    info = f"clothbench_plate-{version}.dist-info"
    files = {
        "clothbench_plate/__init__.py": HOOKS,
        "clothbench_plate/model.py": model,
        f"{info}/METADATA": f"Metadata-Version: 2.1\nName: clothbench-plate\nVersion: {version}\n",
        f"{info}/WHEEL": "Wheel-Version: 1.0\nGenerator: tests\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
        f"{info}/entry_points.txt": "[clothbench]\nplate = clothbench_plate\n",
    }
    lines = [f"{name},sha256={_digest(text)},{len(text.encode())}" for name, text in files.items()]
    files[f"{info}/RECORD"] = "\n".join([*lines, f"{info}/RECORD,,", ""])
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"clothbench_plate-{version}-py3-none-any.whl"
    with zipfile.ZipFile(path, "w") as wheel:
        for name, text in files.items():
            wheel.writestr(name, text)
    return path


def _digest(text: str) -> str:
    return urlsafe_b64encode(sha256(text.encode()).digest()).rstrip(b"=").decode()
