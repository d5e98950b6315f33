"""Verification of a submission: every file as stated, every score computed again; then rows for the leaderboard."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import clothbench
from clothbench.core.errors import ClothbenchError
from clothbench.engine.cells import digest, listed, plugin_versions
from clothbench.engine.store import Store, finite, now, system_info
from clothbench.plugins.discovery import Catalogue
from clothbench.recordings.nodes import Recording, read_recording
from clothbench.submissions.submission import (
    Compared,
    Entry,
    Submission,
    compared,
    read_submission,
    require_all,
    sha256,
)

GRADE = "recomputed"
AGREES = 1e-6  # relative: what the order of a sum may change from machine to machine


@dataclass(frozen=True)
class Verified:
    """What came of a submission. found: of each entry that stands; faults: one line each, of what does not."""

    submission: Submission
    found: tuple[Compared, ...]
    faults: tuple[str, ...]


def verify(folder: Path, measured: Sequence[Recording], plugins: Catalogue) -> Verified:
    """Compute every score of a submission again, from files that are what they were when it was handed in.

    A submission that another version scored is set aside whole: metrics may have changed.
    """
    submission = read_submission(folder)
    if submission.clothbench != clothbench.__version__:
        raise ClothbenchError(
            f"{folder}: scored by clothbench {submission.clothbench}, this is {clothbench.__version__}; set aside: "
            f"score it again with `clothbench submit {folder}`"
        )
    require_all(folder, [entry.recording for entry in submission.entries], measured)
    by_hash, found, faults = {recording.hash: recording for recording in measured}, [], []
    for entry in submission.entries:
        try:
            found.append(_again(folder / entry.file, entry, by_hash, plugins))
        except ClothbenchError as fault:
            faults.append(str(fault))
    return Verified(submission, tuple(found), tuple(faults))


def _again(path: Path, entry: Entry, measured: Mapping[str, Recording], plugins: Catalogue) -> Compared:
    if not path.is_file():
        raise ClothbenchError(f"{path}: is not there; entry {entry.recording!r} names it")
    if (found := sha256(path)) != entry.sha256:
        raise ClothbenchError(
            f"{path}: found SHA-256 {found[:12]}…, expected {entry.sha256[:12]}…: it is not the file that was handed in"
        )
    if entry.recording_hash not in measured:
        raise ClothbenchError(
            f"{path}: is of a recording {entry.recording!r} with hash {entry.recording_hash[:12]}…, which is not among "
            "those given; name the right ones with --recordings"
        )
    again = compared(path, read_recording(path), measured[entry.recording_hash], entry.scores, plugins)
    for metric, claimed in entry.scores.items():
        if not math.isclose(again.scores[metric], claimed, rel_tol=AGREES, abs_tol=1e-12):
            unit = again.units[metric]
            raise ClothbenchError(
                f"{path}: {metric} is {again.scores[metric]:.6g} {unit}, claimed were {claimed:.6g} {unit}"
            )
    return again


def keep(verified: Verified, store: Store, plugins: Catalogue) -> list[str]:
    """A cell of the store for each fabric, with a row for each score that stands and for the mean of each split; gives
    their keys. In place of an optimizer the rows show the grade: how the model was fitted is not known here.
    """
    submission, keys = verified.submission, []
    digests = {entry.recording: entry.sha256 for entry in submission.entries}  # of files that were found to be so
    versions = plugin_versions([("metrics", metric) for metric in submission.metrics], plugins)
    by_fabric: dict[str, list[Compared]] = {}
    for one in verified.found:
        by_fabric.setdefault(one.measured.fabric, []).append(one)
    for fabric, mine in by_fabric.items():
        key = digest([submission.name, sorted(digests[one.measured.name] for one in mine), sorted(submission.metrics)])
        about = {
            "study": "calibration", "suite": submission.suite, "case": fabric, "model": submission.name, "effects": "",
            "optimizer": f"submitted, {GRADE}", "seed": 0, "key": key, "status": "ok", "reason": None, "evaluations": 0,
            "wall_s": 0.0, "low": None, "high": None, "reference": None, "budget": None, "settings": None,
            "plugins": listed(versions), "threads": None,
            "finished": now(), **system_info(),
        }  # fmt: skip
        store.put(key, {"rows": [{**about, **row} for row in _rows(mine)]})
        keys.append(key)
    return keys


def _rows(compared: Sequence[Compared]) -> list[dict[str, Any]]:
    """What differs from row to row: of each recording and metric, and the means of each split."""
    out = []
    for metric in dict.fromkeys(metric for one in compared for metric in one.scores):
        common = {"metric": metric, "objective": metric}
        for split in dict.fromkeys(one.measured.split for one in compared):
            mine = [one for one in compared if one.measured.split == split and metric in one.scores]
            scores, floors = [one.scores[metric] for one in mine], [one.floors[metric] for one in mine]
            names = [None, *(one.measured.name for one in mine)]  # the mean of all is of no recording
            scores, floors = [float(np.mean(scores)), *scores], [float(np.mean(floors)), *floors]
            for name, value, floor in zip(names, scores, floors, strict=True):
                where = {"recording": name, "split": split, "unit": mine[0].units[metric]}
                out.append({**common, **where, "value": value, "floor": finite(floor)})
    return out
