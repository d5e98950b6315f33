"""A strip of cloth in the vertical plane, and how its equilibrium is found without a hand to hold.

From a state that is known to one that is asked for, the fabric is changed in a few stages, each on elements that
crowd where the strip bends. A stage first lets the strip sink a little into the desk: where it lifts off then finds its
place in a few iterations, instead of one for each control point. Where Newton's method fails, half the way is
tried first.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from clothbench import ClothbenchError
from clothbench_models import strip_kernels as kernels
from clothbench_models.splines import DEGREE, Spline

G = 9.81  # m/s²
FREE = math.nan
TOLERANCE = 1e-9  # of the length, Newton's last step
MOST = 60  # Newton iterations before half the way is tried
HALVINGS = 10
REACH = 0.1  # of the length, the longest step of a control point
RATIO = 30.0  # of η_b from one stage to the next: the bending length falls to a third
STIFF = 30.0  # η_b L³ of the strip with which a continuation begins [s²/m]
FEW = 64  # elements of the stages before the last
CROWD = 0.6  # share of the elements that go where the strip bends
HELD = 0.1  # share of them that go to its last end, within about
HAND = 0.5  # bending lengths
SMEAR = 3.0  # bending lengths to either side of a bend that count as bending
SINK = 0.05  # bending lengths that the strip sinks into the desk in the stages before the last

HARDER = (SINK, SINK / 5, SINK / 25)  # tried on the final mesh where it cannot rest on a rigid desk at once


@dataclass(frozen=True)
class Ends:
    """Where the strip's ends are held: x, z [m] and slope angle [rad] of the first and the last; NaN = left free."""

    x0: float = 0.0
    z0: float = 0.0
    angle0: float = 0.0
    x1: float = FREE
    z1: float = FREE
    angle1: float = FREE

    def between(self, other: Ends, share: float) -> Ends:
        """A share of the way from here to `other`; what `other` leaves free is free."""
        pairs = zip(dataclasses.astuple(self), dataclasses.astuple(other), strict=True)
        return Ends(*(a + share * (b - a) for a, b in pairs))


@dataclass(frozen=True, eq=False)
class State:
    """An equilibrium. control (n, 2) m; tension ε/η_m [m²/s²] and moment κ/η_b [m³/s²] at the quadrature points;
    reaction (n, 2) m²/s²: forces per width and areal density at control points that are held or touch.
    """

    spline: Spline
    eta_b: float
    control: np.ndarray
    tension: np.ndarray
    moment: np.ndarray
    reaction: np.ndarray
    iterations: int = 0

    def at(self, u: np.ndarray, derivative: int = 0) -> np.ndarray:
        """Positions (M, 2) m, or derivatives, at material points u (M,) m."""
        functions, first = self.spline.functions(u, derivative), self.spline.element_of(u)
        return np.einsum("mk,mkc->mc", functions, self.control[first[:, None] + np.arange(DEGREE + 1)])

    @property
    def ends(self) -> Ends:
        """Position and slope of both ends as they are, whether held or free; the slope goes on counting past ±π."""
        c = self.control
        slope = np.unwrap(np.arctan2(np.diff(c[:, 1]), np.diff(c[:, 0])))
        return Ends(*map(float, (*c[0], slope[0], *c[-1], slope[-1])))

    @property
    def pull(self) -> float:
        """Horizontal force at the last end [m²/s²], which friction at the desk has to bear."""
        return float(self.reaction[-2:, 0].sum())

    @property
    def press(self) -> float:
        """Force with which the desk carries what lies on it [m²/s²]: all of the weight that the last end does not."""
        return float(self.reaction[:-2, 1].sum())


class Strip:
    """A strip `length` m long over a desk z = 0, if there is one, of cloth of membrane ratio η_m [s²/m²].

    elements: of the final mesh; thickness: m, height of the layer on which the strip's second half comes to lie.
    """

    def __init__(
        self, length: float = 1.0, eta_m: float = 1e-5, elements: int = 200, *, desk: bool = True,
        thickness: float = 0.0, gravity: float = G,
    ):  # fmt: skip
        self.length, self.eta_m, self.elements = length, eta_m, elements
        self.desk, self.thickness, self.gravity = desk, thickness, gravity

    def size(self, eta_b: float) -> float:
        """The bending length (D/ρg)^⅓ [m]."""
        return (self.gravity * eta_b) ** (-1 / 3)

    def flat(self, eta_b: float) -> State:
        """Lying straight on the desk."""
        u = np.array([0.0, self.length])
        return self.guess(eta_b, u, np.stack([u, 0 * u], axis=1))

    def guess(self, eta_b: float, u: np.ndarray, line: np.ndarray) -> State:
        """A first guess that is no equilibrium: the line (M, 2) m through material points u (M,) m, without tension."""
        spline = Spline.even(self.length, self.elements)
        points = np.stack([np.interp(spline.greville, u, line[:, k]) for k in range(2)], axis=1)
        return self._drawn(spline, eta_b, points)

    def equilibrium(self, eta_b: float, ends: Ends, start: State | None = None) -> State:
        """The state with these ends, reached from `start` (None: from the flat strip).

        Raises ClothbenchError where there is no way to it.
        """
        state = self.flat(min(eta_b, STIFF / self.length**3)) if start is None else start
        for ratio in _stages(state.eta_b, eta_b):
            state = self._reach(state, ratio, ends)
        state = self._regraded(self._reach(state, eta_b, ends), self.elements)
        found = self.beside(state, eta_b, ends)
        for sink in HARDER if found is None else ():
            state = self._regraded(self._solved(state, eta_b, ends, sink) or state, self.elements)
            found = found or self.beside(state, eta_b, ends)
        if found is None:
            raise ClothbenchError(f"kirchhoff_love: no equilibrium on the final mesh at η_b = {eta_b:g} m⁻⁴·s²")
        return found

    def beside(self, start: State, eta_b: float, ends: Ends) -> State | None:
        """The state next to a known one, on its mesh; None where it is not that near."""
        return self._solved(start, eta_b, ends, 0.0)

    def onwards(self, start: State, eta_b: float, ends: Ends) -> State:
        """The state next to a known one of the same cloth, on elements that crowd where this one bends.

        Raises ClothbenchError where there is no way to it.
        """
        regraded = self._regraded(start, self.elements)
        return self.beside(regraded, eta_b, ends) or self.equilibrium(eta_b, ends, start)

    def _reach(self, start: State, eta_b: float, ends: Ends, halvings: int = HALVINGS) -> State:
        """A softly resting state from another one on a few elements, over half the way where Newton's method fails."""
        found = self._solved(self._regraded(start, min(FEW, self.elements)), eta_b, ends, SINK)
        if found is not None:
            return found
        if halvings == 0:
            raise ClothbenchError(f"kirchhoff_love: no equilibrium found on the way to η_b = {eta_b:g} m⁻⁴·s²")
        middle = math.sqrt(start.eta_b * eta_b), start.ends.between(ends, 0.5)
        return self._reach(self._reach(start, *middle, halvings - 1), eta_b, ends, halvings - 1)

    def _solved(self, start: State, eta_b: float, ends: Ends, sink: float) -> State | None:
        spline = start.spline
        control, tension, moment = start.control.copy(), start.tension.copy(), start.moment.copy()
        held, target = _bounds(spline, ends)
        reaction = np.zeros((spline.count, 2))
        springs = spline.shares * (self.gravity / (sink * self.size(eta_b)) if sink else 0.0)
        _, d1, d2 = spline.tables
        status, iterations = kernels.equilibrium(
            control, tension, moment, target, held, self._floor(spline), springs, d1, d2, spline.quadrature[1],
            np.stack([0 * spline.shares, -self.gravity * spline.shares], axis=1), self.eta_m, eta_b,
            REACH * self.length, TOLERANCE * self.length, MOST, reaction,
        )  # fmt: skip
        if status != kernels.CONVERGED:
            return None
        return State(spline, eta_b, control, tension, moment, reaction, start.iterations + iterations)

    def _floor(self, spline: Spline) -> np.ndarray:
        if not self.desk:
            return np.full(spline.count, -np.inf)
        return np.where(spline.greville > self.length / 2, self.thickness, 0.0)

    def _regraded(self, state: State, elements: int) -> State:
        """The same shape on a mesh whose elements crowd where it bends."""
        u = np.linspace(0.0, self.length, 16 * elements + 1)
        bent = np.linalg.norm(state.at(u, 2), axis=1)
        wide = int(np.clip(SMEAR * self.size(state.eta_b) / (u[1] - u[0]), 1, len(u) // 4))
        near = np.convolve(np.pad(bent, wide), np.ones(2 * wide + 1), "valid")
        even, total = np.ones_like(u) / self.length, np.trapezoid(near, u)
        # A hand that turns what hangs from it bends it over less than a bending length.
        held = np.exp((u - self.length) / (HAND * self.size(state.eta_b)))
        density = (1 - CROWD - HELD) * even + HELD * held / np.trapezoid(held, u)
        density += CROWD * (even if total < 1e-9 else near / total)
        amount = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2)])
        spline = Spline(np.interp(np.linspace(0.0, amount[-1], elements + 1), amount, u))
        return self._drawn(spline, state.eta_b, state.at(spline.greville), state.iterations)

    def _drawn(self, spline: Spline, eta_b: float, points: np.ndarray, iterations: int = 0) -> State:
        """A shape given by its places at the Greville points, with its moments but no tension.

        Cloth hardly stretches: what tension a change of mesh would make is not the cloth's.
        """
        control = spline.through(points)
        _, d1, d2 = spline.tables
        part = control[np.arange(spline.elements)[:, None] + np.arange(DEGREE + 1)]
        a, b = np.einsum("eqk,ekc->eqc", d1, part), np.einsum("eqk,ekc->eqc", d2, part)
        cross = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
        moment = cross / np.linalg.norm(a, axis=-1) / eta_b
        return State(spline, eta_b, control, np.zeros_like(moment), moment, np.zeros_like(control), iterations)


def _bounds(spline: Spline, ends: Ends) -> tuple[np.ndarray, np.ndarray]:
    """Which coordinates are held, (n, 2), and where (n, 2) m. A slope holds the point next to the end as well."""
    held, target = np.zeros((spline.count, 2), bool), np.zeros((spline.count, 2))
    arms = (spline.greville[1] - spline.greville[0], spline.greville[-2] - spline.greville[-1])
    about = ((0, 1, ends.x0, ends.z0, ends.angle0), (-1, -2, ends.x1, ends.z1, ends.angle1))
    for arm, (here, beside, x, z, angle) in zip(arms, about, strict=True):
        place = np.array([x, z])
        near = place + arm * np.array([math.cos(angle), math.sin(angle)])
        held[here], target[here] = np.isfinite(place), np.nan_to_num(place)
        held[beside], target[beside] = np.isfinite(near), np.nan_to_num(near)
    return held, target


def _stages(start: float, goal: float) -> list[float]:
    """η_b of the stages before the last."""
    count = max(0, math.ceil(math.log(goal / start) / math.log(RATIO)))
    return [start * (goal / start) ** (k / count) for k in range(count)]
