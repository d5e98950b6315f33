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
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from clothbench.core.errors import ClothbenchError
from clothbench.core.files import read_json, whole_file
from clothbench.engine.cells import digest
from clothbench.engine.store import Store, leaderboard_row, require_rows, rows_in
from clothbench.history.commits import Commit, commits_of, text_at

SCHEMA = 1
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
    """Put what a results folder holds into a history, as an entry for each machine that it was computed on."""
    by_machine: dict[str, list[dict[str, Any]]] = {}
    for row in results.rows():
        by_machine.setdefault(f"{row['cpu']}, {row['cores']} cores", []).append(leaderboard_row(row))
    if not by_machine:
        raise ClothbenchError(f"{results.folder}: found no results to add; make some with clothbench run … out=FOLDER")
    return [
        _write(folder, Entry(commit.hash, commit.date, commit.subject, machine, rows))
        for machine, rows in sorted(by_machine.items())
    ]


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
    stated["rows"] = require_rows(stated.get("rows"), path)
    _instant(stated["date"], f"{path}: date")
    return Entry(**{field.name: stated[field.name] for field in dataclasses.fields(Entry)})


def _instant(date: str, where: str) -> datetime:
    try:
        found = datetime.fromisoformat(date)
    except ValueError:
        raise ClothbenchError(f"{where}: is {date!r}, expected a date like 2026-01-31T09:29:00+00:00") from None
    return found.astimezone(UTC) if found.tzinfo else found.replace(tzinfo=UTC)


def entries_of_git(path: Path, machine: str | None) -> list[Entry]:
    """What a committed leaderboard (`clothbench leaderboard --json`) held at every commit that changed it, the oldest
    first. machine: that all of them were computed on, which the file does not say; None: not known.
    """
    found = []
    for commit in commits_of(path):
        if (text := text_at(path, commit)) is not None:  # None: that commit removed the file
            rows = rows_in(text, f"{path} at {commit.hash[:SHORT]}")
            found.append(Entry(commit.hash, commit.date, commit.subject, machine, rows))
    if not found:
        raise ClothbenchError(f"{path}: found no commit with this file, expected a committed leaderboard .json")
    return found
