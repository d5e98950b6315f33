"""One Rerun file per fit: what was seen beside what the best parameters make of it."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from scipy.sparse import csr_array
from scipy.spatial import Delaunay, QhullError

from clothbench.errors import ClothbenchError
from clothbench.experiment.calibrate import Trial
from clothbench.experiment.cell import Bench
from clothbench.observation import Observation
from clothbench.recording import Recording
from clothbench.rollout import Rollout

SEEN, CLOTH, AWAY, HELD, NOISE = (
    (240, 160, 40),
    (110, 160, 215),
    (220, 60, 60),
    (60, 170, 110),
    (150, 150, 150),
)
SLIVER = 0.05  # altitude over longest side below which a triangle only joins points along the hem
MAXWELL = np.sqrt(8 / np.pi)  # mean length of isotropic noise with σ = 1 per coordinate
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


def _log_run(stream: Any, root: str, trial: Trial, recording: Recording, simulated: np.ndarray) -> None:
    """All entities of one recording; `simulated` (T, N, 3) m, NaN where the rollout had stopped."""
    seen = trial.observation
    edge = typical_distance(seen.material)
    there = np.isfinite(simulated).all(axis=(1, 2))
    stream.log(root, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    log_seen(stream, f"{root}/seen", seen.time, seen.position, seen.visible, 0.12 * edge)
    log_sheet(stream, f"{root}/simulated", seen.time[there], simulated[there], seen.material)
    log_away(stream, f"{root}/away", seen, simulated, there, 0.04 * edge)
    if recording.grip_material.size:
        log_points(stream, f"{root}/grips", seen.time, grips_at(recording, seen.time), HELD, 0.25 * edge)
    _log_error(stream, f"{root}/error", trial, simulated, there)


def log_seen(
    stream: Any, path: str, time: np.ndarray, position: np.ndarray, visible: np.ndarray, radius: float
) -> None:
    stream.log(path, rr.Points3D.from_fields(colors=[SEEN], radii=[radius]), static=True)
    columns = rr.Points3D.columns(positions=np.float32(position[visible]))
    stream.send_columns(path, _at(time), columns.partition(visible.sum(axis=1)))


def log_points(
    stream: Any, path: str, time: np.ndarray, position: np.ndarray, colour: tuple[int, ...], radius: float
) -> None:
    """Points (T, n, 3) m that are there in every frame."""
    if len(time):
        stream.log(path, rr.Points3D.from_fields(colors=[colour], radii=[radius]), static=True)
        columns = rr.Points3D.columns(positions=np.float32(position.reshape(-1, 3)))
        stream.send_columns(path, _at(time), columns.partition(np.full(len(time), position.shape[1])))


def log_sheet(stream: Any, path: str, time: np.ndarray, position: np.ndarray, material: np.ndarray) -> None:
    """The simulated nodes (T, N, 3) m: as a mesh, or as points where they all lie on one line."""
    triangles = triangulate(material)
    if len(triangles):
        log_mesh(stream, path, time, position, triangles)
    else:
        log_points(stream, path, time, position, CLOTH, 0.12 * typical_distance(material))


def log_mesh(stream: Any, path: str, time: np.ndarray, position: np.ndarray, triangles: np.ndarray) -> None:
    """The sheet (T, N, 3) m: triangles and colour once, positions and normals for every frame in one go."""
    if not len(time):
        return
    stream.log(path, rr.Mesh3D.from_fields(triangle_indices=triangles, albedo_factor=(*CLOTH, 190)), static=True)
    normals = vertex_normals(position, triangles)
    columns = rr.Mesh3D.columns(
        vertex_positions=np.float32(position.reshape(-1, 3)),
        vertex_normals=np.float32(normals.reshape(-1, 3)),
    )
    stream.send_columns(path, _at(time), columns.partition(np.full(len(time), position.shape[1])))


def log_away(
    stream: Any, path: str, seen: Observation, simulated: np.ndarray, there: np.ndarray, radius: float
) -> None:
    """Arrows from simulated to seen nodes, where both are known."""
    both = seen.visible & there[:, None]
    stream.log(path, rr.Arrows3D.from_fields(colors=[AWAY], radii=[radius]), static=True)
    vectors = seen.position[both] - simulated[both]
    columns = rr.Arrows3D.columns(origins=np.float32(simulated[both]), vectors=np.float32(vectors))
    stream.send_columns(path, _at(seen.time), columns.partition(both.sum(axis=1)))


def _log_error(stream: Any, path: str, trial: Trial, simulated: np.ndarray, there: np.ndarray) -> None:
    """Mean distance of the seen nodes in each frame [mm], and what the noise alone would give."""
    seen = trial.observation
    frames = there & seen.visible.any(axis=1)
    count = seen.visible[frames].sum(axis=1)
    distance = np.linalg.norm(np.nan_to_num(seen.position[frames]) - simulated[frames], axis=-1)
    error = (distance * seen.visible[frames]).sum(axis=1) / count * MM
    log_curve(stream, f"{path}/simulated", seen.time[frames], error, f"{trial.name} [mm]")
    if np.isfinite(seen.sigma):
        floor = np.full(2, MAXWELL * seen.sigma * MM)
        log_curve(stream, f"{path}/noise_floor", seen.time[[0, -1]], floor, "noise floor [mm]", NOISE)


def log_curve(
    stream: Any, path: str, time: np.ndarray, value: np.ndarray, name: str, colour: tuple[int, ...] | None = None
) -> None:
    """A curve over time; without a colour the viewer gives each its own."""
    if len(time):
        colours = [colour] if colour else None
        stream.log(path, rr.SeriesLines(names=name, colors=colours, widths=[2.0]), static=True)
        stream.send_columns(path, _at(time), rr.Scalars.columns(scalars=value))


def _at(time: np.ndarray) -> list[Any]:
    return [rr.TimeColumn("time", duration=time)]


def triangulate(material: np.ndarray) -> np.ndarray:
    """Delaunay triangles (F, 3) of material points (N, 2) m without slivers; none if all lie on one line."""
    try:
        triangles = Delaunay(material).simplices
    except (QhullError, ValueError):  # fewer than three points, or all on one line
        return np.zeros((0, 3), dtype=np.uint32)
    corner = material[triangles]
    side = np.roll(corner, -1, axis=1) - corner
    area = np.abs(side[:, 0, 0] * side[:, 1, 1] - side[:, 0, 1] * side[:, 1, 0])
    return triangles[area > SLIVER * (side**2).sum(axis=-1).max(axis=1)].astype(np.uint32)


def typical_distance(material: np.ndarray) -> float:
    """Distance of neighbours [m] if the points (N, 2) m were spread evenly; what is drawn is sized by it."""
    return float(np.ptp(material, axis=0).max() / max(np.sqrt(len(material)) - 1, 1)) or 0.01


def vertex_normals(position: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Unit normals (T, N, 3) of a moving mesh (T, N, 3) m: the triangles around a node, weighted by area.

    Summed by one sparse product over all frames, which needs no compiling in a fresh worker process.
    """
    frames, nodes = position.shape[:2]
    corner = position[:, triangles]
    normal = np.cross(corner[:, :, 1] - corner[:, :, 0], corner[:, :, 2] - corner[:, :, 0])
    rows, columns = triangles.ravel(), np.repeat(np.arange(len(triangles)), 3)
    around = csr_array((np.ones(len(rows)), (rows, columns)), shape=(nodes, len(triangles)))
    total = (around @ normal.swapaxes(0, 1).reshape(len(triangles), -1)).reshape(nodes, frames, 3).swapaxes(0, 1)
    length = np.linalg.norm(total, axis=-1, keepdims=True)
    return total / np.where(length > 0, length, 1.0)


def grips_at(recording: Recording, time: np.ndarray) -> np.ndarray:
    """Grip positions (T, G, 3) m at the frames' times (T,) s."""
    grips = recording.grip_position.reshape(len(recording.grip_time), -1)
    at = [np.interp(time, recording.grip_time, column) for column in grips.T]
    return np.stack(at, axis=1).reshape(len(time), -1, 3)


def open_viewer(out: Path, name: str) -> int:
    """Open the viewer on the cell of `out` whose key begins with `name`, or, where `out` is of `clothbench improve`,
    on the recording of that name; returns the viewer's exit code.
    """
    file = improved(out, name) if (out / "verdict.json").is_file() else find_cell(out, name) / "fit.rrd"
    if not file.is_file():
        raise ClothbenchError(
            f"cell {file.parent.name} has no fit.rrd: it failed or ran with rerun=false; see the leaderboard"
        )
    return subprocess.run([sys.executable, "-m", "rerun", str(file)], check=False).returncode


def improved(out: Path, name: str) -> Path:
    """The Rerun file of one recording in a folder of `clothbench improve`."""
    names = sorted(p.stem for p in (out / "rerun").glob("*.rrd"))
    if name not in names:
        raise ClothbenchError(f"{out}: found no recording {name!r}; there are: {', '.join(names) or 'none'}")
    return out / "rerun" / f"{name}.rrd"


def find_cell(out: Path, beginning: str) -> Path:
    """The one cell folder of `out` whose key begins so."""
    cells = sorted(p for p in (out / "cells").glob("[0-9a-f]*") if p.is_dir())
    found = [p for p in cells if p.name.startswith(beginning)]
    if len(found) == 1:
        return found[0]
    if not cells:
        raise ClothbenchError(f"{out}: found no cells; make some with: clothbench run +suite=static_dynamic")
    what = "several cells" if found else "no cell"
    names = [p.name for p in found or cells]
    listed = ", ".join(names[:12]) + (f" and {len(names) - 12} more" if len(names) > 12 else "")
    raise ClothbenchError(f"{out}: found {what} whose key begins with {beginning!r}; there are: {listed}")
