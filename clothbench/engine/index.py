"""Tables of many cells in a few files, since opening a file costs more than reading it. A cache and never the truth.

RUNS/index/TABLE/1-DIGEST.parquet   rows of that table of many cells; in the file's head the key of each cell, and the
                                    stamp of the file that its rows were read from

A segment never changes and is named by the digest of its bytes, so that a damaged one is known as such. Rows count as
long as the stamp is that of the cell's file now; all other cells are read themselves. So cells may come, go, and be
replaced, segments may be deleted at any time, and any number of processes may list and write at once.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from clothbench.core.files import whole_file
from clothbench.engine.tables import looked_up

INDEX = "index"  # folder of a store
VERSION = 1
FEW = 256  # so many cells are read themselves without further ado
AT_ONCE = 2048  # cells that are read before they are put together: a table by itself takes much room
AT, HEAD = "cell of this row", b"clothbench_cells"
Rows = list[dict[str, Any]]
Stamp = tuple[int, int, int]  # when written [ns], bytes, number on its disk


def stamp(path: str) -> Stamp | None:
    """What changes whenever a file is another one; None where there is none."""
    if (found := looked_up(path)) is None:
        return None
    return found.st_mtime_ns, found.st_size, found.st_ino


@dataclass(frozen=True, eq=False)
class Segment:
    """Rows of some cells. cells: key → stamp; rows: of all of them, with the number of their cell in a column."""

    cells: Mapping[str, Stamp]
    rows: pa.Table
    path: Path | None = None

    def has(self, columns: Mapping[str, pa.DataType]) -> bool:
        """Whether these columns are there, in these types."""
        names = set(self.rows.column_names)
        return all(name in names and self.rows.schema.field(name).type == of for name, of in columns.items())

    def of(self, keys: Iterable[str]) -> dict[str, Rows]:
        """The rows of some of the cells."""
        numbers = {key: n for n, key in enumerate(self.cells)}
        wanted = [(numbers[key], key) for key in keys]
        chosen = np.zeros(len(self.cells), bool)
        chosen[[n for n, _ in wanted]] = True
        at = self.rows[AT].to_numpy()
        kept = chosen[at]
        rows = dicts(self.rows.drop_columns([AT]).filter(pa.array(kept)))
        first = np.searchsorted(at[kept], np.arange(len(self.cells) + 1))
        return {key: rows[first[n] : first[n + 1]] for n, key in wanted}

    def only(self, keys: Iterable[str]) -> Segment:
        """The same without all other cells."""
        wanted = set(keys)
        numbers = [n for n, key in enumerate(self.cells) if key in wanted]
        new = np.full(len(self.cells), -1)
        new[numbers] = np.arange(len(numbers))
        at = new[self.rows[AT].to_numpy()]
        rows = self.rows.drop_columns([AT]).append_column(AT, pa.array(at)).filter(pa.array(at >= 0))
        return Segment({key: mark for key, mark in self.cells.items() if key in wanted}, rows)


def indexed(
    folder: Path,
    files: Mapping[str, str],
    read: Callable[[str], pa.Table | None],
    columns: Mapping[str, pa.DataType] | None = None,
) -> Rows:
    """The rows of one table, cell by cell in the order of `files`; of many cells, what had to be read is kept.

    folder: of the segments of that table; files: key → path; read: one cell's table, None if it is gone; columns: that
    every such table has.
    """
    if len(files) < FEW:
        return [row for path in files.values() if (table := read(path)) is not None for row in table.to_pylist()]
    now = {key: mark for key, path in files.items() if (mark := stamp(path)) is not None}
    found: dict[str, Rows] = {}
    # Those that were written before a column was declared do not have it: their cells are read once more.
    segments = [segment for segment in segments_in(folder) if segment.has(columns or {})]
    for segment in segments:
        found.update(segment.of(k for k, mark in segment.cells.items() if k not in found and now.get(k) == mark))
    missing = [key for key in now if key not in found]
    for first in range(0, len(missing), AT_ONCE):
        keys = missing[first : first + AT_ONCE]
        tables = {key: table for key in keys if (table := read(files[key])) is not None}
        if len(missing) < FEW:
            found.update({key: table.to_pylist() for key, table in tables.items()})
            continue
        for new in _segments({key: (now[key], table) for key, table in tables.items()}):
            found.update(new.of(new.cells))
            with contextlib.suppress(OSError):  # a folder that nobody may write to, a full disk: the list is right
                segments = _kept(folder, new, segments, now)
    return [row for key in files for row in found.get(key, ())]


def segments_in(folder: Path) -> list[Segment]:
    """All that are whole; damaged ones are removed, and what is no segment is left where it is and passed over."""
    out = []
    for path in sorted(folder.glob(f"{VERSION}-*.parquet")):
        try:
            content = path.read_bytes()
        except OSError:  # another process has just put it together with others
            continue
        if path.name != _name(content):
            _remove(path)
            continue
        try:
            rows = pq.read_table(pa.BufferReader(content))
            rows.validate(full=True)
        except (pa.ArrowException, OSError, ValueError, MemoryError):  # another version of Arrow wrote it
            continue
        if (cells := _cells_of(rows)) is not None:
            out.append(Segment(cells, rows.replace_schema_metadata(), path))
    return out


def _cells_of(rows: pa.Table) -> dict[str, Stamp] | None:
    """The cells that a segment's head states; None if it is no head, or rows are of none of its cells, or not in their
    order: a results folder may come from anybody.
    """
    try:
        head = json.loads(rows.schema.metadata[HEAD])
        cells = {key: (int(written), int(size), int(number)) for key, written, size, number in head}
        at = rows[AT]
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError):
        return None
    names = rows.column_names
    if len(cells) != len(head) or not all(isinstance(key, str) for key in cells) or len(set(names)) != len(names):
        return None
    if at.type != pa.int64() or at.null_count:
        return None
    numbers = at.to_numpy()
    inside = not len(numbers) or (numbers[0] >= 0 and numbers[-1] < len(cells))
    return cells if inside and bool(np.all(numbers[1:] >= numbers[:-1])) else None


def _name(content: bytes) -> str:
    return f"{VERSION}-{hashlib.sha256(content).hexdigest()[:32]}.parquet"


def _remove(path: Path | None) -> None:
    if path is not None:
        with contextlib.suppress(OSError):
            path.unlink()


def _segments(read: Mapping[str, tuple[Stamp, pa.Table]]) -> list[Segment]:
    """Cells that were read, those apart whose tables have other columns."""
    by_schema: dict[pa.Schema, list[str]] = {}
    for key, (_, table) in read.items():
        by_schema.setdefault(table.schema.remove_metadata(), []).append(key)
    out = []
    for keys in by_schema.values():
        tables = [read[key][1].replace_schema_metadata() for key in keys]
        at = np.repeat(np.arange(len(keys)), [table.num_rows for table in tables])
        rows = pa.concat_tables(tables).append_column(AT, pa.array(at)).combine_chunks()
        out.append(Segment({key: read[key][0] for key in keys}, rows))
    return out


def _kept(folder: Path, new: Segment, segments: list[Segment], now: Mapping[str, Stamp]) -> list[Segment]:
    """Write a segment, in one with those of the same columns that are not much larger, so that few remain; what these
    hold of cells that have changed since is left out. Returns the segments that there are then.
    """
    parts, rest = [new], []
    for segment in sorted(segments, key=lambda s: len(s.cells)):
        if segment.rows.schema == new.rows.schema and len(segment.cells) <= 2 * sum(len(s.cells) for s in parts):
            taken = {key for part in parts for key in part.cells}
            parts.append(segment.only(k for k, m in segment.cells.items() if k not in taken and now.get(k, m) == m))
        else:
            rest.append(segment)
    whole = _written(folder, parts)
    for segment in segments:
        if segment not in rest:
            _remove(segment.path)
    return [*rest, whole]


def _written(folder: Path, parts: list[Segment]) -> Segment:
    """One segment of several, in a file."""
    cells: dict[str, Stamp] = {}
    rows = []
    for part in parts:
        at = pa.array(part.rows[AT].to_numpy() + len(cells))
        rows.append(part.rows.drop_columns([AT]).append_column(AT, at))
        cells |= part.cells
    table = pa.concat_tables(rows).combine_chunks()
    head = json.dumps([[key, *mark] for key, mark in cells.items()]).encode()
    sink = pa.BufferOutputStream()
    pq.write_table(table.replace_schema_metadata({HEAD: head}), sink)
    content = sink.getvalue().to_pybytes()
    path = folder / _name(content)
    with whole_file(path) as file:
        file.write_bytes(content)
    return Segment(cells, table, path)


def dicts(table: pa.Table) -> Rows:
    """The same as `table.to_pylist()`, several times as fast for many rows; equal texts are one object."""
    columns = [_values(column) for column in table.columns]
    names = table.column_names
    return [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)]


def _values(column: pa.ChunkedArray) -> list[Any]:
    if pa.types.is_null(column.type):
        return [None] * len(column)
    if pa.types.is_string(column.type):
        coded = column.combine_chunks().dictionary_encode()
        texts = [*coded.dictionary.to_pylist(), None]  # the last one, −1, stands for null
        return [texts[n] for n in coded.indices.fill_null(-1).to_numpy()]
    if pa.types.is_floating(column.type) or pa.types.is_integer(column.type):
        whole = column.combine_chunks()
        values = whole.fill_null(0).to_numpy(zero_copy_only=False).tolist()
        if whole.null_count:
            known = whole.is_valid().to_numpy(zero_copy_only=False).tolist()
            return [value if there else None for value, there in zip(values, known, strict=True)]
        return values
    return column.to_pylist()
