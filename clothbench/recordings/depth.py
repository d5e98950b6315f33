"""Recordings of kind "depth": what a calibrated depth camera gave, frame by frame, on disk as NetCDF-4.

Same header as kind "nodes" (`clothbench.recordings.nodes`), of which `name`, `cloth_width`, `cloth_height`, `gravity`
and `depth_step` are needed; what differs:

| name | dims | units | meaning |
|---|---|---|---|
| `time` | time | s | when each frame was taken |
| `depth` | time, y, x | 1 | whole numbers of `depth_step` [m] along the optical axis; 0: nothing measured |
| `colour` | time, y, x, channel (3) | 1 | red, green, blue, 0 to 255, seen from the depth camera's place; optional |
| `colour_time` | time | s | when each picture was taken, which is not when the depth was |
| `grip_time`, `grip_material`, `grip_position` | as in kind "nodes" | | where the cloth was held, if that is known |

`noise_sigma` [m] may be stated, of a coordinate of the nodes that are tracked, in place of what a tracker judges, and
`thickness` [m], as in kind "nodes"; another note must not have a name under which that kind states something.

Attributes: `depth_step` [m] of one unit of depth (0.001 for millimetres), and the camera: `camera_size` [px, width and
height], `camera_matrix`, `camera_rotation`, `camera_translation` [m], `camera_distortion`, as in `clothbench.Camera`.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from clothbench.core.brief import brief
from clothbench.core.camera import Camera
from clothbench.core.errors import ClothbenchError
from clothbench.recordings.codec import read, write
from clothbench.recordings.layout import Arrays, Layout, Part, Stated, Variable
from clothbench.recordings.nodes import LAYOUT as NODES
from clothbench.recordings.nodes_rules import APART, check_clock, check_gravity, check_pace, check_sides
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

CHANNELS = 3
NEAR, FAR = 0.05, 20.0  # m, between which the middle of all depths lies, or its unit is wrong


@dataclass(frozen=True, eq=False)
class Colour:
    """Pictures (T, H, W, 3), a byte a channel, red first, in the depth camera's pixels; time: (T,) s, their own."""

    time: np.ndarray
    frame: np.ndarray

    __repr__ = brief


def _unpack_camera(arrays: Arrays, stated: Stated, path: Path) -> Camera:
    return unpack_camera(stated, path, "a depth recording")


def _pack_colour(colour: Colour) -> tuple[Arrays, Stated]:
    return {"colour_time": colour.time, "colour": colour.frame}, {}


def _unpack_colour(arrays: Arrays, stated: Stated, path: Path) -> Colour | None:
    if not arrays:
        return None
    if "colour" not in arrays:
        raise ClothbenchError(
            f"{path}: variable 'colour' is missing beside 'colour_time'; add the pictures, or take it out"
        )
    if "colour_time" not in arrays:
        raise ClothbenchError(f"{path}: variable 'colour_time' is missing, expected the stamps of 'colour' in s")
    return Colour(arrays["colour_time"], arrays["colour"])


CAMERA = Part({}, camera_attributes(), pack_camera, _unpack_camera)
COLOUR = Part(
    {
        "colour_time": Variable(("time",), "s"),
        "colour": Variable(("time", "y", "x", "channel"), "1", np.uint8, level=6, exact=True),
    },
    (), _pack_colour, _unpack_colour,
)  # fmt: skip
LAYOUT = Layout(
    kind="depth",
    variables={
        "time": Variable(("time",), "s"),
        "depth": Variable(("time", "y", "x"), "1", np.uint16, level=6, exact=True),
    },
    texts=TEXTS,
    numbers=("cloth_width", "cloth_height", "areal_density", "depth_step"),
    needed=("name", "cloth_width", "cloth_height", "gravity", "depth_step"),
    vectors={"gravity": "three numbers like '0 0 -9.81' [m/s²]"},
    parts={"camera": CAMERA, "colour": COLOUR, "grips": GRIPS, **FOR_NODES},
)


@dataclass(frozen=True, eq=False, kw_only=True)
class DepthImages(RawRecording):
    """What a depth camera saw of one run. Arrays are read-only; all SI, world frame, z up.

    depth: (T, H, W), whole numbers of `depth_step` [m], 0 where nothing was measured; camera: of the
    depth, whose pixels the colour shares; colour: None where it is not known.
    """

    depth: np.ndarray
    depth_step: float
    camera: Camera
    colour: Colour | None = None
    layout: ClassVar[Layout] = LAYOUT

    __repr__ = brief

    def check(self, where: str) -> None:
        _check(self, where)

    def metres(self, frame: int) -> np.ndarray:
        """Depth (H, W) m of a frame, NaN where nothing was measured."""
        return np.where(self.depth[frame] > 0, self.depth[frame] * self.depth_step, np.nan)

    def picture(self, frame: int) -> np.ndarray | None:
        """The picture (H, W, 3) that was taken nearest to a frame of depth; None without one within half a step."""
        if self.colour is None:
            return None
        away = np.abs(self.colour.time - self.time[frame])
        nearest = int(away.argmin())
        step = float(np.median(np.diff(self.time))) if len(self.time) > 1 else np.inf
        return self.colour.frame[nearest] if away[nearest] <= step / 2 * (1 + 1e-6) else None


def read_depth(path: str | os.PathLike[str]) -> DepthImages:
    """Read and check one file; a fault raises `ClothbenchError` with file, variable, found, expected."""
    return read(path, LAYOUT, DepthImages)


def write_depth(images: DepthImages, path: str | os.PathLike[str]) -> Path:
    """Write one file, through a link where one is named, atomically: it is there whole or not at all."""
    return write(images, path, LAYOUT, asked=True)


def _check(r: DepthImages, where: str) -> None:
    """Every rule of the kind, in the order in which a reader would trip over it."""
    check_clock(r.time, "time", where)
    check_jumps(r.time, "time", where)
    check_pace(r.time, where)
    check_sides(r.cloth_width, r.cloth_height, where)
    check_stated(r, where, ("depth_step",))
    check_gravity(r.gravity, where)
    check_for_nodes(r, NODES, where)
    width, height = r.camera.size
    if r.depth.shape != (len(r.time), height, width):
        raise ClothbenchError(
            f"{where}: variable 'depth': found shape {r.depth.shape}, expected ({len(r.time)}, {height}, {width}): as "
            "many frames as stamps, each as large as 'camera_size'"
        )
    empty = np.flatnonzero(~r.depth.any(axis=(1, 2)))
    if empty.size:
        which = ", ".join(map(str, empty[:5])) + (" …" if empty.size > 5 else "")
        raise ClothbenchError(
            f"{where}: variable 'depth': found {empty.size} frames that hold no depth at all ({which}), expected some "
            "in each; drop these frames with their stamps"
        )
    middle = float(np.median(r.depth[r.depth > 0])) * r.depth_step
    if not NEAR <= middle <= FAR:
        raise ClothbenchError(
            f"{where}: variable 'depth': found a middle of all depths of {middle:g} m, expected {NEAR:g} … {FAR:g} m; "
            f"is depth_step, {r.depth_step:g} m, that of the sensor?"
        )
    if r.colour is not None:
        _check_colour(r, r.colour, where)
    check_grips(r, where)
    if r.grips is not None:
        _check_in_reach(r, r.grips.position, where)


def _check_in_reach(r: DepthImages, grips: np.ndarray, where: str) -> None:
    """Grips (K, G, 3) m are near what the camera saw, or either of them stands in another unit, or another world."""
    across, farthest = math.hypot(r.cloth_width, r.cloth_height), float(r.depth.max()) * r.depth_step
    away = float(np.median(np.linalg.norm(grips - r.camera.place, axis=-1)))
    if away > farthest + APART * across:
        raise ClothbenchError(
            f"{where}: variable 'grip_position': found grips {away:g} m from the camera, in the middle of all stamps, "
            f"which saw nothing beyond {farthest:.3g} m, expected them within {APART * across:.2g} m of that; are "
            "these, or the camera's 'translation', millimetres?"
        )


def _check_colour(r: DepthImages, colour: Colour, where: str) -> None:
    if colour.frame.shape != (*r.depth.shape, CHANNELS):
        raise ClothbenchError(
            f"{where}: variable 'colour': found shape {colour.frame.shape}, expected {(*r.depth.shape, CHANNELS)}, "
            "registered to the depth"
        )
    if colour.time.shape != r.time.shape:
        raise ClothbenchError(
            f"{where}: variable 'colour_time': found {colour.time.size} stamps, expected {len(r.time)}, one for each "
            "frame of colour"
        )
    check_clock(colour.time, "colour_time", where)
    if all(r.picture(frame) is None for frame in range(len(r.time))):
        raise ClothbenchError(
            f"{where}: variable 'colour_time': found {colour.time[0]:g}..{colour.time[-1]:g} s, of which no stamp is "
            f"within half a step of a frame of depth ({r.time[0]:g}..{r.time[-1]:g} s), expected one clock; put both "
            "on one, or leave the colour out"
        )
