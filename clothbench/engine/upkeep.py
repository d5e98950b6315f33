"""The upkeep of stores: two made one, and what is no longer wanted removed."""

from __future__ import annotations

import contextlib
import math
import shutil
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from clothbench.core.errors import ClothbenchError
from clothbench.core.files import entries, placing, remove_folder, whole_file
from clothbench.core.packed import files_in
from clothbench.engine.cells import VERSION, installed_version
from clothbench.engine.check import Finding, check_cell, fault, remains, tracked_in, unreadable
from clothbench.engine.disagreement import (
    SEEDLESS,
    agree,
    other_machine,
    outcome,
    recorded,
    why_apart,
)
from clothbench.engine.leaderboard import ROWS, finished
from clothbench.engine.leases import LEASES, live
from clothbench.engine.run import TRACKED
from clothbench.engine.store import JOURNAL, KEY, Store
from clothbench.engine.study import studies
from clothbench.engine.tables import read_table
from clothbench.plugins.discovery import Catalogue
from clothbench.recordings.nodes import read_recording

DAY = 86400.0  # s
PLACING = 600.0  # s that a file or folder is given to come to its place, where no lease tells of who is at it


# --- merge ----------------------------------------------------------------------------------------------------------


@dataclass
class Merged:
    """What became of the cells of a store when they were put into another, by key; findings: faults among them."""

    taken: list[str] = field(default_factory=list)
    same: list[str] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)  # left out: they give way to a result, and to another error
    findings: list[Finding] = field(default_factory=list)


def merge(source: Store, into: Store, plugins: Catalogue) -> Merged:
    """Put the cells of `source` into another store, each whole or not at all; nothing finished is replaced there.

    Unfinished cells are left alone. What trackers made of images comes along.
    """
    into.require_create_only()
    known, out = studies(plugins), Merged()
    for folder in entries(source.folder / "cells"):
        if found := check_cell(folder, known):
            out.findings += found
        else:
            _merge_cell(folder, into, out)
    for path in tracked_in(source):
        out.findings += _merge_tracked(path, into.folder / TRACKED / path.name)
    for path in source.disagreements([*out.taken, *out.same]):
        try:
            into.record(path.parent.name, *recorded(path))
        except ClothbenchError as said:
            out.findings.append(Finding(path, str(said)))
    return out


def _merge_cell(folder: Path, into: Store, out: Merged) -> None:
    key, rows = folder.name, read_table(folder / "rows.parquet", ROWS).to_pylist()
    try:
        there = into.table("rows", [key])
        wanted = not there or (finished(rows) and not finished(there))
        if wanted:
            into.take(key, files_in(folder))
            there = into.table("rows", [key])  # of a run, if one was faster
    except ClothbenchError as said:
        out.findings.append(Finding(into.cell(key), str(said)))
        return
    stays, again, other = outcome(there), outcome(rows), other_machine(there, rows)
    if not finished(rows) and (finished(there) or not wanted):
        out.errors.append(key)
    elif agree(stays, again, other):
        (out.taken if wanted else out.same).append(key)
    else:
        into.record(key, stays, again, other)
        found = f"{stays}, which stays, and {again} in {folder}"
        out.findings.append(fault(into.cell(key), found, "the same of the same cell", why_apart(other)))


def _merge_tracked(path: Path, there: Path) -> list[Finding]:
    """Take what a tracker made; where it is there already, the two must be the same."""
    if found := unreadable(path):
        return [found]
    if not there.is_file():
        with whole_file(there) as part:
            shutil.copyfile(path, part)
    if found := unreadable(there):
        return [found]
    if read_recording(path).hash != read_recording(there).hash:
        return [fault(there, f"another recording than {path}", "the same of the same images and tracker", SEEDLESS)]
    return []


# --- prune ----------------------------------------------------------------------------------------------------------


def prunable(
    store: Store, plugins: Catalogue, *, older: float = DAY, other_versions: bool = False, keys: Iterable[str] = ()
) -> list[tuple[Path, str]]:
    """What may go: where, and why. Finished cells only if they are named by key, or asked for with `other_versions`.

    older: s since anything in it was last written; what runs left younger than that stays, since a run may be at it.
    What is half-written stays for `PLACING` at least.
    other_versions: cells of plugins, or of a schema, in another version than the one installed; no run asks for them.
    """
    left = [(path, what) for path, what in remains(store) if not _at_work(store, path)]
    found = [(path, what) for path, what in left if time.time() - last_written(path) > older]
    for key in keys:
        if not KEY.fullmatch(key) or not store.cell(key).is_dir():
            raise ClothbenchError(
                f"{store.cell(key)}: no such cell; give the whole key, as clothbench leaderboard --json has it"
            )
        found.append((store.cell(key), "named"))
    if other_versions:
        found += _of_other_versions(store, plugins, {path for path, _ in found})
    gone = [path.name for path, _ in found if path == store.cell(path.name)]
    return found + [(path, "a disagreement about a cell that goes") for path in store.disagreements(gone)]


def _at_work(store: Store, path: Path) -> bool:
    """Whether a live command is at this: by the lease of its cell, however long ago it last wrote there, or since it is
    half-written and young.
    """
    if path.parent == store.folder / JOURNAL:
        return live(store.folder / LEASES / path.name)
    if not path.name.startswith("."):
        return False
    if path.parent == store.folder / "cells" and live(store.folder / LEASES / path.name.split(".")[1]):
        return True
    return time.time() - last_written(path) < PLACING


def _of_other_versions(store: Store, plugins: Catalogue, named: set[Path]) -> Iterator[tuple[Path, str]]:
    installed: dict[tuple[str, str], str | None] = {}
    for folder in entries(store.folder / "cells"):
        if KEY.fullmatch(folder.name) and folder not in named and (why := _other_version(folder, plugins, installed)):
            yield folder, why


def _other_version(folder: Path, plugins: Catalogue, installed: dict[tuple[str, str], str | None]) -> str | None:
    """How the version of a cell differs from what is installed; None if it does not, or if that cannot be said."""
    try:
        rows = read_table(folder / "rows.parquet", ROWS).to_pylist()
    except ClothbenchError as said:
        return str(said).removeprefix(f"{folder / 'rows.parquet'}: ") if "found schema" in str(said) else None
    for row in rows:
        for used in VERSION.finditer(row.get("plugins") or ""):
            plugin = used["kind"], used["name"]
            if plugin not in installed:
                installed[plugin] = installed_version(*plugin, plugins)
            if installed[plugin] not in (None, used["version"]):
                return f"{'/'.join(plugin)} {used['version']}; installed is {installed[plugin]}"
    return None


def last_written(path: Path) -> float:
    """When anything in a file or folder was last written [s of the system's clock]; of what has gone meanwhile, which
    a run is done with, later than anything.
    """
    try:
        times = [path.stat().st_mtime]
    except FileNotFoundError:
        return math.inf
    for inside in path.rglob("*") if path.is_dir() else ():
        try:
            times.append(inside.stat().st_mtime)
        except FileNotFoundError:  # a run is at it
            return time.time()
    return max(times)


def remove(path: Path) -> None:
    """Remove what was found to be prunable; a cell is gone at once or not at all."""
    if path.is_dir():
        with contextlib.suppress(FileNotFoundError):  # a run was done with it just now
            remove_folder(path)
    else:
        with placing(path.parent):
            path.unlink(missing_ok=True)
