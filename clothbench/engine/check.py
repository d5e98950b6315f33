"""Whether all of a store is whole: every file that can be read, in the cell that it belongs to."""

from __future__ import annotations

import json
import re
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa

from clothbench.core.errors import ClothbenchError
from clothbench.core.files import half_written
from clothbench.engine.index import INDEX
from clothbench.engine.run import TRACKED
from clothbench.engine.store import FINISHED, JOURNAL, ROW, Store, read_table
from clothbench.engine.study import studies
from clothbench.plugins.discovery import Catalogue
from clothbench.recordings.nodes import read_recording

KEY = re.compile(r"[0-9a-f]+")
AGAIN = "delete the folder and run again"


@dataclass(frozen=True)
class Finding:
    """One thing that was found, as a line that begins with the file. harmless: nothing is wrong, it only lies there."""

    path: Path
    line: str
    harmless: bool = False


def fault(path: Path, found: str, expected: str, advice: str) -> Finding:
    return Finding(path, f"{path}: found {found}, expected {expected}; {advice}")


def check(store: Store, plugins: Catalogue, told: Callable[[int, int, str], None] = lambda *_: None) -> list[Finding]:
    """Read every file of a store. `told(done, planned, name)` after each cell."""
    entries = sorted((store.folder / "cells").glob("[!.]*"))
    known, out = frozenset(studies(plugins)), []
    for done, entry in enumerate(entries):
        out += check_cell(entry, known)
        told(done + 1, len(entries), entry.name)
    out += [found for path in sorted((store.folder / TRACKED).glob("*.nc")) if (found := unreadable(path))]
    out += [Finding(path, f"{path}: {what}", harmless=True) for path, what in remains(store)]
    return out


def check_cell(folder: Path, known: frozenset[str]) -> list[Finding]:
    """What is wrong with one cell, file by file. known: names of the studies that are installed."""
    if not folder.is_dir() or not KEY.fullmatch(folder.name):
        return [fault(folder, "a stray", "folders of cells named by their keys alone", "move it away")]
    rows, tables, out = folder / "rows.parquet", {}, []
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        if path.suffix != ".parquet":
            out += [found] if (found := unreadable(path)) else []
            continue
        try:
            tables[path] = read_table(path)
        except ClothbenchError as said:
            out.append(Finding(path, str(said)))
    for path, table in tables.items():
        out += strangers(path, table, folder.name)
    if rows in tables:
        out += bad_rows(rows, tables[rows].to_pylist(), known)
    elif not rows.exists():
        out.append(fault(folder, "no rows.parquet", "a finished cell", AGAIN))
    return [found for found in out if found.path.exists()]  # else a run has just put a result in place of an error


def unreadable(path: Path) -> Finding | None:
    """A file that cannot be read as what its name says."""
    try:
        if path.suffix == ".nc":
            read_recording(path)
        elif path.suffix == ".npz":
            with zipfile.ZipFile(path) as archive:
                if (bad := archive.testzip()) is not None:
                    return fault(path, f"a damaged array {bad!r}", "arrays as they were written", AGAIN)
        elif path.suffix == ".json":
            json.loads(path.read_text(encoding="utf-8"))
        elif path.stat().st_size == 0:
            return fault(path, "an empty file", "content", AGAIN)
    except ClothbenchError as said:
        return Finding(path, str(said))
    except (OSError, ValueError, zipfile.BadZipFile) as why:
        return fault(path, f"no {path.suffix[1:]} that can be read ({str(why).splitlines()[0]})", "one", AGAIN)
    return None


def strangers(path: Path, table: pa.Table, key: str) -> Iterator[Finding]:
    """Whether rows of a table belong to another cell."""
    if "key" in table.column_names and (other := set(table["key"].to_pylist()) - {key}):
        yield fault(path, f"rows of the cell {min(map(str, other))}", f"those of {key}, as its folder is named", AGAIN)


def bad_rows(path: Path, rows: list[dict[str, Any]], known: frozenset[str]) -> Iterator[Finding]:
    """Rows that lack a column, or say what no run writes."""
    if not rows:
        yield fault(path, "no row", "one or more", AGAIN)
        return
    if missing := [name for name in ROW if name not in rows[0]]:
        yield fault(path, f"no column {missing[0]!r}", "the columns of a leaderboard", AGAIN)
        return
    for status in sorted({str(row["status"]) for row in rows} - {*FINISHED, "error"}):
        yield fault(path, f"status {status!r}", f"{', '.join(FINISHED)} or error", AGAIN)
    for study in sorted({str(row["study"]) for row in rows if row.get("study")} - known):
        yield fault(path, f"study {study!r}", " or ".join(sorted(known)), "install the plugin that wrote it")


def remains(store: Store) -> Iterator[tuple[Path, str]]:
    """What runs that were stopped have left, or what one that is under way is writing: where, and what it is."""
    for folder in (
        store.folder,
        *(store.folder / name for name in ("cells", TRACKED)),
        *store.folder.glob(f"{INDEX}/*"),
    ):
        for path in half_written(folder):
            yield path, "half-written, by a process that was killed or is at work"
    for path in sorted((store.folder / JOURNAL).glob("*")):
        if store.has(path.name):
            yield path, "the journal of a cell that is finished"
        else:
            yield path, "an unfinished cell; the command that began it goes on with it"
