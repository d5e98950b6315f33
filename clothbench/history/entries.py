"""Entries of a history: what came of one commit on one machine. From a folder of them, or from git itself.

A history is a folder with a file for each entry, which never changes and is named by its content: any number of jobs
may add to it, on a branch, too, and no two of them meet in one file. An entry is a JSON document:

| key | meaning |
|---|---|
| `schema` | 1 |
| `commit`, `date`, `subject` | the commit: its hash, when it was made (ISO 8601), the first line of its message |
| `machine` | processor and cores; null: not known, and its speeds are then compared with no others |
| `rows` | of the leaderboard, as `clothbench leaderboard --json` prints them |
"""

from __future__ import annotations

import dataclasses
import json
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from clothbench.core.errors import ClothbenchError, seen
from clothbench.core.files import read_json, whole_file
from clothbench.engine.cells import digest
from clothbench.engine.leaderboard import leaderboard_row, require_rows, rows_in
from clothbench.engine.store import Store
from clothbench.history.commits import Commit, commits_of, text_at

SCHEMA = 1
SHORTEST, LONGEST = 1e-9, 1e12  # s that a cell may have taken
LARGEST = 1e100  # of any error
SHORT = 10  # digits of a commit that people are shown


@dataclass(frozen=True)
class Entry:
    """One commit on one machine. rows: of the leaderboard."""

    commit: str
    date: str
    subject: str
    machine: str | None
    rows: Sequence[Mapping[str, Any]]

    @property
    def short(self) -> str:
        return self.commit[:SHORT]


def add(folder: Path, results: Store, commit: Commit) -> list[Path]:
    """Put what a results folder holds into a history, as an entry for each machine that it was computed on; nothing is
    written where one of them, or of those that are there, could not be read again.
    """
    for path in sorted(folder.glob("*.json")):
        _read(path)  # what is there already is to be readable with the new one
    by_machine: dict[str | None, list[dict[str, Any]]] = {}
    for row in results.rows():
        machine = None if row["cpu"] is None else f"{row['cpu']}, {row['cores']} cores"
        by_machine.setdefault(machine, []).append(leaderboard_row(row))
    if not by_machine:
        raise ClothbenchError(f"{results.folder}: found no results to add; make some with clothbench run … out=FOLDER")
    _instant(commit.date, "the commit's date")
    entries = [
        Entry(commit.hash, commit.date, commit.subject, machine, _followed(rows, results.folder))
        for machine, rows in sorted(by_machine.items(), key=lambda item: item[0] or "")
    ]
    return [_write(folder, entry) for entry in entries]


def _write(folder: Path, entry: Entry) -> Path:
    document = {"schema": SCHEMA, **asdict(entry)}
    when = _instant(entry.date, "the commit's date").strftime("%Y%m%dT%H%M%SZ")
    path = folder / f"{when}-{entry.short}-{digest(document, 8)}.json"
    with whole_file(path) as part:
        part.write_text(json.dumps(document, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8")
    return path


def entries_in(folder: Path) -> list[Entry]:
    """Every entry of a history, by the time of its commit; faults are one line."""
    paths = sorted(folder.glob("*.json"))
    if not paths:
        raise ClothbenchError(
            f"{folder}: found no entries (*.json); add one with `clothbench history {folder} --add RUNS`, or read a "
            "committed leaderboard at every commit with --git FILE"
        )
    return sorted((_read(path) for path in paths), key=lambda e: _instant(e.date, e.commit))


def _read(path: Path) -> Entry:
    stated = read_json(path, "an entry of a history; remove it")
    if not isinstance(stated, dict) or stated.get("schema") != SCHEMA:
        found = stated.get("schema") if isinstance(stated, dict) else type(stated).__name__
        raise ClothbenchError(f"{path}: schema is {found!r}, expected {SCHEMA}; entries of another are set aside")
    for key in ("commit", "date", "subject"):
        if not isinstance(stated.get(key), str):
            raise ClothbenchError(f"{path}: {key} is {stated.get(key)!r}, expected text")
    if not isinstance(stated.get("machine"), str | None):
        raise ClothbenchError(f"{path}: machine is {stated['machine']!r}, expected text or null")
    for key in ("commit", "subject", "machine"):
        stated[key] = stated[key] and seen(stated[key])
    stated["rows"] = _followed(require_rows(stated.get("rows"), path), path)
    _instant(stated["date"], f"{path}: date")
    return Entry(**{field.name: stated[field.name] for field in dataclasses.fields(Entry)})


def _instant(date: str, where: str) -> datetime:
    try:
        found = datetime.fromisoformat(date)
        return found.astimezone(UTC) if found.tzinfo else found.replace(tzinfo=UTC)
    except (ValueError, OverflowError):
        raise ClothbenchError(f"{where}: is {date!r}, expected a date like 2026-01-31T09:29:00+00:00") from None


def _followed(rows: list[dict[str, Any]], where: object) -> list[dict[str, Any]]:
    """Rows that a series can be made of; one that is no suite's, or whose numbers no run has, is refused."""
    for number, row in enumerate(rows):
        at = f"{where}: rows[{number}]"
        if not (row["suite"] or "").strip():
            raise ClothbenchError(f"{at}.suite is {row['suite']!r}, expected the name of a suite")
        if (row["evaluations"] or 0) < 0:
            raise ClothbenchError(f"{at}.evaluations is {row['evaluations']}, expected 0 at least")
        if (wall := row["wall_s"]) and math.isfinite(wall) and not SHORTEST <= wall <= LONGEST:
            raise ClothbenchError(f"{at}.wall_s is {wall:g}, expected 0, or {SHORTEST:g} to {LONGEST:g} s")
        for name in ("value", "low", "high", "reference"):
            if row[name] is not None and math.isfinite(row[name]) and abs(row[name]) > LARGEST:
                raise ClothbenchError(f"{at}.{name} is {row[name]:g}, expected {LARGEST:g} at most")
    return rows


def entries_of_git(path: Path, machine: str | None) -> list[Entry]:
    """What a committed leaderboard (`clothbench leaderboard --json`) held at every commit that changed it, the oldest
    first. machine: that all of them were computed on, which the file does not say; None: not known. A commit whose file
    cannot be read is left out with a line on standard error; a ClothbenchError if that is so of all.
    """
    found, faults = list[Entry](), list[ClothbenchError]()
    for commit in commits_of(path):
        if (text := text_at(path, commit)) is not None:  # None: that commit removed the file
            where = f"{path} at {commit.hash[:SHORT]}"
            try:
                rows = _followed(rows_in(text, where), where)
            except ClothbenchError as fault:
                faults.append(fault)
                continue
            found.append(Entry(commit.hash, commit.date, commit.subject, machine, rows))
    if faults and not found:
        raise faults[-1]
    for said in faults:
        print(f"clothbench: {said}; left out", file=sys.stderr)
    if not found:
        raise ClothbenchError(f"{path}: found no commit with this file, expected a committed leaderboard .json")
    return found
