"""Recordings of kind "curve": the force with which a piece of cloth resists being stretched, on disk as NetCDF-4.

Same header as kind "nodes" (`clothbench.recordings.nodes`); what differs:

| name | dims | units | meaning |
|---|---|---|---|
| `stretch` | sample | 1 | distance of two tracked pins, or of the clamps, over the unloaded distance |
| `force` | sample | N | what the load cell showed |

Samples stand in the order of the measurement. Attributes: `format`, `format_version`, `kind`, `name`, `fabric`,
`direction` ("warp", "weft", "course", "wale" or "": the one along which it was pulled), `noise_sigma` [N, of one
sample; NaN = not known], `sample_width`, `sample_length` [m, unloaded, across and along the pull; NaN = not known, as
where a video has no scale: the ratio `stretch` needs none], `sensor`, `source`, `licence`, `declared_effects`, `motion`
("loading" where the sample was only ever pulled further), `split`.
"""

from __future__ import annotations

import hashlib
import math
import os
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from clothbench.core.files import whole_file
from clothbench.recordings.codec import FORMAT, VERSION, check_header, kind_of, number, open_file, variable
from clothbench.recordings.curve_rules import LAYOUT, check_curve
from clothbench.recordings.laser import LaserImages, read_laser
from clothbench.recordings.nodes import Recording, read_recording

NEEDED = ("name", "direction", "noise_sigma")
NUMBERS = ("noise_sigma", "sample_width", "sample_length")
TEXTS = ("name", "fabric", "direction", "sensor", "source", "licence", "declared_effects", "motion", "split")


@dataclass(frozen=True, eq=False)
class Curve:
    """Force over stretch of one run. Arrays are read-only.

    stretch: (M,), distance over the unloaded distance; force: (M,) N; noise_sigma: N, of one sample (NaN = not known);
    sample_width, sample_length: m, unloaded (NaN = not known). `path` is where it was read from, not part of its
    identity.
    """

    name: str
    stretch: np.ndarray
    force: np.ndarray
    fabric: str = ""
    direction: str = ""
    noise_sigma: float = math.nan
    sample_width: float = math.nan
    sample_length: float = math.nan
    sensor: str = ""
    source: str = ""
    licence: str = ""
    declared_effects: str = ""
    motion: str = "loading"
    split: str = ""
    notes: dict[str, str] = field(default_factory=dict)
    path: str = field(default="", compare=False)

    def __post_init__(self) -> None:
        for name in LAYOUT:
            array = np.array(getattr(self, name), dtype=float)
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        check_curve(self, self.path or self.name)

    @property
    def hash(self) -> str:
        """SHA-256 over everything measured and stated, whatever the file's encoding."""
        digest = hashlib.sha256()
        for name in LAYOUT:
            digest.update(name.encode() + np.ascontiguousarray(getattr(self, name)).tobytes())
        digest.update(repr(sorted(_attributes(self).items())).encode())
        return digest.hexdigest()


def read_curve(path: str | os.PathLike[str]) -> Curve:
    """Read and check one file; a fault raises `ClothbenchError` with file, variable, found, expected."""
    path = Path(path)
    dataset = open_file(path)
    try:
        check_header(dataset.attrs, path, "curve", NEEDED)
        arrays: dict[str, Any] = {name: variable(dataset, name, *LAYOUT[name], path) for name in LAYOUT}
        stated = dict(dataset.attrs)
    finally:
        dataset.close()
    known = {f.name for f in fields(Curve)} | {"format", "format_version", "kind"}
    content: dict[str, Any] = {name: str(stated.get(name, "")) for name in TEXTS}
    content |= {name: number(stated, name, path) for name in NUMBERS}
    notes = {str(k): str(v) for k, v in sorted(stated.items()) if k not in known}
    return Curve(**arrays, **content, notes=notes, path=str(path))


def write_curve(curve: Curve, path: str | os.PathLike[str]) -> Path:
    """Write one file, atomically: it is there whole or not at all."""
    import xarray as xr

    path = Path(path)
    variables = {
        name: xr.Variable(dims, getattr(curve, name), attrs={"units": unit}) for name, (dims, unit) in LAYOUT.items()
    }
    dataset = xr.Dataset(variables, attrs=_attributes(curve))
    encoding = {name: {"zlib": True, "_FillValue": None} for name in LAYOUT}
    with whole_file(path) as part:
        dataset.to_netcdf(part, engine="h5netcdf", encoding=encoding)
    return path


def read_any(path: str | os.PathLike[str]) -> Recording | Curve | LaserImages:
    """Read and check one recording of any kind."""
    kind = kind_of(Path(path))
    return read_curve(path) if kind == "curve" else read_laser(path) if kind == "laser" else read_recording(path)


def _attributes(curve: Curve) -> dict[str, Any]:
    header = {"format": FORMAT, "format_version": VERSION, "kind": "curve"}
    stated = {name: getattr(curve, name) for name in TEXTS}
    return {**curve.notes, **header, **stated, **{name: float(getattr(curve, name)) for name in NUMBERS}}
