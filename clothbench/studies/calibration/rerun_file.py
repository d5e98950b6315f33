"""One Rerun file per fit: what was seen beside what the best parameters make of it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from clothbench.core.rollout import Rollout
from clothbench.display.rerun import (
    HELD,
    NOISE,
    log_away,
    log_curve,
    log_points,
    log_seen,
    log_sheet,
    nearest,
    typical_distance,
)
from clothbench.estimation.trials import Trial
from clothbench.recordings.nodes import Recording, grips_at
from clothbench.recordings.points import PointCloud
from clothbench.recordings.silhouette import Silhouettes
from clothbench.studies.calibration.cell import Bench

MEAN_LENGTH = {3: np.sqrt(8 / np.pi), 2: np.sqrt(np.pi / 2)}  # of isotropic noise with σ = 1 per coordinate
MM = 1e3


def write_rerun(path: Path, bench: Bench, rollouts: Sequence[Rollout]) -> None:
    """Write all recordings of a cell, each below SPLIT/NAME, on the timeline `time` [s] of its own clock.

    rollouts: one per recording, of which the first member (T, N, 3) m is shown: as a mesh, with arrows from
    its nodes to where they were seen, the seen nodes, the grips, and the mean distance per frame [mm].
    """
    cell = bench.cell
    # The viewer remembers layouts by application: one of its own keeps the tabs of other cells out.
    stream = rr.RecordingStream(f"clothbench-{cell.key}", recording_id=cell.key, send_properties=False)
    roots = [rr.new_entity_path([s.split, s.name]) for s in cell.recordings]
    names = [f"{s.name} ({s.split.replace('_', ' ')})" for s in cell.recordings]
    stream.save(path, default_blueprint=blueprint(roots, names))
    try:
        stream.send_recording_name(cell.label)
        for root, trial, recording, rollout in zip(roots, bench.trials, bench.recordings, rollouts, strict=True):
            if isinstance(recording, Silhouettes):
                _log_drapes(stream, root, trial, rollout)
            else:
                _log_run(stream, root, trial, recording, rollout.position[0])
    finally:
        stream.disconnect()


def blueprint(roots: Sequence[str], names: Sequence[str]) -> Any:
    """One tab per recording, space above error; the last tab holds all error curves together."""
    tabs: list[Any] = []
    for root, name in zip(roots, names, strict=True):
        space = rrb.Spatial3DView(origin=root, contents=["$origin/**", "- $origin/error/**"], name=name)
        tabs.append(rrb.Vertical(space, _curves(root, "error [mm]"), row_shares=[3, 1], name=name))
    if len(tabs) > 1:
        tabs.append(_curves("/", "all errors [mm]", [f"+ {root}/error/simulated" for root in roots]))
    return rrb.Blueprint(rrb.Tabs(*tabs, active_tab=0), rrb.TimePanel(state="collapsed"), collapse_panels=True)


def _curves(origin: str, name: str, contents: str | list[str] = "$origin/error/**") -> Any:
    return rrb.TimeSeriesView(origin=origin, contents=contents, name=name)


def _log_drapes(stream: Any, root: str, trial: Trial, rollout: Rollout) -> None:
    """Drapes of the best parameters, one for each first shape, over the outlines that were captured."""
    seen, position = trial.observation.outlines, rollout.position[0]
    assert seen is not None
    there = np.isfinite(position).all(axis=(1, 2))
    stream.log(root, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    log_sheet(stream, f"{root}/simulated", rollout.time[there], position[there], trial.observation.material)
    turn = 2 * np.pi * np.arange(seen.radius.shape[1] + 1) / seen.radius.shape[1]
    closed = np.concatenate([seen.radius, seen.radius[:, :1]], axis=1)[..., None]
    strips = np.concatenate(
        [closed * np.stack([np.cos(turn), np.sin(turn)], axis=1), np.full_like(closed, -seen.disc_radius)], axis=2
    )
    stream.log(f"{root}/seen", rr.LineStrips3D(strips, colors=HELD), static=True)


def _log_run(stream: Any, root: str, trial: Trial, recording: Recording | PointCloud, simulated: np.ndarray) -> None:
    """All entities of one recording; `simulated` (T, N, 3) m, NaN where the rollout had stopped."""
    seen = trial.observation
    edge = typical_distance(seen.material)
    there = np.isfinite(simulated).all(axis=(1, 2))
    stream.log(root, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    log_seen(stream, f"{root}/seen", seen.time, seen.position, seen.visible, 0.12 * edge)
    log_sheet(stream, f"{root}/simulated", seen.time[there], simulated[there], seen.material)
    if not seen.cloud:  # of which no point is another's
        log_away(stream, f"{root}/away", seen, simulated, there, 0.04 * edge)
    if recording.grip_material.size:
        log_points(stream, f"{root}/grips", seen.time, grips_at(recording, seen.time), HELD, 0.25 * edge)
    _log_error(stream, f"{root}/error", trial, simulated, there)


def _log_error(stream: Any, path: str, trial: Trial, simulated: np.ndarray, there: np.ndarray) -> None:
    """Mean distance of the seen nodes in each frame [mm], of a cloud to the nearest that is simulated; and what the
    noise alone would give, where that is known.
    """
    seen = trial.observation
    frames = there & seen.visible.any(axis=1)
    count = seen.visible[frames].sum(axis=1)
    if seen.cloud:
        distance = np.nan_to_num(nearest(seen.position[frames], simulated[frames]))
    else:
        distance = np.linalg.norm(seen.differences(simulated)[frames], axis=-1)
    error = (distance * seen.visible[frames]).sum(axis=1) / count * MM
    log_curve(stream, f"{path}/simulated", seen.time[frames], error, f"{trial.name} [mm]")
    if np.isfinite(seen.sigma) and not seen.cloud:
        floor = np.full(2, MEAN_LENGTH[seen.coordinates] * seen.sigma * MM)
        log_curve(stream, f"{path}/noise_floor", seen.time[[0, -1]], floor, "noise floor [mm]", NOISE)
