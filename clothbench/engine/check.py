"""Whether all of a store is whole: every file that can be read, in the cell that it belongs to."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa

from clothbench.core.errors import ClothbenchError, one_line
from clothbench.core.files import entries, files_below, half_written, read_arrays, read_json
from clothbench.engine.disagreement import recorded, why_apart
from clothbench.engine.index import INDEX
from clothbench.engine.leaderboard import FINISHED, ROW, ROWS
from clothbench.engine.leases import LEASES, live
from clothbench.engine.run import TRACKED
from clothbench.engine.store import JOURNAL, KEY, Store
from clothbench.engine.study import Study, studies
from clothbench.engine.tables import as_declared, read_table
from clothbench.plugins.discovery import Catalogue
from clothbench.recordings.nodes import read_recording

AGAIN = "delete the folder and run again"


@dataclass(frozen=True)
class Finding:
    """One thing that was found, as a line that begins with the file. harmless: nothing is wrong, it only lies there."""

    path: Path
    line: str
    harmless: bool = False


def fault(path: Path, found: str, expected: str, advice: str) -> Finding:
    return Finding(path, one_line(f"{path}: found {found}, expected {expected}; {advice}"))


def check(store: Store, plugins: Catalogue, told: Callable[[int, int, str], None] = lambda *_: None) -> list[Finding]:
    """Read every file of a store. `told(done, planned, name)` after each cell."""
    cells = entries(store.folder / "cells")
    known, out = studies(plugins), []
    for done, folder in enumerate(cells):
        out += check_cell(folder, known)
        told(done + 1, len(cells), folder.name)
    out += [found for path in tracked_in(store) if (found := unreadable(path))]
    out += disagreeing(store)
    out += [Finding(path, f"{path}: {what}", harmless=True) for path, what in remains(store)]
    return out


def tracked_in(store: Store) -> list[Path]:
    """What trackers made of images."""
    return [path for path in entries(store.folder / TRACKED) if path.suffix == ".nc"]


def check_cell(folder: Path, known: Mapping[str, Study]) -> list[Finding]:
    """What is wrong with one cell, file by file. known: the studies that are installed."""
    if not folder.is_dir() or not KEY.fullmatch(folder.name):
        return [fault(folder, "a stray", "folders of cells named by their keys alone", "move it away")]
    rows, tables, out = folder / "rows.parquet", {}, []
    try:
        files = [path for path in files_below(folder, hidden=True) if path.is_file()]
    except OSError as why:
        closed = f"a folder that cannot be looked into ({why.strerror})"
        return [fault(Path(why.filename or folder), closed, "one that can", "let its owner give you the right to")]
    for path in files:
        if path.suffix != ".parquet":
            out += [found] if (found := unreadable(path)) else []
            continue
        try:
            tables[path] = read_table(path)
        except ClothbenchError as said:
            out.append(Finding(path, str(said)))
    study = None
    if rows in tables:
        missing = [name for name in ROW if name not in tables[rows].column_names]
        out += list(bad_rows(rows, tables[rows], missing, known))
        study = next((known[name] for name in known if name in _texts(tables[rows], "study")), None)
    elif not rows.exists():
        out.append(fault(folder, "no rows.parquet", "a finished cell", AGAIN))
    for path, table in tables.items():
        out += strangers(path, table, folder.name)
        declared = study.tables.get(path.stem, {}) if study is not None and path != rows else {}
        try:
            as_declared(table, declared, (), str(path))
        except ClothbenchError as said:
            out.append(Finding(path, str(said)))
    return [found for found in out if found.path.exists()]  # else a run has just put a result in place of an error


def unreadable(path: Path) -> Finding | None:
    """A file that cannot be read as what its name says."""
    try:
        if path.suffix == ".nc":
            read_recording(path)
        elif path.suffix == ".npz":
            read_arrays(path)
        elif path.suffix == ".json":
            read_json(path, "a document as it was written")
        elif path.stat().st_size == 0:
            return fault(path, "an empty file", "content", AGAIN)
    except ClothbenchError as said:
        return Finding(path, str(said))
    except (OSError, ValueError, zipfile.BadZipFile) as why:
        return fault(path, f"no {path.suffix[1:]} that can be read ({str(why).splitlines()[0]})", "one", AGAIN)
    return None


def _texts(table: pa.Table, name: str) -> set[str]:
    """The texts in a column, whatever else it may hold."""
    values = table[name].to_pylist() if name in table.column_names else []
    return {str(value) for value in values if value is not None}


def strangers(path: Path, table: pa.Table, key: str) -> Iterator[Finding]:
    """Whether rows of a table belong to another cell."""
    if other := _texts(table, "key") - {key}:
        yield fault(path, f"rows of the cell {min(other)}", f"those of {key}, as its folder is named", AGAIN)


def bad_rows(path: Path, table: pa.Table, missing: Sequence[str], known: Collection[str]) -> Iterator[Finding]:
    """Rows that lack a column, or say what no run writes."""
    if not table.num_rows:
        yield fault(path, "no row", "one or more", AGAIN)
        return
    if missing:
        yield fault(path, f"no column {missing[0]!r}", "the columns of a leaderboard", AGAIN)
        return
    try:
        as_declared(table, ROWS, ("status",), str(path))
    except ClothbenchError as said:
        yield Finding(path, str(said))
    for status in sorted(_texts(table, "status") - {*FINISHED, "error"}):
        yield fault(path, f"status {status!r}", f"{', '.join(FINISHED)} or error", AGAIN)
    for study in sorted(_texts(table, "study") - set(known)):
        yield fault(path, f"study {study!r}", " or ".join(sorted(known)), "install the plugin that wrote it")


def disagreeing(store: Store) -> Iterator[Finding]:
    """Cells that did not come to the same when they were computed twice; not those that are gone."""
    for path in store.disagreements():
        if not store.cell(path.parent.name).is_dir():
            continue
        try:
            first, second, other = recorded(path)
        except ClothbenchError as said:
            yield Finding(path, str(said))
            continue
        found = f"that this cell was computed twice, first {first}, which stays, then {second}"
        yield fault(path, found, "the same of the same cell", why_apart(other))


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
    for path in store.disagreements():
        if not store.cell(path.parent.name).is_dir():
            yield path, "the record of a disagreement about a cell that is gone"
    for path in sorted((store.folder / LEASES).glob("*")):
        if not live(path):
            yield path, "the lease of a command that has gone"
