"""Repeated motions: by how much cloth that is moved alike differs, which no model can undercut."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from clothbench.core.observation import Observation
from clothbench.recordings.nodes import Recording
from clothbench.studies.improve.settings import LOOP

MANY = 1000  # delays looked at together, of which all would not fit into memory

Swing = tuple[Recording, Observation, np.ndarray]  # a recording, what was seen of it, and a residual field (T, N, 3) m


def spread_of_repeats(swings: Sequence[Swing]) -> float:
    """σ of one coordinate [m] by which recordings of one motion differ; 0 where no motion was repeated.

    It is taken of what a fit leaves, which is the model's error in all of them alike, and from frames that fall nearly
    together, since others would have to be interpolated.
    """
    squares, count = 0.0, 0
    for (one, seen_one, field), (other, seen_other, other_field) in combinations(swings, 2):
        shift = delay_of_repeat(one, other, seen_one, seen_other)
        if shift is None:
            continue
        time, there = seen_one.time, seen_other.time - shift
        k = np.clip(np.searchsorted(there, time) - 1, 0, len(there) - 2)
        weight = (time - there[k]) / (there[k + 1] - there[k])
        used = np.minimum(np.abs(weight), np.abs(weight - 1)) <= LOOP.repeat_frame_distance
        k, weight = k[used], weight[used, None, None]
        difference = field[used] - (1 - weight) * other_field[k] - weight * other_field[k + 1]
        seen = seen_one.visible[used] & seen_other.visible[k] & seen_other.visible[k + 1]
        squares += float(np.sum((difference**2 / (1 + weight**2 + (1 - weight) ** 2))[seen]))
        count += seen_one.coordinates * int(seen.sum())
    return (squares / count) ** 0.5 if count else 0.0


def delay_of_repeat(a: Recording, b: Recording, seen_a: Observation, seen_b: Observation) -> float | None:
    """By how much [s] the motion comes later in recording b of the same sheet; None if it is another one."""
    held_alike = len(a.grip_material) and np.array_equal(a.grip_material, b.grip_material)
    if not (held_alike and np.array_equal(seen_a.material, seen_b.material)):
        return None  # nor can a sheet that nobody holds be said to be moved alike
    if still(a.grip_position) and not all(still(s.position, float(np.nan_to_num(s.sigma))) for s in (seen_a, seen_b)):
        return None  # what swings in grips that stand still was let go otherwise
    step = float(np.median(np.diff(a.grip_time)))
    late = np.arange(0.0, (1 - LOOP.repeat_overlap) * min(np.ptp(a.grip_time), np.ptp(b.grip_time)), step)
    delays = np.array(sorted([*late, *-late[1:]], key=abs))
    shifts = delays + b.grip_time[0] - a.grip_time[0]
    every = slice(None, None, max(1, len(a.grip_time) // LOOP.repeat_samples))
    time, here = a.grip_time[every], a.grip_position[every]
    apart = np.concatenate(
        [apart_after(some, time, here, b) for some in np.array_split(shifts, -(-len(shifts) // MANY))]
    )
    size = float(np.mean((here - here.mean(axis=0)) ** 2)) ** 0.5
    least = int(np.argmin(apart))  # of equal ones the shortest delay
    near = max(LOOP.repeat_distance * size, LOOP.repeat_distance_floor)
    return float(shifts[least]) if apart[least] <= near else None


def apart_after(shifts: np.ndarray, time: np.ndarray, here: np.ndarray, other: Recording) -> np.ndarray:
    """(D,) m, rms between grips here (S, G, 3) m at times (S,) s and those of the other recording so many s later,
    (D,), over what both have.
    """
    later = time + shifts[:, None]
    both = (later >= other.grip_time[0]) & (later <= other.grip_time[-1])
    square = np.zeros(later.shape)
    for g in range(here.shape[1]):
        for c in range(3):
            square += (here[:, g, c] - np.interp(later, other.grip_time, other.grip_position[:, g, c])) ** 2
    both &= np.isfinite(square)
    mean = np.where(both, square, 0.0).sum(axis=1) / np.maximum(both.sum(axis=1), 1) / (3 * here.shape[1])
    return np.sqrt(np.where(both.any(axis=1), mean, np.inf))


def still(position: np.ndarray, sigma: float = 0.0) -> bool:
    """Whether places (T, N, 3) m, NaN where unknown, stay where they are in the middle of all times, but for noise."""
    known = position[:, np.isfinite(position).any(axis=0).all(axis=1)]
    away = np.linalg.norm(known - np.nanmedian(known, axis=0), axis=2)
    return bool(np.nanmedian(away) <= LOOP.repeat_distance_floor + 3 * sigma)
