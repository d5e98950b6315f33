"""Recording files of every kind: read, written and hashed from the tables that state a kind's layout.

A file is NetCDF-4 (HDF5). Its header, the same for all kinds, are the global attributes `format`
("clothbench-recording"), `format_version` (1) and `kind`; the other attributes and the variables are the kind's own.
Each variable states its unit in an attribute `units`. An attribute that a kind does not know is kept as a note, a
variable is passed over, unless it is nearly one that the file lacks.
"""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from clothbench.core.errors import ClothbenchError, misspelled
from clothbench.core.files import whole_file
from clothbench.recordings.layout import KINDS, Layout, Stated, Variable
from clothbench.recordings.netcdf import NetCDF, opened

FORMAT, VERSION = "clothbench-recording", 1

Record = TypeVar("Record")


def freeze(record: Any, layout: Layout) -> None:
    """Give a frozen record arrays of its own that are read-only, of the layout's types."""
    for name, of in layout.variables.items():
        values = np.asarray(getattr(record, name))
        if np.issubdtype(of.dtype, np.integer) and values.dtype.kind in "iuf":
            values = _converted(values, name, of, record.path or record.name)
        array: np.ndarray = np.array(values, dtype=of.dtype, order="C")
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
    with opened(path) as file:
        stated = file.attributes
        check_header(stated, path, layout)
        require_no_misspelling("variable", file.names, layout.arrays, path)
        content: dict[str, Any] = {name: variable(file, name, of) for name, of in layout.variables.items()}
        there = {
            name: {n: variable(file, n, of) for n, of in part.variables.items() if n in file}
            for name, part in layout.parts.items()
        }
    content |= {name: _vector(stated.get(name), name, what, path) for name, what in layout.vectors.items()}
    content |= {name: str(stated.get(name, "")) for name in layout.texts}
    content |= {name: number(stated, name, path) for name in layout.numbers}
    notes = {str(k): str(v) for k, v in sorted(stated.items()) if k not in layout.known}
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # the rules refuse what is not finite, in words
        content |= {name: part.unpack(there[name], stated, path) for name, part in layout.parts.items()}
        return make(**content, notes=notes, path=str(path))


def write(record: Any, path: str | os.PathLike[str], layout: Layout, asked: bool = False) -> Path:
    """Write one file, atomically: it is there whole or not at all. asked: as of `whole_file`: whether somebody named
    this very file, which is then written through a link.
    """
    import xarray as xr

    path = Path(path)
    arrays, stated = _content(record, layout)
    require_no_misspelling("attribute", stated, layout.attributes, path, layout.known)  # it could not be read again
    tables = {**layout.variables, **{name: of for part in layout.parts.values() for name, of in part.variables.items()}}
    variables = {n: xr.Variable(tables[n].dims, array, attrs={"units": tables[n].unit}) for n, array in arrays.items()}
    encoding = {
        n: {"zlib": True, "complevel": tables[n].level, "_FillValue": None}
        for n in arrays
        if tables[n].level is not None
    }
    with whole_file(path, asked=asked) as part:
        xr.Dataset(variables, attrs=stated).to_netcdf(part, engine="h5netcdf", encoding=encoding)
    return path


def _content(record: Any, layout: Layout) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """A record's arrays and attributes as they stand in its file, the parts' last."""
    arrays = {name: getattr(record, name) for name in layout.variables}
    if taken := sorted(layout.known & set(record.notes)):  # it would be read as a field, or not at all
        raise ClothbenchError(
            f"{record.path or record.name}: note {taken[0]!r}: found a word that recordings of kind {layout.kind!r} "
            "have for something else, expected another one; rename the note"
        )
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


def kind_of(path: Path) -> str:
    """The kind that a recording file states: "nodes", "curve", or another one that cannot be read yet."""
    return stated_in(path, "kind")


def stated_in(path: Path, name: str) -> str:
    """What the header of a recording file states under a name, "" where that is nothing; no array is read."""
    with opened(path) as file:
        return str(file.attributes.get(name, ""))


def check_header(stated: Stated, path: Path, layout: Layout) -> None:
    """Format, version and kind are as expected, no attribute is one that is missing, misspelled, and none that a file
    must state is missing.
    """
    if stated.get("format") != FORMAT:
        raise ClothbenchError(f"{path}: attribute 'format': found {stated.get('format')!r}, expected {FORMAT!r}")
    version = stated.get("format_version")
    if version != VERSION:
        if str(version) == str(VERSION):
            found, remedy = f"the text {version!r}", "write it as a number"
        else:
            found, remedy = str(version), "upgrade clothbench or convert the file"
        raise ClothbenchError(
            f"{path}: attribute 'format_version': found {found}, expected the number {VERSION}; {remedy}"
        )
    if stated.get("kind") != layout.kind:
        kind = stated.get("kind")
        hint = "; curves go to `clothbench improve`, in a folder of their own" if kind == "curve" else ""
        expected = repr(layout.kind) if kind in KINDS else f"one of {', '.join(map(repr, KINDS))}"
        raise ClothbenchError(f"{path}: attribute 'kind': found {kind!r}, expected {expected}{hint}")
    require_no_misspelling("attribute", stated, layout.attributes, path, layout.known)
    for name in layout.needed:
        if name not in stated:
            raise ClothbenchError(f"{path}: attribute {name!r} is missing; add it to the file's header")


def require_no_misspelling(
    what: str, there: Iterable[str], stateable: Iterable[str], path: Path, known: Iterable[str] = ()
) -> None:
    """Refuse an attribute or a variable, which `what` says, that would be a note or nothing at all though it is nearly
    one that may be stated and is not. known: other names that mean something.
    """
    found, may = set(there), set(stateable)
    if near := misspelled(found - may - set(known), may - found):
        raise ClothbenchError(
            f"{path}: {what} {near[0]!r}: expected {near[1]!r}, which the file lacks; rename it (whatever else it is "
            "needs a name less like that)"
        )


def variable(file: NetCDF, name: str, of: Variable) -> np.ndarray:
    """One variable of an open file, its dimensions, unit and values as the layout has them."""
    dims, path = ", ".join(of.dims), file.path
    if name not in file:
        raise ClothbenchError(f"{path}: variable '{name}' is missing, expected {name}({dims}) in {of.unit}")
    found = file.variable(name)
    native = found.dtype.newbyteorder("=")  # either order of bytes holds the same numbers
    fits = native == of.dtype if of.exact else native.kind in "iuf"
    if of.exact and found.packed and found.stored.newbyteorder("=") == of.dtype:
        raise ClothbenchError(
            f"{path}: variable '{name}': found an attribute {found.packed[0]!r}, expected none: its {found.stored} are "
            "taken as they stand; write them without it"
        )
    if found.dims != of.dims or not fits:
        what = f"{found.dtype} with dimensions ({', '.join(found.dims)})"
        wanted = np.dtype(of.dtype).name if of.exact else "numbers"
        raise ClothbenchError(f"{path}: variable '{name}': found {what}, expected {wanted} ({dims})")
    if found.unit != of.unit:
        hint = "" if of.exact else "; convert the values and the attribute"
        raise ClothbenchError(f"{path}: variable '{name}': found units {found.unit!r}, expected {of.unit!r}{hint}")
    return _converted(found.values(), name, of, path)


def _converted(values: np.ndarray, name: str, of: Variable, path: Path | str) -> np.ndarray:
    """Numbers as the layout's type; whole numbers must be whole and within its range, nothing is rounded or clipped."""
    if np.issubdtype(of.dtype, np.integer) and values.dtype != of.dtype:
        with np.errstate(invalid="ignore"):  # what does not fit comes back as another number
            fits = np.array_equal(values.astype(of.dtype), values)
        if not fits:
            least, most = np.iinfo(of.dtype).min, np.iinfo(of.dtype).max
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
