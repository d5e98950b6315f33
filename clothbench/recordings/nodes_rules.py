"""The rules of the arrays of kind "nodes": what a reader checks before anything is simulated."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.scene import HEAVIEST
from clothbench.core.scene_rules import off_sheet
from clothbench.recordings.layout import Arrays, Layout, Part

COVERED = 0.9  # of the frames, while which somebody has to know where the grips are
SIZES = {"uv": 2, "space": 3}
LONGEST = 0.5  # s, for which a grip that a camera lost may be taken to go straight on: a hand swings at 1 Hz
FARTHEST = 1e6  # m from the origin that cloth and grips may be; sums and squares of what is farther may overflow


def check_shapes(arrays: Arrays, layout: Layout | Part, where: str, may_be_empty: str = "") -> None:
    """Every array has its dimensions, none empty but one that may be, each as long in one array as in another."""
    sizes: dict[str, tuple[str, int]] = {}
    for name, of in layout.variables.items():
        dims, shape = of.dims, arrays[name].shape
        if len(shape) != len(dims):
            raise ClothbenchError(f"{where}: variable '{name}': found shape {shape}, expected ({', '.join(dims)})")
        for dim, size in zip(dims, shape, strict=True):
            if dim in SIZES and size != SIZES[dim]:
                raise ClothbenchError(f"{where}: variable '{name}': found {size} along '{dim}', expected {SIZES[dim]}")
            if size == 0 and dim != may_be_empty:
                raise ClothbenchError(
                    f"{where}: variable '{name}': found no entries along '{dim}', expected at least one"
                )
            first, known = sizes.setdefault(dim, (name, size))
            if known != size:
                raise ClothbenchError(
                    f"{where}: variable '{name}': found {size} along '{dim}', expected {known} as in '{first}'"
                )


def check_clock(time: np.ndarray, name: str, where: str) -> None:
    """Stamps (T,) s are two or more, finite and strictly increasing."""
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


def check_values(arrays: Arrays, where: str) -> None:
    """Only the tracked positions may be NaN (not seen), and at least one of them is whole."""
    position = arrays["position"]
    infinite = np.argwhere(np.isinf(position))
    if infinite.size:
        t, n, _ = infinite[0]
        raise ClothbenchError(
            f"{where}: variable 'position': found {len(infinite)} infinite values, the first at frame {t}, node {n}, "
            "expected metres or NaN (not seen)"
        )
    for name in ("grip_position", "material", "grip_material"):
        check_finite(arrays[name], name, where)
    for name in ("grip_position", "position"):
        check_near(arrays[name], name, where)
    if not np.isfinite(position).any():
        raise ClothbenchError(f"{where}: variable 'position': found only NaN, expected at least one node seen")
    if not np.isfinite(position).all(axis=-1).any():
        raise ClothbenchError(f"{where}: variable 'position': found no node with all of x, y and z")


def check_length(name: str, length: float, where: str) -> None:
    if not 0 < length <= FARTHEST:
        raise ClothbenchError(f"{where}: attribute '{name}': found {length}, expected metres above 0")


def check_density(areal_density: float, where: str) -> None:
    if areal_density <= 0 or areal_density > HEAVIEST:
        raise ClothbenchError(
            f"{where}: attribute 'areal_density': found {areal_density}, expected kg/m² above 0, {HEAVIEST:g} at "
            "most, or NaN"
        )


def check_gravity(gravity: Sequence[float], where: str) -> None:
    """Gravity is three finite numbers [m/s²]."""
    if len(gravity) != 3 or not all(map(math.isfinite, gravity)):
        raise ClothbenchError(f"{where}: attribute 'gravity': found {gravity}, expected three finite numbers [m/s²]")


def check_finite(values: np.ndarray, name: str, where: str) -> None:
    """Every value is a number."""
    bad = np.argwhere(~np.isfinite(values))
    if bad.size:
        at = tuple(map(int, bad[0]))
        raise ClothbenchError(f"{where}: variable '{name}': found a value that is not finite at {at}, expected metres")


def check_near(places: np.ndarray, name: str, where: str) -> None:
    """No place, of those that are known, is farther away than anything that is measured."""
    far = np.argwhere(np.abs(places) > FARTHEST)
    if far.size:
        at = tuple(map(int, far[0]))
        raise ClothbenchError(
            f"{where}: variable '{name}': found {places[at]:g} m at {at}, expected metres within {FARTHEST:g} of 0"
        )


def check_points(points: np.ndarray, name: str, size: np.ndarray, where: str) -> None:
    """Material points (N, 2) m lie on a cloth of `size` (2,) m, each of them once."""
    outside = off_sheet(points, size)  # markers, too, may stand a little over the hem
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


def longest_gap(time: np.ndarray, seen: np.ndarray) -> tuple[float, float]:
    """The longest time [s] without a sample, of those numbered `seen` (K,) among stamps (T,) s, and when it begins [s];
    0 where no sample is missing between the first and the last.
    """
    gaps = np.where(np.diff(seen) > 1, np.diff(time[seen]), 0.0)
    worst = int(np.argmax(gaps)) if gaps.size else 0
    return (float(gaps[worst]), float(time[seen[worst]])) if gaps.size else (0.0, float("nan"))


def check_grip_gap(time: np.ndarray, seen: np.ndarray, what: str, where: str) -> None:
    """Refuse a grip that no frame between showed for too long: nobody knows how it moved. what: which grip it is."""
    gap, begin = longest_gap(time, seen)
    if gap > LONGEST:
        raise ClothbenchError(
            f"{where}: found {what} in no frame for {gap:.3g} s after {begin:.3g} s, expected gaps of {LONGEST:g} s at "
            "most; cut the recording there, or state the grips"
        )


def check_overlap(time: np.ndarray, grip_time: np.ndarray, where: str) -> None:
    """The grips were tracked while nine tenths of the frames were taken."""
    covered = np.mean((time >= grip_time[0] - 1e-9) & (time <= grip_time[-1] + 1e-9))
    if covered < COVERED:
        raise ClothbenchError(
            f"{where}: variable 'grip_time': found {grip_time[0]:g}..{grip_time[-1]:g} s, "
            f"which covers {covered:.0%} of the "
            f"frames, expected to cover 'time' {time[0]:g}..{time[-1]:g} s; "
            "put both on one clock or cut the recording"
        )
