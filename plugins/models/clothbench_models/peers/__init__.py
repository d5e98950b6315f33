"""Peers: other simulators stepping the same hanging sheet, so that a speed has something to stand beside.

Every module here offers `step_sheet(side, dt, steps, size, areal_density) -> SheetRun` and `skip_reason()`.
A peer is set up to run as fast as it can on that sheet: one thread, explicit steps, no contacts, the
stepping loop in compiled code, set-up and compilation outside the timing.
"""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass

# Structural springs of a light woven sheet at 21 × 21 nodes [N/m].
STIFFNESS = 70.0
# A node between six kinds of spring stays stable below k dt² / m ≈ 1/3; half of it leaves room for rotation.
STABLE_FRACTION = 0.15


@dataclass(frozen=True)
class SheetRun:
    """One timed run of a square sheet held at its two upper corners.

    The sheet starts flat and vertical with its grips at height 0, so a sound run ends with `lowest` a
    little below minus the sheet's size: it sagged, and it did not fall or blow up.
    """

    peer: str
    version: str
    nodes: int
    steps: int
    seconds: float
    """Wall time of `steps` steps [s]; set-up, compilation and warm-up are not in it."""
    lowest: float
    """Height of the lowest node above the grips [m]."""
    finite: bool

    @property
    def node_steps_per_s(self) -> float:
        """Nodes advanced by one step, per second of wall time [1/s]."""
        return self.nodes * self.steps / self.seconds


def node_mass(side: int, size: float, areal_density: float) -> float:
    """Mass of one of side × side equal nodes [kg]; size in m, areal density in kg/m²."""
    return areal_density * size**2 / side**2


def stable_stiffness(mass: float, dt: float) -> float:
    """Spring stiffness [N/m]: a woven sheet's, or less where an explicit step of dt [s] could not carry it.

    The cost of an explicit step does not depend on it, so a fine sheet may be softer without harm.
    """
    return min(STIFFNESS, STABLE_FRACTION * mass / dt**2)


def missing(module: str, extra: str) -> str | None:
    """What to install when `module` is absent, without importing it; None when it is there."""
    return None if importlib.util.find_spec(module) else f"pip install clothbench[{extra}]"
