"""Recordings of kind "video": what one colour camera, a webcam say, saw of a printed cloth, on disk as NetCDF-4.

Same header as kind "nodes" (`clothbench.recordings.nodes`), of which `name`, `cloth_width`, `cloth_height` and
`gravity` are needed; what differs:

| name | dims | units | meaning |
|---|---|---|---|
| `time` | time | s | when each frame was taken |
| `stream` | byte | 1 | uint8: the bytes of a video file (MP4), or of pictures (PNG, JPEG) one after the other |
| `stream_end` | time | 1 | int64, with pictures only: where in `stream` each of them ends |
| `template` | row, column, channel (3) | 1 | uint8, red first: the flat cloth from hem to hem, u to the right, v down |
| `mark_material`, `mark_pixel` | mark, uv / mark, xy (2) | m / px | held points in the first frame; optional |
| `grip_time`, `grip_material`, `grip_position` | as in kind "nodes" | | where the cloth was held, if that is known |

`noise_sigma`, `thickness` and notes as in kind "depth". Frames are inside the file, so that none can be lost on the
way. Attributes: the camera, if it is calibrated
(`camera_size` [px], `camera_matrix`, `camera_rotation`, `camera_translation` [m], `camera_distortion`, as in
`clothbench.Camera`), and `world`: "camera" where its place is known too, else "cloth": the world then begins at the
upper left corner of the cloth as the first frame shows it, x along its upper hem, z up.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from clothbench.core.brief import brief
from clothbench.core.camera import Camera
from clothbench.core.errors import ClothbenchError
from clothbench.core.pictures import picture_of, silenced
from clothbench.recordings.codec import read, write
from clothbench.recordings.layout import Arrays, Layout, Part, Stated, Variable
from clothbench.recordings.nodes import LAYOUT as NODES
from clothbench.recordings.nodes_rules import check_clock, check_gravity, check_pace, check_points, check_sides
from clothbench.recordings.rig import (
    FOR_NODES,
    GRIPS,
    TEXTS,
    RawRecording,
    camera_attributes,
    check_for_nodes,
    check_grips,
    check_jumps,
    check_stated,
    pack_camera,
    unpack_camera,
)

WORLDS = ("cloth", "camera")
LEAST_TEMPLATE = 64  # px along the shorter side


@dataclass(frozen=True, eq=False)
class Marks:
    """Held points in the first frame. material: (G, 2) m; pixel: (G, 2) px, to the right and down."""

    material: np.ndarray
    pixel: np.ndarray

    __repr__ = brief


def _unpack_camera(arrays: Arrays, stated: Stated, path: Path) -> Camera | None:
    if not any(name in stated for name in camera_attributes()):
        return None
    return unpack_camera(stated, path, "a video of a calibrated camera")


def _pack_ends(ends: np.ndarray) -> tuple[Arrays, Stated]:
    return {"stream_end": ends}, {}


def _unpack_ends(arrays: Arrays, stated: Stated, path: Path) -> np.ndarray | None:
    return arrays.get("stream_end")


def _pack_marks(marks: Marks) -> tuple[Arrays, Stated]:
    return {"mark_material": marks.material, "mark_pixel": marks.pixel}, {}


def _unpack_marks(arrays: Arrays, stated: Stated, path: Path) -> Marks | None:
    if not arrays:
        return None
    if missing := sorted(set(MARKS.variables) - set(arrays)):
        raise ClothbenchError(f"{path}: variable '{missing[0]}' is missing beside the other mark variable; add it")
    return Marks(arrays["mark_material"], arrays["mark_pixel"])


MARKS = Part(
    {"mark_material": Variable(("mark", "uv"), "m"), "mark_pixel": Variable(("mark", "xy"), "px")},
    (), _pack_marks, _unpack_marks,
)  # fmt: skip
LAYOUT = Layout(
    kind="video",
    variables={
        "time": Variable(("time",), "s"),
        "stream": Variable(("byte",), "1", np.uint8, exact=True),
        "template": Variable(("row", "column", "channel"), "1", np.uint8, level=6, exact=True),
    },
    texts=(*TEXTS, "world"),
    numbers=("cloth_width", "cloth_height", "areal_density"),
    needed=("name", "cloth_width", "cloth_height", "gravity"),
    vectors={"gravity": "three numbers like '0 0 -9.81' [m/s²]"},
    parts={
        "camera": Part({}, camera_attributes(), pack_camera, _unpack_camera),
        "ends": Part({"stream_end": Variable(("time",), "1", np.int64)}, (), _pack_ends, _unpack_ends),
        "marks": MARKS,
        "grips": GRIPS,
        **FOR_NODES,
    },
)


@dataclass(frozen=True, eq=False, kw_only=True)
class ColourVideo(RawRecording):
    """What a colour camera saw of one run. Arrays are read-only; all SI.

    stream: (S,) uint8, a video file's bytes, or pictures' with `ends` (T,); template: (H, W, 3) uint8,
    the flat cloth from hem to hem; camera: its calibration, None where nobody knows it;
    world: "camera", its place is known too, or "cloth"; marks: None where they are not known.
    """

    stream: np.ndarray
    template: np.ndarray
    ends: np.ndarray | None = None
    camera: Camera | None = None
    world: str = "cloth"
    marks: Marks | None = None
    layout: ClassVar[Layout] = LAYOUT

    __repr__ = brief

    def check(self, where: str) -> None:
        _check(self, where)

    def frames(self) -> Iterator[np.ndarray]:
        """Frames (H, W, 3) uint8, red first, one after the other; one that cannot be read ends in an error."""
        where, count = self.path or self.name, 0
        for frame in decoded(self.stream, self.ends):
            if frame is None:
                raise ClothbenchError(f"{where}: variable 'stream': found no picture that can be read at frame {count}")
            if count < len(self.time):
                yield frame
            count += 1
        if count != len(self.time):
            raise ClothbenchError(
                f"{where}: variable 'stream': found {count} frames, expected {len(self.time)}, one for each 'time'"
            )


def decoded(stream: np.ndarray, ends: np.ndarray | None) -> Iterator[np.ndarray | None]:
    """Frames (H, W, 3), red first, of a video's bytes, or of pictures that end at `ends`; None for one that is
    broken.
    """
    import cv2

    if ends is not None:
        for begin, end in zip(np.concatenate([[0], ends[:-1]]), ends, strict=True):
            picture = picture_of(stream[begin:end], cv2.IMREAD_COLOR)
            yield None if picture is None else cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)
        return
    with tempfile.TemporaryDirectory(prefix="clothbench-") as folder:  # OpenCV reads videos from files only
        file = Path(folder) / "stream.mp4"
        file.write_bytes(stream.tobytes())
        with silenced():
            video = cv2.VideoCapture(str(file))
        try:
            while True:
                with silenced():
                    there, frame = video.read()
                if not there:
                    return
                yield cv2.cvtColor(frame, cv2.COLOR_BGR2RGB)
        finally:
            video.release()


def read_video(path: str | os.PathLike[str]) -> ColourVideo:
    """Read and check one file; a fault raises `ClothbenchError` with file, variable, found, expected."""
    return read(path, LAYOUT, ColourVideo)


def write_video(video: ColourVideo, path: str | os.PathLike[str]) -> Path:
    """Write one file, through a link where one is named, atomically: it is there whole or not at all."""
    return write(video, path, LAYOUT, asked=True)


def _check(r: ColourVideo, where: str) -> None:
    """Every rule of the kind, in the order in which a reader would trip over it; frames are read when they are used."""
    check_clock(r.time, "time", where)
    check_jumps(r.time, "time", where)
    check_pace(r.time, where)
    check_sides(r.cloth_width, r.cloth_height, where)
    check_stated(r, where)
    check_gravity(r.gravity, where)
    check_for_nodes(r, NODES, where)
    if r.world not in WORLDS:
        raise ClothbenchError(f"{where}: attribute 'world': found {r.world!r}, expected 'cloth' or 'camera'")
    if r.world == "camera" and r.camera is None:
        raise ClothbenchError(f"{where}: attribute 'world': found 'camera', expected 'cloth': no camera is stated")
    if r.grips is not None and r.world != "camera":
        raise ClothbenchError(f"{where}: variable 'grip_position': found grips, and no camera in whose world they are")
    if r.template.ndim != 3 or r.template.shape[2] != 3 or min(r.template.shape[:2]) < LEAST_TEMPLATE:
        raise ClothbenchError(
            f"{where}: variable 'template': found shape {r.template.shape}, expected (H, W, 3) with at least "
            f"{LEAST_TEMPLATE} px each way"
        )
    if r.ends is not None and (
        r.ends.shape != r.time.shape or (np.diff(r.ends, prepend=0) <= 0).any() or r.ends[-1] != len(r.stream)
    ):
        raise ClothbenchError(
            f"{where}: variable 'stream_end': found {len(r.ends)} ends, expected {len(r.time)}, each after the one "
            f"before, the last {len(r.stream)}"
        )
    first = next(decoded(r.stream, r.ends), None)
    if first is None:
        raise ClothbenchError(
            f"{where}: variable 'stream': found no frame that can be read, expected a video or pictures"
        )
    if r.camera is not None and first.shape[:2] != r.camera.size[::-1]:
        raise ClothbenchError(
            f"{where}: variable 'stream': found frames of {first.shape[1]} × {first.shape[0]} px, expected camera_size "
            f"{r.camera.size}"
        )
    if r.marks is not None:
        _check_marks(r, r.marks, first, where)
    check_grips(r, where)


def _check_marks(r: ColourVideo, marks: Marks, first: np.ndarray, where: str) -> None:
    size = np.array([r.cloth_width, r.cloth_height])
    if marks.material.ndim != 2 or marks.material.shape != marks.pixel.shape or marks.material.shape[1] != 2:
        raise ClothbenchError(
            f"{where}: variable 'mark_pixel': found {marks.pixel.shape}, expected {marks.material.shape}"
        )
    check_points(marks.material, "mark_material", size, where)
    inside = ((marks.pixel >= 0) & (marks.pixel < first.shape[1::-1])).all()
    if not inside:
        raise ClothbenchError(
            f"{where}: variable 'mark_pixel': found a mark outside the frame of {first.shape[1]} × {first.shape[0]} px"
        )
