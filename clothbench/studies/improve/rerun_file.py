"""One Rerun file per recording of `clothbench improve`: what was seen beside the model before and after."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from clothbench.display.rerun import (
    HELD,
    NOISE,
    log_away,
    log_curve,
    log_points,
    log_seen,
    log_sheet,
    typical_distance,
)
from clothbench.recordings.nodes import grips_at
from clothbench.studies.improve.evidence import Comparison, Unit
from clothbench.studies.improve.sheet_tables import frame_rows

COLOURS = {"before": (213, 94, 0), "after": (0, 119, 187)}


def write_recording_file(path: Path, one: Comparison, label: str, floor: float, unit: Unit) -> None:
    """Write one recording: below `before` and `after` the sheet with arrows to where its nodes were seen, on the
    recording's own clock; below `error` the rms of each frame beside what noise and mesh leave (floor: base
    unit), in the reported unit.

    The sheet is as the sensor would see it; unlike the errors it has the mesh's own error in it.
    """
    name = f"{one.case.name} · {label}"
    stream = rr.RecordingStream("clothbench-improve", recording_id=name, send_properties=False)
    stream.save(path, default_blueprint=blueprint(unit))
    try:
        stream.send_recording_name(name)
        _log(stream, one, floor, unit)
    finally:
        stream.disconnect()


def blueprint(unit: Unit) -> Any:
    """Before and after side by side, the error curves below."""
    spaces = [
        rrb.Spatial3DView(origin="/", contents=["+ /seen", "+ /grips", f"+ /{fit}/**"], name=fit) for fit in COLOURS
    ]
    curves = rrb.TimeSeriesView(origin="/error", name=f"error [{unit.reported}]")
    page = rrb.Vertical(rrb.Horizontal(*spaces), curves, row_shares=[3, 1])
    return rrb.Blueprint(page, rrb.TimePanel(state="collapsed"), collapse_panels=True)


def _log(stream: Any, one: Comparison, floor: float, unit: Unit) -> None:
    seen, recording = one.case.observation, one.case.recording
    edge = typical_distance(seen.material)
    stream.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    log_seen(stream, "seen", seen.time, seen.position, seen.visible, 0.12 * edge)
    if recording.grip_material.size:
        log_points(stream, "grips", seen.time, grips_at(recording, seen.time), HELD, 0.25 * edge)
    rows = [r for r in frame_rows([one], unit) if r["coordinates"]]
    for fit, simulated in (("before", one.before), ("after", one.after)):
        there = np.isfinite(simulated).all(axis=(1, 2))
        log_sheet(stream, f"{fit}/simulated", seen.time[there], simulated[there], seen.material)
        log_away(stream, f"{fit}/away", seen, simulated, there, 0.04 * edge)
        known = np.array([(r["time"], r[fit]) for r in rows if r[fit] is not None]).reshape(-1, 2)
        log_curve(stream, f"error/{fit}", known[:, 0], known[:, 1], f"{fit} [{unit.reported}]", COLOURS[fit])
    line = np.full(2, unit.scale * floor)
    log_curve(stream, "error/noise_and_mesh", seen.time[[0, -1]], line, f"noise and mesh [{unit.reported}]", NOISE)
