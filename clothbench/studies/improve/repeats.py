"""Repeated motions: by how much cloth that is moved alike differs, which no model can undercut."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from clothbench.core.observation import Observation
from clothbench.core.statistics import noise_and_share
from clothbench.recordings.nodes import Recording
from clothbench.studies.improve.settings import LOOP

MANY = 1000  # delays looked at together, of which all would not fit into memory
ALWAYS = 0.98  # of the time, in which what stands still stays where it is: a blunder of the sensor is no motion
SCATTER = 5.0  # σ of a coordinate, within which the noisiest of many places stays for so much of the time
AGREE = 0.8  # of what third differences show, as which higher ones show noise as well
ABOUT = 1.2  # times the noise that logs show, which is known about so well, within which they are alike

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
    """By how much [s] the motion comes later in recording b of the same sheet; None if it is another one. The noise of
    the grips' logs, as these show it, is no difference.
    """
    held_alike = len(a.grip_material) and np.array_equal(a.grip_material, b.grip_material)
    if not (held_alike and np.array_equal(seen_a.material, seen_b.material)):
        return None  # nor can a sheet that nobody holds be said to be moved alike
    noise = [grip_noise(one.grip_time, one.grip_position) for one in (a, b)]
    at_rest = still(a.grip_position, noise[0])
    if at_rest and not all(still(s.position, float(np.nan_to_num(s.sigma))) for s in (seen_a, seen_b)):
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
    own = max(LOOP.repeat_distance * size, LOOP.repeat_distance_floor)
    near = float(np.hypot(own, ABOUT * np.hypot(noise[0], noise[1])))
    # Of equal ones the shortest delay: of grips that stand still noise alone would choose one.
    least = int(np.argmax(apart <= near) if at_rest else np.argmin(apart))
    later = a.grip_time + shifts[least]
    both = (later >= b.grip_time[0]) & (later <= b.grip_time[-1])
    if apart[least] > near or (not at_rest and still(a.grip_position[both], noise[0])):
        return None  # grips that are alike only while they stand still were not moved alike
    return float(shifts[least])


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
    """Whether places (T, N, 3) m, NaN where unknown, with a noise of σ m in a coordinate, stay where they are all the
    time: what moves and then rests, or was let go and comes to rest, does not.
    """
    known = position[:, np.isfinite(position).any(axis=0).all(axis=1)]
    if not known.shape[1]:
        return False
    away = np.linalg.norm(known - np.nanmedian(known, axis=0), axis=2)
    farthest = np.nanquantile(away, ALWAYS, axis=0).max(initial=0.0)
    return bool(farthest <= LOOP.repeat_distance_floor + SCATTER * sigma)


def grip_noise(time: np.ndarray, position: np.ndarray) -> float:
    """σ of one coordinate [m] of grips (T, G, 3) m at times (T,) s, as their log shows it; 0 where it is too short, or
    where higher differences show less of it: then it is motion, fast beside the stamps, that passes for noise.
    """
    noise, share = noise_and_share(time, position.reshape(len(time), -1))
    return share * noise if np.isfinite(noise) and share >= AGREE else 0.0
