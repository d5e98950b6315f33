"""Recording files of every kind: the header they share, and variables read with their dimensions and units checked."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from clothbench.core.errors import ClothbenchError

FORMAT, VERSION = "clothbench-recording", 1
HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"


def open_file(path: Path):
    """The file as an xarray dataset; the caller closes it."""
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


def kind_of(path: Path) -> str:
    """The kind that a recording file states: "nodes", "curve", or another one that cannot be read yet."""
    dataset = open_file(path)
    try:
        return str(dataset.attrs.get("kind", ""))
    finally:
        dataset.close()


def check_header(stated: Mapping[str, Any], path: Path, kind: str, needed: Sequence[str]) -> None:
    """Format, version and kind are as expected, and no attribute in `needed` is missing."""
    if stated.get("format") != FORMAT:
        raise ClothbenchError(f"{path}: attribute 'format': found {stated.get('format')!r}, expected {FORMAT!r}")
    version = stated.get("format_version")
    if version != VERSION:
        raise ClothbenchError(
            f"{path}: attribute 'format_version': found {version}, expected {VERSION}; "
            "upgrade clothbench or convert the file"
        )
    if stated.get("kind") != kind:
        hint = "; curves go to `clothbench improve`, in a folder of their own" if stated.get("kind") == "curve" else ""
        raise ClothbenchError(f"{path}: attribute 'kind': found {stated.get('kind')!r}, expected {kind!r}{hint}")
    for name in needed:
        if name not in stated:
            raise ClothbenchError(f"{path}: attribute {name!r} is missing; add it to the file's header")


def variable(dataset, name: str, dims: tuple[str, ...], unit: str, path: Path) -> np.ndarray:
    """One variable as float64, its dimensions and unit as the format has them."""
    if name not in dataset.variables:
        raise ClothbenchError(f"{path}: variable '{name}' is missing, expected {name}({', '.join(dims)}) in {unit}")
    found = dataset.variables[name]
    if tuple(found.dims) != dims or not np.issubdtype(found.dtype, np.number):
        what = f"{found.dtype} with dimensions ({', '.join(map(str, found.dims))})"
        raise ClothbenchError(f"{path}: variable '{name}': found {what}, expected numbers ({', '.join(dims)})")
    found_unit = found.attrs.get("units")
    if found_unit != unit:
        raise ClothbenchError(
            f"{path}: variable '{name}': found units {found_unit!r}, expected {unit!r}; "
            "convert the values and the attribute"
        )
    return np.asarray(found.values, dtype=float)


def number(stated: Mapping[str, Any], name: str, path: Path) -> float:
    """An attribute that is a number; NaN where it is not stated."""
    try:
        return float(stated.get(name, math.nan))
    except (TypeError, ValueError):
        raise ClothbenchError(f"{path}: attribute '{name}': found {stated[name]!r}, expected a number") from None
