"""Stage 3: what a small amount of each candidate would change, and which share of the residual only it could explain.

s_e is what the rollout gains by some of the effect, in exchange for as much of the base as does the same; the base
parameters' own sensitivities are then projected out of s_e and of the residual, since a refit would take their part.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

from clothbench.core.protocols import Effect
from clothbench.estimation.trials import over
from clothbench.studies.improve.fitting import Fitted
from clothbench.studies.improve.problem import Problem, digest, residuals

SHAPES = 4  # how many settings of an effect's other parameters are looked at (the effect's place, direction, time, …)
AMOUNT = 0.1  # of the range, where an amount has no default of its own
LARGE = 5.0  # times the default amount: folding cloth answers anything small with ripples, which hide it
BEST = 2  # settings of an effect with several shape parameters that are looked at in exchange with the base
MOST = 10.0  # times the amount that was tried, or its inverse
FURTHEST = 0.2  # of the range: how far the base moves to make up for a candidate
RIDGE = 1e-6  # of the squares of all columns


@dataclass(frozen=True, eq=False)
class Probe:
    """One candidate with its shape parameters at some values: phi (P,) with its amounts at null.

    amounts: numbers of the parameters that were set apart from null, one column each; steps: (k,), by how much;
    shifts: (k, base parameters), how far the base moved along in the unit cube; columns: per fit recording (M, k) m,
    what amount and shift together change at visible coordinates.
    """

    effect: str
    phi: np.ndarray
    amounts: tuple[int, ...]
    steps: np.ndarray
    shifts: np.ndarray
    columns: list[np.ndarray]


def settings_of(
    effect: Effect, seed: int, duration: float = np.inf
) -> Iterator[tuple[np.ndarray, tuple[int, ...], np.ndarray]]:
    """(phi with amounts at null, numbers of the amounts, their steps) for each setting of the other parameters: default
    amounts at the default setting, large ones at it and at all others.

    duration: s, of the longest recording; no time after its end is looked at.
    """
    space = effect.parameters
    amounts = tuple(i for i, p in enumerate(space) if p.null is not None)
    shapes = [i for i, p in enumerate(space) if p.null is None]
    null = null_of(effect)
    steps = np.array([space.defaults[i] - null[i] or AMOUNT * (space.high[i] - null[i]) for i in amounts])
    room = np.where(steps > 0, (space.high - null)[[*amounts]], (null - space.low)[[*amounts]])
    large = np.sign(steps) * np.minimum(LARGE * np.abs(steps), room)
    yield null, amounts, steps
    yield null, amounts, large
    if shapes:
        many = SHAPES * (2 if len(shapes) > 1 else 1)
        last = [
            space.to_unit(np.minimum(space.high, duration))[i] if space.parameters[i].unit == "s" else 1.0
            for i in shapes
        ]
        for point in qmc.Sobol(len(shapes), rng=np.random.default_rng(seed)).random(many):
            unit = space.to_unit(null)
            unit[shapes] = point * last
            phi = space.from_unit(unit)
            phi[list(amounts)] = null[list(amounts)]
            yield phi, amounts, large


def null_of(effect: Effect) -> np.ndarray:
    """Where the effect vanishes (P,): amounts at null, the others at their defaults."""
    return np.array([p.default if p.null is None else p.null for p in effect.parameters], dtype=float)


def probes(problem: Problem, fitted: Fitted, name: str) -> tuple[list[Probe], int]:
    """One candidate beside the fitted model, with its shape parameters where they explain most; and how many parameter
    sets that took.

    Twice: alone, in some amounts, at all settings of its shape; then, at the best of these, as much of it as would
    change what is left by its own size, with the base moved so that it makes up for what it can. Drag, say, may have
    passed for damping: only what is left of both after that exchange tells them apart, and the exchange is too far for
    a tangent. In return, what is small may drown in the ripples of folding cloth.
    """
    effect = problem.plugins.make("effects", name)
    duration = max(case.duration for case in problem.of_split("fit"))
    settings = list(settings_of(effect, problem.seed, duration))
    rows = [(phi, i, step) for phi, amounts, steps in settings for i, step in zip(amounts, steps, strict=True)]
    still = np.zeros(len(fitted.theta))
    alone = changes_of(problem, fitted, name, np.array([beside(fitted, still, *row) for row in rows]))
    count, evaluations = len(settings[0][1]), len(rows)
    tangent = [[c[k * count : (k + 1) * count] for c in alone] for k in range(len(settings))]
    chosen = sorted(range(len(settings)), key=lambda k: -share_of(fitted, tangent[k]))
    out = []
    for k in chosen[: BEST if len(settings) > 2 + SHAPES else 1]:
        phi, amounts, steps = settings[k]
        rows = [(phi, i, step) for i, step in zip(amounts, steps, strict=True)]
        exchanges = [exchange(fitted, effect, [c[n] for c in tangent[k]], *row) for n, row in enumerate(rows)]
        theta = [beside(fitted, s, phi, i, step) for (step, s), i in zip(exchanges, amounts, strict=True)]
        exchanged = changes_of(problem, fitted, name, np.array(theta))
        evaluations += len(theta)
        by, shifts = (np.array(each) for each in zip(*exchanges, strict=True))
        for columns, used, shift in ((tangent[k], steps, 0 * shifts), (exchanged, by, shifts)):
            if all(np.isfinite(c).all() for c in columns):
                out.append(Probe(name, phi, amounts, used, shift, [c.T for c in columns]))
    return out, evaluations


def share_of(fitted: Fitted, change: list[np.ndarray]) -> float:
    """Share of what the base leaves that changes, per recording (k, M) m, explain beside it; -1 if they failed."""
    columns = np.hstack(change).T * fitted.scale[:, None]
    if not np.isfinite(columns).all():
        return -1.0
    left = outside(fitted.tangent, np.column_stack([fitted.left, columns]))
    rest = outside(left[:, 1:], left[:, :1]) if np.abs(left[:, 1:]).max() > 0 else left[:, :1]
    return float(1 - np.square(rest).sum() / np.square(left[:, 0]).sum())


def beside(fitted: Fitted, shift: np.ndarray, phi: np.ndarray, amount: int, step: float) -> np.ndarray:
    """The base moved by `shift` in the unit cube, then the effect's phi with one amount set apart by `step`; (P,)."""
    phi = phi.copy()
    phi[amount] += step
    return np.concatenate([moved(fitted, shift), phi])


def moved(fitted: Fitted, shift: np.ndarray) -> np.ndarray:
    """The base parameters after a shift in the unit cube, inside their bounds."""
    if not shift.any():
        return fitted.theta
    return fitted.space.from_unit(np.clip(fitted.space.to_unit(fitted.theta) + shift, 0.0, 1.0))


def exchange(
    fitted: Fitted, effect: Effect, change: list[np.ndarray], phi: np.ndarray, amount: int, step: float
) -> tuple[float, np.ndarray]:
    """How much of the effect, and the shift of the base that makes up for it, from what `step` of it alone changes.

    The amount is the one that changes as much as is left unexplained, with the sign that would explain it.
    """
    seen, left = np.concatenate(change) * fitted.scale, fitted.left
    size = float(np.linalg.norm(seen))
    if not (np.isfinite(size) and size > 0):
        return step, np.zeros(len(fitted.theta))
    factor = float(np.clip(np.linalg.norm(left) / size, 1 / MOST, MOST))
    if outside(fitted.tangent, seen[:, None])[:, 0] @ left > 0:
        factor = -factor
    parameter = effect.parameters.parameters[amount]
    low, high = parameter.bounds
    if not low <= phi[amount] + factor * step <= high:
        factor = abs(factor) if low <= phi[amount] + abs(factor) * step <= high else 1.0
    return factor * step, np.clip(ridge(fitted.tangent, -factor * seen), -FURTHEST, FURTHEST)


def ridge(columns: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Least squares (K,) for columns (M, K), kept small along what hardly changes anything."""
    square = columns.T @ columns
    return np.linalg.solve(square + RIDGE * np.trace(square) * np.eye(len(square)), columns.T @ target)


def changes_of(problem: Problem, fitted: Fitted, name: str, theta: np.ndarray) -> list[np.ndarray]:
    """What the candidate at theta (B, P) changes, (B, M) m for each fit recording; remembered."""
    key = problem.key("probe", fitted.effects, fitted.theta.tolist(), name, digest(theta))
    if (known := problem.memory.recall(key)) is not None:
        return [known[str(k)] for k in range(len(known))]
    runs = over(problem.trials((*fitted.effects, name), "fit"), lambda trial: residuals(trial, theta))
    changes = [run - residual for run, residual in zip(runs, fitted.residual, strict=True)]
    problem.memory.keep(key, **{str(k): change for k, change in enumerate(changes)})
    return changes


def outside(base: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """What of the columns (M, k) no combination of the base's columns (M, P) makes."""
    q, r = np.linalg.qr(base)
    strong = np.abs(np.diag(r)) > 1e-9 * np.abs(r).max()
    q = q[:, strong]
    return columns - q @ (q.T @ columns)
