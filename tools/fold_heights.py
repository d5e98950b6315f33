"""Ten measured fold heights beside what the paper's own η_b predicts, and what could explain the difference.

The table gives each fabric's mean height h, to 1 mm, and η_b = ρ/D, to two digits, that the paper's shell model found
from it. Both are of the same height, so the spread between measurements cancels: only rounding is noise. A fold of an
endless strip without thickness has one length in it, (D/ρg)^⅓, so that h = 0.9066 (1/gη_b)^⅓ (heavy elastica).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clothbench.reference.fabrics import FABRICS
from clothbench.reference.mechanics import G, fold_coefficients

HEIGHTS, ETAS = (np.array([getattr(f, name) for f in FABRICS]) for name in ("height", "eta"))  # m, m⁻⁴·s²
SPREADS = np.array([f.spread for f in FABRICS])
END_HEIGHTS = np.concatenate([HEIGHTS - SPREADS, HEIGHTS + SPREADS])
END_ETAS = np.array([[f.eta_high for f in FABRICS], [f.eta_low for f in FABRICS]]).ravel()
# Heights to 1 mm, and η_b to two digits, a third of whose relative error is the height's.
DIGIT = 10.0 ** (np.floor(np.log10(ETAS)) - 1)
ROUNDING = float(np.sqrt(1e-6 / 12 + np.mean((DIGIT / ETAS * HEIGHTS / 3) ** 2) / 12))


def elastica(eta: np.ndarray) -> np.ndarray:
    """Height [m] of the fold of an endless strip without thickness."""
    return fold_coefficients()[0] * lengths(eta)


def lengths(eta: np.ndarray) -> np.ndarray:
    """(D/ρg)^⅓ [m]."""
    return (1 / (G * eta)) ** (1 / 3)


@functools.cache
def thick_fold(thickness: float) -> float:
    """Height of a fold of cloth `thickness` thick, ground to upper side; both in units of (D/ρg)^⅓.

    As `references.fold_loop`, but it comes down on a layer whose middle is one thickness above the lower one's: the
    loop's invariant is then P at lift-off and −P − t at touch-down, so that P = −t/2.
    """
    from scipy.integrate import solve_ivp
    from scipy.optimize import brentq

    def loop(force: float):
        def slope(s, y):
            across, along = math.sin(y[0]), math.cos(y[0])
            return [y[1], -thickness / 2 * across - (force + s) * along, along, across]

        def turns(s, y):
            return y[1]

        turns.terminal, turns.direction = True, 1.0  # type: ignore[attr-defined]
        e = 1e-4
        start = [-force * e**2 / 2 - e**3 / 6, -force * e - e**2 / 2, e, -force * e**3 / 6]
        return solve_ivp(slope, (e, 20.0), start, events=turns, dense_output=True, rtol=1e-10, atol=1e-12)

    force = brentq(lambda v: loop(v).y[0, -1] - math.pi, -4.3, -3.5, xtol=1e-12)
    found = loop(force)
    return float(found.sol(np.linspace(found.t[0], found.t[-1], 2001))[3].max()) + thickness


def with_thickness(eta: np.ndarray, thickness: float) -> np.ndarray:
    """Heights [m] if all fabrics were `thickness` m thick."""
    unit = lengths(eta)
    return unit * np.array([thick_fold(round(float(t), 6)) for t in thickness / unit])


# What may explain it: columns of the change of height by its amounts, from the heights the elastica predicts.
EXPLANATIONS = {
    "nothing": lambda p: np.zeros((len(p), 0)),
    "offset": lambda p: np.ones((len(p), 1)),
    "scale": lambda p: p[:, None],
    "offset and scale": lambda p: np.stack([np.ones(len(p)), p], axis=1),
}


@dataclass(frozen=True)
class Score:
    """rms [m]: of the ten that it was fitted to; of each fabric when it was left out; of the intervals' ends."""

    fitted: float
    left_out: float
    ends: float


def fitted(name: str, heights: np.ndarray, predicted: np.ndarray) -> np.ndarray:
    """Amounts by least squares: offset m, scale 1."""
    return np.linalg.lstsq(EXPLANATIONS[name](predicted), heights - predicted, rcond=None)[0]


def score(name: str) -> Score:
    predicted, ends = elastica(ETAS), elastica(END_ETAS)

    def left(amounts: np.ndarray, heights: np.ndarray, p: np.ndarray) -> np.ndarray:
        return heights - p - EXPLANATIONS[name](p) @ amounts

    out = []
    for one in range(len(HEIGHTS)):
        rest = np.arange(len(HEIGHTS)) != one
        out.append(left(fitted(name, HEIGHTS[rest], predicted[rest]), HEIGHTS[[one]], predicted[[one]])[0])
    whole = fitted(name, HEIGHTS, predicted)
    return Score(rms(left(whole, HEIGHTS, predicted)), rms(np.array(out)), rms(left(whole, END_HEIGHTS, ends)))


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def thickness_alone(tried: Sequence[float] = (0.0, 2e-4, 5e-4, 1e-3, 2e-3)) -> tuple[float, float]:
    """The one of these thicknesses [m] that fits best if all fabrics had the same, and what it leaves, rms [m]."""
    left = [rms(HEIGHTS - with_thickness(ETAS, t)) for t in tried]
    return tried[int(np.argmin(left))], min(left)


def exponent(draws: int = 10_000) -> tuple[float, float, float]:
    """n of η_b ∝ h⁻ⁿ over the ten, and its 95 % interval if rounding is all that is wrong."""
    random = np.random.default_rng(0)
    heights = HEIGHTS + random.uniform(-5e-4, 5e-4, (draws, len(HEIGHTS)))
    etas = ETAS + DIGIT * random.uniform(-0.5, 0.5, (draws, len(ETAS)))
    x, y = np.log(heights), np.log(etas)
    x, y = x - x.mean(axis=1, keepdims=True), y - y.mean(axis=1, keepdims=True)
    low, high = np.quantile(-(x * y).sum(axis=1) / (x * x).sum(axis=1), [0.025, 0.975])
    return float(-np.polyfit(np.log(HEIGHTS), np.log(ETAS), 1)[0]), float(low), float(high)


def print_table() -> None:
    predicted = elastica(ETAS)
    print("| fabric | η_b | height in the table | elastica | difference |\n|---|---|---|---|---|")
    for fabric, p in zip(FABRICS, predicted, strict=True):
        print(f"| {fabric.name} | {fabric.eta:.2g} | {1e3 * fabric.height:.0f} mm | {1e3 * p:.1f} mm | "
              f"{1e3 * (fabric.height - p):+.1f} mm |")  # fmt: skip
    print(f"\nrounding {1e3 * ROUNDING:.2f} mm; exponent {exponent()}")
    print(f"correlation of difference and height {np.corrcoef(HEIGHTS, HEIGHTS - predicted)[0, 1]:.2f}")
    print("thickness alone [m, rms m]:", thickness_alone())
    chanel = [1e3 * float(with_thickness(ETAS[1:2], t)[0]) for t in (0.0, 1e-3, 2e-3)]
    print("chanel, 0, 1 and 2 mm thick: " + ", ".join(f"{height:.1f} mm" for height in chanel))
    for name in EXPLANATIONS:
        s, amounts = score(name), fitted(name, HEIGHTS, predicted)
        values = ", ".join(f"{1e3 * v:.2f}" for v in (s.fitted, s.left_out, s.ends))
        print(f"{name} {amounts}: fitted, left out, ends {values} mm")
