"""What every scene must be, whoever made it: a model's compiled loops check nothing, and run on with whatever they get.

Recordings and settings are checked before; these rules are for those who make scenes of their own. Each fault is one
line that names the field.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from numbers import Integral, Real
from typing import Any

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.outline import first_off

OVER_HEM = 0.02  # of the sheet's size, by which clamps may stand over its hem, as in recordings


def is_triple(value: Any) -> bool:
    """Whether it is three finite numbers."""
    try:
        numbers = np.array(value)
    except ValueError:  # lists of unequal lengths
        return False
    return numbers.shape == (3,) and numbers.dtype.kind in "iuf" and bool(np.isfinite(numbers).all())


def as_array(name: str, value: Any) -> np.ndarray:
    """A read-only copy of what may be a list, in double."""
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise ClothbenchError(f"scene: {name} is a {type(value).__name__}, expected an array of numbers") from None
    array.flags.writeable = False
    return array


def check_number(name: str, value: Any, above_zero: bool = False) -> None:
    """A finite number, above 0 or at least not below it."""
    number = float(value) if isinstance(value, Real) else math.nan
    if not (math.isfinite(number) and (number > 0 if above_zero else number >= 0)):
        expected = "a number above 0" if above_zero else "a finite number, 0 or above"
        raise ClothbenchError(f"scene: {name} is {value!r}, expected {expected}")


def check_gravity(gravity: Sequence[float]) -> None:
    if not is_triple(gravity):
        raise ClothbenchError(f"scene: gravity is {gravity!r}, expected three finite numbers [m/s²]")


def check_resolution(resolution: Any) -> None:
    """None, or two whole numbers."""
    if resolution is None:
        return
    try:
        fits = len(resolution) == 2 and all(isinstance(n, Integral) and int(n) >= 3 for n in resolution)
    except TypeError:
        fits = False
    if not fits:
        raise ClothbenchError(f"scene: resolution is {resolution!r}, expected at least 3 nodes each way, as (9, 13)")


def check_stamps(name: str, stamps: np.ndarray, least: int = 1) -> None:
    """Finite seconds (T,) that increase; a loop that steps to a stamp that is no number never ends."""
    if stamps.ndim != 1 or stamps.size < least:
        raise ClothbenchError(f"scene: {name} has shape {stamps.shape}, expected a list of {least} or more seconds")
    if not np.isfinite(stamps).all():
        raise ClothbenchError(f"scene: {name} holds a stamp that is not finite, expected seconds")
    if (np.diff(stamps) <= 0).any():
        raise ClothbenchError(f"scene: {name} must be a strictly increasing list of seconds; sort it, drop repeats")


def check_shape(name: str, array: np.ndarray, *shape: int | str, finite: bool = True) -> None:
    """An array of this shape, where a word stands for any length."""
    if array.ndim != len(shape) or any(s != n for s, n in zip(shape, array.shape, strict=True) if isinstance(s, int)):
        expected = ", ".join(map(str, shape))
        raise ClothbenchError(f"scene: {name} has shape {array.shape}, expected ({expected})")
    if finite and not np.isfinite(array).all():
        raise ClothbenchError(f"scene: {name} holds a value that is not finite, expected metres")


def check_points(points: np.ndarray, seen: Sequence[tuple[str, np.ndarray | None]]) -> None:
    """At least one point (N, 2) m; and what was seen of them, (N, 3) each or None, NaN where nobody saw it."""
    check_shape("points", points, "points", 2)
    if not len(points):
        raise ClothbenchError("scene: points are none, expected at least one, where the rollout is wanted")
    for name, array in seen:
        if array is not None:
            check_shape(name, array, len(points), 3, finite=False)


def check_grips(time: np.ndarray, material: np.ndarray, position: np.ndarray, size: np.ndarray) -> None:
    """Grips (G, 2) m that are on the sheet of `size` (2,) m, each with a place at every stamp; there may be none."""
    check_shape("grip_material", material, "grips", 2)
    if not len(material):
        return
    check_stamps("grip_time", time, least=2)
    check_shape("grip_position", position, len(time), len(material), 3)
    if len(off := off_sheet(material, size)):
        u, v = material[off[0]]
        raise ClothbenchError(
            f"scene: grip_material {off[0]} is at ({u:g}, {v:g}) m, expected it on the sheet of "
            f"{size[0]:g} × {size[1]:g} m; a grip holds a point of the cloth"
        )


def off_sheet(points: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Numbers of the points (N, 2) m that are farther over the hems of a sheet of `size` (2,) m than clamps may be."""
    slack = OVER_HEM * size
    return np.flatnonzero(((points < -slack) | (points > size + slack)).any(axis=1))


def grip_off(outline: np.ndarray | None, material: np.ndarray, size: np.ndarray) -> str | None:
    """What is wrong where a grip (G, 2) m holds what an outline (M, 2) m cuts away of a sheet of `size` (2,) m, which
    would be nothing; None where all hold cloth.
    """
    if outline is None or (off := first_off(outline, material, OVER_HEM * size)) is None:
        return None
    u, v = material[off]
    return (
        f"grip_material {off} is at ({u:g}, {v:g}) m, off the outline, expected it on the cloth; move the grip, "
        "or correct the outline"
    )
