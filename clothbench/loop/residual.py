"""Stage 2: how large the residual is beside the noise, where and when it is, and what the mesh has to do with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clothbench.experiment.calibrate import over
from clothbench.loop.attribution import outside
from clothbench.loop.fitting import Fitted
from clothbench.loop.guard import field_of
from clothbench.loop.problem import Case, Problem, residuals

ORDER = 4 / 3  # with half the cells' size, three quarters of a second-order error are gone


def correction(problem: Problem, fitted: Fitted, split: str) -> list[np.ndarray]:
    """What a mesh and step of half the size would change, carried on to the limit (Richardson), (M,) m per recording.

    Added to the coarse model's residual it takes the error of the mesh away where the model converges as the square of
    the cell's size; a third of it is what may be left (`numerical_floor`).
    """
    coarse, fine = problem.trials(fitted.effects, split), problem.finer().trials(fitted.effects, split)
    runs = over([*coarse, *fine], lambda trial: residuals(trial, fitted.theta[None])[0])
    out = []
    for a, b in zip(runs[: len(coarse)], runs[len(coarse) :], strict=True):
        change = b - a
        out.append(ORDER * change if np.isfinite(change).all() else np.zeros_like(change))
    return out


def numerical_floor(fitted: Fitted, corrections: Sequence[np.ndarray]) -> float:
    """What the mesh may still be wrong by [m]: a third of the correction, less what a refit takes up."""
    left = outside(fitted.tangent, (np.concatenate(corrections) * fitted.scale)[:, None])
    return float(np.sqrt(np.square(left).sum() / len(corrections))) / 3


@dataclass(frozen=True)
class Portrait:
    """One recording's residual: rms and its share along the normal, warp and weft [mm]; whiteness, the correlation of
    one frame with the next (0 for noise).
    """

    recording: str
    rms_mm: float
    normal_mm: float
    warp_mm: float
    weft_mm: float
    next_frame: float


def portrait(case: Case, residual: np.ndarray) -> Portrait:
    field = field_of(case, residual)
    seen = case.observation.visible
    frames = directions(case)
    normal, warp, weft = (1e3 * float(np.sqrt(np.mean(np.sum(field * d, axis=-1)[seen] ** 2))) for d in frames)
    both = seen[1:] & seen[:-1]
    product = float(np.mean((field[1:] * field[:-1])[both]))
    square = float(np.mean(residual**2))
    return Portrait(case.name, 1e3 * square**0.5, normal, warp, weft, product / square)


def directions(case: Case) -> list[np.ndarray]:
    """Unit vectors (T, N, 3) along the sheet's normal, warp and weft, from the nodes seen nearest in u and in v."""
    material, position = case.observation.material, case.observation.position
    out = []
    for axis in range(2):
        along = material[:, axis][None] - material[:, axis][:, None]
        beside = np.abs(material[:, 1 - axis][None] - material[:, 1 - axis][:, None])
        cost = np.where(along > 1e-9, along + 10 * beside, np.inf)
        after = np.where(np.isfinite(cost.min(axis=1)), cost.argmin(axis=1), np.arange(len(material)))
        cost = np.where(along < -1e-9, -along + 10 * beside, np.inf)
        before = np.where(np.isfinite(cost.min(axis=1)), cost.argmin(axis=1), np.arange(len(material)))
        out.append(_unit(np.nan_to_num(position[:, after] - position[:, before])))
    warp, weft = out
    normal = _unit(np.cross(warp, weft))
    return [normal, warp, weft]


def _unit(vectors: np.ndarray) -> np.ndarray:
    size = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.divide(vectors, size, out=np.zeros_like(vectors), where=size > 0)
