"""A submission: a folder with a simulated recording for each measured one, and `submission.json` about them.

A simulated recording is the measured one's file (kind "nodes") with the simulator's positions of the same material
points at the same times in place of the measured ones, whoever wrote it and in whatever language. `submission.json`:

| key | meaning |
|---|---|
| `schema` | 1 |
| `name`, `by`, `about` | what the model is called on the leaderboard, who hands it in, one line about it |
| `suite` | of which recordings, in words: what its rows are grouped by |
| `clothbench` | the version that scored it |
| `entries` | `recording` and `recording_hash` of what was measured, `file` and its `sha256`, `scores` by metric |
| `entries` | and `cell`, the key of the fit that simulated it, where that is handed in, too |
| `cells` | of a submission made from a results folder: `key` and `question`, all that a fit depends on, as JSON |
| `wheels` | `file` and `sha256` of the distributions that its plugins come from |
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

import clothbench
from clothbench.core.errors import ClothbenchError
from clothbench.core.files import sha256, whole_file
from clothbench.core.rollout import Rollout
from clothbench.engine.cells import seed_of
from clothbench.engine.tables import finite
from clothbench.estimation.intervals import interval_of
from clothbench.plugins.discovery import Catalogue
from clothbench.recordings.nodes import Recording, find_recordings, grips_at, read_recording

FILE, SCHEMA = "submission.json", 1
SAME = 1e-9  # s and m: times, material points and grips are copied, not computed
COPIED = 0.9  # share of the tracker's noise: no cloth lies so near to what was tracked
WHEEL = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.+!-]*\.whl")  # the name of one, as the packaging standard spells them
HELD = 2e-3  # m, how far from its grip a held point may lie: a model may hold the node that is nearest


@dataclass(frozen=True)
class Entry:
    """One simulated recording. file: below the submission's folder; sha256: of that file; scores: by metric's name;
    cell: key of the fit that simulated it, "" where that is not known.
    """

    recording: str
    recording_hash: str
    file: str
    sha256: str
    scores: Mapping[str, float]
    cell: str = ""


@dataclass(frozen=True)
class Wheel:
    """A distribution that is handed in, too. file: below the submission's folder; sha256: of it."""

    file: str
    sha256: str


@dataclass(frozen=True)
class Asked:
    """A fit that is handed in. question: the calibration's cell as JSON text, recordings by hash."""

    key: str
    question: str


@dataclass(frozen=True)
class Submission:
    """What `submission.json` says."""

    name: str
    by: str
    about: str
    suite: str
    clothbench: str
    entries: tuple[Entry, ...]
    cells: tuple[Asked, ...] = ()
    wheels: tuple[Wheel, ...] = ()

    @property
    def metrics(self) -> tuple[str, ...]:
        """The metrics of its scores."""
        return tuple(dict.fromkeys(metric for entry in self.entries for metric in entry.scores))


@dataclass(frozen=True, eq=False)
class Compared:
    """One simulated recording beside what was measured. scores, floors and intervals, the 95 % ones of the scores (NaN
    where there are none): by metric, in its unit; cell: key of the fit, "" where that is not known; fitted: whether the
    fit used the recording, as its question says, None where that is not known.
    """

    measured: Recording
    path: Path
    scores: Mapping[str, float]
    intervals: Mapping[str, tuple[float, float]]
    floors: Mapping[str, float]
    units: Mapping[str, str]
    cell: str = ""
    fitted: bool | None = None

    @property
    def split(self) -> str:
        """What it is shown under: what its fit made of it, which need not be what the recording's file states."""
        if self.fitted is None:
            return self.measured.split
        return "fit" if self.fitted else "held_out"

    def row(self, metric: str) -> dict[str, float | None]:
        """The score by a metric as rows have it: value, low, high and floor, None where one is not known."""
        low, high = self.intervals[metric]
        return {
            "value": self.scores[metric],
            "low": finite(low),
            "high": finite(high),
            "floor": finite(self.floors[metric]),
        }

    @property
    def against_file(self) -> bool:
        """Whether it was fitted, though the recording's file holds it out, or the other way round."""
        return bool(self.measured.split) and self.split != self.measured.split


def pack(
    folder: Path, measured: Sequence[Recording], metrics: Sequence[str], plugins: Catalogue, **about: Any
) -> Submission:
    """Check and score the simulated recordings in a folder, and write its `submission.json`. about: name, by, about and
    suite. The first fault raises a ClothbenchError: file, what was found, what was expected.
    """
    by_name = {recording.name: recording for recording in measured}
    entries: list[Entry] = []
    for path in find_recordings([folder]):
        simulated = read_recording(path)
        if simulated.name not in by_name:
            known = ", ".join(sorted(by_name)[:4])
            raise ClothbenchError(
                f"{path}: found name {simulated.name!r}, expected that of a measured recording ({known}, …)"
            )
        if simulated.name in {entry.recording for entry in entries}:
            raise ClothbenchError(f"{path}: is a second file of {simulated.name!r}, expected one for each recording")
        found = compared(path, simulated, by_name[simulated.name], metrics, plugins)
        entries.append(
            Entry(simulated.name, found.measured.hash, path.relative_to(folder).as_posix(), sha256(path), found.scores)
        )
    require_all(folder, [entry.recording for entry in entries], measured)
    return written(folder, Submission(clothbench=clothbench.__version__, entries=tuple(entries), **about))


def written(folder: Path, submission: Submission) -> Submission:
    """Write a folder's `submission.json`, whole or not at all."""
    with whole_file(folder / FILE) as part:
        part.write_text(json.dumps({"schema": SCHEMA, **asdict(submission)}, indent=1) + "\n", encoding="utf-8")
    return submission


def require_all(folder: Path, names: Iterable[str], measured: Sequence[Recording]) -> None:
    """Refuse a choice of recordings: a model is not to be shown only where it does well."""
    missing = sorted({recording.name for recording in measured} - set(names))
    if missing:
        raise ClothbenchError(
            f"{folder}: has {len(measured) - len(missing)} of {len(measured)} recordings, {missing[0]!r} is missing; "
            "hand in all of them, or name those that it is about with --recordings"
        )


def require_same_metrics(folder: Path, entries: Sequence[Entry]) -> None:
    """Refuse a choice of scores: a mean is not to leave out the recordings on which a model does badly. All entries of
    a fit have the same metrics, and every metric is there for all recordings; another fit may have other ones.
    """
    for name in dict.fromkeys(metric for entry in entries for metric in entry.scores):
        fits = {entry.cell for entry in entries if name in entry.scores}
        known = {entry.recording for entry in entries if name in entry.scores}
        for entry in entries:
            if name not in entry.scores and (entry.cell in fits or entry.recording not in known):
                raise ClothbenchError(
                    f"{folder / FILE}: {entry.file} has no score by {name!r}, which others have; expected the same "
                    "metrics for all recordings, and for all that one fit simulated"
                )


def compared(
    path: Path, simulated: Recording, measured: Recording, metrics: Iterable[str], plugins: Catalogue, cell: str = ""
) -> Compared:
    """The scores of a simulated recording, once it is sure that it can be one of what was measured."""
    require_of(path, simulated, measured)
    seen = plugins.make("trackers", "markers").track(measured)
    rollout = Rollout(measured.time, simulated.position[None], ("ok",), np.zeros(1, int), len(measured.material))
    scores, intervals, floors, units = {}, {}, {}, {}
    for name in metrics:
        metric = plugins.make("metrics", name)
        score = metric(seen, rollout)
        scores[name], floors[name], units[name] = float(score.value[0]), float(metric.floor(seen)), score.unit
        intervals[name] = interval_of(metric, score, seen, rollout, seed_of(name, measured.hash))
        if not np.isfinite(scores[name]):
            raise ClothbenchError(f"{path}: the metric {name!r} gives no number for it; leave that metric out")
    require_not_copied(path, simulated, measured)
    return Compared(measured, path, scores, intervals, floors, units, cell)


def require_of(path: Path, simulated: Recording, measured: Recording) -> None:
    """Refuse what is not the same points at the same times in the same grips, or has positions where no cloth is."""
    for what in ("time", "material", "grip_time", "grip_material", "grip_position"):
        mine, theirs = getattr(measured, what), getattr(simulated, what)
        if mine.shape != theirs.shape:
            raise ClothbenchError(f"{path}: found {what} of {theirs.shape}, expected {mine.shape} as measured")
        if not np.allclose(mine, theirs, rtol=0, atol=SAME, equal_nan=True):
            away = float(np.nanmax(np.abs(mine - theirs)))
            raise ClothbenchError(f"{path}: found {what} that differs from what was measured by {away:.3g}, expected 0")
    lost = np.isnan(simulated.position).any(axis=2)
    if lost.any():
        frame, node = np.argwhere(lost)[0]
        raise ClothbenchError(f"{path}: position is no number at frame {frame}, node {node}; expected all of them")
    require_held(path, simulated, measured, "drive the cloth with the recorded grips")


def require_held(where: object, simulated: Recording, measured: Recording, remedy: str) -> None:
    """Refuse held points that do not lie in the recorded grips. where, remedy: what a fault is about, what to do."""
    held, grip = held_points(measured)
    if not len(held):
        return
    grips = grips_at(measured, measured.time)[:, grip]
    away = np.linalg.norm(simulated.position[:, held] - grips, axis=2)
    if away.max() > HELD:
        frame, k = np.unravel_index(int(away.argmax()), away.shape)
        raise ClothbenchError(
            f"{where}: node {held[k]} is held, and lies {1e3 * away.max():.3g} mm from its grip at frame {frame}; "
            f"expected {1e3 * HELD:g} mm at most: {remedy}"
        )


def held_points(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the tracked points that a grip holds, and of their grips."""
    away = np.linalg.norm(recording.material[:, None] - recording.grip_material[None], axis=2)
    held, grip = np.nonzero(away < SAME)
    return held, grip


def require_not_copied(path: Path, simulated: Recording, measured: Recording) -> None:
    """Refuse positions that are nearer to what was tracked than the tracker's own noise lets any cloth be."""
    free = np.setdiff1d(np.arange(len(measured.material)), held_points(measured)[0])
    seen = measured.visible[:, free]
    sigma, count = measured.noise_sigma, 3 * int(seen.sum())
    if not (np.isfinite(sigma) and count):
        return
    away = float(np.sqrt(np.mean(np.square((simulated.position - measured.position)[:, free][seen]))))
    # The rms of so many normal numbers scatters by 1/√(2n) of itself: a perfect model is not as near by chance.
    if away < sigma * min(COPIED, 1 - 5 / np.sqrt(2 * count)):
        raise ClothbenchError(
            f"{path}: lies {1e3 * away:.3g} mm a coordinate from the tracked positions, whose noise alone is "
            f"{1e3 * sigma:.3g} mm; expected simulated positions, not measured ones"
        )
