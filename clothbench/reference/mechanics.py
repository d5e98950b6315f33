"""What textbooks say: closed formulas, and the two heavy elasticas that need a computer. SI; one line per width.

D: bending rigidity N·m; ρ: areal density kg/m²; g: m/s²; L: length m; Γ = ρgL³/D, weight over bending stiffness.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np

G = 9.81  # m/s²
BESSEL_ZERO = 2.404825557695773  # first zero of J₀


@dataclass(frozen=True, eq=False)
class Curve:
    """A bent line in a vertical plane: arc length s, slope angle [rad], x along and z up; all (n,), one unit."""

    s: np.ndarray
    angle: np.ndarray
    x: np.ndarray
    z: np.ndarray


# --- heavy elastica -------------------------------------------------------------------------------------------------


@functools.cache
def cantilever(gamma: float) -> Curve:
    """A strip of length 1 held level at s = 0, bent by its own weight: θ″ = −Γ (1 − s) cos θ, θ(0) = θ′(1) = 0.

    θ is the slope below the horizontal, here with its sign turned so that z points up. Solved by collocation, from
    small loads up. Bickley 1934, The heavy elastica.
    """
    from scipy.integrate import solve_bvp

    loads = [*(10.0 ** np.arange(0, math.log10(max(gamma, 1.0)), 0.25)), gamma]
    s = np.linspace(0.0, 1.0, 101)
    state = np.stack([loads[0] / 6 * (1 - (1 - s) ** 3), loads[0] / 2 * (1 - s) ** 2, s, 0 * s])
    for load in loads:

        def slope(s, y, load=load):
            return np.stack([y[1], -load * (1 - s) * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])])

        found = solve_bvp(slope, lambda a, b: np.array([a[0], a[2], a[3], b[1]]), s, state, tol=1e-9, max_nodes=100_000)
        if found.status != 0:
            raise ArithmeticError(f"heavy elastica at Γ = {load:g}: {found.message}")
        s, state = found.x, found.y
    fine = np.linspace(0.0, 1.0, 401)
    angle, _, x, z = found.sol(fine)
    return Curve(fine, -angle, x, -z)


def drop_over_reach(gamma: float) -> float:
    """H/W of a cantilever: how far its tip hangs below the clamp over how far it reaches out; Γ/8 for small Γ."""
    curve = cantilever(gamma)
    return float(-curve.z[-1] / curve.x[-1])


def small_sag(gamma: float) -> float:
    """Tip sag over length of a barely bent cantilever, Γ/8 (Euler–Bernoulli); 3e-5 too much at Γ = 0.05."""
    return gamma / 8


@functools.cache
def fold_loop() -> Curve:
    """The loop of a strip folded back on itself, lengths in units of (D/ρg)^⅓: height 0.9066, length 4.683.

    D θ″ = P sin θ − (V + ρg s) cos θ with the forces P along and V up at lift-off (s = 0), where the strip leaves
    the ground: θ = θ′ = z = 0, for a flat strip carries no moment. It comes down, on the ground or on the layer
    that lies there without thickness, with θ = π, θ′ = z = 0. Along the loop D θ′²/2 − ρg z + P cos θ + (V + ρg s)
    sin θ stays the same; it is P at lift-off and −P at touch-down, so that P = 0: nothing has to hold the fold
    together, no friction takes part, and z = 0 at touch-down follows. What is left is one number, V, found by
    shooting: the slope at its first minimum has to be π. (There are further, curled-up solutions of larger height.)
    """
    from scipy.optimize import brentq

    force = brentq(lambda v: _loop(v).y[0, -1] - math.pi, -3.8, -3.7, xtol=1e-13)
    found = _loop(force)
    s = np.linspace(found.t[0], found.t[-1], 801)
    angle, _, x, z = found.sol(s)
    return Curve(s, angle, x, z)


def _loop(force: float):
    """The line that leaves the ground under the vertical force V [in (D(ρg)²)^⅓], up to its first least slope."""
    from scipy.integrate import solve_ivp

    def slope(s, y):
        return [y[1], -(force + s) * math.cos(y[0]), math.cos(y[0]), math.sin(y[0])]

    def turns(s, y):
        return y[1]

    turns.terminal, turns.direction = True, 1.0  # type: ignore[attr-defined]
    e = 1e-4  # just off the start, where θ′ = 0 as well
    start = [-force * e**2 / 2 - e**3 / 6, -force * e - e**2 / 2, e, -force * e**3 / 6]
    return solve_ivp(slope, (e, 20.0), start, events=turns, dense_output=True, rtol=1e-11, atol=1e-13)


@functools.cache
def fold_coefficients() -> tuple[float, float]:
    """Height and length of the fold's loop over (D/ρg)^⅓."""
    from scipy.interpolate import CubicSpline

    loop = fold_loop()
    peaks = CubicSpline(loop.s, loop.z).derivative().roots(extrapolate=False)
    return float(CubicSpline(loop.s, loop.z)(peaks).max()), float(loop.s[-1])


def bending_length(bending: float, areal_density: float) -> float:
    """(D/ρg)^⅓ [m]."""
    return (bending / (areal_density * G)) ** (1 / 3)


def eta_of_fold(height: float, coefficient: float) -> float:
    """η_b = ρ/D [m⁻⁴·s²] from a fold's height h [m] = c (D/ρg)^⅓: c³/(g h³)."""
    return coefficient**3 / (G * height**3)


# --- motion ---------------------------------------------------------------------------------------------------------


def swing_period(length: float, extra: float = 0.0) -> float:
    """Period [s] of the lowest small swing of a hanging flexible sheet, ω₁ = (z₁/2) √(g/L) (D. Bernoulli 1733).

    extra: air carried along over the sheet's mass, m_a/ρ: it is accelerated but weighs nothing, ω₁/√(1 + m_a/ρ).
    """
    omega = BESSEL_ZERO / 2 * math.sqrt(G / length)
    return 2 * math.pi / omega * math.sqrt(1 + extra)


def fall(time: float) -> float:
    """How far a body falls from rest in vacuum [m]."""
    return G * time**2 / 2


def terminal_speed(areal_density: float, air_density: float, coefficient: float) -> float:
    """Speed [m/s] at which pressure drag carries a sheet that falls flat, √(2ρg/(ρ_air C_N))."""
    return math.sqrt(2 * areal_density * G / (air_density * coefficient))


# --- catenary -------------------------------------------------------------------------------------------------------


def catenary_sag(length: float, span: float, weight: float, stiffness: float = math.inf) -> float:
    """How far the middle of a perfectly flexible strip hangs below its two supports [m].

    length: m, unstretched; span: m; weight: ρg [N/m²]; stiffness: tensile, N/m (inf: the common catenary). With the
    horizontal pull H [N/m] and a = wS/2H: X = (2H/w) asinh a + HS/K, sag = (H/w) (√(1 + a²) − 1) + wS²/8K.
    Irvine 1981, Cable Structures, section 1.4.
    """
    from scipy.optimize import brentq

    def excess(log_pull: float) -> float:
        pull = math.exp(log_pull)
        return 2 * pull / weight * math.asinh(weight * length / (2 * pull)) + pull * length / stiffness - span

    if stiffness == math.inf and span >= length:
        raise ValueError("an inextensible strip cannot span more than its length")
    pull = math.exp(brentq(excess, math.log(1e-9 * weight * length), math.log(1e9 * weight * length), xtol=1e-14))
    a = weight * length / (2 * pull)
    return pull / weight * (math.sqrt(1 + a**2) - 1) + weight * length**2 / (8 * stiffness)


def clamped_annulus_sag(inner: float, outer: float, load: float, poisson: float = 0.0) -> float:
    """How far the rim of a flat ring sags under its own weight, clamped at `inner` m and free at `outer` m, where it
    sags by little [m]. load: weight per area over bending rigidity [1/m³]; poisson: ratio of cross
    contraction in bending.

    Timoshenko and Woinowsky-Krieger 1959, Theory of Plates and Shells, section 17: w = q r⁴/64D + c₀ + c₁ r² + c₂ ln r
    + c₃ r² ln r with w = w' = 0 at the clamp, and neither moment nor shear at the rim.
    """
    a, b = inner, outer
    rows = np.array(
        [
            [1.0, a**2, np.log(a), a**2 * np.log(a)],
            [0.0, 2 * a, 1 / a, 2 * a * np.log(a) + a],
            [  # w'' + ν w'/r = 0
                0.0,
                2.0 + 2.0 * poisson,
                (poisson - 1.0) / b**2,
                2 * np.log(b) + 3.0 + poisson * (2 * np.log(b) + 1.0),
            ],
            [0.0, 0.0, 0.0, 4 / b],  # (∇²w)' = 0
        ]
    )
    right = -load * np.array([a**4 / 64, a**3 / 16, (3.0 + poisson) * b**2 / 16, b / 2])
    constant = np.linalg.solve(rows, right)
    return float(load * b**4 / 64 + constant @ np.array([1.0, b**2, np.log(b), b**2 * np.log(b)]))
