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
    if not isinstance(value, int | float) or isinstance(value, bool) or not math.isfinite(value) or value <= 0:
        raise ClothbenchError(f"{who}: {what} is {value!r}, expected metres above 0, or null")
