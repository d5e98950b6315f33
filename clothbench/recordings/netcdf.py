"""NetCDF-4 files as anybody may hand them in, read with HDF5's own means and nothing taken on trust.

Only plain arrays of numbers that lie in the file itself are read, each once it is asked for; links, data that lie
elsewhere, groups, references and compound types are refused. Whatever the library says of a broken file becomes one
line.
"""

from __future__ import annotations

import math
import mmap
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from clothbench.core.errors import ClothbenchError, seen

MAGIC = b"\x89HDF\r\n\x1a\n"
DEFLATE = 1032  # times smaller at best: zlib, whose blocks of zeros pack no denser
UNSUSPICIOUS = 100_000_000  # bytes of an array that are nobody's memory problem
MOST = 65536  # values of an attribute
HEAP = b"GCOL\x01\0\0\0"  # begins each of its heaps of texts
RESERVED = ("_NCProperties", "_nc3_strict", "_Netcdf4Coordinates", "_Netcdf4Dimid", "CLASS", "NAME", "REFERENCE_LIST",
            "DIMENSION_LIST", "DIMENSION_LABELS", "coordinates")  # fmt: skip
MASKS, SCALES = ("_FillValue", "missing_value"), ("scale_factor", "add_offset")


class NetCDF:
    """An open file. attributes: texts and numbers, but for what NetCDF itself keeps there."""

    def __init__(self, file: Any, path: Path):
        self._file, self.path = file, path
        self.attributes = {name: _plain(file.attrs, name, path) for name in file.attrs if name not in RESERVED}

    def __contains__(self, name: str) -> bool:
        return name in self._file and not _only_a_dimension(self._file, name)

    @property
    def names(self) -> set[str]:
        """Of all that is no mere dimension."""
        return {name for name in self._file if name in self}

    def variable(self, name: str) -> Array:
        """What is said of an array of this name; its values are read when they are asked for."""
        import h5py

        link = self._file.get(name, getlink=True)
        data = self._file[name] if isinstance(link, h5py.HardLink) else None
        if not isinstance(data, h5py.Dataset) or data.is_virtual or data.external:
            raise ClothbenchError(
                f"{self.path}: variable '{name}': found a link, a group or values that lie in another file, expected "
                "an array in this one; copy the values into it"
            )
        return Array(self._file, data, name, self.path)


class Array:
    """An array of an open file: dims, shape and dtype as they come when it is read, stored: its dtype in the file; unit
    None where none is stated.
    """

    def __init__(self, file: Any, data: Any, name: str, path: Path):
        self._data, self.name, self.path = data, name, path
        self.shape = tuple(data.shape or ())
        self.unit = _plain(data.attrs, "units", path) if "units" in data.attrs else None
        self.stored = data.dtype
        self._packing = {n: self._number(n) for n in (*MASKS, *SCALES) if n in data.attrs}
        self.dtype = np.dtype(float) if self._packing and data.dtype.kind in "iuf" else data.dtype
        self.dims = _dims(file, data, name)

    @property
    def packed(self) -> tuple[str, ...]:
        """The attributes by which its values become others when it is read."""
        return tuple(self._packing)

    def _number(self, name: str) -> float:
        value = _plain(self._data.attrs, name, self.path)
        if isinstance(value, str):
            raise ClothbenchError(
                f"{self.path}: variable '{self.name}': attribute {name!r}: found {value!r}, expected a number"
            )
        return float(value)

    def values(self) -> np.ndarray:
        """The numbers, packed ones unpacked, NaN where the file has its mark for nothing; one that claims far more than
        the file can hold is refused before memory is taken for it.
        """
        require_possible(self.shape, self.dtype, self.name, self.path)
        stored = np.asarray(self._data[()])
        if not self._packing:
            return stored
        nothing = np.isin(stored, [self._packing[n] for n in MASKS if n in self._packing]) | (stored != stored)
        with np.errstate(over="ignore", invalid="ignore"):  # what is not finite then is refused by the kind's rules
            scaled = stored * self._packing.get("scale_factor", 1.0) + self._packing.get("add_offset", 0.0)
        return np.where(nothing, np.nan, scaled)


@contextmanager
def opened(path: Path) -> Iterator[NetCDF]:
    """The file, open for reading."""
    import h5py

    if not path.is_file():
        raise ClothbenchError(f"{path}: no such file; give a recording (.nc)")
    try:
        with open(path, "rb") as stream:
            start = stream.read(len(MAGIC))
    except OSError as fault:
        raise ClothbenchError(f"{path}: cannot be read ({fault.strerror or fault}); give a file of yours") from fault
    if start != MAGIC:
        raise ClothbenchError(
            f"{path}: found a file that starts with {start!r}, expected NetCDF-4 (HDF5); docs/recordings.md tells how "
            "other files become recordings"
        )
    _require_walkable(path)
    try:
        with h5py.File(path, "r") as file:
            yield NetCDF(file, path)
    except ClothbenchError:
        raise
    except MemoryError:
        raise ClothbenchError(f"{path}: found more values than there is memory for; cut the recording") from None
    except Exception as fault:  # whatever the library trips over in a broken file: it documents no list
        said = (str(fault).splitlines() or [type(fault).__name__])[0]
        what = "a truncated file" if "truncated" in said else f"an unreadable file ({said})"
        raise ClothbenchError(
            f"{path}: found {what} of {path.stat().st_size} bytes, expected whole NetCDF-4; copy it again"
        ) from fault


def _require_walkable(path: Path) -> None:
    """Refuse a heap of texts in which an entry has no length: HDF5 (2.0.0) goes from entry to entry by their lengths,
    and would never come to the end of it. Format: "HDF5 File Format Specification", III.E, "Global Heap".
    """
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as file:
        start = file.find(HEAP)
        while start >= 0:
            at, end = start + 16, min(start + int.from_bytes(file[start + 8 : start + 16], "little"), len(file))
            while at + 16 <= end:
                free = file[at : at + 2] == b"\0\0"  # what is left over counts its head in its length
                length = int.from_bytes(file[at + 8 : at + 16], "little")
                if (free and length == 0) or length >= 2**63:
                    raise ClothbenchError(
                        f"{path}: found a heap of texts with an entry of {length} bytes at byte {at}, expected whole "
                        "NetCDF-4; copy it again"
                    )
                at += length if free else 16 + -(-length // 8) * 8
            start = file.find(HEAP, start + 1)


def require_possible(shape: tuple[int, ...], dtype: np.dtype, name: str, path: Path) -> None:
    """Refuse an array that is far larger than what its file can hold, before memory is taken for it: a header may claim
    anything.
    """
    size, held = math.prod(shape) * dtype.itemsize, path.stat().st_size
    if size > max(UNSUSPICIOUS, DEFLATE * held):
        raise ClothbenchError(
            f"{path}: variable '{name}': found a claim of {' × '.join(map(str, shape))} values ({size / 1e9:.3g} GB) "
            f"in a file of {held} bytes, expected at most what such a file can hold; write the values as well"
        )


def _plain(attributes: Any, name: str, path: Path) -> Any:
    """An attribute as a text or a number; an empty one is the empty text, several numbers are a text with blanks."""
    import h5py

    stored = attributes.get_id(name)
    of, count = stored.dtype, math.prod(stored.shape or ())
    if stored.shape is None or count == 0:
        return ""
    text = of.kind == "S" or h5py.check_string_dtype(of) is not None
    if not ((text and count == 1) or (of.kind in "iufb" and count <= MOST)):
        raise ClothbenchError(
            f"{path}: attribute {name!r}: found {count} values of {of}, expected a text, or numbers; write it as such"
        )
    value = attributes[name]
    if count > 1:
        return " ".join(map(str, np.ravel(value).tolist()))
    value = np.ravel(value)[0] if isinstance(value, np.ndarray) else value
    if not text:
        return value
    return seen(value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value))


def _only_a_dimension(file: Any, name: str) -> bool:
    """Whether an array only stands for a dimension that has no coordinates, as NetCDF marks it."""
    import h5py

    if not isinstance(file.get(name, getlink=True), h5py.HardLink):
        return False
    mark = file[name].attrs.get("NAME", "")
    mark = mark.decode("ascii", "replace") if isinstance(mark, bytes) else mark
    return isinstance(mark, str) and mark.startswith("This is a netCDF dimension but not a netCDF variable")


def _dims(file: Any, data: Any, name: str) -> tuple[str, ...]:
    """The names of an array's dimensions; "?" where it has none."""
    if "DIMENSION_LIST" in data.attrs:
        scales = [file[refs[-1]].name if len(refs) else "?" for refs in data.attrs["DIMENSION_LIST"]]
        return tuple(str(scale).rpartition("/")[2] for scale in scales)
    if "CLASS" in data.attrs and len(data.shape or ()) == 1:  # a dimension's own coordinates
        return (name,)
    return ("?",) * len(data.shape or ())
