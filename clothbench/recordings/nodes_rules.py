"""The rules of the recording format, version 1: what a reader checks before anything is simulated."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from clothbench.core.errors import ClothbenchError

if TYPE_CHECKING:
    from clothbench.recordings.nodes import Recording

SPLITS = ("fit", "held_out", "")

# variable: (dimensions, unit)
LAYOUT: dict[str, tuple[tuple[str, ...], str]] = {
    "time": (("time",), "s"),
    "material": (("node", "uv"), "m"),
    "position": (("time", "node", "space"), "m"),
    "grip_time": (("grip_time",), "s"),
    "grip_material": (("grip", "uv"), "m"),
    "grip_position": (("grip_time", "grip", "space"), "m"),
}
SIZES = {"uv": 2, "space": 3}


def check(r: Recording, where: str) -> None:
    """Every rule of the format, in the order in which a reader would trip over it."""
    _check_shapes(r, where)
    _check_clock(r.time, "time", where)
    _check_clock(r.grip_time, "grip_time", where)
    _check_values(r, where)
    _check_video(r, where)
    _check_cloth(r, where)
    _check_overlap(r, where)


def _check_shapes(r: Recording, where: str) -> None:
    sizes: dict[str, tuple[str, int]] = {}
    for name, (dims, _) in LAYOUT.items():
        shape = getattr(r, name).shape
        if len(shape) != len(dims):
            raise ClothbenchError(f"{where}: variable '{name}': found shape {shape}, expected ({', '.join(dims)})")
        for dim, size in zip(dims, shape, strict=True):
            if dim in SIZES and size != SIZES[dim]:
                raise ClothbenchError(f"{where}: variable '{name}': found {size} along '{dim}', expected {SIZES[dim]}")
            if size == 0:
                raise ClothbenchError(
                    f"{where}: variable '{name}': found no entries along '{dim}', expected at least one"
                )
            first, known = sizes.setdefault(dim, (name, size))
            if known != size:
                raise ClothbenchError(
                    f"{where}: variable '{name}': found {size} along '{dim}', expected {known} as in '{first}'"
                )


def _check_clock(time: np.ndarray, name: str, where: str) -> None:
    if time.size < 2:
        raise ClothbenchError(f"{where}: variable '{name}': found {time.size} stamp, expected at least 2")
    if not np.isfinite(time).all():
        raise ClothbenchError(f"{where}: variable '{name}': found a stamp that is not finite, expected seconds")
    back = np.flatnonzero(np.diff(time) <= 0)
    if back.size:
        i = int(back[0])
        raise ClothbenchError(
            f"{where}: variable '{name}': found {time[i + 1]:g} s after {time[i]:g} s at index {i + 1}, "
            "expected strictly increasing; sort or drop these frames"
        )


def _check_values(r: Recording, where: str) -> None:
    infinite = np.argwhere(np.isinf(r.position))
    if infinite.size:
        t, n, _ = infinite[0]
        raise ClothbenchError(
            f"{where}: variable 'position': found {len(infinite)} infinite values, the first at frame {t}, node {n}, "
            "expected metres or NaN (not seen)"
        )
    for name in ("grip_position", "material", "grip_material"):
        bad = np.argwhere(~np.isfinite(getattr(r, name)))
        if bad.size:
            at = tuple(int(i) for i in bad[0])
            raise ClothbenchError(
                f"{where}: variable '{name}': found a value that is not finite at {at}, expected metres"
            )
    if not np.isfinite(r.position).any():
        raise ClothbenchError(f"{where}: variable 'position': found only NaN, expected at least one node seen")
    if not r.visible.any():
        raise ClothbenchError(f"{where}: variable 'position': found no node with all of x, y and z")


def _check_video(r: Recording, where: str) -> None:
    if r.video is not None and len(r.video.frame) != len(r.time):
        raise ClothbenchError(
            f"{where}: variable 'frame': found {len(r.video.frame)} frames, expected {len(r.time)}, one for each 'time'"
        )


def _check_cloth(r: Recording, where: str) -> None:
    if not r.name:
        raise ClothbenchError(f"{where}: attribute 'name': found nothing, expected the recording's name")
    if not all(map(math.isfinite, r.gravity)):
        raise ClothbenchError(f"{where}: attribute 'gravity': found {r.gravity}, expected three finite numbers [m/s²]")
    for name in ("cloth_width", "cloth_height"):
        value = getattr(r, name)
        if not (math.isfinite(value) and value > 0):
            raise ClothbenchError(f"{where}: attribute '{name}': found {value}, expected metres above 0")
    if r.areal_density <= 0 or math.isinf(r.areal_density):
        raise ClothbenchError(
            f"{where}: attribute 'areal_density': found {r.areal_density}, expected kg/m² above 0, or NaN"
        )
    if r.noise_sigma < 0 or math.isinf(r.noise_sigma):
        raise ClothbenchError(f"{where}: attribute 'noise_sigma': found {r.noise_sigma}, expected metres, 0 or above")
    if r.split not in SPLITS:
        raise ClothbenchError(f"{where}: attribute 'split': found {r.split!r}, expected 'fit', 'held_out' or ''")
    size = np.array([r.cloth_width, r.cloth_height])
    slack = 0.02 * size  # markers and clamps may stand a little over the hem
    for name in ("material", "grip_material"):
        points = getattr(r, name)
        outside = np.flatnonzero(((points < -slack) | (points > size + slack)).any(axis=1))
        if outside.size:
            u, v = points[outside[0]]
            raise ClothbenchError(
                f"{where}: variable '{name}': found ({u:g}, {v:g}) m at row {outside[0]}, "
                f"expected inside the {size[0]:g} m × {size[1]:g} m cloth"
            )
        _, first, counts = np.unique(points.round(9), axis=0, return_index=True, return_counts=True)
        if (counts > 1).any():
            row = int(first[counts > 1].min())
            raise ClothbenchError(
                f"{where}: variable '{name}': found row {row} {int(counts[counts > 1].max())} times "
                f"(the same material point), expected every point once; drop the repeats"
            )


def _check_overlap(r: Recording, where: str) -> None:
    covered = np.mean((r.time >= r.grip_time[0] - 1e-9) & (r.time <= r.grip_time[-1] + 1e-9))
    if covered < 0.9:
        raise ClothbenchError(
            f"{where}: variable 'grip_time': found {r.grip_time[0]:g}..{r.grip_time[-1]:g} s, "
            f"which covers {covered:.0%} of the "
            f"frames, expected to cover 'time' {r.time[0]:g}..{r.time[-1]:g} s; "
            "put both on one clock or cut the recording"
        )
