"""Drapes of discs as a drapemeter shows them: outlines from above, and what is read off them.

A specimen, a disc of radius r₂, lies between two plates of radius r₁ and hangs over their rim; what is seen is its
shadow (Cusick 1968, The measurement of fabric drape). Its outline is r(φ) about the plates' middle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clothbench.core.brief import brief
from clothbench.core.errors import ClothbenchError

ANGLES = 360  # of an outline
RINGS, SPOKES = 7, 120  # of material points in which a drape is simulated: from the plate to the rim, around it


@dataclass(frozen=True)
class Quantity:
    """What is read off a drape's outline. meaning: one line; unit: as reports show it; scale: of 1 in that unit."""

    name: str
    symbol: str
    unit: str
    scale: float
    meaning: str


DRAPE_COEFFICIENT = Quantity(
    "drape_coefficient", "DC", "%", 100.0, "share of the ring beyond the plate that lies in the shadow"
)
QUANTITIES = (
    DRAPE_COEFFICIENT,
    Quantity("folds", "n", "1", 1.0, "number of folds around the rim"),
    Quantity("depth", "d", "mm", 1e3, "mean height of the folds in the outline over the troughs beside them"),
    Quantity("unevenness", "c_v", "%", 100.0, "spread of the angles from fold to fold, over their mean"),
)


@dataclass(frozen=True, eq=False)
class Outlines:
    """Outlines of drapes of one fabric, capture by capture; arrays are read-only.

    radius: (T, K) m, at K even angles from 0 on, counter-clockwise as seen from above, about the plates' middle;
    plate_radius, disc_radius: m; sample: (T,), which specimen each capture shows; sigma: m, of one radius; pixel: m.
    """

    radius: np.ndarray
    plate_radius: float
    disc_radius: float
    sample: np.ndarray
    sigma: float
    pixel: float

    __repr__ = brief

    def __post_init__(self) -> None:
        for name in ("radius", "sample"):
            array = np.array(getattr(self, name))
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        if self.radius.ndim != 2 or self.sample.shape != self.radius.shape[:1]:
            raise ClothbenchError(
                f"outlines: found radius {self.radius.shape} and sample {self.sample.shape}, expected (T, K) and (T,)"
            )

    def coefficient(self) -> np.ndarray:
        """The drape coefficient of each capture (T,)."""
        return drape_coefficient(self.radius, self.plate_radius, self.disc_radius)


def drape_coefficient(radius: np.ndarray, plate: float, disc: float) -> np.ndarray:
    """(A − π r₁²)/(π (r₂² − r₁²)) of outlines (..., K) m (Cusick 1968)."""
    area = np.pi * np.mean(np.square(radius), axis=-1)
    return (area - np.pi * plate**2) / (np.pi * (disc**2 - plate**2))


def drape_points(plate: float, disc: float) -> np.ndarray:
    """Material points (RINGS · SPOKES, 2) m of a disc that touches the sides of its sheet: rings from the plate's rim
    to its own, evenly apart.
    """
    turn = 2 * np.pi * np.arange(SPOKES) / SPOKES
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return (disc + np.linspace(plate, disc, RINGS)[:, None, None] * ring).reshape(-1, 2)


def outlines_of_points(position: np.ndarray, centre: tuple[float, float, float], plate: float) -> np.ndarray:
    """Outlines (..., ANGLES) m, from above, of drapes whose `drape_points` are at position (..., N, 3) m.

    How far the farthest ring reaches along each ray from the plates' middle, and the plate at least; NaN where a point
    is not known.
    """
    rings = (position[..., :2] - np.array(centre[:2])).reshape(*position.shape[:-2], RINGS, SPOKES, 2)
    flat = rings.reshape(-1, RINGS, SPOKES, 2)
    out = np.stack([_reach(one) for one in flat]) if len(flat) else np.zeros((0, ANGLES))
    out = np.where(np.isfinite(flat).all(axis=(1, 2, 3))[:, None], np.maximum(out, plate), np.nan)
    return out.reshape(*position.shape[:-2], ANGLES)


def _reach(rings: np.ndarray) -> np.ndarray:
    """How far along each of ANGLES rays from the origin any of closed rings (R, S, 2) m crosses it (ANGLES,), 0 where
    none does. A ray at angle φ meets the side from a to b at (a × b)/((b − a) × e), e the ray's direction.
    """
    turn = 2 * np.pi * np.arange(ANGLES) / ANGLES
    ray = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    a, b = rings.reshape(-1, 2), np.roll(rings, -1, axis=1).reshape(-1, 2)
    left_a, left_b = (np.outer(ray[:, 0], p[:, 1]) - np.outer(ray[:, 1], p[:, 0]) for p in (a, b))
    cut = (left_a <= 0) != (left_b <= 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = left_a / (left_a - left_b)
        along = (ray @ a.T) * (1 - share) + (ray @ b.T) * share
    return np.where(cut, along, 0.0).max(axis=1)
