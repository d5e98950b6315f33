"""How well a fit determines each parameter: perturbations at the solution, and fits repeated from other starts.

Bhat et al. 2003, section 5 (figure 4) and table 2. Its text perturbs by "up to ±0.20%", which is read as a fraction: a
fifth of the value.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from clothbench.core.parameters import ParameterSpace
from clothbench.engine.checkpoint import Checkpoint
from clothbench.estimation.calibrate import Fit, remembered
from clothbench.estimation.trials import Trial

REACH = 0.20  # perturbations go up to ± this share of a parameter's value
ONE_PERCENT = 0.01
AROUND = 0.05  # starts of repeated fits lie within ± this share of the first one's; of the scaled range from 0


def perturbed(space: ParameterSpace, best: np.ndarray, points: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Parameter sets (B, P) with one parameter changed each, which one (B,), and by what share (B,).

    `points` changes each, evenly from −20 % to +20 % without 0; what lies outside the bounds is left out.
    """
    half = REACH * np.arange(1, points // 2 + 1) / (points // 2)
    changes = np.concatenate([-half[::-1], half])
    which, share = (a.ravel() for a in np.meshgrid(np.arange(len(space)), changes, indexing="ij"))
    theta = np.repeat(best[None], len(which), axis=0)
    theta[np.arange(len(which)), which] *= 1 + share
    inside = ((theta >= space.low) & (theta <= space.high)).all(axis=1) & (best[which] != 0)
    return theta[inside], which[inside], share[inside]


def variability(
    trials: Sequence[Trial], space: ParameterSpace, best: np.ndarray, points: int, checkpoint: Checkpoint | None = None
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Per parameter the change [%] that changes the error by 1 %, and the perturbations behind it."""
    theta, which, share = perturbed(space, best, points)
    evaluation = remembered(trials, np.vstack([best[None], theta]), checkpoint)
    base, error = float(evaluation.value[0]), evaluation.value[1:]
    found, behind = [], []
    for i, p in enumerate(space):
        mine = (which == i) & np.isfinite(error)
        percent, slope, curvature, reason = parabola(share[mine], error[mine], base)
        if best[i] == 0:
            reason = "its value is 0, of which there is no share"
        elif base == 0:
            percent, reason = None, "the error is 0, of which there is no percent"
        found.append({
            "name": p.name, "symbol": p.symbol, "unit": p.unit, "value": float(best[i]), "percent": percent,
            "slope": slope, "curvature": curvature, "reason": reason,
        })  # fmt: skip
        pairs = zip(share[mine], error[mine], strict=True)
        behind += [{"name": p.name, "change": float(s), "error": float(e)} for s, e in pairs]
    return found, behind


def parabola(share: np.ndarray, error: np.ndarray, base: float) -> tuple[float | None, float | None, float | None, str]:
    """(percent, slope, curvature, reason) of E(δ) = E₀ + slope δ + ½ curvature δ², through `base` at δ = 0.

    percent: 100 δ for the smallest |δ| at which the parabola has moved by 1 % of `base`, infinite if it never does;
    not known with fewer than two points. Slope and curvature in the error's unit.
    """
    if len(share) < 2:
        return None, None, None, "fewer than two perturbations"
    columns = np.stack([share, share**2 / 2], axis=1)
    slope, curvature = (float(c) for c in np.linalg.lstsq(columns, error - base, rcond=None)[0])
    roots = [
        abs(r.real)
        for step in (ONE_PERCENT * base, -ONE_PERCENT * base)
        for r in np.roots([curvature / 2, slope, -step])
        if abs(r.imag) <= 1e-12 * abs(r)
    ]
    nearest = min((r for r in roots if r > 0), default=math.inf)
    return 100 * nearest, slope, curvature, ""


def repeats(
    trials: Sequence[Trial], space: ParameterSpace, fit: Fit, count: int, seed: int,
    search: Callable[[ParameterSpace, int], Fit], checkpoint: Checkpoint | None = None,
) -> list[dict[str, Any]]:  # fmt: skip
    """The fit and `count` more from starts within ±5 % of its own (table 2); search(space, seed) finds each.

    The start is handed over as the space's defaults. One of 0, of which there is no share, is moved by as much of its
    scaled range.
    """
    begin = space.defaults if fit.start is None else fit.start
    random, rows = np.random.default_rng(seed), []
    for n in range(count + 1):
        share = random.uniform(1 - AROUND, 1 + AROUND, len(begin))
        aside = space.from_unit(1 - np.abs(1 - np.abs(space.to_unit(begin) + share - 1)))  # turned back at a bound
        near = np.where(begin == 0, aside, begin * share)
        start = begin if n == 0 else np.clip(near, space.low, space.high)
        found = search(moved(space, start), seed + n) if n else fit
        first = float(remembered(trials, start[None], checkpoint).value[0])
        rows += [
            {"repeat": n, "name": p.name, "symbol": p.symbol, "unit": p.unit, "start": float(start[i]),
             "value": float(found.best[i]), "error_start": first, "error": found.error, "reason": ""}
            for i, p in enumerate(space)
        ]  # fmt: skip
    return rows


def moved(space: ParameterSpace, start: np.ndarray) -> ParameterSpace:
    """The space with its defaults at `start` (P,)."""
    return ParameterSpace(tuple(dataclasses.replace(p, default=float(s)) for p, s in zip(space, start, strict=True)))
