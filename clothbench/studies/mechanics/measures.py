"""What is read off a simulation: numbers from positions (T, N, 3) m at the scene's times and points."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from clothbench import ClothbenchError, Scene
from clothbench.reference.mechanics import G, swing_period
from clothbench.studies.mechanics.scenes import LENGTH, first_mode, middle

TOUCHING = 1e-3  # of a fold's height: a gap to the ground below which cloth counts as lying on it
FLAT = 1e-9  # rad, of a turn at a node that is rounding


class NoMeasure(ClothbenchError):
    """The motion does not show what is to be measured in it."""


def drop(scene: Scene, x: np.ndarray) -> float:
    """How far the sheet fell from the first to the last frame [m]."""
    return float((x[0, :, 2] - x[-1, :, 2]).mean())


def last_speed(scene: Scene, x: np.ndarray) -> float:
    """Speed of the fall between the last two frames [m/s]."""
    return float((x[-2, :, 2] - x[-1, :, 2]).mean() / (scene.times[-1] - scene.times[-2]))


def tip_sag(scene: Scene, x: np.ndarray) -> float:
    """How far a cantilever's tip hangs below its clamp [m]."""
    line = x[-1, middle(scene)]
    return float(line[0, 2] - line[-1, 2])


def sag_over_reach(scene: Scene, x: np.ndarray) -> float:
    """H/W of a cantilever, from the line where it begins to turn (the second column of nodes) to its tip."""
    line = x[-1, middle(scene)]
    reach = line[-1, 0] - line[1, 0]
    if reach <= 0:
        raise NoMeasure("the strip hangs behind its clamp")
    return float((line[0, 2] - line[-1, 2]) / reach)


def rigidity(scene: Scene, x: np.ndarray) -> float:
    """Bending stiffness D [N·m] of a cantilever: the moment of what hangs beyond a node over the curvature there, by
    least squares over the nodes between clamp and tip. Where the clamp begins does not matter to it.
    """
    line = x[-1, middle(scene)]
    rows = scene.points[middle(scene), 0]
    step = rows[1] - rows[0]
    along, angle = line[:, 0], np.unwrap(np.arctan2(np.diff(line[:, 2]), np.diff(line[:, 0])))
    weight = np.full(len(line), scene.areal_density * G * step)
    weight[-1] /= 2
    inner = range(2, len(line) - 1)
    moment = np.array([(weight[i:] * (along[i:] - along[i])).sum() for i in inner])
    curvature = -np.diff(angle)[[i - 1 for i in inner]] / step
    if not np.abs(curvature).max(initial=0.0) * step > FLAT:
        raise NoMeasure("the strip does not bend")
    return float(moment @ curvature / (curvature @ curvature))


def fold_height(scene: Scene, x: np.ndarray) -> float:
    """Height [m] of a fold over its held end: the top of a cubic spline through the middle line's nodes."""
    from scipy.interpolate import CubicSpline

    spline = CubicSpline(scene.points[middle(scene), 0], x[-1, middle(scene), 2])
    turns = spline.derivative().roots(extrapolate=False)
    top = max([*spline(turns), *x[-1, middle(scene), 2]])
    return float(top - x[-1, middle(scene)[0], 2])


def fold_length(scene: Scene, x: np.ndarray) -> float:
    """Arc length [m] of a fold's loop: of the cloth from where it leaves the ground to where it comes down again.

    On a mesh that falls between two nodes. What lies flat carries no moment, so that the gap to the ground grows with
    the cube of the way from there: its cube root, drawn straight through the two nodes next to the ground whose gaps
    exceed a thousandth of the height (`TOUCHING`), meets zero at the end of the loop. The error of that is below a
    hundredth of a loop with 20 nodes and falls with their distance.
    """
    line = middle(scene)
    s, gap = scene.points[line, 0], x[-1, line, 2] - x[-1, line[0], 2]
    top = int(gap.argmax())
    low = np.flatnonzero(gap <= TOUCHING * gap[top])
    before, after = low[low < top], low[low > top]
    if not len(before) or not len(after) or min(top - before[-1], after[0] - top) < 2:
        raise NoMeasure("the fold has no loop that comes down to the ground on both sides over two nodes or more")
    ends = []
    for near, far in ((before[-1] + 1, before[-1] + 2), (after[0] - 1, after[0] - 2)):
        a, b = np.cbrt(gap[[near, far]])
        if not b > a:
            raise NoMeasure("the fold does not rise from where it leaves the ground")
        ends.append(s[near] - a * (s[far] - s[near]) / (b - a))
    return float(ends[1] - ends[0])


def middle_sag(scene: Scene, x: np.ndarray) -> float:
    """How far the middle of a strip hangs below its two ends [m]."""
    line = x[-1, middle(scene), 2]
    return float((line[0] + line[-1]) / 2 - np.interp(scene.width / 2, scene.points[middle(scene), 0], line))


def period(scene: Scene, x: np.ndarray) -> float:
    """Period [s] of the sheet's lowest swing: a damped sine fitted to its share of the motion.

    The share is the projection on J₀(z₁ √ξ), to which the sheet's other modes are orthogonal.
    """
    aside = _mean_across(scene, x[1:, :, 1] - x[1:, :1, 1])
    return 2 * math.pi / _frequency(scene.times[1:], np.trapezoid(aside * first_mode(aside.shape[1]), axis=1))


def _mean_across(scene: Scene, values: np.ndarray) -> np.ndarray:
    """Means (T, along) over the width of a hanging sheet of values (T, N) at its nodes, from the top down."""
    assert scene.resolution is not None  # the scenes here all state one
    rows = values.reshape(len(values), -1, scene.resolution[0])
    return np.trapezoid(rows, axis=2) / (rows.shape[2] - 1)


def _frequency(time: np.ndarray, signal: np.ndarray) -> float:
    """ω [rad/s] of e^(−γt) (a sin ωt + b cos ωt) + c; a, b and c by linear least squares, ω and γ by search."""
    from scipy.optimize import least_squares

    scale, clock = np.abs(signal).max(), time - time[0]
    if not scale > 1e-9:
        raise NoMeasure("the sheet does not swing")

    def misfit(p: np.ndarray) -> np.ndarray:
        omega, decay = p
        wave = np.exp(-decay * clock)
        base = np.stack([wave * np.sin(omega * clock), wave * np.cos(omega * clock), np.ones_like(clock)], axis=1)
        return base @ np.linalg.lstsq(base, signal / scale, rcond=None)[0] - signal / scale

    guess = 2 * math.pi / swing_period(LENGTH)
    starts = [np.array([guess * f, d]) for f in np.linspace(0.5, 1.5, 21) for d in (0.01, 1.0)]
    best = min(starts, key=lambda p: float((misfit(p) ** 2).sum()))
    found = least_squares(misfit, best, bounds=([0.3 * guess, -5.0], [2.0 * guess, 50.0]), xtol=1e-12, ftol=1e-14)
    omega, decay = found.x
    if not found.fun.var() < 0.1 * (signal / scale).var() or decay * (2 * math.pi / omega) > 3:
        raise NoMeasure("the motion is no swing whose period could be measured")
    return float(omega)


def energy_drift(scene: Scene, x: np.ndarray) -> float:
    """How much of a swing's energy is gone or has come within ten seconds [%].

    Energy of motion (speeds from frames 2·interval apart) and height above the sheet at rest, as means over two
    periods at the beginning and ten seconds later. What the weave stores elastically cannot be seen from outside; in
    this scene it is below 0.1 % of the swing and hardly changes.
    """
    time, path = scene.times[1:], x[1:]
    speed = (path[2:] - path[:-2]) / (time[2:] - time[:-2])[:, None, None]
    everywhere = (speed**2).sum(axis=-1) / 2 + G * (path[1:-1, :, 2] - x[0, :, 2])
    energy = np.trapezoid(_mean_across(scene, everywhere), axis=1)
    window = 2 * swing_period(LENGTH)
    early = energy[time[1:-1] < time[0] + window].mean()
    late = energy[time[1:-1] > time[-1] - window].mean()
    if not early > 0:
        raise NoMeasure("the sheet does not swing")
    return float(100 * (late - early) / early)


def observed_order(sizes: Sequence[float], values: Sequence[float]) -> float | None:
    """The power of the cell size with which the last three values approach their limit (Richardson).

    p of (a₁ − a₂)/(a₂ − a₃) = (h₁ᵖ − h₂ᵖ)/(h₂ᵖ − h₃ᵖ), sizes falling. None where the values do not approach one
    steadily, or differ by rounding alone: then there is no order to see.
    """
    from scipy.optimize import brentq

    if len(values) < 3 or not np.isfinite(values[-3:]).all():
        return None
    (h1, h2, h3), (a1, a2, a3) = sizes[-3:], values[-3:]
    if abs(a2 - a3) < 1e-7 * max(abs(a3), 1e-12) or (a1 - a2) * (a2 - a3) <= 0:
        return None
    ratio = (a1 - a2) / (a2 - a3)

    def excess(p: float) -> float:
        return (h1**p - h2**p) / (h2**p - h3**p) - ratio

    low, high = 0.02, 12.0
    return float(brentq(excess, low, high)) if excess(low) < 0 < excess(high) else None
