"""Stage 2: how large the residual is beside the noise, where and when it is, and what the mesh has to do with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.interpolate import interp1d

from clothbench.estimation.trials import over
from clothbench.studies.improve.attribution import outside
from clothbench.studies.improve.curves import CurveCase
from clothbench.studies.improve.fitting import Fitted
from clothbench.studies.improve.guard import field_of
from clothbench.studies.improve.problem import Case, Problem, residuals

ORDER = 4 / 3  # with half the cells' size, three quarters of a second-order error are gone
# Grips that keep this near (share of their motion, m) over this part of the shorter recording repeat a motion.
SAME, STILL, TOGETHER = 0.05, 1e-3, 0.8
SAMPLES = 200  # of a grip's path, to compare it by
NEARLY = 0.1  # of a frame's time: frames of two recordings that lie no farther apart are compared


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


def noise_of(problem: Problem) -> float:
    """σ of one coordinate [m]: as stated, else from how much neighbouring frames jump."""
    found = []
    for case in problem.of_split("fit"):
        sigma = case.observation.sigma
        if not np.isfinite(sigma):
            x = np.where(case.observation.visible[..., None], case.observation.position, np.nan)
            sigma = 1.4826 * float(np.nanmedian(np.abs(np.diff(x, n=3, axis=0)))) / np.sqrt(20)
        found.append(sigma)
    return float(np.sqrt(np.mean(np.square(found))))


def repeat_spread(problem: Problem, fitted: Fitted) -> float:
    """σ of one coordinate [m] by which fit recordings of one motion differ; 0 where no motion was repeated.

    It is taken of what the fit leaves, which is the model's error in all of them alike, and from frames that fall
    nearly together, since others would have to be interpolated.
    """
    cases, squares, count = problem.of_split("fit"), 0.0, 0
    for a, b in combinations(range(len(cases)), 2):
        shift = repeated(cases[a], cases[b])
        if shift is None:
            continue
        time, other = cases[a].observation.time, cases[b].observation.time - shift
        k = np.clip(np.searchsorted(other, time) - 1, 0, len(other) - 2)
        weight = (time - other[k]) / (other[k + 1] - other[k])
        used = np.minimum(np.abs(weight), np.abs(weight - 1)) <= NEARLY
        k, weight = k[used], weight[used, None, None]
        left, right = field_of(cases[a], fitted.residual[a])[used], field_of(cases[b], fitted.residual[b])
        difference = left - (1 - weight) * right[k] - weight * right[k + 1]
        seen = cases[b].observation.visible
        seen = cases[a].observation.visible[used] & seen[k] & seen[k + 1]
        squares += float(np.sum((difference**2 / (1 + weight**2 + (1 - weight) ** 2))[seen]))
        count += 3 * int(seen.sum())
    return (squares / count) ** 0.5 if count else 0.0


def repeated(one: Case, other: Case) -> float | None:
    """By how much [s] the motion comes later in the other recording of the same sheet; None if it is another one."""
    if isinstance(one, CurveCase):
        return None  # its floor is the spread already
    a, b = one.recording, other.recording
    held_alike = len(a.grip_material) and np.array_equal(a.grip_material, b.grip_material)
    if not (held_alike and np.array_equal(one.observation.material, other.observation.material)):
        return None  # nor can a sheet that nobody holds be said to be moved alike
    step = float(np.median(np.diff(a.grip_time)))
    late = np.arange(0.0, (1 - TOGETHER) * min(np.ptp(a.grip_time), np.ptp(b.grip_time)), step)
    shifts = np.concatenate([-late[:0:-1], late]) + b.grip_time[0] - a.grip_time[0]
    every = slice(None, None, max(1, len(a.grip_time) // SAMPLES))
    time, here = a.grip_time[every], a.grip_position[every]
    there = interp1d(b.grip_time, b.grip_position, axis=0, bounds_error=False)
    apart = [float(np.nanmean((here - there(time + shift)) ** 2)) ** 0.5 for shift in shifts]
    size = float(np.mean((here - here.mean(axis=0)) ** 2)) ** 0.5
    least = int(np.argmin(apart))
    return float(shifts[least]) if apart[least] <= max(SAME * size, STILL) else None


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
