"""Recordings of kind "points": clouds of points of which nobody knows which is which, on disk as NetCDF-4.

Same header as kind "nodes" (`clothbench.recordings.nodes`), of which `name`, `cloth_width`, `cloth_height`, `gravity`
and `noise_sigma` are needed; what differs:

| name | dims | units | meaning |
|---|---|---|---|
| `time` | time | s | when each frame was taken, strictly increasing |
| `position` | time, point, space | m | what was seen of the sheet, world frame, z up, in any order |
| `grip_time`, `grip_material`, `grip_position` | as in kind "nodes" | | where the cloth was held |

A frame with fewer points than others is padded with NaN; one of nothing but NaN is a frame in which nothing was seen.
Outline, obstacles and thickness: `clothbench.recordings.supports`.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from clothbench.core.brief import brief
from clothbench.core.errors import ClothbenchError
from clothbench.core.outline import within
from clothbench.core.scene import Obstacle
from clothbench.recordings.codec import freeze, hash_of, read, write
from clothbench.recordings.layout import Layout, Variable
from clothbench.recordings.nodes import grips_at
from clothbench.recordings.nodes_rules import (
    SHRUNK,
    check_clock,
    check_finite,
    check_gravity,
    check_grips_near,
    check_near,
    check_noise,
    check_overlap,
    check_pace,
    check_points,
    check_shapes,
    check_sides,
    check_spread,
    check_strays,
    frames_held,
)
from clothbench.recordings.rig import GRIPS, TEXTS, check_numbers, check_stated
from clothbench.recordings.supports import SUPPORTS, check_supports

LINES = 5, 40  # of the lattice along a side, at least and at most: a finer one costs time, and says no more
AWAY = 2.0  # of the cloth's size, as which none of it is from the nearest grip: no cloth stretches to twice its length

LAYOUT = Layout(
    kind="points",
    variables={
        "time": Variable(("time",), "s"),
        "position": Variable(("time", "point", "space"), "m", level=4),
        **GRIPS.variables,
    },
    texts=TEXTS,
    numbers=("cloth_width", "cloth_height", "areal_density", "noise_sigma"),
    needed=("name", "cloth_width", "cloth_height", "gravity", "noise_sigma"),
    vectors={"gravity": "three numbers like '0 0 -9.81' [m/s²]"},
    parts=SUPPORTS,
)


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Points of one run without identity, with the grips that drove it. Arrays are read-only; all SI, z up.

    time: (T,) s, strictly increasing; position: (T, P, 3) m, in any order, NaN where a frame has fewer points; the
    other fields as of `Recording`. `path` is where it was read from, not part of its identity.
    """

    name: str
    time: np.ndarray
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
        """Which places of which frame hold a point, (T, P) bool."""
        return np.isfinite(self.position).all(axis=-1)

    @property
    def counts(self) -> np.ndarray:
        """Which of them may count, (T, P) bool: those of frames in which it is known where the grips were."""
        return self.visible & frames_held(self.time, self.grip_time, self.grip_position)[:, None]

    @cached_property
    def lattice(self) -> np.ndarray:
        """The material points (M, 2) m that are simulated to be compared with the clouds, from hem to hem, row by row:
        about as many as a frame has points, so that both are about as dense; those of them on the outline.
        """
        counts = self.visible.sum(axis=1)
        width, height = self.cloth_width, self.cloth_height
        spacing = math.sqrt(width * height / float(np.median(counts[counts > 0])))
        u, v = (
            np.linspace(0.0, length, int(np.clip(round(length / spacing) + 1, *LINES))) for length in (width, height)
        )
        points = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
        if self.outline is None:
            return points
        inside = points[within(self.outline, points)]
        return inside if len(inside) else self.outline

    @property
    def hash(self) -> str:
        """SHA-256 over everything measured and stated, whatever the file's encoding."""
        return hash_of(self, LAYOUT)


def read_points(path: str | os.PathLike[str]) -> PointCloud:
    """Read and check one file; a fault raises `ClothbenchError` with file, variable, found, expected."""
    return read(path, LAYOUT, PointCloud)


def write_points(cloud: PointCloud, path: str | os.PathLike[str]) -> Path:
    """Write one file, through a link where one is named, atomically: it is there whole or not at all."""
    return write(cloud, path, LAYOUT, asked=True)


def _check(r: PointCloud, where: str) -> None:
    """Every rule of the kind, in the order in which a reader would trip over it."""
    arrays = {name: getattr(r, name) for name in LAYOUT.variables}
    carry = any(o.carried for o in r.obstacles or ())  # then grips need not hold any cloth
    check_shapes(arrays, LAYOUT, where, may_be_empty="grip" if r.obstacles and not carry else "")
    check_clock(r.time, "time", where)
    check_pace(r.time, where)
    check_clock(r.grip_time, "grip_time", where)
    _check_values(r, where)
    _check_header(r, where)
    size = np.array([r.cloth_width, r.cloth_height])
    check_points(r.grip_material, "grip_material", size, where)
    check_noise(r.noise_sigma, size, where)
    _check_scale(r, float(np.hypot(*size)), where)
    check_overlap(r.time, r.grip_time, r.grip_position, where)
    if not carry:
        _check_reach(r, float(np.hypot(*size)), where)
    check_supports(r.outline, r.thickness, r.grip_material[:0] if carry else r.grip_material, size, where)


def _check_values(r: PointCloud, where: str) -> None:
    """Only positions may be NaN, all of a point's or none, and some frame has a point."""
    infinite = np.argwhere(np.isinf(r.position))
    if infinite.size:
        t, n, _ = infinite[0]
        raise ClothbenchError(
            f"{where}: variable 'position': found {len(infinite)} infinite values, the first at frame {t}, point {n}, "
            "expected metres, or NaN where a frame has fewer points"
        )
    known = np.isfinite(r.position)
    half = np.argwhere(known.any(axis=-1) & ~known.all(axis=-1))
    if half.size:
        t, n = half[0]
        raise ClothbenchError(
            f"{where}: variable 'position': found {len(half)} points of which a coordinate is missing, the first at "
            f"frame {t}, point {n}, expected all of x, y and z, or none; make them NaN"
        )
    for name in ("grip_position", "grip_material"):
        check_finite(getattr(r, name), name, where)
    for name in ("grip_position", "position"):
        check_near(getattr(r, name), name, where)
    if not known.any():
        raise ClothbenchError(
            f"{where}: variable 'position': found only NaN, expected points in at least one frame; is it the right "
            "file?"
        )


def _check_header(r: PointCloud, where: str) -> None:
    check_numbers(r, LAYOUT.numbers, where)
    check_stated(r, where)
    check_gravity(r.gravity, where)
    check_sides(r.cloth_width, r.cloth_height, where)


def _check_scale(r: PointCloud, across: float, where: str) -> None:
    """Clouds are about as large as the cloth, `across` m from corner to corner, in the middle of all frames; and no
    point is where none of the cloth can be, nor are grips.
    """
    frames = [places[np.isfinite(places).all(axis=1)] for places in r.position]
    spread = np.array([np.linalg.norm(np.ptp(cloud, axis=0)) for cloud in frames if len(cloud)])
    check_spread(spread, across, where, "points")
    if max(map(len, frames)) > 1 and spread.max() <= SHRUNK * across:
        raise ClothbenchError(
            f"{where}: variable 'position': found points {spread.max():g} m apart at most of a cloth {across:.2g} m "
            "across, expected metres; is it scaled twice?"
        )
    check_strays(r.position, across, where, "point")
    check_grips_near(r.grip_position, [cloud for cloud in frames if len(cloud)], across, where, "points")


def _check_reach(r: PointCloud, across: float, where: str) -> None:
    """No point that counts is farther from the nearest grip than cloth `across` m from corner to corner can be: with
    nothing that says which point is which, all that else was seen would pass for cloth.
    """
    if not r.grip_material.size:
        return
    grips = grips_at(r, r.time)
    for t in np.flatnonzero(r.counts.any(axis=1)):
        there = np.flatnonzero(r.counts[t])
        away = np.linalg.norm(r.position[t, there, None] - grips[t], axis=-1).min(axis=1)
        if away.max() > AWAY * across:
            point = int(there[np.argmax(away)])
            at = ", ".join(f"{x:g}" for x in r.position[t, point])
            raise ClothbenchError(
                f"{where}: variable 'position': found point {point} at frame {t} at ({at}) m, {away.max():.3g} m from "
                f"the nearest grip, expected {AWAY * across:.2g} m at most of a cloth {across:.2g} m across; leave out "
                "what is not cloth, and put grips and points into one frame of reference"
            )
