"""The scenes whose answer is known. All are strips of one cloth, `along` nodes along their longer side.

A strip is four times as long as wide (eight times where it swings or folds), on cells as square as can be, so that
its edges are a part of the sheet that stays the same as the mesh is refined.
"""

from __future__ import annotations

import math

import numpy as np

from clothbench import Obstacle, Scene
from clothbench.reference.mechanics import BESSEL_ZERO, Curve, bending_length, fold_loop, swing_period

DENSITY = 0.15  # kg/m²
AIR = 1.2  # kg/m³
ASPECT, SLENDER = 4, 8  # length over width
OVERLAP = 1.0  # flat cloth on either side of a fold's loop, in bending lengths
LENGTH = 0.297  # m, of the sheet that swings
# How long a swing's upper edge takes to step aside, in periods. A step 10s³ − 15s⁴ + 6s⁵ of τ s excites a mode of ω
# in proportion to j₂(ωτ/2)/(ωτ/2)²; the second to fourth modes (2.295, 3.598 and 4.903 ω₁) fall on its first zeros.
RAMP = 5.763459 / 2.295421 / math.pi
SPAN = 0.8  # of a hanging strip's length


def nodes_across(along: int, aspect: int = ASPECT) -> int:
    """An odd number of nodes, at least 3, that makes cells nearly square: there is a middle row."""
    return max(3, 2 * round((along - 1) / aspect / 2) + 1)


def level(length: float, along: int, times: np.ndarray) -> Scene:
    """A strip that nothing holds, lying level in the air at rest."""
    points = np.stack([a.ravel() for a in np.meshgrid(np.linspace(0, length, 9), np.linspace(0, length / ASPECT, 3))])
    start = np.stack([points[0], points[1], 0 * points[0]], axis=1)
    return _scene(length, length / ASPECT, along, np.zeros((0, 2)), np.zeros((2, 0, 3)), times, points.T, start)


def clamped(length: float, along: int, load: float) -> Scene:
    """A cantilever of free length `length` m, held level at one end, to be looked at when it hangs still.

    The first two columns of nodes are held, every node of them, and the cloth begins to turn at the second: the strip
    is longer than L by the held cell, L (n − 1)/(n − 2) in all, so that L stays the same on every mesh. The first guess
    is a curve of small deflections, with no more than 80° at the tip.
    """
    total = length * (along - 1) / (along - 2)
    cell = total / (along - 1)
    angle = min(load / 6, 1.4)

    def slope(s: np.ndarray) -> np.ndarray:
        free = np.clip((s - cell) / length, 0.0, 1.0)
        return -angle * (1 - (1 - free) ** 3)

    return _still(total, length / ASPECT, along, slope, [0.0, cell])


def folded(bending: float, along: int) -> Scene:
    """A strip folded back on itself on the ground z = 0, its lower end held flat, to be looked at when it rests.

    Layers pass through each other, so that both can lie at z = 0: the limit of a cloth without thickness, which the
    reference describes. The ground is smooth, since no horizontal force takes part (see `references.fold_loop`), and
    the lower end is held only to keep the fold from sliding away. On a mesh the node at either end of the loop can
    carry a kink, so that loops of a whole range of sizes rest, the wider the coarser the mesh; the first guess is a
    loop a tenth too large, which shrinks until those nodes carry no moment, as in the limit.
    """
    unit = bending_length(bending, DENSITY)
    loop = fold_loop()
    size, total = 1.1 * unit, (loop.s[-1] + 2 * OVERLAP) * unit
    begin = (total - size * loop.s[-1]) / 2

    def slope(s: np.ndarray) -> np.ndarray:
        return np.interp((s - begin) / size, loop.s, loop.angle)

    return _still(total, total / SLENDER, along, slope, [0.0, total / (along - 1)], (Obstacle("plane"),))


def strung(length: float, along: int) -> Scene:
    """A strip whose two ends are held level, 0.8 of its length apart, to be looked at when it hangs still."""
    ends = np.array([0.0, length])
    points = _rows(length, length / ASPECT, along)
    s = points[:, 0] / length - 0.5
    start = np.stack([SPAN * length * s, points[:, 1], 1.2 * length * (s**2 - 0.25)], axis=1)
    held = _grips(ends, length / ASPECT, nodes_across(along))
    at = np.stack([SPAN * (held[:, 0] - length / 2), held[:, 1], 0 * held[:, 0]], axis=1)
    return _scene(length, length / ASPECT, along, held, np.stack([at, at]), np.array([0.0, 0.1]), points, start)


def swinging(along: int, step: float, seconds: float, interval: float, extra: float = 0.0) -> Scene:
    """A sheet held along its whole top edge, which steps aside by `step` m; then it swings freely for `seconds`.

    The step is timed so that the lowest mode alone swings, with air of `extra` times the sheet's mass carried along.
    The first frame is the sheet at rest, the others follow from the end of the step every `interval` s.
    """
    width, across = LENGTH / SLENDER, nodes_across(along, SLENDER)
    held = np.stack([np.linspace(0, width, across), np.zeros(across)], axis=1)
    ramp = RAMP * swing_period(LENGTH, extra)
    clock = np.linspace(0.0, ramp, 100)
    s = clock / ramp
    aside = step * s**3 * (10 - 15 * s + 6 * s**2)
    at = np.stack([held[:, 0], 0 * held[:, 0], 0 * held[:, 0]], axis=1)
    path = at + aside[:, None, None] * np.array([0.0, 1.0, 0.0])
    times = np.concatenate([[0.0], ramp + np.arange(0.0, seconds, interval)])
    return Scene(
        width=width, height=LENGTH, areal_density=DENSITY, grip_time=clock, grip_material=held, grip_position=path,
        times=times, points=_nodes(width, LENGTH, across, along), air_density=AIR, resolution=(across, along),
    )  # fmt: skip


def first_mode(along: int) -> np.ndarray:
    """J₀(z₁ √ξ) on the nodes from the top down, ξ from 0 at the free end to 1: how the hanging sheet swings."""
    from scipy.special import j0

    return j0(BESSEL_ZERO * np.sqrt(1 - np.linspace(0, 1, along)))


def middle(scene: Scene) -> np.ndarray:
    """Numbers of the points on the strip's middle line, in the order of u."""
    return np.flatnonzero(np.abs(scene.points[:, 1] - scene.height / 2) < 1e-9)


# --- making them ----------------------------------------------------------------------------------------------------


def drawn(slope, s: np.ndarray) -> Curve:
    """The line with the given slope angle, from the origin along x."""
    fine = np.linspace(0.0, s.max(), 2001)
    angle = slope(fine)
    step = np.diff(fine, prepend=0.0)
    half = (angle + np.concatenate([angle[:1], angle[:-1]])) / 2
    x, z = np.cumsum(step * np.cos(half)), np.cumsum(step * np.sin(half))
    return Curve(s, slope(s), np.interp(s, fine, x), np.interp(s, fine, z))


def _still(length: float, width: float, along: int, slope, columns, obstacles: tuple[Obstacle, ...] = ()) -> Scene:
    """A strip along x held level at the given columns u [m], with its first guess drawn from a slope angle."""
    points = _rows(length, width, along)
    line = drawn(slope, points[:, 0])
    start = np.stack([line.x, points[:, 1], line.z], axis=1)
    held = _grips(np.array(columns), width, _across(length, width, along))
    at = np.stack([held[:, 0], held[:, 1], 0 * held[:, 0]], axis=1)
    times = np.array([0.0, 0.1])
    return _scene(length, width, along, held, np.stack([at, at]), times, points, start, obstacles)


def _rows(length: float, width: float, along: int) -> np.ndarray:
    """Every node, (n, 2) m; row by row, so that a first guess known there is known evenly in both directions."""
    return _nodes(length, width, along, _across(length, width, along))


def _nodes(width: float, height: float, nu: int, nv: int) -> np.ndarray:
    u, v = np.meshgrid(np.linspace(0, width, nu), np.linspace(0, height, nv))
    return np.stack([u.ravel(), v.ravel()], axis=1)


def _across(length: float, width: float, along: int) -> int:
    return nodes_across(along, round(length / width))


def _grips(columns: np.ndarray, width: float, across: int) -> np.ndarray:
    """Every node of some columns, (G, 2) m."""
    u, v = np.meshgrid(columns, np.linspace(0, width, across))
    return np.stack([u.ravel(), v.ravel()], axis=1)


def _scene(length, width, along, held, position, times, points, start, obstacles=()) -> Scene:
    return Scene(
        width=length, height=width, areal_density=DENSITY, grip_time=np.array([0.0, max(times[-1], 0.1)]),
        grip_material=held, grip_position=position, times=times, points=points, air_density=AIR,
        resolution=(along, _across(length, width, along)), start=start, obstacles=obstacles,
    )  # fmt: skip


def tip_length(bending: float, load: float) -> float:
    """The overhang [m] at which Γ = ρgL³/D of a cloth is `load`."""
    return bending_length(bending, DENSITY) * math.cbrt(load)
