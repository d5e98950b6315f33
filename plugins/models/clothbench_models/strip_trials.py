"""What strips of cloth are made to do in laboratories: hang over, lie folded, hang as a loop, be lifted off a desk."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from clothbench import ClothbenchError
from clothbench_models.strip import FREE, Ends, State, Strip

TURNS = {"pear": (-math.pi / 2, -math.pi), "ring": (0.0, -2 * math.pi), "heart": (math.pi / 2, -3 * math.pi)}
FOLD_LENGTHS = 12.0  # bending lengths, of the shortest strip that is folded at first
LOOP = 0.8  # bending lengths, radius of the first guess of a fold


def cantilever(strip: Strip, eta_b: float) -> State:
    """Held level at its first end, the rest hanging over: Γ = η_b g L³."""
    return strip.equilibrium(eta_b, Ends())


def free_fold(strip: Strip, eta_b: float, tip: float = 0.0) -> State:
    """Folded back on itself on the desk, its last end at x = `tip` m.

    No end pulls at the other: what lies flat on either side takes up what the loop leaves. The loop is first
    made of cloth so stiff that it takes up much of the strip, then of the one asked for.
    """
    first = min(eta_b, (FOLD_LENGTHS / strip.length) ** 3 / strip.gravity)
    radius = LOOP * strip.size(first)
    flat = (strip.length - math.pi * radius + tip) / 2
    if not 0 < flat < strip.length - math.pi * radius:
        raise ClothbenchError(f"kirchhoff_love: no fold of a strip of {strip.length:g} m has its end at {tip:g} m")
    line = _drawn(strip.length, lambda u: np.clip((u - flat) / radius, 0.0, math.pi))
    return strip.equilibrium(eta_b, Ends(x1=tip, z1=FREE), strip.guess(first, *line))


def fold_height(state: State) -> float:
    """How high a fold stands [m]."""
    return float(state.at(np.linspace(0.0, state.spline.breaks[-1], 20_001))[:, 1].max())


def fold_length(state: State) -> float:
    """Arc length of a fold's loop [m], from where the strip leaves the desk to where it comes down again.

    What lies flat carries no moment, and the gap grows with the cube of the way from there: the end of the loop is as
    far from the place where the gap is a thousandth of the height as that from where it is eight.
    """
    u = np.linspace(0.0, state.spline.breaks[-1], 20_001)
    gap = state.at(u)[:, 1]
    top = int(gap.argmax())
    rising, falling = (np.maximum.accumulate(part) / gap[top] for part in (gap[: top + 1], gap[top:][::-1]))
    ends = [
        2 * np.interp(1e-3, g, s) - np.interp(8e-3, g, s) for g, s in ((rising, u[: top + 1]), (falling, u[top:][::-1]))
    ]
    return float(ends[1] - ends[0])


def hanging_loop(strip: Strip, eta_b: float, kind: str) -> State:
    """Both ends clamped together at the origin: "pear" (leaving straight down), "ring" (level) or "heart" (up).

    Peirce 1930, The handle of cloth as a measurable quantity; the strip must have no desk.
    """
    if kind not in TURNS:
        raise ClothbenchError(f"kirchhoff_love: loop is {kind!r}, expected one of {', '.join(TURNS)}")
    first, turn = TURNS[kind]
    line = _drawn(strip.length, lambda u: first + turn * u / strip.length)
    stiff = min(eta_b, 10.0 / (strip.gravity * strip.length**3))
    closed = Ends(0.0, 0.0, first, 0.0, 0.0, first + turn)
    return strip.equilibrium(eta_b, closed, strip.equilibrium(stiff, closed, strip.guess(stiff, *line)))


def lift(strip: Strip, eta_b: float, height: float, start: State | None = None) -> State:
    """The last end raised to `height` m, free to follow sideways and to turn: no horizontal force (phase 1)."""
    return strip.equilibrium(eta_b, Ends(z1=height), start)


def _drawn(length: float, slope: Callable[[np.ndarray], np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Material points (M,) m of a line with a slope angle along it, and where they lie (M, 2) m."""
    u = np.linspace(0.0, length, 4001)
    angle = slope((u[1:] + u[:-1]) / 2)
    steps = (u[1] - u[0]) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return u, np.vstack([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
