"""Folding a strip that lies on a desk by its last end: what a model with the capability "fold" has to answer.

The strip lies along x on the desk z = 0, its first end at the origin; its last end is held at a pose (x, z, slope).
Forces are per width and areal density, in m²/s², since nothing else is known of the cloth: friction is a ratio of two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from clothbench.core.brief import brief


@dataclass(frozen=True, eq=False)
class FoldState:
    """A strip held at rest, for B parameter sets. Arrays are read-only.

    pose: (B, 3), x and z [m] and slope [rad] of the held end; profile: (B, M, 2) m, x and z along the strip, evenly;
    pull: (B,) m²/s², horizontal force of the held end, which friction at the desk bears; press: (B,) m²/s², force with
    which the desk carries the strip; status: "ok" or "diverged", then everything else is NaN; kept: what the model
    wants to begin from when it is asked for a state near this one.
    """

    pose: np.ndarray
    profile: np.ndarray
    pull: np.ndarray
    press: np.ndarray
    status: tuple[str, ...]
    kept: Sequence[Any] = ()

    __repr__ = brief

    def __post_init__(self) -> None:
        for name in ("pose", "profile", "pull", "press"):
            array = np.array(getattr(self, name), dtype=float)
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    @property
    def friction(self) -> np.ndarray:
        """The coefficient of friction (B,) that keeps the strip from slipping: |pull| over press."""
        return np.abs(self.pull) / self.press


class Folding(Protocol):
    """A strip of some length, as `model.strip(length)` gives it; theta (B, P) are the model's own parameters."""

    def lift(self, height: float, theta: np.ndarray) -> FoldState:
        """Phase 1 of a folding path: the end raised to `height` m, x and slope such that no horizontal force is left.

        Petrík et al., Automatic Material Properties Estimation for the Physics-Based Robotic Garment Folding, eq. 2
        and 3.
        """
        ...

    def hold(self, pose: np.ndarray, theta: np.ndarray, near: FoldState) -> FoldState:
        """The end held at poses (B, 3); `near` has one member, from which to set out."""
        ...


@dataclass(frozen=True, eq=False)
class FoldPath:
    """A whole folding path of one fabric, or what became of a strip on one: P states in order.

    phase: (P,) 1 to 3, 0 if the path has none; state: its P members are the path's states;
    origin: (P,) m, where the strip's first end lies, which slips where the desk's friction does not hold it; needed:
    (P,), the coefficient that would have held it where it lay a state before; laid: so many states at the end have
    layers that touch as they are expected to. Arrays are read-only.
    """

    phase: np.ndarray
    state: FoldState
    origin: np.ndarray
    needed: np.ndarray
    laid: int = 0

    __repr__ = brief

    def __post_init__(self) -> None:
        for name, kind in (("phase", int), ("origin", float), ("needed", float)):
            array = np.array(getattr(self, name), dtype=kind)
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    @property
    def places(self) -> np.ndarray:
        """Where the hand is, (P, 2) m: x and z."""
        return self.state.pose[:, :2]


@runtime_checkable
class FoldsOver(Protocol):
    """A strip that is folded all the way, which `model.strip(length)` may offer beside `lift` and `hold`.

    Both raise ClothbenchError where there is no such path.
    """

    def fold(self, theta: np.ndarray, tip: float = 0.0) -> FoldPath:
        """The three phases of the path for parameters theta (P,) that lay the end down at x = `tip` m.

        Petrík et al., Automatic Material Properties Estimation for the Physics-Based Robotic Garment Folding, III.A.
        """
        ...

    def follow(self, places: np.ndarray, theta: np.ndarray, friction: float) -> FoldPath:
        """What becomes of a strip whose end is led through places (P, 2) m, turning freely, on a desk of `friction`.

        Infinite friction is a desk that holds: nothing slips, and `needed` is what each place takes.
        """
        ...


def triangular_path(length: float, height: np.ndarray) -> np.ndarray:
    """x [m] of the end at `height` m on the way to half the strip, for cloth without stiffness."""
    return length - height


def circular_path(length: float, height: np.ndarray) -> np.ndarray:
    """x [m] of the end at `height` m if the upper half turned about the middle like a board."""
    return length / 2 + np.sqrt((length / 2) ** 2 - height**2)


def geometric_places(name: str, length: float, count: int) -> np.ndarray:
    """Where the "triangular" or the "circular" path leads the end of a strip that is folded in half, (count, 2) m.

    It begins behind the flat strip's end and ends at x = z = 0, in steps of equal length.
    """
    return geometric_path(name, length, np.linspace(0.0, 1.0, count + 1)[1:])


def geometric_path(name: str, length: float, share: np.ndarray) -> np.ndarray:
    """Places (n, 2) m of the same paths at shares (n,) of their way, 0 the flat strip's end."""
    if name == "circular":
        return length / 2 * np.stack([1 + np.cos(np.pi * share), np.sin(np.pi * share)], axis=1)
    if name != "triangular":
        raise ValueError(f"there is no path {name!r}; there are: circular, triangular")
    return length * np.stack([1 - share, np.minimum(share, 1 - share)], axis=1)
