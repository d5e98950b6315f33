"""`clothbench submit` and `clothbench verify`: what others simulated, scored and checked."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from rich.markup import escape
from rich.table import Table

from clothbench.core.errors import ClothbenchError, seen
from clothbench.display.terminal import console
from clothbench.engine.store import Store
from clothbench.engine.suite import resolve
from clothbench.plugins.discovery import Catalogue, catalogue
from clothbench.recordings.nodes import Recording, find_recordings, read_recording
from clothbench.submissions.grades import choose, held_out, reproduce, require_new
from clothbench.submissions.kept import drop, keep, rows_of
from clothbench.submissions.packing import pack_results, require_wheel
from clothbench.submissions.reading import require_submission
from clothbench.submissions.sandbox import require_posix, sandbox
from clothbench.submissions.site import write_site
from clothbench.submissions.submission import FILE, Compared, pack
from clothbench.submissions.unpublished import Fabric, by_fabric, require_unpublished
from clothbench.submissions.verdicts import HELD_OUT, WHEELS, Verdict, find_verdict, verdict_on, write_verdict
from clothbench.submissions.verification import REFUSED, REPRODUCED, VERIFIED, Verified, verify

WARNING = (
    "runs the submitter's plugin with your rights: it can read, change and send whatever you can; do it on a machine "
    "or in a container that holds nothing of value, and say so with --run-their-code"
)
CELLS, TIME_LIMIT = 2, 3600.0  # that are run again, and s that one fit of them may take, where nobody says


def measured(paths: Sequence[str], option: str = "--recordings") -> list[Recording]:
    """The recordings that submissions are held against; of tracked nodes only."""
    found = [read_recording(p) for path in paths for p in find_recordings(resolve(path, {}))]
    names = [recording.name for recording in found]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise ClothbenchError(f"{option}: found {twice[0]!r} twice, expected every name once")
    return found


def submit(options: argparse.Namespace, results: Store | None) -> int:
    """Score what was simulated and write what is handed in. results: that it is made from; None: from the folder."""
    if results is None and options.wheel:
        raise ClothbenchError("submit: --wheel is for the fits of --runs; give --runs RUNS, or leave it out")
    if results is not None and options.metric:
        raise ClothbenchError("submit: --metric is for simulated files; the fits of --runs have theirs, leave it out")
    if not options.name.strip():
        raise ClothbenchError(f"submit: --name is {options.name!r}, expected what the model is called")
    for wheel in options.wheel or ():
        require_wheel(wheel)
    folder, known, plugins = options.folder, measured(options.recordings), catalogue()
    about = {name: seen(getattr(options, name)) for name in ("name", "by", "about")}
    about["suite"] = seen(options.suite or suite_of(options.recordings))
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
    table.add_column("recording")
    for name in found.metrics:
        table.add_column(escape(f"{name} [{plugins.make('metrics', name).unit}]"), justify="right")
    for entry in found.entries:
        table.add_row(
            escape(entry.recording), *(f"{entry.scores[m]:.4g}" if m in entry.scores else "" for m in found.metrics)
        )
    console().print(table)
    check = shlex.join(["clothbench", "verify", str(folder), "--recordings", *options.recordings])
    print(f"{folder / FILE}: written; anybody who has the recordings can check it with `{check}`")
    return 0


def suite_of(recordings: Sequence[str]) -> str:
    """What recordings are called as a whole: by the names of their folders, or of what has them built in."""
    places = []
    for name in recordings:
        inside = name.startswith(("builtin:", "dataset:", "pkg:"))
        path = Path(name.partition(":")[2]) if inside else Path(name).resolve()
        places.append(path.parent.name if path.suffix.lower() == ".nc" else path.name)
    return ", ".join(filter(None, dict.fromkeys(places))) or "recordings"


def verify_all(options: argparse.Namespace) -> int:
    """Check submissions one by one; those that stand go into the results `out`. 1 if one does not. A folder without a
    submission is refused before anything is looked at.
    """
    if (options.reproduce or options.held_out) and not options.run_their_code:
        raise ClothbenchError(f"verify: --reproduce and --held-out {WARNING}")
    given = {
        "run-their-code": options.run_their_code or None, "cells": options.cells, "seed": options.seed,
        "time-limit": options.time_limit,
    }  # fmt: skip
    idle = [name for name, value in given.items() if value is not None]
    if idle and not (options.reproduce or options.held_out):
        raise ClothbenchError(
            f"verify: --{idle[0]} is for --reproduce and --held-out, which run a plugin; give one of them, or leave it "
            "out"
        )
    if options.verdicts is not None and not (options.reproduce or options.held_out or options.out):
        raise ClothbenchError("verify: --verdicts is for --reproduce, --held-out and --out; give one, or leave it out")
    for folder in options.folders:
        require_submission(folder)
    known, plugins, bad = measured(options.recordings), catalogue(), 0
    secret = measured(options.held_out, "--held-out") if options.held_out else []
    require_unpublished(secret, known)
    fabrics = by_fabric(secret)
    for folder in options.folders:
        try:
            bad += not _verified(folder, known, fabrics, plugins, options)
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
    fabrics: Mapping[str, Fabric],
    plugins: Catalogue,
    options: argparse.Namespace,
) -> bool:
    """Check one submission as far as was asked for, and keep what stands; whether all of it does."""
    try:
        found = verify(folder, known, plugins)
    except OSError as fault:  # whatever its files are, the others are looked at
        raise ClothbenchError(f"{folder}: {fault}; it cannot be read") from None
    if found.faults:
        _refuse(folder, found, found.faults)
        return False
    verdict, unpublished = verdict_on(folder, found.submission.name), list[Compared]()
    if options.reproduce or fabrics:
        verdict, unpublished = _run(folder, found, verdict, fabrics, plugins, options)
    if options.verdicts is not None:
        verdict = verdict.after(find_verdict(options.verdicts, folder))
        if options.reproduce or fabrics:
            print(f"{write_verdict(options.verdicts, verdict, folder)}: written")
    if options.out is not None:
        store = Store(options.out)
        if verdict.faults:
            drop(found.submission, store)
        else:
            keep(found.submission, found.found, store, plugins, verdict.cells)
            keep(found.submission, unpublished, store, plugins, named=False)
    if verdict.faults:
        _refuse(folder, found, [fault for faults in verdict.faults.values() for fault in faults])
        return False
    tell(folder, found, len(known), verdict)
    return True


def _run(
    folder: Path,
    found: Verified,
    verdict: Verdict,
    fabrics: Mapping[str, Fabric],
    plugins: Catalogue,
    options: argparse.Namespace,
) -> tuple[Verdict, list[Compared]]:
    """Run the plugin of a submission as was asked for: what came of it, and what it made of unpublished recordings."""
    of, unpublished = found.submission, list[Compared]()
    require_posix()
    require_new(folder, of, fabrics)
    what, limit = WHEELS, TIME_LIMIT if options.time_limit is None else options.time_limit
    try:
        with sandbox([folder / wheel.file for wheel in of.wheels], limit) as place:
            verdict = replace(verdict, network="cut off" if place.fence else "open")
            print(f"running its plugin, network {verdict.network}, {limit:g} s at most for each fit")
            if options.reproduce:
                chosen = choose(folder, of, options.cells or CELLS, options.seed)
                told = f"{len(chosen.keys)} of {len(of.cells)} cells by seed {chosen.seed}"
                print(f"chosen: {told}: {', '.join(chosen.keys)}")
                faults = reproduce(folder, of, found.found, chosen, place, plugins)
                passed = [key for key in chosen.keys if key not in faults]
                verdict = replace(verdict, seed=chosen.seed, cells=passed, faults=faults)
                if faults:
                    return verdict, []
                print(f"{of.name}: {REPRODUCED}, {told}, within the noise")
            if fabrics:
                what = HELD_OUT
                unpublished = held_out(folder, of, fabrics, place, plugins)
                means = [row for row in rows_of(unpublished) if row["recording"] is None]
                verdict = replace(verdict, unpublished=means)
    except ClothbenchError as fault:
        if what == WHEELS:
            return replace(verdict, faults={what: [str(fault).replace(f"{folder}/", "")]}), []
        print(f"clothbench: {fault}", file=sys.stderr)  # for whoever has the recordings; it may name them
        said = "it could not be fitted to unpublished recordings, or scored on them"
        return replace(verdict, faults={what: [said]}), []
    return verdict, unpublished


def site(folder: Path, out: Path, recordings: Sequence[str], verdicts: Path | None) -> int:
    """Write the static site; 0 whatever came of the submissions, which the site says."""
    for one in write_site(folder, out, measured(recordings), verdicts, catalogue()):
        print(f"{one.folder}: {one.grade if not one.reason else f'refused: {one.reason}'}")
    print(f"site: {out / 'index.html'}")
    return 0


def _refuse(folder: Path, found: Verified, faults: Sequence[str]) -> None:
    """Say why a submission does not stand, a line for each fault."""
    print(f"{found.submission.name} ({folder}): {REFUSED}, {len(faults)} fault{'s' if len(faults) > 1 else ''}")
    for fault in faults:
        print(f"refused: {fault}", file=sys.stderr)


def tell(folder: Path, found: Verified, of: int, verdict: Verdict) -> None:
    """Every score, each with the grade that it was shown to have."""
    name, recordings = found.submission.name, len({one.measured.hash for one in found.found})
    title = f"{escape(f'{name} ({folder})')}: [green]{verdict.grade}[/], {recordings} of {of} recordings"
    table = Table(title=title, title_justify="left")
    for column in ("recording", "metric", "computed again", "floor", "grade"):
        table.add_column(column, justify="right" if column in ("computed again", "floor") else "left")
    for one in found.found:
        for metric, value in one.scores.items():
            score = _scored(metric, value, one.units[metric], one.floors[metric])
            table.add_row(escape(one.measured.name), *score, verdict.grade_of([one.cell]))
    for row in verdict.unpublished:  # means only: which recordings they are is nobody's business
        score = _scored(row["metric"], row["value"], row["unit"], row["floor"])
        table.add_row("unpublished, mean", *score, VERIFIED)
    console().print(table)
    for moved, split in dict.fromkeys((one.measured.name, one.split) for one in found.found if one.against_file):
        if split == "fit":
            print(f"{moved}: shown under fit: a fit used it, though its file holds it out")
        else:
            print(f"{moved}: shown under held_out: a fit did not use it, though its file says that it is to fit")


def _scored(metric: str, value: float, unit: str, floor: float | None) -> tuple[str, str, str]:
    return metric, f"{value:.4g} {unit}", "" if floor is None or floor != floor else f"{floor:.3g}"
