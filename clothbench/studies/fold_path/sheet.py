"""A rectangular sheet on a desk, one edge led along a path: the scene for a model of sheets, and what came of it.

The sheet lies flat at rest, and its edge goes from there to the path's first place; u runs along the fold's direction
x, v along −y. The desk is a plane with friction. Without a thickness the halves pass through each other, and both lie
on the desk, where the upper one rubs, too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clothbench.core.protocols import Material
from clothbench.core.scene import Obstacle, Scene
from clothbench.studies.fold_path.cell import FoldPathCell

STRETCH, SHEAR = 50.0, 12.5  # N/m: limp enough for steps of a millisecond; 1 m hangs 2 cm longer at 0.2 kg/m²
CALM = 0.02  # s, viscosity of bending over its rigidity
DAMPED = 0.02  # N·s/m
STAMPS, RESTS = 201, 0.5  # of the grips; s after the path's end when the edges are looked at
FRAMES = 13  # that are kept


@dataclass(frozen=True)
class Landed:
    """Edges of a folded sheet: how far the led edge is from the other one, mean and spread along it [m]; where that
    one slipped to [m]; the middle line of every frame kept (FRAMES, M, 2) m.
    """

    error: float
    spread: float
    slip: float
    lines: np.ndarray


def scene(cell: FoldPathCell, places: np.ndarray) -> Scene:
    """The edge u = length is led through places (P, 2) m, slowly at both ends of the way."""
    about = cell.path
    across = max(3, round((about.nodes - 1) * about.width / about.length) + 1)
    clock = np.linspace(0.0, about.seconds, STAMPS)
    x, z = led(places, about.length, clock / about.seconds).T
    z = np.maximum(z, about.thickness * (1 - x / about.length))  # it comes down on the lower layer, not into it
    edge = np.linspace(0.0, about.width, across)
    along = np.ones((STAMPS, across))
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(0.0, about.length, about.nodes), edge))
    flat = np.stack([u, -v, 0 * u], axis=1)
    return Scene(
        width=about.length, height=about.width, areal_density=about.layers * about.areal_density, air_density=0.0,
        grip_time=clock, grip_material=np.stack([np.full(across, about.length), edge], axis=1),
        grip_position=np.stack([x[:, None] * along, -edge * along, z[:, None] * along], axis=-1),
        times=np.append(np.linspace(0.0, about.seconds, FRAMES - 1), about.seconds + RESTS),
        points=np.stack([u, v], axis=1), resolution=(about.nodes, across), start=flat, velocity=0 * flat,
        obstacles=(Obstacle("plane", friction=about.friction),), thickness=about.thickness,
    )  # fmt: skip


def led(places: np.ndarray, length: float, share: np.ndarray) -> np.ndarray:
    """Where the edge is (T, 2) m at shares (T,) of the time, from the flat sheet on, without a jerk at either end."""
    route = np.vstack([[length, 0.0], places])
    gone = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(route, axis=0), axis=1))])
    at = gone[-1] * share**3 * (10 - 15 * share + 6 * share**2)
    return np.stack([np.interp(at, gone, route[:, k]) for k in range(2)], axis=1)


def material(cell: FoldPathCell) -> Material:
    """Of the η_b that the path was computed for; the sheet's tensile and shear stiffness are nominal."""
    rigidity = cell.path.layers * cell.path.areal_density / cell.eta_b
    return Material(rigidity, STRETCH, SHEAR, bending_damping=CALM * rigidity, stretch_damping=DAMPED)


def landed(cell: FoldPathCell, rollout: Any) -> Landed:
    """What the last frame says, and the middle line of all."""
    nodes = cell.path.nodes
    sheet = rollout.position[0].reshape(FRAMES, -1, nodes, 3)
    apart = sheet[-1, :, -1, 0] - sheet[-1, :, 0, 0]
    lines = sheet[:, sheet.shape[1] // 2][..., [0, 2]]
    return Landed(float(apart.mean()), float(np.ptp(apart)), float(sheet[-1, :, 0, 0].mean()), lines)
