"""Stage 3: what a small amount of each candidate would change, and which share of the residual only it could explain.

s_e = ∂x/∂φ_e near the effect's null values, by differences; the base parameters' own sensitivities are projected out
of s_e and of the residual, since a refit would take their part.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

from clothbench.experiment.calibrate import over
from clothbench.loop.fitting import Fitted
from clothbench.loop.problem import Problem, digest, residuals
from clothbench.protocols import Effect

SHAPES = 4  # how many settings of an effect's other parameters are looked at (the effect's place, direction, time, …)
AMOUNT = 0.1  # of the range, where an amount has no default of its own


@dataclass(frozen=True, eq=False)
class Probe:
    """One candidate with its shape parameters at some values: phi (P,) at which the columns were measured.

    amounts: numbers of the parameters that were set apart from null, one column each; steps: (k,), by how much.
    columns: per fit recording (M, k) m, the change of the rollout at visible coordinates.
    """

    effect: str
    phi: np.ndarray
    amounts: tuple[int, ...]
    steps: np.ndarray
    columns: list[np.ndarray]


def settings_of(effect: Effect, seed: int) -> Iterator[tuple[np.ndarray, tuple[int, ...], np.ndarray]]:
    """(phi with amounts at null, numbers of the amounts, their steps) for each setting of the other parameters."""
    space = effect.parameters
    amounts = tuple(i for i, p in enumerate(space) if p.null is not None)
    shapes = [i for i, p in enumerate(space) if p.null is None]
    null = null_of(effect)
    away = space.defaults - null
    steps = [away[i] or AMOUNT * (space.high[i] - null[i]) for i in amounts]
    yield null, amounts, np.array(steps)
    if shapes:
        many = SHAPES * (2 if len(shapes) > 2 else 1)
        for point in qmc.Sobol(len(shapes), rng=np.random.default_rng(seed)).random(many):
            unit = space.to_unit(null)
            unit[shapes] = point
            phi = space.from_unit(unit)
            phi[list(amounts)] = null[list(amounts)]
            yield phi, amounts, np.array(steps)


def null_of(effect: Effect) -> np.ndarray:
    """Where the effect vanishes (P,): amounts at null, the others at their defaults."""
    return np.array([p.default if p.null is None else p.null for p in effect.parameters], dtype=float)


def probes(problem: Problem, fitted: Fitted, name: str) -> list[Probe]:
    """All settings of one candidate beside the fitted model."""
    effect = problem.plugins.make("effects", name)
    settings = list(settings_of(effect, problem.seed))
    rows = []
    for phi, amounts, steps in settings:
        for i, step in zip(amounts, steps, strict=True):
            row = phi.copy()
            row[i] += step
            rows.append(row)
    theta = np.hstack([np.tile(fitted.theta, (len(rows), 1)), np.array(rows)])
    changes = changes_of(problem, fitted, name, theta)
    out, at = [], 0
    for phi, amounts, steps in settings:
        columns = [c[at : at + len(amounts)].T for c in changes]
        at += len(amounts)
        if all(np.isfinite(c).all() for c in columns):
            out.append(Probe(name, phi, amounts, steps, columns))
    return out


def changes_of(problem: Problem, fitted: Fitted, name: str, theta: np.ndarray) -> list[np.ndarray]:
    """What the candidate at theta (B, P) changes, (B, M) m for each fit recording; remembered."""
    key = problem.key("probe", fitted.effects, fitted.theta.tolist(), name, digest(theta))
    if (known := problem.memory.recall(key)) is not None:
        return [known[str(k)] for k in range(len(known))]
    runs = over(problem.trials((*fitted.effects, name), "fit"), lambda trial: residuals(trial, theta))
    changes = [run - residual for run, residual in zip(runs, fitted.residual, strict=True)]
    problem.memory.keep(key, **{str(k): change for k, change in enumerate(changes)})
    return changes


def weights(parts: Sequence[np.ndarray]) -> np.ndarray:
    """1/√M of every row, so that each recording has the same say."""
    return np.concatenate([np.full(len(p), len(p) ** -0.5) for p in parts])


def outside(base: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """What of the columns (M, k) no combination of the base's columns (M, P) makes."""
    q, r = np.linalg.qr(base)
    strong = np.abs(np.diag(r)) > 1e-9 * np.abs(r).max()
    q = q[:, strong]
    return columns - q @ (q.T @ columns)
