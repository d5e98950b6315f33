"""Recordings of kind "nodes": one physical run as measured, on disk as NetCDF-4 (`clothbench-recording`, version 1).

| name | dims | units | meaning |
|---|---|---|---|
| `time` | time | s | when each frame was taken, strictly increasing |
| `material` | node, uv | m | flat rest coordinates of the tracked points (u along the warp, v down) |
| `position` | time, node, space | m | where they were, world frame, z up; NaN = not seen |
| `grip_time` | grip_time | s | the grips' own clock, on the same origin as `time`, of which it covers nine tenths |
| `grip_material` | grip, uv | m | material points that are held |
| `grip_position` | grip_time, grip, space | m | where they were held |
| `frame` | time, y, x | 1 | optional, uint8: what a calibrated camera saw (`clothbench.recordings.video`) |
| `confidence` | time, node | 1 | optional: how sure the tracker is, 0 to 1; may be NaN where a point was not seen |

Attributes: `format`, `format_version`, `kind`, `name`, `fabric`, `cloth_width`, `cloth_height` [m], `areal_density`
[kg/m²; NaN = not known], `gravity` [m/s², three numbers as text], `noise_sigma` [m per coordinate; NaN = not known],
`sensor`, `source`, `licence`, `declared_effects`, `motion`, `split` ("fit", "held_out" or ""). Points that were seen
in one camera's picture only have that camera in `sight_size` [px], `sight_matrix`, `sight_rotation`,
`sight_translation` [m] and `sight_distortion`: `position` then is any place on the line of sight. The cloth's outline,
obstacles and its thickness: `clothbench.recordings.supports`. `camera_place` [m, three numbers as text] may say where
the camera stood that saw points in space.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from clothbench.core.brief import brief
from clothbench.core.camera import Camera, Video
from clothbench.core.errors import ClothbenchError
from clothbench.core.files import files_below
from clothbench.core.observation import confidence_fault
from clothbench.core.scene import Obstacle
from clothbench.recordings.codec import freeze, hash_of, read, write
from clothbench.recordings.layout import SPLITS, Arrays, Layout, Part, Stated, Variable
from clothbench.recordings.nodes_rules import (
    between_stamps,
    check_clock,
    check_density,
    check_gravity,
    check_grip_order,
    check_noise,
    check_overlap,
    check_pace,
    check_points,
    check_scale,
    check_shapes,
    check_sides,
    check_values,
    frames_held,
)
from clothbench.recordings.rig import GRIPS, TEXTS, camera_attributes, check_numbers, pack_camera, unpack_camera
from clothbench.recordings.supports import SUPPORTS, check_supports
from clothbench.recordings.video import VIDEO, numbers_of

EYE = "camera_place"  # note: where the camera stood, m


def _pack_sight(camera: Camera) -> tuple[Arrays, Stated]:
    return pack_camera(camera, "sight")


def _unpack_sight(arrays: Arrays, stated: Stated, path: Path) -> Camera | None:
    if not any(name in stated for name in camera_attributes("sight")):
        return None
    return unpack_camera(stated, path, "a recording of points seen in a picture", "sight")


def _pack_confidence(confidence: np.ndarray) -> tuple[Arrays, Stated]:
    return {"confidence": confidence}, {}


def _unpack_confidence(arrays: Arrays, stated: Stated, path: Path) -> np.ndarray | None:
    return arrays.get("confidence")


LAYOUT = Layout(
    kind="nodes",
    variables={
        "time": Variable(("time",), "s"),
        "material": Variable(("node", "uv"), "m"),
        "position": Variable(("time", "node", "space"), "m", level=4),
        **GRIPS.variables,
    },
    texts=TEXTS,
    numbers=("cloth_width", "cloth_height", "areal_density", "noise_sigma"),
    needed=("name", "cloth_width", "cloth_height", "gravity", "noise_sigma"),
    vectors={"gravity": "three numbers like '0 0 -9.81' [m/s²]"},
    parts={
        "video": VIDEO,
        "sight": Part({}, camera_attributes("sight"), _pack_sight, _unpack_sight),
        "confidence": Part(
            {"confidence": Variable(("time", "node"), "1", level=4)}, (), _pack_confidence, _unpack_confidence
        ),
        **SUPPORTS,
    },
)


@dataclass(frozen=True, eq=False)
class Recording:
    """Tracked material points of one run, with the grips that drove it. All SI, world frame, z up.

    time: (T,) s, strictly increasing; material: (N, 2) m, flat rest coordinates (u along the warp, v down); position:
    (T, N, 3) m, NaN where not seen; grip_time: (K,) s, the grips' own clock; grip_material: (G, 2) m; grip_position:
    (K, G, 3) m; cloth_width, cloth_height: m; areal_density: kg/m² (NaN = not known); gravity: (3,) m/s²;
    noise_sigma: m per coordinate; video: what a calibrated camera saw at the same times, or None; sight: the one
    camera in whose picture the points were seen, where nothing tells their distance, or None; confidence: (T, N), 0
    to 1, how sure the tracker is, or None; outline: (M, 2) m, what the sheet has been cut to, obstacles: what it
    cannot enter, and thickness: m, how far apart its layers stay; None where they are not stated. `path` is where it
    was read from, not part of its identity.
    """

    name: str
    time: np.ndarray
    material: np.ndarray
    position: np.ndarray
    grip_time: np.ndarray
    grip_material: np.ndarray
    grip_position: np.ndarray
    cloth_width: float
    cloth_height: float
    areal_density: float = math.nan
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    noise_sigma: float = math.nan
    fabric: str = ""
    sensor: str = ""
    source: str = ""
    licence: str = ""
    declared_effects: str = ""
    motion: str = ""
    split: str = ""
    notes: dict[str, str] = field(default_factory=dict)
    video: Video | None = None
    sight: Camera | None = None
    confidence: np.ndarray | None = None
    outline: np.ndarray | None = None
    obstacles: tuple[Obstacle, ...] | None = None
    thickness: float | None = None
    path: str = field(default="", compare=False)

    __repr__ = brief

    def __post_init__(self) -> None:
        freeze(self, LAYOUT)
        _check(self, self.path or self.name)

    @property
    def kind(self) -> str:
        """As its header states it."""
        return LAYOUT.kind

    @property
    def visible(self) -> np.ndarray:
        """Which nodes were seen in which frame, (T, N) bool."""
        return np.isfinite(self.position).all(axis=-1)

    @property
    def counts(self) -> np.ndarray:
        """Which nodes in which frames may count, (T, N) bool: those that were seen while it is known where the grips
        were, if there are grips. A simulation holds them still before and after, as nobody did.
        """
        return self.visible & frames_held(self.time, self.grip_time, self.grip_position)[:, None]

    @property
    def eye(self) -> np.ndarray | None:
        """Where the camera stood (3,) m: as the note `camera_place` says, or that in whose picture the points were
        seen, or that of the video; None where nobody knows.
        """
        if (stated := _eye_stated(self)) is not None:
            return stated
        camera = self.sight or (self.video and self.video.camera)
        return camera.place if camera else None

    @property
    def hash(self) -> str:
        """SHA-256 over everything measured and stated, whatever the file's encoding."""
        return hash_of(self, LAYOUT)


def read_recording(path: str | os.PathLike[str]) -> Recording:
    """Read and check one file; a fault raises `ClothbenchError` with file, variable, found, expected."""
    return read(path, LAYOUT, Recording)


def write_recording(recording: Recording, path: str | os.PathLike[str]) -> Path:
    """Write one file, through a link where one is named, atomically: it is there whole or not at all."""
    return write(recording, path, LAYOUT, asked=True)


def grips_at(recording: Any, time: np.ndarray) -> np.ndarray:
    """Grip positions (T, G, 3) m of a recording of nodes, or of a cloud, at the frames' times (T,) s."""
    return between_stamps(time, recording.grip_time, recording.grip_position)


def find_recordings(paths: Iterable[str | os.PathLike[str]]) -> list[Path]:
    """The recording files named, in their order, or lying in the folders named, each folder's sorted by path; an empty
    find is an error.
    """
    found: list[Path] = []
    for path in map(Path, paths):
        if os.path.isdir(path):  # which does not stumble over a name that is too long
            # Hidden folders, which are left out, are what a killed import left behind.
            inside = [file for file in files_below(path) if file.suffix.lower() == ".nc"]
            if not inside:
                raise ClothbenchError(f"{path}: found no recordings, expected files ending in .nc in this folder")
            found += inside
        elif os.path.exists(path):
            found.append(path)
        else:
            raise ClothbenchError(f"{path}: no such file or folder; give a recording (.nc) or a folder of them")
    return found


def _check(r: Recording, where: str) -> None:
    """Every rule of the kind, in the order in which a reader would trip over it."""
    arrays = {name: getattr(r, name) for name in LAYOUT.variables}
    alone = bool(r.obstacles) and not any(o.carried for o in r.obstacles or ())  # may bear the cloth without any grip
    check_shapes(arrays, LAYOUT, where, may_be_empty="grip" if alone else "")
    check_clock(r.time, "time", where)
    check_pace(r.time, where)
    check_clock(r.grip_time, "grip_time", where)
    check_values(arrays, where)
    _check_video(r, where)
    if r.confidence is not None and r.confidence.shape != r.position.shape[:2]:
        raise ClothbenchError(
            f"{where}: variable 'confidence': found shape {r.confidence.shape}, expected {r.position.shape[:2]}"
        )
    if r.confidence is not None and (fault := confidence_fault(r.confidence, r.visible)):
        raise ClothbenchError(f"{where}: variable 'confidence': {fault}")
    _check_stated(r, where)
    size = np.array([r.cloth_width, r.cloth_height])
    for name in ("material", "grip_material"):
        check_points(arrays[name], name, size, where)
    check_noise(r.noise_sigma, size, where)
    if r.sight is None:  # else along the line of sight nothing is known
        check_scale(arrays, size, where, read=bool(r.path))
    check_overlap(r.time, r.grip_time, r.grip_position, where)
    carry = any(o.carried for o in r.obstacles or ())  # then grips need not hold any cloth
    if r.sight is None and not carry:
        check_grip_order(arrays, float(np.hypot(*size)), where)
    check_supports(r.outline, r.thickness, r.grip_material[:0] if carry else r.grip_material, size, where)


def _eye_stated(r: Recording) -> np.ndarray | None:
    """Where a note says that the camera stood (3,) m; one of anything but three numbers is refused."""
    return numbers_of(r.notes, EYE, (3,), Path(r.path or r.name)) if EYE in r.notes else None


def _check_video(r: Recording, where: str) -> None:
    if r.video is not None and len(r.video.frame) != len(r.time):
        raise ClothbenchError(
            f"{where}: variable 'frame': found {len(r.video.frame)} frames, expected {len(r.time)}, one for each 'time'"
        )


def _check_stated(r: Recording, where: str) -> None:
    check_numbers(r, LAYOUT.numbers, where)
    if not r.name:
        raise ClothbenchError(f"{where}: attribute 'name': found nothing, expected the recording's name")
    _eye_stated(r)
    check_gravity(r.gravity, where)
    check_sides(r.cloth_width, r.cloth_height, where)
    check_density(r.areal_density, where)
    if r.split not in SPLITS:
        raise ClothbenchError(f"{where}: attribute 'split': found {r.split!r}, expected 'fit', 'held_out' or ''")
