"""`clothbench submit` and `clothbench verify`: what others simulated, scored and checked."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from rich.markup import escape
from rich.table import Table

from clothbench.core.errors import ClothbenchError, seen
from clothbench.display.terminal import console
from clothbench.engine.store import Store
from clothbench.engine.suite import resolve
from clothbench.plugins.discovery import catalogue
from clothbench.recordings.nodes import Recording, find_recordings, read_recording
from clothbench.submissions.submission import FILE, pack
from clothbench.submissions.verification import GRADE, Verified, keep, verify


def measured(paths: Sequence[str]) -> list[Recording]:
    """The recordings that submissions are held against; of tracked nodes only."""
    found = [read_recording(p) for path in paths for p in find_recordings(resolve(path, {}))]
    names = [recording.name for recording in found]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise ClothbenchError(f"--recordings: found {twice[0]!r} twice, expected every name once")
    return found


def submit(folder: Path, recordings: Sequence[str], metrics: Sequence[str], **about: str) -> int:
    """Score the simulated recordings in a folder and write what it hands in."""
    if not folder.is_dir():
        raise ClothbenchError(f"{folder}: is not a folder; expected one with simulated recordings (*.nc)")
    known, plugins = measured(recordings), catalogue()
    found = pack(folder, known, metrics, plugins, **{name: seen(text) for name, text in about.items()})
    table = Table(title=f"{escape(found.name)}: {len(found.entries)} of {len(known)} recordings", title_justify="left")
    for name in ("recording", *found.metrics):
        table.add_column(name, justify="left" if name == "recording" else "right")
    for entry in found.entries:
        table.add_row(escape(entry.recording), *(f"{entry.scores[metric]:.4g}" for metric in found.metrics))
    console().print(table)
    print(f"{folder / FILE}: written; anybody can check it with `clothbench verify {folder}`")
    return 0


def verify_all(folders: Sequence[Path], recordings: Sequence[str], out: Path | None) -> int:
    """Check submissions one by one; those that stand go into the results `out`. 1 if one does not."""
    known, plugins, bad = measured(recordings), catalogue(), 0
    for folder in folders:
        try:
            found = verify(folder, known, plugins)
        except ClothbenchError as fault:
            print(f"clothbench: {fault}", file=sys.stderr)
            bad += 1
            continue
        tell(folder, found, len(known))
        bad += bool(found.faults)
        if out is not None and not found.faults:
            keep(found, Store(out), plugins)
    if out is not None and bad < len(folders):
        print(f"`clothbench leaderboard --out {out}` lists what stands, `clothbench report out={out}` makes a page")
    return 1 if bad else 0


def tell(folder: Path, found: Verified, of: int) -> None:
    grade = f"[red]refused[/], {len(found.faults)} faults" if found.faults else f"[green]{GRADE}[/]"
    name = found.submission.name
    table = Table(
        title=f"{escape(f'{name} ({folder})')}: {grade}, {len(found.found)} of {of} recordings", title_justify="left"
    )
    table.add_column("recording")
    for name in ("metric", "computed again", "floor"):
        table.add_column(name, justify="left" if name == "metric" else "right")
    for one in found.found:
        for metric, value in one.scores.items():
            floor = "" if one.floors[metric] != one.floors[metric] else f"{one.floors[metric]:.3g}"
            table.add_row(escape(one.measured.name), metric, f"{value:.4g} {one.units[metric]}", floor)
    console().print(table)
    for fault in found.faults:
        print(f"refused: {fault}", file=sys.stderr)
