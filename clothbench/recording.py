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

FORMAT, VERSION = "clothbench-recording", 1
SPLITS = ("fit", "held_out", "")
HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"

# variable: (dimensions, unit)
LAYOUT: dict[str, tuple[tuple[str, ...], str]] = {
    "time": (("time",), "s"),
    "material": (("node", "uv"), "m"),
    "position": (("time", "node", "space"), "m"),
    "grip_time": (("grip_time",), "s"),
    "grip_material": (("grip", "uv"), "m"),
    "grip_position": (("grip_time", "grip", "space"), "m"),
}
SIZES = {"uv": 2, "space": 3}
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
        _check(self, self.path or self.name)

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
        arrays = {name: _variable(dataset, name, path) for name in LAYOUT}
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
            inside = sorted(path.rglob("*.nc"))
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
    gravity = " ".join(f"{g:g}" for g in recording.gravity)
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
        return xr.open_dataset(path, engine="h5netcdf", decode_times=False, mask_and_scale=True)
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
    if str(version) != str(VERSION):
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
    if variable.ndim != len(dims) or not np.issubdtype(variable.dtype, np.number):
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


def _check(r: Recording, where: str) -> None:
    """Every rule of the format, in the order in which a reader would trip over it."""
    _check_shapes(r, where)
    _check_clock(r.time, "time", where)
    _check_clock(r.grip_time, "grip_time", where)
    _check_values(r, where)
    _check_cloth(r, where)
    _check_overlap(r, where)


def _check_shapes(r: Recording, where: str) -> None:
    sizes: dict[str, tuple[str, int]] = {}
    for name, (dims, _) in LAYOUT.items():
        shape = getattr(r, name).shape
        if len(shape) != len(dims):
            raise ClothbenchError(f"{where}: variable '{name}': found shape {shape}, expected ({', '.join(dims)})")
        for dim, size in zip(dims, shape, strict=True):
            if dim in SIZES and size != SIZES[dim]:
                raise ClothbenchError(f"{where}: variable '{name}': found {size} along '{dim}', expected {SIZES[dim]}")
            if size == 0:
                raise ClothbenchError(
                    f"{where}: variable '{name}': found no entries along '{dim}', expected at least one"
                )
            first, known = sizes.setdefault(dim, (name, size))
            if known != size:
                raise ClothbenchError(
                    f"{where}: variable '{name}': found {size} along '{dim}', expected {known} as in '{first}'"
                )


def _check_clock(time: np.ndarray, name: str, where: str) -> None:
    if time.size < 2:
        raise ClothbenchError(f"{where}: variable '{name}': found {time.size} stamp, expected at least 2")
    if not np.isfinite(time).all():
        raise ClothbenchError(f"{where}: variable '{name}': found a stamp that is not finite, expected seconds")
    back = np.flatnonzero(np.diff(time) <= 0)
    if back.size:
        i = int(back[0])
        raise ClothbenchError(
            f"{where}: variable '{name}': found {time[i + 1]:g} s after {time[i]:g} s at index {i + 1}, "
            "expected strictly increasing; sort or drop these frames"
        )


def _check_values(r: Recording, where: str) -> None:
    infinite = np.argwhere(np.isinf(r.position))
    if infinite.size:
        t, n, _ = infinite[0]
        raise ClothbenchError(
            f"{where}: variable 'position': found {len(infinite)} infinite values, the first at frame {t}, node {n}, "
            "expected metres or NaN (not seen)"
        )
    for name in ("grip_position", "material", "grip_material"):
        bad = np.argwhere(~np.isfinite(getattr(r, name)))
        if bad.size:
            at = tuple(int(i) for i in bad[0])
            raise ClothbenchError(
                f"{where}: variable '{name}': found a value that is not finite at {at}, expected metres"
            )
    if not np.isfinite(r.position).any():
        raise ClothbenchError(f"{where}: variable 'position': found only NaN, expected at least one node seen")


def _check_cloth(r: Recording, where: str) -> None:
    for name in ("cloth_width", "cloth_height"):
        value = getattr(r, name)
        if not (math.isfinite(value) and value > 0):
            raise ClothbenchError(f"{where}: attribute '{name}': found {value}, expected metres above 0")
    if r.areal_density <= 0 or math.isinf(r.areal_density):
        raise ClothbenchError(
            f"{where}: attribute 'areal_density': found {r.areal_density}, expected kg/m² above 0, or NaN"
        )
    if r.noise_sigma < 0 or math.isinf(r.noise_sigma):
        raise ClothbenchError(f"{where}: attribute 'noise_sigma': found {r.noise_sigma}, expected metres, 0 or above")
    if r.split not in SPLITS:
        raise ClothbenchError(f"{where}: attribute 'split': found {r.split!r}, expected 'fit', 'held_out' or ''")
    size = np.array([r.cloth_width, r.cloth_height])
    slack = 0.02 * size  # markers and clamps may stand a little over the hem
    for name in ("material", "grip_material"):
        points = getattr(r, name)
        outside = np.flatnonzero(((points < -slack) | (points > size + slack)).any(axis=1))
        if outside.size:
            u, v = points[outside[0]]
            raise ClothbenchError(
                f"{where}: variable '{name}': found ({u:g}, {v:g}) m at row {outside[0]}, "
                f"expected inside the {size[0]:g} m × {size[1]:g} m cloth"
            )
        _, first, counts = np.unique(points.round(9), axis=0, return_index=True, return_counts=True)
        if (counts > 1).any():
            row = int(first[counts > 1].min())
            raise ClothbenchError(
                f"{where}: variable '{name}': found row {row} {int(counts[counts > 1].max())} times "
                f"(the same material point), expected every point once; drop the repeats"
            )


def _check_overlap(r: Recording, where: str) -> None:
    covered = np.mean((r.time >= r.grip_time[0] - 1e-9) & (r.time <= r.grip_time[-1] + 1e-9))
    if covered < 0.9:
        raise ClothbenchError(
            f"{where}: variable 'grip_time': found {r.grip_time[0]:g}..{r.grip_time[-1]:g} s, "
            f"which covers {covered:.0%} of the "
            f"frames, expected to cover 'time' {r.time[0]:g}..{r.time[-1]:g} s; "
            "put both on one clock or cut the recording"
        )
