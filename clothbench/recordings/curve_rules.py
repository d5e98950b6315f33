"""The rules of recordings of kind "curve": what a reader checks before anything is fitted."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.recordings.nodes_rules import SPLITS

if TYPE_CHECKING:
    from clothbench.recordings.curve import Curve

DIRECTIONS = ("warp", "weft", "course", "wale", "")

# variable: (dimensions, unit)
LAYOUT: dict[str, tuple[tuple[str, ...], str]] = {
    "stretch": (("sample",), "1"),
    "force": (("sample",), "N"),
}
FEWEST = 8  # samples; fewer make no curve
BEGINS = (0.8, 1.5)  # where the smallest stretch lies: a ratio to the unloaded distance, no strain and no millimetres
LONGEST = 20.0  # the stretch that no cloth survives


def check_curve(c: Curve, where: str) -> None:
    """Every rule of the kind, in the order in which a reader would trip over it."""
    _check_shapes(c, where)
    _check_values(c, where)
    _check_stretch(c.stretch, where)
    _check_stated(c, where)


def _check_shapes(c: Curve, where: str) -> None:
    for name in LAYOUT:
        shape = getattr(c, name).shape
        if len(shape) != 1:
            raise ClothbenchError(f"{where}: variable '{name}': found shape {shape}, expected (sample)")
    if len(c.force) != len(c.stretch):
        raise ClothbenchError(
            f"{where}: variable 'force': found {len(c.force)} along 'sample', expected {len(c.stretch)} as in 'stretch'"
        )
    if len(c.stretch) < FEWEST:
        raise ClothbenchError(
            f"{where}: variable 'stretch': found {len(c.stretch)} samples, expected at least {FEWEST}"
        )


def _check_values(c: Curve, where: str) -> None:
    for name, (_, unit) in LAYOUT.items():
        bad = np.flatnonzero(~np.isfinite(getattr(c, name)))
        if bad.size:
            what = "newtons" if unit == "N" else "the ratio of distances"
            raise ClothbenchError(
                f"{where}: variable '{name}': found {len(bad)} values that are not finite, "
                f"the first at sample {bad[0]}, expected {what}; drop these samples"
            )
    if not np.ptp(c.force) > 0:
        raise ClothbenchError(f"{where}: variable 'force': found {c.force[0]:g} N in every sample, expected a curve")


def _check_stretch(stretch: np.ndarray, where: str) -> None:
    least, most = float(stretch.min()), float(stretch.max())
    if not BEGINS[0] <= least <= BEGINS[1] or most > LONGEST:
        raise ClothbenchError(
            f"{where}: variable 'stretch': found {least:g} to {most:g}, expected the ratio to the unloaded distance, "
            f"about 1 at the start and below {LONGEST:g}; divide distances by the unloaded one, add 1 to a strain"
        )
    if most - least < 1e-3:
        raise ClothbenchError(
            f"{where}: variable 'stretch': found {least:g} to {most:g}, expected it to change by 0.001 at least"
        )


def _check_stated(c: Curve, where: str) -> None:
    if not c.name:
        raise ClothbenchError(f"{where}: attribute 'name': found nothing, expected the recording's name")
    if c.direction not in DIRECTIONS:
        known = ", ".join(repr(d) for d in DIRECTIONS)
        raise ClothbenchError(f"{where}: attribute 'direction': found {c.direction!r}, expected one of {known}")
    if c.noise_sigma < 0 or math.isinf(c.noise_sigma):
        raise ClothbenchError(
            f"{where}: attribute 'noise_sigma': found {c.noise_sigma}, expected newtons, 0 or above, or NaN"
        )
    for name in ("sample_width", "sample_length"):
        value = getattr(c, name)
        if value <= 0 or math.isinf(value):
            raise ClothbenchError(f"{where}: attribute '{name}': found {value}, expected metres above 0, or NaN")
    if c.split not in SPLITS:
        raise ClothbenchError(f"{where}: attribute 'split': found {c.split!r}, expected 'fit', 'held_out' or ''")
