"""The whole folding path of a strip on a desk: lifted, carried over, laid down on itself; and what becomes of it.

Petrík et al., Automatic Material Properties Estimation for the Physics-Based Robotic Garment Folding, section III.A: in
phase 1 the gripper's z is known, in phase 2 its x, in phase 3 its z again, and the rest of the pose is computed such
that the layers touch where they are expected to. What the paper leaves to its references is chosen here; the hand lets
the end turn freely all the time:

- expected is what the finished fold has: a point u of the upper layer at x = L + tip − u;
- phase 1 has no horizontal force, and ends when no more of the strip lies on the desk than under the finished fold;
- phase 2 leaves that as it is: the place of lift-off stays, which gives z for every x, up to where z would fall by more
  than x does, so that it is z that tells one place from the next;
- phase 3 is the way on which the upper layer lies where it is expected. Followed upwards from the finished fold it has
  a highest state. Between that and the end of phase 2 no state of the one kind becomes one of the other: the strip
  falls over, and the hand goes straight from one place to the other.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from clothbench import ClothbenchError
from clothbench_models import strip_trials
from clothbench_models.strip import Ends, State, Strip

ON = 1e-9  # m, as near to the desk as this a control point touches
FINE = 4001  # points among which the lowest is looked for
EXACT, ENOUGH = 1e-6, 2e-3  # of the length; of the bending length: how well lift-off and landing are to be met
TRIES = 12  # of a secant
LIFTS, FALLS = 24, 6  # states of phase 1, and of the way on which the strip falls
LIFTED = 0.9  # of what is off the desk, how high its end is at first taken to be
ACROSS, MOST = 0.25, 200  # bending lengths, step of phase 2; how many at most
DOWN, LEAST = 1 / 30, 0.02  # of the length, and of the bending length: longest and shortest step of phase 3
FIRST, HALVINGS = 0.01, 4  # bending lengths, first step of a slip; how often a step of the hand is halved at most

Condition = Callable[[float, State], tuple[float, State]]  # (coordinate, state nearby) → (what shall be 0, state there)


@dataclass(frozen=True, eq=False)
class Path:
    """States of a path in order, with the phase of each; the last `laid` of them have layers that touch as expected."""

    phases: tuple[int, ...]
    states: tuple[State, ...]
    laid: int


def lower_layer(state: State) -> np.ndarray:
    """Which control points (n,) come before the first that lies further back than the one before it."""
    back = np.diff(state.control[:, 0]) < -ON
    return np.arange(len(state.control)) <= (int(np.argmax(back)) if back.any() else len(back))


def lift_off(state: State, gravity: float) -> float:
    """Where the lower layer leaves the desk [m], by how it presses: its weight up to there, and a point force there.

    From M₀ = g a + P and M₁ = g a²/2 + P a follows a, which is not bound to control points as what touches is.
    """
    on = lower_layer(state) & (state.control[:, 1] < ON)
    press, place = state.reaction[on, 1], state.spline.greville[on]
    whole, first = float(press.sum()), float((press * place).sum())
    return (whole - math.sqrt(max(whole**2 - 2 * gravity * first, 0.0))) / gravity


def carried(state: State) -> float:
    """Force with which the lower layer carries the upper one [m²/s²]."""
    on = ~lower_layer(state) & (state.control[:, 1] < ON)
    return float(state.reaction[:-2, 1][on[:-2]].sum())


def landing(state: State, tip: float) -> float:
    """By how much [m] the upper layer's lowest point lies further out than expected, x + u − L − tip."""
    length = float(state.spline.breaks[-1])
    u = np.linspace(0.0, length, FINE)
    line = state.at(u)
    turn = int(np.argmax(line[:, 0]))
    lowest = turn + int(np.argmin(line[turn:, 1]))
    return float(line[lowest, 0] + u[lowest] - length - tip)


def path(strip: Strip, eta_b: float, tip: float = 0.0) -> Path:
    """All three phases for a strip whose end is to lie at x = `tip` m.

    Raises ClothbenchError for cloth too stiff for its length: no fold lies there by itself.
    """
    fold = strip_trials.free_fold(strip, eta_b, tip)
    if carried(fold) <= 0:
        raise ClothbenchError(f"kirchhoff_love: a strip of {strip.length:g} m is too stiff to lie folded")
    left = lift_off(fold, strip.gravity)
    lifted = lifts(strip, eta_b, left)
    laid = laid_down(strip, eta_b, fold, tip, lifted)
    over = carried_over(strip, eta_b, lifted[-1], left)
    falling, _ = followed(strip, eta_b, between(over[-1], laid[0]), math.inf, over[-1])
    states = (*lifted, *over, *falling, *laid)
    phases = (1,) * len(lifted) + (2,) * len(over) + (3,) * (len(falling) + len(laid))
    return Path(phases, states, len(laid))


def lifts(strip: Strip, eta_b: float, left: float) -> list[State]:
    """Phase 1, until the strip lies on the desk up to `left` m only."""

    def excess(z: float, near: State) -> tuple[float, State]:
        found = strip.onwards(near, eta_b, Ends(z1=z))
        return lift_off(found, strip.gravity) - left, found

    reach = strip.length - left
    near = strip_trials.lift(strip, eta_b, LIFTED * reach)
    last = _secant(excess, reach * np.array([LIFTED, LIFTED + 1e-3]), near, *_tolerances(strip, eta_b))
    return [*(strip_trials.lift(strip, eta_b, k * last.ends.z1 / LIFTS) for k in range(1, LIFTS)), last]


def carried_over(strip: Strip, eta_b: float, start: State, left: float) -> list[State]:
    """Phase 2: x goes back, the lift-off stays at `left` m; up to where the hand goes down at 45°, or nothing rests."""
    out, step = [start], ACROSS * strip.size(eta_b)
    for _ in range(MOST):
        x, z = out[-1].ends.x1 - step, out[-1].ends.z1

        def excess(z: float, near: State, x: float = x) -> tuple[float, State]:
            found = strip.onwards(near, eta_b, Ends(x1=x, z1=z))
            return lift_off(found, strip.gravity) - left, found

        try:
            found = _secant(excess, z - step * np.array([0.0, 1e-2]), out[-1], *_tolerances(strip, eta_b))
        except ClothbenchError:
            if len(out) > 2 and z < out[-2].ends.z1:  # beyond the place where it falls over nothing is left to find
                return out[1:]
            raise
        if z - found.ends.z1 > step:
            return out[1:]
        out.append(found)
    raise ClothbenchError(f"kirchhoff_love: phase 2 finds no end at η_b = {eta_b:g} m⁻⁴·s²")


def laid_down(strip: Strip, eta_b: float, fold: State, tip: float, lifted: list[State]) -> list[State]:
    """Phase 3 from its highest state down to the fold, found upwards: each step half as long where it leads off.

    Each begins as far from the mirror image of phase 1 as the one before it was.
    """
    out, step, aside = [fold], DOWN * strip.length, 0.0
    heights, places = np.array([[0.0, strip.length], *([s.ends.z1, s.ends.x1] for s in lifted)]).T
    z = 0.0
    while step > LEAST * strip.size(eta_b):
        mirrored = strip.length + tip - float(np.interp(z + step, heights, places))

        def off(x: float, near: State, z: float = z + step) -> tuple[float, State]:
            found = strip.onwards(near, eta_b, Ends(x1=x, z1=z))
            return landing(found, tip), found

        try:
            first = mirrored + aside + step * np.array([0.0, 1e-2])
            found = _secant(off, first, out[-1], *_tolerances(strip, eta_b))
        except ClothbenchError:
            step /= 2
            continue
        if carried(found) > 0:
            out.append(found)
            z, aside = z + step, found.ends.x1 - mirrored
        else:
            step /= 2
    return out[::-1]


def between(first: State, last: State) -> np.ndarray:
    """Places (n, 2) m of the hand on the straight way from one state to another, without these."""
    share = np.linspace(0.0, 1.0, FALLS + 2)[1:-1, None]
    a, b = first.ends, last.ends
    return (1 - share) * [a.x1, a.z1] + share * [b.x1, b.z1]


def followed(
    strip: Strip, eta_b: float, places: np.ndarray, friction: float, start: State | None = None
) -> tuple[list[State], list[float]]:
    """What becomes of a strip whose end is led through places (n, 2) m, turning freely: n states, and n coefficients of
    friction that it would have taken to keep what lies on the desk where it lay before each step.

    Where the desk has less than that, what lies there slips as a whole until it does (cloth hardly stretches): the
    first end's place tells by how much. start: None, it lies flat.
    """
    near = start or strip_trials.lift(strip, eta_b, max(float(places[0, 1]), ENOUGH * strip.size(eta_b)))
    out, needed = [], []
    for x, z in places:
        near = _led(strip, eta_b, near, Ends(x0=near.ends.x0, x1=float(x), z1=float(z)))
        needed.append(abs(near.pull) / near.press)
        if needed[-1] > friction:
            near = slipped(strip, eta_b, near, friction)
        out.append(near)
    return out, needed


def slipped(strip: Strip, eta_b: float, state: State, friction: float) -> State:
    """Where a strip comes to rest that is pulled at by more than `friction` times what presses it to the desk."""
    from scipy.optimize import brentq

    way, near = math.copysign(1.0, state.pull), state

    def excess(x0: float) -> float:
        nonlocal near
        near = strip.onwards(near, eta_b, Ends(x0=x0, x1=state.ends.x1, z1=state.ends.z1))
        return way * near.pull - friction * near.press

    held, step = state.ends.x0, FIRST * strip.size(eta_b)
    while excess(held + way * step) > 0:
        held, step = held + way * step, 2 * step
    brentq(excess, held, held + way * step, xtol=EXACT * strip.length)
    return near


def _led(strip: Strip, eta_b: float, near: State, ends: Ends, halvings: int = HALVINGS) -> State:
    """The strip with its end at another place, over half the way where there is no direct one."""
    try:
        return strip.onwards(near, eta_b, ends)
    except ClothbenchError:
        if halvings == 0:
            raise
    half = replace(near.ends.between(ends, 0.5), angle0=0.0)
    return _led(strip, eta_b, _led(strip, eta_b, near, half, halvings - 1), ends, halvings - 1)


def _tolerances(strip: Strip, eta_b: float) -> tuple[float, float]:
    return EXACT * strip.length, ENOUGH * strip.size(eta_b)


def _secant(condition: Condition, first: np.ndarray, near: State, tolerance: float, enough: float) -> State:
    """Where a condition is met, from two coordinates to begin with, each state found from the one before it.

    Contact goes from one control point to the next, so that the tolerance may not be met: what is `enough` will do.
    """
    (a, b), (fa, near) = map(float, first), condition(float(first[0]), near)
    fb, near = condition(b, near)
    for _ in range(TRIES):
        if abs(fb) < tolerance or fa == fb:
            break
        a, b, fa = b, b - fb * (b - a) / (fb - fa), fb
        fb, near = condition(b, near)
    if abs(fb) > enough:
        raise ClothbenchError("kirchhoff_love: no state meets what this part of the path asks for")
    return near
