"""Recording files of every kind: read, written and hashed from the tables that state a kind's layout.

A file is NetCDF-4 (HDF5). Its header, the same for all kinds, are the global attributes `format`
("clothbench-recording"), `format_version` (1) and `kind`; the other attributes and the variables are the kind's own.
Each variable states its unit in an attribute `units`. An attribute that a kind does not know is kept as a note.
"""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.files import whole_file
from clothbench.recordings.layout import Layout, Stated, Variable

FORMAT, VERSION = "clothbench-recording", 1
DEFLATE = 1032  # times smaller at best: zlib, whose blocks of zeros pack no denser
UNSUSPICIOUS = 100_000_000  # bytes of an array that are nobody's memory problem
HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"

Record = TypeVar("Record")


def freeze(record: Any, layout: Layout) -> None:
    """Give a frozen record arrays of its own that are read-only, of the layout's types."""
    for name, of in layout.variables.items():
        array: np.ndarray = np.array(getattr(record, name), dtype=of.dtype, order="C")
        array.flags.writeable = False
        object.__setattr__(record, name, array)


def hash_of(record: Any, layout: Layout) -> str:
    """SHA-256 over everything measured and stated, whatever the file's encoding and wherever it lies."""
    arrays, stated = _content(record, layout)
    text = repr(sorted(stated.items())).encode()
    digest = hashlib.sha256(text if layout.stated_first else b"")
    for name, array in arrays.items():
        digest.update(name.encode() + np.ascontiguousarray(array).tobytes())
    digest.update(b"" if layout.stated_first else text)
    return digest.hexdigest()


def read(path: str | os.PathLike[str], layout: Layout, make: Callable[..., Record]) -> Record:
    """Read one file and make its record, which checks it; faults raise `ClothbenchError`: file, field, found, expected.

    make: the record's class, called with all its fields by name.
    """
    path = Path(path)
    dataset = open_file(path)
    try:
        stated = dict(dataset.attrs)
        check_header(stated, path, layout.kind, layout.needed)
        content: dict[str, Any] = {name: variable(dataset, name, of, path) for name, of in layout.variables.items()}
        for name, part in layout.parts.items():
            there = {n: variable(dataset, n, of, path) for n, of in part.variables.items() if n in dataset.variables}
            content[name] = part.unpack(there, stated, path)
    finally:
        dataset.close()
    content |= {name: _vector(stated.get(name), name, what, path) for name, what in layout.vectors.items()}
    content |= {name: str(stated.get(name, "")) for name in layout.texts}
    content |= {name: number(stated, name, path) for name in layout.numbers}
    notes = {str(k): str(v) for k, v in sorted(stated.items()) if k not in layout.known}
    return make(**content, notes=notes, path=str(path))


def write(record: Any, path: str | os.PathLike[str], layout: Layout) -> Path:
    """Write one file, atomically: it is there whole or not at all."""
    import xarray as xr

    path = Path(path)
    arrays, stated = _content(record, layout)
    tables = {**layout.variables, **{name: of for part in layout.parts.values() for name, of in part.variables.items()}}
    variables = {n: xr.Variable(tables[n].dims, array, attrs={"units": tables[n].unit}) for n, array in arrays.items()}
    encoding = {
        n: {"zlib": True, "complevel": tables[n].level, "_FillValue": None}
        for n in arrays
        if tables[n].level is not None
    }
    with whole_file(path) as part:
        xr.Dataset(variables, attrs=stated).to_netcdf(part, engine="h5netcdf", encoding=encoding)
    return path


def _content(record: Any, layout: Layout) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """A record's arrays and attributes as they stand in its file, the parts' last."""
    arrays = {name: getattr(record, name) for name in layout.variables}
    stated = {**record.notes, "format": FORMAT, "format_version": VERSION, "kind": layout.kind}
    stated |= {name: " ".join(repr(float(v)) for v in getattr(record, name)) for name in layout.vectors}
    stated |= {name: getattr(record, name) for name in layout.texts}
    stated |= {name: float(getattr(record, name)) for name in layout.numbers}
    for name, part in layout.parts.items():
        if (value := getattr(record, name)) is not None:
            more, said = part.pack(value)
            arrays |= more
            stated |= said
    return arrays, stated


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


def check_header(stated: Stated, path: Path, kind: str, needed: Sequence[str]) -> None:
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


def variable(dataset, name: str, of: Variable, path: Path) -> np.ndarray:
    """One variable of an open file, its dimensions, unit and values as the layout has them."""
    dims = ", ".join(of.dims)
    if name not in dataset.variables:
        raise ClothbenchError(f"{path}: variable '{name}' is missing, expected {name}({dims}) in {of.unit}")
    found = dataset.variables[name]
    fits = found.dtype == of.dtype if of.exact else np.issubdtype(found.dtype, np.number)
    if tuple(found.dims) != of.dims or not fits:
        what = f"{found.dtype} with dimensions ({', '.join(map(str, found.dims))})"
        wanted = np.dtype(of.dtype).name if of.exact else "numbers"
        raise ClothbenchError(f"{path}: variable '{name}': found {what}, expected {wanted} ({dims})")
    unit = found.attrs.get("units")
    if unit != of.unit:
        hint = "" if of.exact else "; convert the values and the attribute"
        raise ClothbenchError(f"{path}: variable '{name}': found units {unit!r}, expected {of.unit!r}{hint}")
    require_possible(found.shape, found.dtype, name, path)
    return _converted(np.asarray(found.values), name, of, path)


def require_possible(shape: Sequence[int], dtype: np.dtype, name: str, path: Path) -> None:
    """Refuse an array that is far larger than what its file can hold, before memory is taken for it: a header may claim
    anything.
    """
    size, held = math.prod(shape) * dtype.itemsize, path.stat().st_size
    if size > max(UNSUSPICIOUS, DEFLATE * held):
        raise ClothbenchError(
            f"{path}: variable '{name}': found a claim of {' × '.join(map(str, shape))} values ({size / 1e9:.3g} GB) "
            f"in a file of {held} bytes, expected at most what such a file can hold; write the values as well"
        )


def _converted(values: np.ndarray, name: str, of: Variable, path: Path) -> np.ndarray:
    """Numbers as the layout's type; whole numbers must be whole and within its range, nothing is rounded or clipped."""
    if np.issubdtype(of.dtype, np.integer) and values.dtype != of.dtype:
        least, most = np.iinfo(of.dtype).min, np.iinfo(of.dtype).max
        if not np.array_equal(values, np.clip(np.round(values), least, most)):
            raise ClothbenchError(
                f"{path}: variable '{name}': found other values than whole numbers from {least} to {most}"
            )
    return np.asarray(values, dtype=of.dtype)


def number(stated: Stated, name: str, path: Path) -> float:
    """An attribute that is a number; NaN where it is not stated."""
    try:
        return float(stated.get(name, math.nan))
    except (TypeError, ValueError):
        raise ClothbenchError(f"{path}: attribute '{name}': found {stated[name]!r}, expected a number") from None


def _vector(text: Any, name: str, expected: str, path: Path) -> tuple[float, float, float]:
    try:
        x, y, z = (float(part) for part in str(text).split())
    except ValueError:
        raise ClothbenchError(f"{path}: attribute '{name}': found {text!r}, expected {expected}") from None
    return x, y, z
