"""The store: one folder per finished cell, Parquet inside, put in place whole or not at all.

RUNS/cells/KEY/rows.parquet         what the leaderboard shows, with the system each row was computed on
RUNS/cells/KEY/TABLE.parquet        what else the cell's study has to tell: each study's `schema` has the columns
RUNS/cells/KEY/fit.rrd              of a calibration: recording beside rollout, for Rerun
RUNS/cells/KEY/films/N.npz          of a calibration: the same thinned, for the page's player
RUNS/tracked/KEY.nc                 what a tracker made of images: a recording of nodes
RUNS/disagreements/KEY/DIGEST.json  that a cell was computed twice and did not come to the same: what stays, what not
RUNS/journal/KEY/                   what an unfinished cell has simulated so far
RUNS/index/                         a cache for listing many cells; may be deleted at any time

Of results in a bucket the folder is a mirror (`clothbench.engine.mirror`): what it takes is published there first.
"""

from __future__ import annotations

import functools
import json
import os
import re
import shutil
import socket
import warnings
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clothbench.core.create_only import require_create_only
from clothbench.core.errors import ClothbenchError
from clothbench.core.files import read_json, require_folder, whole_file, whole_folder
from clothbench.core.packed import Files, files_in, packed, unpacked, write_files
from clothbench.engine.bucket import (
    ATTEMPT,
    Bucket,
    attempt_name,
    cell_object,
    error_object,
    mirrored,
    require_conditional,
)
from clothbench.engine.cells import VERSION, digest, installed_version
from clothbench.engine.disagreement import agree, other_machine, outcome, why_apart
from clothbench.engine.index import INDEX, indexed
from clothbench.engine.leaderboard import (
    ABOUT,
    BEYOND,
    LISTED,
    NUMBERS,
    QUESTION,
    ROWS,
    finished,
    require_rows,
    row_order,
)
from clothbench.engine.tables import Columns, read_if_there, read_table, write_table
from clothbench.plugins.discovery import catalogue

if TYPE_CHECKING:
    import pandas as pd

KEY = re.compile(r"[0-9a-f]+")  # of a cell, and the name of its folder
DISAGREEMENTS = "disagreements"  # folder of the records of cells that were computed twice and did not come to the same
JOURNAL = "journal"  # folder of what unfinished cells have simulated


class Store:
    """Finished cells below one folder."""

    def __init__(self, folder: str | os.PathLike[str]):
        self.folder = Path(folder)
        require_folder(str(folder))

    @functools.cached_property
    def bucket(self) -> Bucket | None:
        """What the folder is the mirror of; None if it stands for itself."""
        return mirrored(self.folder)

    @property
    def address(self) -> str:
        """As a user names it."""
        return self.bucket.address if self.bucket is not None else str(self.folder)

    def require_create_only(self) -> None:
        """Try out that of several who put the same cell here one comes first; a ClothbenchError where it is not so."""
        require_create_only(self.folder)
        if self.bucket is not None:
            require_conditional(self.bucket.address)

    def cell(self, key: str) -> Path:
        return self.folder / "cells" / key

    def has(self, key: str) -> bool:
        """Whether a cell is finished; one that ended in an error is not."""
        return finished(self.table("rows", [key]))

    def status(self, key: str) -> str | None:
        """Of a finished cell that of its first row that is not "ok", if there is one; None if it is not finished."""
        rows = self.table("rows", [key])
        return next((row["status"] for row in rows if row["status"] != "ok"), "ok") if finished(rows) else None

    def finished(self, keys: Iterable[str]) -> set[str]:
        """Those of these cells that are finished."""
        by_key: dict[str, list[dict[str, Any]]] = {}
        for row in self.table("rows", keys):
            by_key.setdefault(row["key"], []).append(row)
        return {key for key, rows in by_key.items() if finished(rows)}

    def put(
        self,
        key: str,
        tables: Mapping[str, list[dict[str, Any]] | pd.DataFrame],
        extra: Callable[[Path], None] | None = None,
        columns: Mapping[str, Columns] | None = None,
    ) -> Path:
        """Write a cell: tables, then whatever `extra(folder)` adds. It replaces an error; a finished cell stays, with a
        warning if the two do not agree.

        columns: of the tables beside "rows", by name.
        """
        known = {"rows": ROWS, **(columns or {})}

        def fill(part: Path) -> None:
            for name, content in tables.items():
                write_table(part / f"{name}.parquet", content, known.get(name))
            if extra is not None:
                extra(part)

        return self._placed(key, fill)

    def take(self, key: str, files: Files) -> Path:
        """Write a cell that was made in another store, by the paths of its files below its folder; as `put` does."""
        return self._placed(key, lambda part: write_files(part, files))

    def _placed(self, key: str, fill: Callable[[Path], None]) -> Path:
        with whole_folder(self.cell(key), lambda: self._stands(key, part)) as part:
            fill(part)
            if self.bucket is not None:
                self._publish(self.bucket, key, part)
        return self.cell(key)

    def record(
        self, key: str, first: Sequence[float | str], second: Sequence[float | str], other: Collection[str] = ()
    ) -> None:
        """Keep it that a cell did not come to the same twice: the outcome that stays, and the one that was dropped.
        other: what it was computed with another one of, see `other_machine`.
        """
        name = f"{DISAGREEMENTS}/{key}/{digest([first, second])}.json"
        about = {"key": key, "first": list(first), "second": list(second), "on": socket.gethostname()}
        text = json.dumps({**about, "other": list(other)})
        if self.bucket is not None:
            self.bucket.create(name, text.encode())
        with whole_file(self.folder / name) as part:
            part.write_text(text)

    def disagreements(self, keys: Iterable[str] = ("*",)) -> list[Path]:
        """The records of all cells that did not come to the same twice, or of some."""
        return sorted(path for key in keys for path in (self.folder / DISAGREEMENTS).glob(f"{key}/*.json"))

    def _compare(
        self, key: str, where: object, stays: Sequence[Mapping[str, Any]], again: Sequence[Mapping[str, Any]]
    ) -> None:
        """Tell and record it if a cell that was computed twice did not come to the same."""
        first, second, other = outcome(stays), outcome(again), other_machine(stays, again)
        if finished(again) and not agree(first, second, other):
            self.record(key, first, second, other)
            warnings.warn(
                f"{where}: computed twice, first {first}, which stays, then {second}; {why_apart(other)}", stacklevel=2
            )

    def _stands(self, key: str, part: Path) -> bool:
        """Whether a cell is finished, also against the same cell in another folder."""
        if not self.has(key):
            return False
        self._compare(key, self.cell(key), self.table("rows", [key]), _rows_in(part))
        return True

    def _publish(self, bucket: Bucket, key: str, part: Path) -> None:
        """Put the cell in a folder into the bucket, by one create. If it is there already, that takes its place in the
        folder, too; an error has a key of its own.
        """
        rows = _rows_in(part)
        if not finished(rows):
            (part / ATTEMPT).write_text(attempt := attempt_name())
            bucket.create(error_object(key, attempt), packed(files_in(part)))
        elif not bucket.create(name := cell_object(key), packed(files_in(part))):
            where = f"{bucket.address}/{name}"
            files = unpacked(bucket.read([name])[name], where)
            shutil.rmtree(part)
            write_files(part, files)
            self._compare(key, where, _rows_in(part), rows)

    def rows(self, keys: Iterable[str] | None = None, every: bool = False) -> list[dict[str, Any]]:
        """Rows of all cells that are not `superseded`, of `every` one, or of some, sorted by what they are about, which
        a text says of each, if an empty one. A number that no error can be is none.
        """
        rows = [{"study": None, **row} for row in self.table("rows", keys)]
        for row in rows:
            for name in ABOUT:
                if row[name] is None:
                    row[name] = ""
            for name in NUMBERS:
                if (value := row[name]) is not None and not abs(value) < BEYOND:
                    row[name] = None
        if keys is None and not every:
            old = superseded(rows)
            rows = [row for row in rows if row["key"] not in old]
        return sorted(rows, key=row_order)

    def tables_of(self, key: str) -> frozenset[str]:
        """The names of the tables that a cell has."""
        return frozenset(path.stem for path in self.cell(key).glob("*.parquet"))

    def table(
        self, name: str, keys: Iterable[str] | None = None, columns: Columns | None = None
    ) -> list[dict[str, Any]]:
        """A table by its name, over all cells that have it, or over some. columns: those that it has to have; "rows"
        has those of all studies.
        """
        files = {key: f"{self.folder}/cells/{key}/{name}.parquet" for key in (self._keys() if keys is None else keys)}
        declared = ROWS if name == "rows" else columns
        needed = ("status",) if name == "rows" else ("key",) if "key" in (columns or {}) else ()
        return indexed(self.folder / INDEX / name, files, lambda path: read_if_there(path, declared, needed), declared)

    def _keys(self) -> list[str]:
        """Of all cells, in order; what is not named as a key is none, as a copy of a cell's folder beside it."""
        try:
            return sorted(name for name in os.listdir(self.folder / "cells") if KEY.fullmatch(name))
        except FileNotFoundError:
            return []


NOWHERE: frozenset[Any] = frozenset()  # the recordings of a cell that failed as a whole


def superseded(rows: Iterable[Mapping[str, Any]]) -> set[str]:
    """Keys of cells of which the store has the same question with the same plugins in other versions: of those the
    ones that are not installed, or of several such those that were not finished last.

    Whether two cells ask the same is told from their rows: a cell that failed as a whole has no recordings in its one
    row, and is taken for every other's that differs in nothing else.
    """
    cells: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        cells.setdefault(row["key"], []).append(row)
    alike: dict[tuple[Any, ...], list[str]] = {}
    for key, mine in cells.items():
        plugins, cases = _without_versions(mine[0].get("plugins") or ""), sorted({r["case"] for r in mine})
        alike.setdefault((plugins, *map(mine[0].get, QUESTION), *cases), []).append(key)
    out, is_installed = set(), functools.cache(_is_installed)
    for keys in alike.values():
        versions = {key: cells[key][0].get("plugins") or "" for key in keys}
        if len(set(versions.values())) < 2:
            continue
        rank = {key: (is_installed(versions[key]), cells[key][0].get("finished") or "") for key in keys}
        places = {key: frozenset((r["recording"], r["split"]) for r in cells[key] if r["recording"]) for key in keys}
        first: dict[frozenset[Any] | None, dict[str, tuple[bool, str]]] = {}  # of each version; None: wherever
        for key in keys:
            for place in (places[key], None):
                known = first.setdefault(place, {})
                known[versions[key]] = max(rank[key], known.get(versions[key], rank[key]))
        for key in keys:
            beside = (first[places[key]], first.get(NOWHERE, {})) if places[key] else (first[None],)
            if any(v != versions[key] and rank[key] < best for some in beside for v, best in some.items()):
                out.add(key)
    return out


@functools.lru_cache(1024)
def _without_versions(plugins: str) -> str:
    return VERSION.sub(r"\g<kind>/\g<name>;", plugins)


def _is_installed(plugins: str) -> bool:
    """Whether the plugins that a row lists are installed in just these versions."""
    here = catalogue()
    return all(installed_version(p["kind"], p["name"], here) == p["version"] for p in VERSION.finditer(plugins))


def _rows_in(cell: Path) -> list[dict[str, Any]]:
    return read_table(cell / "rows.parquet").to_pylist()


def load_rows(path: str | os.PathLike[str]) -> list[dict[str, Any]]:
    """Rows of a results folder, or of a file that `leaderboard --json` wrote."""
    path = Path(path)
    if path.is_dir():
        return Store(require_results(path, path)).rows()
    if not path.exists():
        raise ClothbenchError(f"{path}: no such folder or file; give a results folder or a leaderboard .json")
    if not (rows := require_rows(read_json(path, LISTED), path)):
        raise ClothbenchError(f"{path}: found an empty list, expected {LISTED}")
    return rows


def require_results(folder: Path, named: object) -> Path:
    """The folder; one without any cells is the user's error. named: how it was asked for."""
    if not (folder / "cells").is_dir():
        raise ClothbenchError(
            f"{named}: found no results (no folder 'cells'); make some with clothbench run … out={named}"
        )
    return folder
