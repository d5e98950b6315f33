"""Verification of a submission: every file as stated, every score computed again; then rows for the leaderboard."""

from __future__ import annotations

import dataclasses
import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import clothbench
from clothbench.core.errors import ClothbenchError
from clothbench.core.files import sha256
from clothbench.plugins.discovery import Catalogue
from clothbench.recordings.nodes import Recording, read_recording
from clothbench.studies.calibration.cell import CalibrationCell
from clothbench.submissions.reading import questions_of, read_submission
from clothbench.submissions.submission import (
    FILE,
    Compared,
    Entry,
    Submission,
    compared,
    require_all,
    require_same_metrics,
)

GRADE, REPRODUCED, VERIFIED, REFUSED = "recomputed", "reproduced", "verified", "refused"
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
            f"score it again with `clothbench submit {folder} --name {shlex.quote(submission.name)}`"
        )
    require_all(folder, [entry.recording for entry in submission.entries], measured)
    require_same_metrics(folder, submission.entries)
    by_hash, found = {recording.hash: recording for recording in measured}, []
    cells, faults = questions_of(folder, submission)
    for wheel in submission.wheels:
        try:
            require_same_file(folder / wheel.file, wheel.sha256, "wheels.file")
        except ClothbenchError as fault:
            faults.append(str(fault))
    of = [(entry.cell, entry.recording_hash) for entry in submission.entries]
    faults += [
        f"{folder / FILE}: cell {key}: has no simulation of {source.name!r}, which it is about; expected one of each"
        for key, cell in cells.items()
        for source in cell.recordings
        if (key, source.hash) not in of
    ]
    for number, entry in enumerate(submission.entries):
        if of[number] in of[:number]:
            faults.append(f"{folder / entry.file}: is a second one of {entry.recording!r}, expected one for each fit")
            continue
        try:
            again = _again(folder / entry.file, entry, by_hash, plugins)
            _require_of_fit(f"{folder / FILE}: entries[{number}]", entry, submission, cells)
            found.append(dataclasses.replace(again, fitted=was_fitted(cells.get(entry.cell), entry.recording_hash)))
        except ClothbenchError as fault:
            faults.append(str(fault))
    return Verified(submission, tuple(found), tuple(faults))


def _require_of_fit(where: str, entry: Entry, submission: Submission, cells: Mapping[str, CalibrationCell]) -> None:
    """Refuse an entry of a fit that is not handed in, or that never knew its recording: one recording under many
    invented keys would make the mean.
    """
    if entry.cell and entry.cell not in {told.key for told in submission.cells}:
        raise ClothbenchError(f"{where}.cell is {entry.cell!r}, expected the key of one of the cells, or none")
    cell = cells.get(entry.cell)  # none of a damaged question either, which is a fault of its own
    if cell is not None and entry.recording_hash not in {source.hash for source in cell.recordings}:
        raise ClothbenchError(
            f"{where}.cell is {entry.cell!r}, whose question lacks {entry.recording!r}; expected a fit that has it"
        )


def was_fitted(cell: CalibrationCell | None, recording: str) -> bool | None:
    """Whether a fit used a recording, given by its hash: a suite may split otherwise than the files state. None where
    the fit is not known, or does not say.
    """
    splits = [source.split for source in cell.recordings if source.hash == recording] if cell else []
    return "fit" in splits if splits else None


def require_same_file(path: Path, expected: str, field: str) -> None:
    """Refuse a file that is not there, or is another one than was handed in. expected: its SHA-256; field: of
    `submission.json`, that names it.
    """
    try:
        found = sha256(path) if path.is_file() else None
    except (OSError, ValueError) as fault:  # a name that no file can have: it comes from a stranger
        said = getattr(fault, "strerror", None) or fault
        raise ClothbenchError(f"{path}: {field} cannot be read ({said}); expected a file of the submission") from None
    if found is None:
        raise ClothbenchError(f"{path}: is not there; the submission names it")
    if found != expected:
        raise ClothbenchError(
            f"{path}: found SHA-256 {found[:12]}…, expected {expected[:12]}…: it is not the file that was handed in"
        )


def _again(path: Path, entry: Entry, measured: Mapping[str, Recording], plugins: Catalogue) -> Compared:
    require_same_file(path, entry.sha256, "entries.file")
    if entry.recording_hash not in measured:
        raise ClothbenchError(
            f"{path}: is of a recording {entry.recording!r} with hash {entry.recording_hash[:12]}…, which is not among "
            "those given; name the right ones with --recordings"
        )
    if entry.recording != (name := measured[entry.recording_hash].name):
        raise ClothbenchError(f"{path}: is said to be of {entry.recording!r}, but its hash is that of {name!r}")
    again = compared(path, read_recording(path), measured[entry.recording_hash], entry.scores, plugins, entry.cell)
    for metric, claimed in entry.scores.items():
        if not math.isclose(again.scores[metric], claimed, rel_tol=AGREES, abs_tol=1e-12):
            unit = again.units[metric]
            raise ClothbenchError(
                f"{path}: {metric} is {again.scores[metric]:.6g} {unit}, claimed were {claimed:.6g} {unit}"
            )
    return again
