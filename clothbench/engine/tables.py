"""Tables of the store as Parquet files: written with checksums, and read as what anybody may have put there.

Whoever reads a table of known columns gets these columns, in these types, or one line that says what is wrong.
"""

from __future__ import annotations

import math
import os
import re
import stat
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa
import pyarrow.parquet as pq

from clothbench.core.errors import ClothbenchError, seen

if TYPE_CHECKING:
    import pandas as pd

SCHEMA_VERSION = 1
Columns = Mapping[str, pa.DataType]
DENSEST = 10_000_000  # values of a table that are nobody's memory problem
SMALL = 100_000  # values that one thread reads at once
FEW = 100  # rows
# `UNSEEN` of clothbench/core/errors.py in UTF-8: whole columns are looked through at once.
_UNSEEN = re.compile(rb"[\x00-\x08\x0b-\x1f\x7f]|\xc2[\x80-\x9f]|\xe2\x80[\xaa-\xae]|\xe2\x81[\xa6-\xa9]")
READABLE = "give a folder whose cells you may read"
AGAIN = "delete its folder and run again"


def write_table(path: Path, content: list[dict[str, Any]] | pd.DataFrame, columns: Columns | None = None) -> None:
    """One Parquet file; rows become a table of exactly these columns."""
    if isinstance(content, list):
        table = pa.Table.from_pylist(content, schema=pa.schema(list((columns or {}).items())) if columns else None)
    else:
        table = pa.Table.from_pandas(content, preserve_index=False)
    stamped = table.replace_schema_metadata({"clothbench_schema": str(SCHEMA_VERSION)})
    many = table.num_rows > FEW  # below that, lists of distinct values and ranges take more room than what they spare
    # With a checksum a flipped bit is a fault, and not another number.
    pq.write_table(stamped, path, write_page_checksum=True, use_dictionary=many, write_statistics=many)


def read_table(path: Path, columns: Columns | None = None, needed: Collection[str] = ()) -> pa.Table:
    """One Parquet file of this schema version; a damaged or foreign one is refused in one line.

    columns: those that it has to have by name and type; one that is not there is null, as an older version may have
    written it, but for those that are `needed`, in which there is no null either. Others stay as they are.
    """
    try:
        # Opened here: Arrow takes no name that is not UTF-8.
        with path.open("rb") as content, pq.ParquetFile(content, page_checksum_verification=True) as file:
            values = file.metadata.num_rows * file.metadata.num_columns
            if values > max(DENSEST, 100 * path.stat().st_size):
                raise ClothbenchError(
                    f"{path}: found a claim of {values} values in a file of {path.stat().st_size} bytes, expected at "
                    f"most what such a file can hold; {AGAIN}"
                )
            # Dividing a cell's few rows among threads takes longer than reading them.
            table = file.read(use_threads=values > SMALL)
        table.validate(full=True)
    except PermissionError as fault:
        raise ClothbenchError(f"{path}: cannot be read ({fault.strerror}); {READABLE}") from fault
    except (pa.ArrowException, OSError, ValueError, MemoryError) as fault:
        said = (str(fault).splitlines() or [type(fault).__name__])[0]
        raise ClothbenchError(f"{path}: found a damaged table ({said}); {AGAIN}") from fault
    found = (table.schema.metadata or {}).get(b"clothbench_schema", b"none").decode("ascii", "replace")
    if found != str(SCHEMA_VERSION):
        raise ClothbenchError(
            f"{path}: found schema {found}, expected {SCHEMA_VERSION}; "
            "results of another version are set aside: move them"
        )
    return as_declared(table, columns or {}, needed, str(path))


def read_if_there(path: str, columns: Columns | None = None, needed: Collection[str] = ()) -> pa.Table | None:
    """One Parquet file; None if there is none, or none any more."""
    if not _is_file(path):
        return None
    try:
        return read_table(Path(path), columns, needed)
    except ClothbenchError:  # another process may just have put a new attempt in place of this error
        return read_table(Path(path), columns, needed) if _is_file(path) else None


def _is_file(path: str) -> bool:
    return (found := looked_up(path)) is not None and stat.S_ISREG(found.st_mode)


def looked_up(path: str) -> os.stat_result | None:
    """What the system says of a file; None where there is none. A folder on the way that may not be looked into is a
    ClothbenchError: what is in it may be a cell that somebody has finished.
    """
    try:
        return os.stat(path)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as fault:
        raise ClothbenchError(f"{path}: cannot be looked up ({fault.strerror}); {READABLE}") from fault


def as_declared(
    table: pa.Table, columns: Columns, needed: Collection[str], where: str, advice: str = AGAIN
) -> pa.Table:
    """A table with its declared columns in their types, and texts without what cannot be seen.

    advice: what to do where it is none, as of one that lies in the folder of a cell.
    """
    there = {name: k for k, name in enumerate(table.column_names)}
    if len(there) < table.num_columns:
        raise ClothbenchError(f"{where}: found a column twice, expected each once; {advice}")
    for name, of in columns.items():
        if name not in there:
            if name in needed:
                raise ClothbenchError(f"{where}: found no column {name!r}, expected one of {of}; {advice}")
            table = table.append_column(name, pa.nulls(table.num_rows, of))
            continue
        column = table.column(there[name])
        if name in needed and column.null_count:
            raise ClothbenchError(f"{where}: column {name!r}: found nothing in a row, expected {of}; {advice}")
        if column.type != of and not pa.types.is_null(column.type):
            raise ClothbenchError(f"{where}: column {name!r}: found {column.type}, expected {of}; {advice}")
        shown = column if column.type == of else column.cast(of)
        if of == pa.string() and any(map(_has_unseen, shown.chunks)):
            shown = pa.chunked_array([pa.array([text and seen(text) for text in shown.to_pylist()], of)])
        if shown is not column:
            table = table.set_column(there[name], name, shown)
    return table


def _has_unseen(texts: pa.Array) -> bool:
    data = texts.buffers()[2]
    return data is not None and _UNSEEN.search(data) is not None


def finite(value: float | None) -> float | None:
    """None where there is no number: tables have nulls, JSON has no NaN and no infinity."""
    return float(value) if value is not None and math.isfinite(value) else None
