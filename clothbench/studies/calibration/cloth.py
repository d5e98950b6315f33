"""Films of a cell: what was recorded beside the fit, the start of the search, and the truth where it is known."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from clothbench.core.camera import Camera, Projector
from clothbench.core.observation import Observation
from clothbench.core.rollout import Rollout
from clothbench.display.film import Film, Take, chosen_frames, contact_sheet, scaled, write_film
from clothbench.engine.tables import finite
from clothbench.estimation.calibrate import Fit
from clothbench.estimation.trials import Trial, score_of
from clothbench.recordings.colour_video import ColourVideo
from clothbench.recordings.depth import DepthImages
from clothbench.recordings.kinds import read_sheet
from clothbench.recordings.nodes import Recording
from clothbench.studies.calibration.analysis import truth_of
from clothbench.studies.calibration.cell import Bench

FILMED = 4  # recordings of a cell: the first that were fitted, and others that were not
FITTED, START, TRUTH = "fitted", "start of the search", "true parameters"
Picture = tuple[bytes, tuple[int, int], Camera | None, Projector | None]


def films_of(bench: Bench, fit: Fit, rollouts: Sequence[Rollout]) -> list[Film]:
    """A film of each recording that is worth one; none of drapes, which have pictures of their own."""
    out, others = [], further_sets(bench, fit)
    for n in filmed(bench):
        trial = bench.trials[n]
        if trial.observation.outlines is None:
            out.append(film_of(bench, n, rollouts[n], others))
    return out


def filmed(bench: Bench) -> list[int]:
    """Numbers of the recordings that are filmed: half of them fitted, as far as there are any, the others held out."""
    splits = [source.split for source in bench.cell.recordings]
    fitted = [n for n, split in enumerate(splits) if split == "fit"]
    held = [n for n, split in enumerate(splits) if split != "fit"]
    count = max(FILMED - len(held), FILMED // 2)
    return [*fitted[:count], *held][:FILMED]


def further_sets(bench: Bench, fit: Fit) -> dict[str, np.ndarray]:
    """Parameter sets (P,) beside the best: where the search set out from, and the truth, where all of it is stated."""
    out = {} if fit.start is None else {START: fit.start}
    truth = [truth_of(bench, name) for name in bench.space.names]
    if truth and None not in truth:
        out[TRUTH] = np.array(truth, dtype=float)
    return out


def film_of(bench: Bench, number: int, rollout: Rollout, others: Mapping[str, np.ndarray]) -> Film:
    trial, recording, source = bench.trials[number], bench.recordings[number], bench.cell.recordings[number]
    seen, frames = trial.observation, chosen_frames(len(trial.observation.time))
    takes = {FITTED: take_of(trial, rollout, 0, frames)}
    if others:
        inside = np.clip(np.stack(list(others.values())), bench.space.low, bench.space.high)
        further = trial.simulation.run(inside)
        takes |= {word: take_of(trial, further, n, frames) for n, word in enumerate(others)}
    picture, size, camera, projector = picture_of(recording, source.file, seen, frames)
    return Film(
        recording.hash, source.name, source.split, seen.time[frames], seen.material,
        np.where(seen.visible[..., None], seen.position, np.nan)[frames], trial.metric.name, trial.metric.unit,
        finite(trial.metric.floor(seen)), picture, size, camera, projector, seen.sight is not None, seen.cloud, takes,
    )  # fmt: skip


def take_of(trial: Trial, rollout: Rollout, member: int, frames: np.ndarray) -> Take:
    """One member of a rollout, in some frames; a run that had stopped is not a number from there on."""
    score = score_of(trial, trial.metric, rollout)
    error = np.full(len(frames), np.nan) if score.per_frame is None else score.per_frame[member][frames]
    return Take(rollout.position[member][frames], error)


def picture_of(recording: Any, path: str, seen: Observation, frames: np.ndarray) -> Picture:
    """What a camera saw in some frames; nothing where only nodes were recorded."""
    if isinstance(recording, Recording) and recording.video is not None:
        picture, size = contact_sheet(recording.video.frame[frames])
        return picture, size, scaled(recording.video.camera, size), recording.video.projector
    raw = read_sheet(path)
    if isinstance(raw, ColourVideo) and seen.sight is not None:
        picture, size = contact_sheet(np.stack(list(picked(raw.frames(), frames))))
        return picture, size, scaled(seen.sight, size), None
    if isinstance(raw, DepthImages):
        nearest = [int(np.abs(raw.time - t).argmin()) for t in seen.time[frames]]  # trackers may even out the stamps
        picture, size = contact_sheet(as_grey(raw.depth[nearest]))
        return picture, size, scaled(raw.camera, size), None
    return b"", (0, 0), None, None  # nodes that were seen across a line of sight, too: there is no picture to draw in


def picked(frames: Iterator[np.ndarray], numbers: np.ndarray) -> Iterator[np.ndarray]:
    wanted = set(numbers.tolist())
    return (frame for n, frame in enumerate(frames) if n in wanted)


def as_grey(depth: np.ndarray) -> np.ndarray:
    """Depth (F, H, W), 0 where nothing was measured, as grey of 8 bits: near is bright."""
    known = depth > 0
    near, far = np.quantile(depth[known], (0.02, 0.98)) if known.any() else (0.0, 1.0)
    share = 1 - np.clip((depth - near) / max(far - near, 1e-9), 0, 1)
    return np.where(known, 60 + 180 * share, 8).astype(np.uint8)


def write_films(folder: Path, films: Sequence[Film]) -> None:
    """Files "0.npz", "1.npz" … in a folder of the cell."""
    folder.mkdir()
    for number, film in enumerate(films):
        write_film(folder / f"{number}.npz", film)
