"""The recording: one physical run as measured, on disk as NetCDF-4 (format `clothbench-recording`, version 1)."""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Iterable
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from clothbench.core.camera import Video
from clothbench.core.errors import ClothbenchError
from clothbench.core.files import whole_file
from clothbench.recordings.codec import FORMAT, VERSION, check_header, number, open_file, variable
from clothbench.recordings.nodes_rules import LAYOUT, check
from clothbench.recordings.video import ATTRIBUTES, DIMS, UNIT, read_video, video_attributes

NEEDED = ("name", "cloth_width", "cloth_height", "gravity", "noise_sigma")
NUMBERS = ("cloth_width", "cloth_height", "areal_density", "noise_sigma")
TEXTS = ("name", "fabric", "sensor", "source", "licence", "declared_effects", "motion")


@dataclass(frozen=True, eq=False)
class Recording:
    """Tracked material points of one run, with the grips that drove it. All SI, world frame, z up.

    time: (T,) s, strictly increasing; material: (N, 2) m, flat rest coordinates (u along the warp, v down);
    position: (T, N, 3) m, NaN where not seen; grip_time: (K,) s, the grips' own clock; grip_material: (G, 2) m;
    grip_position: (K, G, 3) m; cloth_width, cloth_height: m; areal_density: kg/m² (NaN = not known);
    gravity: (3,) m/s²; noise_sigma: m per coordinate; video: what a calibrated camera saw at the same times, or None.
    `path` is where it was read from, not part of its identity.
    """

    name: str
    time: np.ndarray
    material: np.ndarray
    position: np.ndarray
    grip_time: np.ndarray
    grip_material: np.ndarray
    grip_position: np.ndarray
    cloth_width: float
    cloth_height: float
    areal_density: float = math.nan
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    noise_sigma: float = math.nan
    fabric: str = ""
    sensor: str = ""
    source: str = ""
    licence: str = ""
    declared_effects: str = ""
    motion: str = ""
    split: str = ""
    notes: dict[str, str] = field(default_factory=dict)
    video: Video | None = None
    path: str = field(default="", compare=False)

    def __post_init__(self) -> None:
        for name in LAYOUT:
            array = np.ascontiguousarray(getattr(self, name), dtype=float)
            array = array.copy() if array is getattr(self, name) else array
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        check(self, self.path or self.name)

    @property
    def visible(self) -> np.ndarray:
        """Which nodes were seen in which frame, (T, N) bool."""
        return np.isfinite(self.position).all(axis=-1)

    @property
    def hash(self) -> str:
        """SHA-256 over everything measured and stated, whatever the file's encoding."""
        digest = hashlib.sha256()
        for name in LAYOUT:
            digest.update(name.encode() + np.ascontiguousarray(getattr(self, name)).tobytes())
        if self.video is not None:
            digest.update(b"frame" + np.ascontiguousarray(self.video.frame).tobytes())
        digest.update(repr(sorted(_attributes(self).items())).encode())
        return digest.hexdigest()


def read_recording(path: str | os.PathLike[str]) -> Recording:
    """Read and check one file; a fault raises `ClothbenchError` with file, variable, found, expected."""
    path = Path(path)
    dataset = open_file(path)
    try:
        check_header(dataset.attrs, path, "nodes", NEEDED)
        arrays: dict[str, Any] = {name: variable(dataset, name, *LAYOUT[name], path) for name in LAYOUT}
        stated, video = dict(dataset.attrs), read_video(dataset, path)
    finally:
        dataset.close()
    gravity = _gravity(stated.get("gravity"), path)
    known = {f.name for f in fields(Recording)} | {"format", "format_version", "kind", *ATTRIBUTES}
    content: dict[str, Any] = {name: str(stated.get(name, "")) for name in (*TEXTS, "split")}
    content |= {name: number(stated, name, path) for name in NUMBERS}
    notes = {str(k): str(v) for k, v in sorted(stated.items()) if k not in known}
    return Recording(**arrays, **content, gravity=gravity, notes=notes, video=video, path=str(path))


def write_recording(recording: Recording, path: str | os.PathLike[str]) -> Path:
    """Write one file, atomically: it is there whole or not at all."""
    import xarray as xr

    path = Path(path)
    variables = {}
    for name, (dims, unit) in LAYOUT.items():
        variables[name] = xr.Variable(dims, getattr(recording, name), attrs={"units": unit})
    encoding: dict[str, Any] = {name: {"zlib": True, "_FillValue": None} for name in ("position", "grip_position")}
    if recording.video is not None:
        variables["frame"] = xr.Variable(DIMS, recording.video.frame, attrs={"units": UNIT})
        encoding["frame"] = {"zlib": True, "complevel": 9}
    dataset = xr.Dataset(variables, attrs=_attributes(recording))
    with whole_file(path) as part:
        dataset.to_netcdf(part, engine="h5netcdf", encoding=encoding)
    return path


def find_recordings(paths: Iterable[str | os.PathLike[str]]) -> list[Path]:
    """The recording files named, or lying in the folders named, sorted; an empty find is an error."""
    found: list[Path] = []
    for path in map(Path, paths):
        if path.is_dir():
            # Hidden folders are what a killed import left behind.
            inside = sorted(
                p for p in path.rglob("*.nc") if not any(x.startswith(".") for x in p.relative_to(path).parts)
            )
            if not inside:
                raise ClothbenchError(f"{path}: found no recordings, expected files ending in .nc in this folder")
            found += inside
        elif path.exists():
            found.append(path)
        else:
            raise ClothbenchError(f"{path}: no such file or folder; give a recording (.nc) or a folder of them")
    return found


def _attributes(recording: Recording) -> dict[str, Any]:
    stated = {name: getattr(recording, name) for name in (*TEXTS, "split")}
    numbers = {n: float(getattr(recording, n)) for n in NUMBERS}
    gravity = " ".join(repr(float(g)) for g in recording.gravity)
    header = {"format": FORMAT, "format_version": VERSION, "kind": "nodes", "gravity": gravity}
    seen = video_attributes(recording.video) if recording.video is not None else {}
    return {**recording.notes, **header, **stated, **numbers, **seen}


def _gravity(text: Any, path: Path) -> tuple[float, float, float]:
    try:
        x, y, z = (float(part) for part in str(text).split())
    except ValueError:
        raise ClothbenchError(
            f"{path}: attribute 'gravity': found {text!r}, expected three numbers like '0 0 -9.81' [m/s²]"
        ) from None
    return x, y, z
