"""Stage 3: what a small amount of each candidate would change, and which share of the residual only it could explain.

An effect's parameters are of two sorts: amounts, by which it vanishes at their null values, and shapes (its place,
direction, time, …), which have none.

s_e is what the rollout gains by some of the effect, in exchange for as much of the base as does the same; the base
parameters' own sensitivities are then projected out of s_e and of the residual, since a refit would take their part.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from clothbench.core.parameters import ParameterSpace
from clothbench.core.statistics import sobol
from clothbench.estimation.trials import Trial, over
from clothbench.studies.improve.fitted import Fitted
from clothbench.studies.improve.problem import Problem, array_digest, residuals
from clothbench.studies.improve.settings import LOOP

Setting = tuple[np.ndarray, tuple[int, ...], np.ndarray]  # an effect's phi, numbers of its amounts, their steps


@dataclass(frozen=True, eq=False)
class Probe:
    """One candidate with its shape parameters at some values.

    effect: its name;
    phi: (Q,) its parameters, amounts at null;
    amounts: numbers of the k parameters that were set apart from null, one column each;
    steps: (k,), by how much, each in its parameter's unit;
    shifts: (k, P), how far the base's parameters moved along, in the unit cube;
    columns: per fit recording (M, k), base unit, what amount and shift together change of the rollout.
    """

    effect: str
    phi: np.ndarray
    amounts: tuple[int, ...]
    steps: np.ndarray
    shifts: np.ndarray
    columns: list[np.ndarray]


def shape_settings(space: ParameterSpace, seed: int, last: float = np.inf) -> Iterator[Setting]:
    """(phi with amounts at null, numbers of the amounts, their steps) for each setting of an effect's shape parameters:
    default amounts at the default setting, large ones at it and at all others.

    last: s, the moment at which the longest recording ends; no time after that is looked at.
    """
    amounts = tuple(i for i, p in enumerate(space) if p.null is not None)
    shapes = [i for i, p in enumerate(space) if p.null is None]
    null = null_point(space)
    steps = np.array([space.defaults[i] - null[i] or LOOP.default_step * side_of(space, null, i) for i in amounts])
    room = np.where(steps > 0, (space.high - null)[[*amounts]], (null - space.low)[[*amounts]])
    large = np.sign(steps) * np.minimum(LOOP.large_step * np.abs(steps), room)
    yield null, amounts, steps
    yield null, amounts, large
    if shapes:
        many = LOOP.shape_settings * (2 if len(shapes) > 1 else 1)
        ends = space.to_unit(np.clip(last, space.low, space.high))
        most = [ends[i] if space.parameters[i].unit == "s" else 1.0 for i in shapes]
        for point in sobol(len(shapes), np.random.default_rng(seed), many):
            unit = space.to_unit(null)
            unit[shapes] = point * most
            phi = space.from_unit(unit)
            phi[list(amounts)] = null[list(amounts)]
            yield phi, amounts, large


def side_of(space: ParameterSpace, null: np.ndarray, amount: int) -> float:
    """How far an amount can go from null, above it or, where its bounds end there, below it."""
    return float(space.high[amount] - null[amount] or space.low[amount] - null[amount])


def null_point(space: ParameterSpace) -> np.ndarray:
    """Where an effect vanishes (Q,): amounts at null, the others at their defaults."""
    return np.array([p.default if p.null is None else p.null for p in space], dtype=float)


def probe_candidate(problem: Problem, fitted: Fitted, name: str) -> tuple[list[Probe], int]:
    """One candidate beside the fitted model, with its shape parameters where they explain most; and how many parameter
    sets that took.

    Twice: alone, in some amounts, at all settings of its shape; then, at the best of these, as much of it as would
    change what is left by its own size, with the base moved so that it makes up for what it can. Drag, say, may have
    passed for damping: only what is left of both after that exchange tells them apart, and the exchange is too far for
    a tangent. In return, what is small may drown in the ripples of wrinkling cloth.
    """
    space, out = problem.space_of(name), []
    chosen, evaluations = best_settings(problem, fitted, name)
    for (phi, amounts, steps), tangent in zip(chosen, tangents(problem, fitted, name, chosen), strict=True):
        evaluations += len(amounts)
        rows = [(phi, i, step) for i, step in zip(amounts, steps, strict=True)]
        exchanges = [exchange(fitted, space, [c[n] for c in tangent], *row) for n, row in enumerate(rows)]
        theta = [with_effect(fitted, s, phi, i, step) for (step, s), i in zip(exchanges, amounts, strict=True)]
        exchanged = response(problem, fitted, name, np.array(theta))
        evaluations += len(theta)
        by, shifts = (np.array(each) for each in zip(*exchanges, strict=True))
        for columns, used, shift in ((tangent, steps, 0 * shifts), (exchanged, by, shifts)):
            if all(np.isfinite(c).all() for c in columns):
                out.append(Probe(name, phi, amounts, used, shift, [c.T for c in columns]))
    return out, evaluations


def best_settings(problem: Problem, fitted: Fitted, name: str) -> tuple[list[Setting], int]:
    """The settings of an effect's shape at which its amounts alone explain most; and how many parameter sets that took.

    Looked for on the recordings that leave most: where an effect is worth a fit, they show at which shape.
    """
    settings = shapes_looked_at(problem, name)
    where = np.argsort(-fitted.mean_squares)[: LOOP.scouts].tolist()
    some = fitted.on(where)
    share = [explained_share(some, change) for change in tangents(problem, fitted, name, settings, where)]
    count = LOOP.exchanged_settings if len(settings) > 2 + LOOP.shape_settings else 1
    best = sorted(range(len(settings)), key=lambda k: -share[k])[:count]
    sets = sum(len(amounts) for _, amounts, _ in settings)
    return [settings[k] for k in best], -(-sets * len(where) // len(fitted.residual))


def shapes_looked_at(problem: Problem, name: str) -> list[Setting]:
    """The settings of an effect's shape that are looked at."""
    last = max(case.last_moment for case in problem.of_split("fit"))
    return list(shape_settings(problem.space_of(name), problem.seed, last))


def tangents(
    problem: Problem, fitted: Fitted, name: str, settings: Sequence[Setting], where: Sequence[int] | None = None
) -> list[list[np.ndarray]]:
    """What an effect's amounts alone change of the rollout at each of the settings of its shape, (k, M) for each fit
    recording, or for those of the numbers `where`; kept for each setting and recording.
    """
    trials, still = problem.trials((*fitted.effects, name), "fit"), np.zeros(len(fitted.theta))
    numbers = range(len(trials)) if where is None else where
    theta = [
        np.array([with_effect(fitted, still, phi, i, step) for i, step in zip(amounts, steps, strict=True)])
        for phi, amounts, steps in settings
    ]
    question = ["tangent", fitted.effects, fitted.theta.tolist(), name]
    keys = {r: [problem.key(*question, array_digest(sets), r) for sets in theta] for r in numbers}
    kept = {r: [problem.checkpoint.recall(key) for key in keys[r]] for r in numbers}
    change = {r: {k: found["change"] for k, found in enumerate(kept[r]) if found is not None} for r in numbers}
    new = {r: [k for k in range(len(theta)) if k not in change[r]] for r in numbers}
    asked = {id(trials[r]): r for r in numbers if new[r]}

    def simulated(trial: Trial) -> list[np.ndarray]:
        r = asked[id(trial)]
        return np.split(residuals(trial, np.concatenate([theta[k] for k in new[r]])) - fitted.residual[r], len(new[r]))

    for r, found in zip(asked.values(), over([trials[r] for r in asked.values()], simulated), strict=True):
        for k, changed in zip(new[r], found, strict=True):
            change[r][k] = changed
            problem.checkpoint.keep(keys[r][k], change=changed)
    return [[change[r][k] for r in numbers] for k in range(len(settings))]


def explained_share(fitted: Fitted, change: list[np.ndarray]) -> float:
    """Share of the variance that the base leaves which changes, per recording (k, M), explain beside it; -1 if they
    failed.
    """
    columns = np.hstack(change).T * fitted.weights[:, None]
    if not np.isfinite(columns).all():
        return -1.0
    out = projected_out(fitted.weighted_jacobian, np.column_stack([fitted.weighted_residual, columns]))
    residual, columns = out[:, :1], out[:, 1:]
    rest = projected_out(columns, residual) if np.abs(columns).max() > 0 else residual
    return float(1 - np.square(rest).sum() / np.square(residual).sum())


def with_effect(fitted: Fitted, shift: np.ndarray, phi: np.ndarray, amount: int, step: float) -> np.ndarray:
    """The base moved by `shift` in the unit cube, then the effect's phi with one amount set apart by `step`; (P,)."""
    phi = phi.copy()
    phi[amount] += step
    return np.concatenate([shifted(fitted, shift), phi])


def shifted(fitted: Fitted, shift: np.ndarray) -> np.ndarray:
    """The base parameters after a shift in the unit cube, inside their bounds."""
    if not shift.any():
        return fitted.theta
    return fitted.space.from_unit(np.clip(fitted.space.to_unit(fitted.theta) + shift, 0.0, 1.0))


def exchange(
    fitted: Fitted, space: ParameterSpace, change: list[np.ndarray], phi: np.ndarray, amount: int, step: float
) -> tuple[float, np.ndarray]:
    """How much of the effect, and the shift of the base that makes up for it, from what `step` of it alone changes.

    The amount is the one that changes as much as is left unexplained, with the sign that would explain it.
    """
    seen, residual = np.concatenate(change) * fitted.weights, fitted.weighted_residual
    size = float(np.linalg.norm(seen))
    if not (np.isfinite(size) and size > 0):
        return step, np.zeros(len(fitted.theta))
    factor = float(np.clip(np.linalg.norm(residual) / size, 1 / LOOP.exchange_factor, LOOP.exchange_factor))
    if projected_out(fitted.weighted_jacobian, seen[:, None])[:, 0] @ residual > 0:
        factor = -factor
    low, high = space.parameters[amount].bounds
    if not low <= phi[amount] + factor * step <= high:
        factor = abs(factor) if low <= phi[amount] + abs(factor) * step <= high else 1.0
    shift = ridge_solution(fitted.weighted_jacobian, -factor * seen)
    return factor * step, np.clip(shift, -LOOP.exchange_shift, LOOP.exchange_shift)


def ridge_solution(columns: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Least squares (K,) for columns (M, K), kept small along what hardly changes anything."""
    square = columns.T @ columns
    return np.linalg.solve(square + LOOP.ridge * np.trace(square) * np.eye(len(square)), columns.T @ target)


def response(problem: Problem, fitted: Fitted, name: str, theta: np.ndarray) -> list[np.ndarray]:
    """What the candidate at theta (B, P) changes of the rollout, (B, M) for each fit recording; kept."""
    key = problem.key("probe", fitted.effects, fitted.theta.tolist(), name, array_digest(theta))
    if (known := problem.checkpoint.recall(key)) is not None:
        return [known[str(k)] for k in range(len(known))]
    runs = over(problem.trials((*fitted.effects, name), "fit"), lambda trial: residuals(trial, theta))
    changes = [run - residual for run, residual in zip(runs, fitted.residual, strict=True)]
    problem.checkpoint.keep(key, **{str(k): change for k, change in enumerate(changes)})
    return changes


def projected_out(base: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """The columns (M, k) less their projection on the span of the base's columns (M, P)."""
    q, r = np.linalg.qr(base)
    strong = np.abs(np.diag(r)) > 1e-9 * np.abs(r).max()
    q = q[:, strong]
    return columns - q @ (q.T @ columns)
