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

from clothbench.errors import ClothbenchError
from clothbench.files import whole_file
from clothbench.recording_rules import LAYOUT, check

FORMAT, VERSION = "clothbench-recording", 1
HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"

NUMBERS = ("cloth_width", "cloth_height", "areal_density", "noise_sigma")
TEXTS = ("name", "fabric", "sensor", "source", "licence", "declared_effects", "motion")


@dataclass(frozen=True, eq=False)
class Recording:
    """Tracked material points of one run, with the grips that drove it. All SI, world frame, z up.

    time: (T,) s, strictly increasing; material: (N, 2) m, flat rest coordinates (u along the warp, v down);
    position: (T, N, 3) m, NaN where not seen; grip_time: (K,) s, the grips' own clock; grip_material: (G, 2) m;
    grip_position: (K, G, 3) m; cloth_width, cloth_height: m; areal_density: kg/m² (NaN = not known);
    gravity: (3,) m/s²; noise_sigma: m per coordinate. `path` is where it was read from, not part of its identity.
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
        digest.update(repr(sorted(_attributes(self).items())).encode())
        return digest.hexdigest()


def read_recording(path: str | os.PathLike[str]) -> Recording:
    """Read and check one file; a fault raises `ClothbenchError` with file, variable, found, expected."""
    path = Path(path)
    dataset = _open(path)
    try:
        _check_header(dataset.attrs, path)
        arrays: dict[str, Any] = {name: _variable(dataset, name, path) for name in LAYOUT}
        stated = dict(dataset.attrs)
    finally:
        dataset.close()
    gravity = _gravity(stated.get("gravity"), path)
    known = {f.name for f in fields(Recording)} | {"format", "format_version", "kind"}
    content: dict[str, Any] = {name: str(stated.get(name, "")) for name in (*TEXTS, "split")}
    content |= {name: _number(stated, name, path) for name in NUMBERS}
    notes = {str(k): str(v) for k, v in sorted(stated.items()) if k not in known}
    return Recording(**arrays, **content, gravity=gravity, notes=notes, path=str(path))


def write_recording(recording: Recording, path: str | os.PathLike[str]) -> Path:
    """Write one file, atomically: it is there whole or not at all."""
    import xarray as xr

    path = Path(path)
    variables = {}
    for name, (dims, unit) in LAYOUT.items():
        variables[name] = xr.Variable(dims, getattr(recording, name), attrs={"units": unit})
    dataset = xr.Dataset(variables, attrs=_attributes(recording))
    encoding = {name: {"zlib": True, "_FillValue": None} for name in ("position", "grip_position")}
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
    return {**recording.notes, **header, **stated, **numbers}


def _open(path: Path):
    import xarray as xr

    if not path.is_file():
        raise ClothbenchError(f"{path}: no such file; give a recording (.nc)")
    with open(path, "rb") as stream:
        start = stream.read(8)
    if start != HDF5_MAGIC:
        raise ClothbenchError(
            f"{path}: found a file that starts with {start!r}, expected NetCDF-4 (HDF5); convert it first"
        )
    try:
        return xr.open_dataset(path, engine="h5netcdf", decode_times=False, mask_and_scale=True, phony_dims="access")
    except (OSError, ValueError, KeyError, RuntimeError) as fault:
        size = path.stat().st_size
        what = "a truncated file" if "truncated" in str(fault) else f"an unreadable file ({str(fault).splitlines()[0]})"
        raise ClothbenchError(
            f"{path}: found {what} of {size} bytes, expected whole NetCDF-4; copy it again"
        ) from fault


def _check_header(stated: dict[str, Any], path: Path) -> None:
    if stated.get("format") != FORMAT:
        raise ClothbenchError(f"{path}: attribute 'format': found {stated.get('format')!r}, expected {FORMAT!r}")
    version = stated.get("format_version")
    if version != VERSION:
        raise ClothbenchError(
            f"{path}: attribute 'format_version': found {version}, expected {VERSION}; "
            "upgrade clothbench or convert the file"
        )
    if stated.get("kind") != "nodes":
        raise ClothbenchError(f"{path}: attribute 'kind': found {stated.get('kind')!r}, expected 'nodes'")
    for name in ("name", "cloth_width", "cloth_height", "gravity", "noise_sigma"):
        if name not in stated:
            raise ClothbenchError(f"{path}: attribute {name!r} is missing; add it to the file's header")


def _variable(dataset, name: str, path: Path) -> np.ndarray:
    dims, unit = LAYOUT[name]
    if name not in dataset.variables:
        raise ClothbenchError(f"{path}: variable '{name}' is missing, expected {name}({', '.join(dims)}) in {unit}")
    variable = dataset.variables[name]
    if tuple(variable.dims) != dims or not np.issubdtype(variable.dtype, np.number):
        found = f"{variable.dtype} with dimensions ({', '.join(map(str, variable.dims))})"
        raise ClothbenchError(f"{path}: variable '{name}': found {found}, expected numbers ({', '.join(dims)})")
    found_unit = variable.attrs.get("units")
    if found_unit != unit:
        raise ClothbenchError(
            f"{path}: variable '{name}': found units {found_unit!r}, expected {unit!r}; "
            "convert the values and the attribute"
        )
    return np.asarray(variable.values, dtype=float)


def _gravity(text: Any, path: Path) -> tuple[float, float, float]:
    try:
        x, y, z = (float(part) for part in str(text).split())
    except ValueError:
        raise ClothbenchError(
            f"{path}: attribute 'gravity': found {text!r}, expected three numbers like '0 0 -9.81' [m/s²]"
        ) from None
    return x, y, z


def _number(stated: dict[str, Any], name: str, path: Path) -> float:
    try:
        return float(stated.get(name, math.nan))
    except (TypeError, ValueError):
        raise ClothbenchError(f"{path}: attribute '{name}': found {stated[name]!r}, expected a number") from None
