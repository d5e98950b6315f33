"""Recordings of kind "laser": images of a laser line on the cloth, by a calibrated camera, on disk as NetCDF-4.

Same header as kind "nodes" (`clothbench.recordings.nodes`), of which `name` is needed; what differs:

| name | dims | units | meaning |
|---|---|---|---|
| `time` | time | s | when each image was taken |
| `image` | time, y, x | 1 | brightness, 0 to 255 |
| `camera_matrix` | row, column (3 × 3) | 1 | pinhole camera: focal lengths and principal point in pixels |
| `distortion` | coefficient (5) | 1 | k1, k2, p1, p2, k3 of Brown's lens model, as OpenCV has them |
| `camera_rotation` | row, column (3 × 3) | 1 | R of x_camera = R x_world + t; the camera looks along its z, y down |
| `camera_translation` | space (3) | m | t |
| `laser_plane` | plane (4) | 1 | unit normal n and distance d [m] of the plane n·x = d that the laser lights |
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from clothbench.core.brief import brief
from clothbench.core.camera import matrix_fault
from clothbench.core.errors import ClothbenchError
from clothbench.recordings.codec import freeze, hash_of, read, write
from clothbench.recordings.layout import Layout, Variable

LAYOUT = Layout(
    kind="laser",
    variables={
        "time": Variable(("time",), "s"),
        "image": Variable(("time", "y", "x"), "1", np.uint8, level=4),
        "camera_matrix": Variable(("row", "column"), "1"),
        "distortion": Variable(("coefficient",), "1"),
        "camera_rotation": Variable(("row", "column"), "1"),
        "camera_translation": Variable(("space",), "m"),
        "laser_plane": Variable(("plane",), "1"),
    },
    texts=("name", "fabric", "source"),
    stated_first=True,
)
SHAPES = {"camera_matrix": (3, 3), "distortion": (5,), "camera_rotation": (3, 3), "camera_translation": (3,),
          "laser_plane": (4,)}  # fmt: skip
SMALLEST = 16  # pixels


@dataclass(frozen=True, eq=False)
class LaserImages:
    """Images of a laser line, with the camera's calibration; shapes and units as above. Arrays are read-only."""

    name: str
    time: np.ndarray
    image: np.ndarray
    camera_matrix: np.ndarray
    distortion: np.ndarray
    camera_rotation: np.ndarray
    camera_translation: np.ndarray
    laser_plane: np.ndarray
    fabric: str = ""
    source: str = ""
    notes: dict[str, str] = field(default_factory=dict)
    path: str = field(default="", compare=False)

    __repr__ = brief

    def __post_init__(self) -> None:
        freeze(self, LAYOUT)
        _check(self, self.path or self.name)

    @property
    def hash(self) -> str:
        """SHA-256 over everything measured and stated."""
        return hash_of(self, LAYOUT)


def read_laser(path: str | os.PathLike[str]) -> LaserImages:
    """Read and check one file; a fault raises `ClothbenchError` with file, variable, found, expected."""
    return read(path, LAYOUT, LaserImages)


def write_laser(images: LaserImages, path: str | os.PathLike[str]) -> Path:
    """Write one file, through a link where one is named, atomically: it is there whole or not at all."""
    return write(images, path, LAYOUT, asked=True)


def _check(r: LaserImages, where: str) -> None:
    if not r.name:
        raise ClothbenchError(f"{where}: attribute 'name': found nothing, expected the recording's name")
    for name, shape in SHAPES.items():
        array = getattr(r, name)
        if array.shape != shape or not np.isfinite(array).all():
            found = f"found shape {array.shape}, expected {shape}, all finite"
            raise ClothbenchError(f"{where}: variable '{name}': {found}")
    if fault := matrix_fault(r.camera_matrix):
        raise ClothbenchError(f"{where}: variable 'camera_matrix': {fault}")
    if r.image.ndim != 3 or len(r.image) != len(r.time) or len(r.time) == 0 or min(r.image.shape[1:]) < SMALLEST:
        raise ClothbenchError(
            f"{where}: variable 'image': found shape {r.image.shape}, expected ({len(r.time)}, y, x), "
            f"at least {SMALLEST} pixels each way"
        )
    if not np.isfinite(r.time).all() or (np.diff(r.time) <= 0).any():
        raise ClothbenchError(f"{where}: variable 'time': expected strictly increasing seconds")
    turn = r.camera_rotation
    if not np.allclose(turn @ turn.T, np.eye(3), atol=1e-6) or np.linalg.det(turn) < 0:
        raise ClothbenchError(
            f"{where}: variable 'camera_rotation': found no rotation, expected R Rᵀ = 1 and det R = 1, no mirror"
        )
    if not np.isclose(np.linalg.norm(r.laser_plane[:3]), 1.0, atol=1e-6):
        raise ClothbenchError(f"{where}: variable 'laser_plane': expected a normal of length 1 before the distance")
