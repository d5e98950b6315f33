"""The heavy elastica of a strip that is lifted off a desk, and of hanging loops: boundary-value problems. SI.

Balance along the arc s from where the strip leaves the desk, per width and areal density: θ′ = η_b m,
m′ = H sin θ − F cos θ, F′ = g, with slope θ, moment m [m³/s²], horizontal force H and vertical force F [m²/s²] of
what lies beyond. Inextensible; solved by collocation (scipy), the length off the desk as one of the unknowns. It
shares nothing with any model: neither energy nor mesh nor contact.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from clothbench.reference.mechanics import Curve, G

Stiffness = Callable[[np.ndarray], np.ndarray]  # η_b [m⁻⁴·s²] at material points u [m]
START = 0.3  # bending lengths: as high as a barely bent strip may be lifted
GROWTH = 1.6  # of the height, from one solution to the next
HALVINGS = 8
TOLERANCE = 1e-7  # relative, of the collocation's residual


@dataclass(frozen=True, eq=False)
class Lifted:
    """A strip of `length` m whose last end is held at height z: `s` is counted from lift-off, at x = length − off.

    slope, moment, x, z: (n,); off: m, length off the desk; pull, rise: H and F at lift-off [m²/s²].
    """

    length: float
    s: np.ndarray
    slope: np.ndarray
    moment: np.ndarray
    x: np.ndarray
    z: np.ndarray
    pull: float
    rise: float

    @property
    def off(self) -> float:
        return float(self.s[-1])

    @property
    def pose(self) -> tuple[float, float, float]:
        """x, z [m] and slope [rad] of the held end."""
        return float(self.x[-1]), float(self.z[-1]), float(self.slope[-1])

    @property
    def press(self) -> float:
        """Force with which the desk carries the strip [m²/s²]: what lies there, and the edge where it lifts off."""
        return G * (self.length - self.off) - self.rise

    def line(self, u: np.ndarray) -> np.ndarray:
        """Where material points u (M,) m lie, (M, 2) m; splines through the collocation points."""
        from scipy.interpolate import CubicHermiteSpline

        s = np.asarray(u) - (self.length - self.off)
        x, z = (CubicHermiteSpline(self.s, y, d)(np.maximum(s, 0.0)) for y, d in
                ((self.x, np.cos(self.slope)), (self.z, np.sin(self.slope))))  # fmt: skip
        return np.stack([np.where(s > 0, x, u), np.where(s > 0, z, 0.0)], axis=1)


def lift(
    length: float, stiffness: Stiffness, height: float, start: Lifted | None = None, *, tolerance: float = TOLERANCE
) -> Lifted:
    """The last end raised to `height` m without horizontal force or moment: it follows sideways and turns freely."""
    if start is None:
        eta = float(np.mean(stiffness(np.linspace(0, length, 101))))
        first = min(height, START * (G * eta) ** (-1 / 3))
        start = _solved(length, stiffness, (math.nan, first, math.nan), _barely(length, eta, first), tolerance)
    while start.pose[1] < height:
        onwards = min(height, GROWTH * start.pose[1])
        start = _towards(length, stiffness, (math.nan, onwards, math.nan), start, tolerance)
    return start


def hold(
    length: float,
    stiffness: Stiffness,
    pose: tuple[float, float, float],
    start: Lifted,
    *,
    tolerance: float = TOLERANCE,
) -> Lifted:
    """The last end held at a pose x, z [m] and slope [rad], reached from a state near it."""
    return _towards(length, stiffness, pose, start, tolerance)


def _towards(
    length: float, stiffness: Stiffness, pose, start: Lifted, tolerance: float, halvings: int = HALVINGS
) -> Lifted:
    """Over half the way where there is no direct one."""
    try:
        return _solved(length, stiffness, pose, start, tolerance)
    except ArithmeticError:
        if halvings == 0:
            raise
    middle = tuple((a + b) / 2 for a, b in zip(start.pose, pose, strict=True))
    middle = (math.nan, middle[1], math.nan) if math.isnan(pose[0]) else middle
    start = _towards(length, stiffness, middle, start, tolerance, halvings - 1)
    return _towards(length, stiffness, pose, start, tolerance, halvings - 1)


def _barely(length: float, eta: float, height: float) -> Lifted:
    """The barely bent strip z = η_b g (off·s³/6 − s⁴/12)/2 (Euler–Bernoulli), by which z = η_b g off⁴/24 at its end."""
    off = (24 * height / (G * eta)) ** 0.25
    s = np.linspace(0.0, off, 41)
    slope = eta * G * (off * s**2 / 2 - s**3 / 3) / 2
    z = eta * G * (off * s**3 / 6 - s**4 / 12) / 2
    return Lifted(length, s, slope, G * s * (off - s) / 2, length - off + s, z, 0.0, -G * off / 2)


def _solved(length: float, stiffness: Stiffness, pose, start: Lifted, tolerance: float) -> Lifted:
    """Collocation from a first guess; x and slope of the pose NaN: free, and then H = 0 and m = 0 at the end."""
    from scipy.integrate import solve_bvp

    x, z, slope = pose
    free = math.isnan(x)

    def balance(t, y, p):
        off, rise, pull = p[0], p[1], 0.0 if free else p[2]
        s, (sine, cosine) = off * t, (np.sin(y[0]), np.cos(y[0]))
        bent = stiffness(length - off + s) * y[1]
        return off * np.stack([bent, pull * sine - (rise + G * s) * cosine, cosine, sine])

    def ends(a, b, p):
        desk = [a[0], a[1], a[2] - (length - p[0]), a[3]]
        return np.array(desk + ([b[1], b[3] - z] if free else [b[0] - slope, b[2] - x, b[3] - z]))

    unknown = [start.off, start.rise] + ([] if free else [start.pull])
    guess = np.stack([start.slope, start.moment, start.x, start.z])
    found = solve_bvp(balance, ends, start.s / start.off, guess, p=unknown, tol=tolerance, max_nodes=20_000)
    told = f"a strip of {length:g} m with its end at {pose[1]:g} m"
    if found.status != 0:
        raise ArithmeticError(f"{told}: {found.message}")
    if not 0 < found.p[0] < length:
        raise ArithmeticError(f"{told} would leave the desk altogether")
    pull = 0.0 if free else float(found.p[2])
    slope, moment, x, z = found.y
    return Lifted(length, found.p[0] * found.x, slope, moment, x, z, pull, float(found.p[1]))


def hanging_loop(gamma: float, slope: float, turn: float) -> Curve:
    """A strip of length 1 with both ends clamped together at the origin, Γ = ρgL³/D; s, x, z in its lengths.

    slope: rad, of the first end; turn: rad, of the whole loop, of which the half down to the lowest point is solved:
    θ(0) = slope, θ(½) = slope + turn/2, x(½) = 0, and half the weight hangs there on either side. Peirce 1930.
    """
    from scipy.integrate import solve_bvp

    s = np.linspace(0.0, 0.5, 101)
    angle = slope + turn * s
    guess = np.stack([angle, turn + 0 * s, np.cumsum(np.cos(angle)) / 200, np.cumsum(np.sin(angle)) / 200])
    unknown = [0.0]
    for load in np.unique([min(0.1, gamma), *np.geomspace(0.1, max(gamma, 0.1), 12), gamma]):
        if load > gamma:
            continue

        def balance(s, y, p, load=load):
            return np.stack([y[1], p[0] * np.sin(y[0]) - load * (s - 0.5) * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])])

        def ends(a, b, p):
            return np.array([a[0] - slope, a[2], a[3], b[0] - slope - turn / 2, b[2]])

        found = solve_bvp(balance, ends, s, guess, p=unknown, tol=1e-8, max_nodes=50_000)
        if found.status != 0:
            raise ArithmeticError(f"hanging loop at Γ = {load:g}: {found.message}")
        s, guess, unknown = found.x, found.y, found.p
    return Curve(s, guess[0], guess[2], guess[3])
