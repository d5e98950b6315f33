"""`clothbench submit` and `clothbench verify`: what others simulated, scored and checked."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.markup import escape
from rich.table import Table

from clothbench.core.errors import ClothbenchError, seen
from clothbench.display.terminal import console
from clothbench.engine.store import Store
from clothbench.engine.suite import resolve
from clothbench.plugins.discovery import Catalogue, catalogue
from clothbench.recordings.nodes import Recording, find_recordings, read_recording
from clothbench.submissions.grades import REPRODUCED, VERIFIED, cells_of, choose, held_out, reproduce
from clothbench.submissions.kept import keep, rows_of
from clothbench.submissions.packing import pack_results
from clothbench.submissions.sandbox import sandbox
from clothbench.submissions.site import write_site
from clothbench.submissions.submission import FILE, Compared, pack
from clothbench.submissions.verdicts import verdict_on, write_verdict
from clothbench.submissions.verification import GRADE, Verified, verify

WARNING = (
    "runs the submitter's plugin with your rights: it can read, change and send whatever you can; do it on a machine "
    "or in a container that holds nothing of value, and say so with --run-their-code"
)


def measured(paths: Sequence[str], option: str = "--recordings") -> list[Recording]:
    """The recordings that submissions are held against; of tracked nodes only."""
    found = [read_recording(p) for path in paths for p in find_recordings(resolve(path, {}))]
    names = [recording.name for recording in found]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise ClothbenchError(f"{option}: found {twice[0]!r} twice, expected every name once")
    return found


def submit(options: argparse.Namespace, results: Store | None) -> int:
    """Score what was simulated and write what is handed in. results: that it is made from; None: from the folder."""
    folder, known, plugins = options.folder, measured(options.recordings), catalogue()
    about = {name: seen(getattr(options, name)) for name in ("name", "by", "about", "suite")}
    if results is not None:
        if not options.wheel:
            raise ClothbenchError("submit: --runs needs --wheel FILE, the distribution that the plugins come from")
        found = pack_results(folder, results, options.wheel, known, plugins, **about)
    elif not folder.is_dir():
        raise ClothbenchError(f"{folder}: is not a folder; expected one with simulated recordings (*.nc)")
    else:
        found = pack(folder, known, options.metric or ["node_error"], plugins, **about)
    several = f" by {len(found.cells)} fits" if found.cells else f" of {len(known)} recordings"
    table = Table(title=f"{escape(found.name)}: {len(found.entries)} simulations{several}", title_justify="left")
    for name in ("recording", *found.metrics):
        table.add_column(name, justify="left" if name == "recording" else "right")
    for entry in found.entries:
        table.add_row(
            escape(entry.recording), *(f"{entry.scores[m]:.4g}" if m in entry.scores else "" for m in found.metrics)
        )
    console().print(table)
    print(f"{folder / FILE}: written; anybody can check it with `clothbench verify {folder}`")
    return 0


def verify_all(options: argparse.Namespace) -> int:
    """Check submissions one by one; those that stand go into the results `out`. 1 if one does not."""
    if (options.reproduce or options.held_out) and not options.run_their_code:
        raise ClothbenchError(f"verify: --reproduce and --held-out {WARNING}")
    known, plugins, bad = measured(options.recordings), catalogue(), 0
    secret = measured(options.held_out, "--held-out") if options.held_out else []
    for folder in options.folders:
        try:
            bad += not _verified(folder, known, secret, plugins, options)
        except ClothbenchError as fault:
            print(f"clothbench: {fault}", file=sys.stderr)
            bad += 1
    if options.out is not None and bad < len(options.folders):
        out = options.out
        print(f"`clothbench leaderboard --out {out}` lists what stands, `clothbench report out={out}` makes a page")
    return 1 if bad else 0


def _verified(
    folder: Path,
    known: Sequence[Recording],
    secret: Sequence[Recording],
    plugins: Catalogue,
    options: argparse.Namespace,
) -> bool:
    """Check one submission as far as was asked for, and keep what stands; whether all of it does."""
    found = verify(folder, known, plugins)
    tell(folder, found, len(known))
    if found.faults:
        return False
    grade, more = GRADE, dict[str, Any]()
    unpublished: list[Compared] = []
    if options.reproduce or secret:
        cells_of(folder, found.submission, plugins)
        wheels = [folder / wheel.file for wheel in found.submission.wheels]
        with sandbox(wheels, options.time_limit) as place:
            more["network"] = "cut off" if place.fence else "open"
            print(f"running its plugin, network {more['network']}, {options.time_limit:g} s at most for each fit")
            if options.reproduce:
                chosen = choose(folder, found.submission, options.cells, options.seed)
                told = f"{len(chosen.keys)} of {len(found.submission.cells)} cells by seed {chosen.seed}"
                print(f"chosen: {told}: {', '.join(chosen.keys)}")
                if not refused(reproduce(folder, found.submission, found.found, chosen, place, plugins)):
                    return False
                grade, more = REPRODUCED, {**more, "seed": chosen.seed, "cells": chosen.keys}
                print(f"{found.submission.name}: {REPRODUCED}, {told}, within the noise")
            if secret:
                unpublished = held_out(folder, found.submission, secret, known, place, plugins)
                grade, more = VERIFIED, {**more, "unpublished": [r for r in rows_of(unpublished) if not r["recording"]]}
                _tell_unpublished(found.submission.name, unpublished)
    if options.verdicts is not None and grade != GRADE:
        verdict = verdict_on(folder, found.submission.name, grade, **more)
        print(f"{write_verdict(options.verdicts, verdict, folder)}: written")
    if options.out is not None:
        store = Store(options.out)
        keep(found.submission, found.found, store, plugins, REPRODUCED if options.reproduce else GRADE)
        keep(found.submission, unpublished, store, plugins, VERIFIED, named=False)
    return True


def site(folder: Path, out: Path, recordings: Sequence[str], verdicts: Path | None) -> int:
    """Write the static site; 0 whatever came of the submissions, which the site says."""
    for one in write_site(folder, out, measured(recordings), verdicts, catalogue()):
        print(f"{one.folder}: {one.grade if not one.reason else f'refused: {one.reason}'}")
    print(f"site: {out / 'index.html'}")
    return 0


def refused(faults: Sequence[str]) -> bool:
    """Say each fault in a line; whether there was none."""
    for fault in faults:
        print(f"refused: {fault}", file=sys.stderr)
    return not faults


def _tell_unpublished(name: str, found: Sequence[Compared]) -> None:
    """Means only: which recordings they are is nobody's business."""
    table = Table(
        title=f"{name}: {VERIFIED}, on {len(found)} simulations of unpublished recordings", title_justify="left"
    )
    for column in ("metric", "mean error", "floor"):
        table.add_column(column, justify="left" if column == "metric" else "right")
    for row in rows_of(found):
        if row["recording"] is None:
            floor = "" if row["floor"] is None else f"{row['floor']:.3g}"
            table.add_row(row["metric"], f"{row['value']:.4g} {row['unit']}", floor)
    console().print(table)


def tell(folder: Path, found: Verified, of: int) -> None:
    grade = f"[red]refused[/], {len(found.faults)} faults" if found.faults else f"[green]{GRADE}[/]"
    name, recordings = found.submission.name, len({one.measured.hash for one in found.found})
    title = f"{escape(f'{name} ({folder})')}: {grade}, {recordings} of {of} recordings"
    table = Table(title=title, title_justify="left")
    table.add_column("recording")
    for name in ("metric", "computed again", "floor"):
        table.add_column(name, justify="left" if name == "metric" else "right")
    for one in found.found:
        for metric, value in one.scores.items():
            floor = "" if one.floors[metric] != one.floors[metric] else f"{one.floors[metric]:.3g}"
            table.add_row(escape(one.measured.name), metric, f"{value:.4g} {one.units[metric]}", floor)
    console().print(table)
    refused(found.faults)
