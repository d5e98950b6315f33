"""Refusals of the options that several trackers have."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from clothbench import ClothbenchError


def check_mesh(who: str, mesh: Any, least: int) -> tuple[int, int]:
    """A mesh's two numbers, refused where they are not two whole numbers, `least` or more."""
    two = isinstance(mesh, Sequence) and not isinstance(mesh, str) and len(mesh) == 2
    if not two or not all(isinstance(n, int) and not isinstance(n, bool) and n >= least for n in mesh):
        raise ClothbenchError(f"{who}: mesh is {mesh!r}, expected two whole numbers ≥ {least}")
    return int(mesh[0]), int(mesh[1])


def check_metres(who: str, what: str, value: Any) -> None:
    """Refuse an option that is neither None nor a length above 0."""
    if value is None:
        return
    if not is_number(value) or value <= 0:
        raise ClothbenchError(f"{who}: {what} is {value!r}, expected metres above 0, or null")


def is_number(value: Any) -> bool:
    """Whether a value is a finite number, which true and false are not."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def check_number(who: str, what: str, value: Any, nothing: bool = False) -> None:
    """Refuse an option that is no finite number above 0; nothing: 0 will do, too."""
    if not is_number(value) or value < 0 or (value == 0 and not nothing):
        raise ClothbenchError(f"{who}: {what} is {value!r}, expected a number {'0 or above' if nothing else 'above 0'}")


def check_whole(who: str, what: str, value: Any, least: int, most: int | None = None) -> None:
    """Refuse an option that is no whole number from `least` to `most`."""
    good = isinstance(value, int) and not isinstance(value, bool)
    if not good or value < least or (most is not None and value > most):
        bound = f"≥ {least}" if most is None else f"from {least} to {most}"
        raise ClothbenchError(f"{who}: {what} is {value!r}, expected a whole number {bound}")


def check_switch(who: str, what: str, value: Any) -> None:
    """Refuse an option that is neither true nor false."""
    if not isinstance(value, bool):
        raise ClothbenchError(f"{who}: {what} is {value!r}, expected true or false")


def check_colour(who: str, colour: Any) -> None:
    """Refuse a colour that is neither None, False, nor three whole numbers from 0 to 255."""
    if colour is None or colour is False:
        return
    three = isinstance(colour, Sequence) and not isinstance(colour, str) and len(colour) == 3
    if not three or not all(isinstance(c, int) and not isinstance(c, bool) and 0 <= c <= 255 for c in colour):
        raise ClothbenchError(
            f"{who}: colour is {colour!r}, expected [red, green, blue], whole numbers from 0 to 255, null or false"
        )
