"""Where and when something is missing: which part of the cloth and which phase of the motion, beside chance.

A part of the cloth is told when more is left there than elsewhere in recording after recording (Student's t of the
logarithm of the ratio over recordings, times the number of parts: Bonferroni). A phase is told when more is left in it
than in the same residual moved round in time (max-statistic over all phases): a residual that is everywhere alike in
time has no phase, however large it is. Frames in which nothing was seen are in none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from clothbench.core.observation import Observation
from clothbench.core.scene import Scene
from clothbench.core.statistics import student_above
from clothbench.studies.improve.law import moved_round
from clothbench.studies.improve.repeats import grip_noise
from clothbench.studies.improve.settings import LOOP

Rows = list[dict[str, Any]]  # of the table `whereabouts`
DOWN, ACROSS = ("upper", "middle", "lower"), ("left", "middle", "right")
MOVES = 0.1  # of the grips' greatest speed: above that they move; and of their speed: above that it changes
PAUSE = 0.3  # s; grips that stand still for longer do not turn, but pause
LEAST_FRAMES = 5  # of a phase in a recording, for it to have a say
SPEED_OVER = 0.1  # s, over which speeds are taken
SURELY = 3.0  # times the speed that noise alone gives grips that stand still: above that they move


def whereabouts(seen: Sequence[tuple[Observation, Scene, np.ndarray]], scale: float, unit: str, seed: int = 0) -> Rows:
    """A row for each part of the cloth and each phase of the motion. seen: of each recording the observation, the scene
    and what a fit leaves (T, N, 3) m, 0 where nothing was seen; scale: how many of `unit` a metre is.
    """
    return where(seen, scale, unit) + when(seen, scale, unit, seed)


def row(kind: str, part: str, square: float, ratio: float, p_value: float, scale: float, unit: str) -> dict[str, Any]:
    return {"kind": kind, "part": part, "rms": scale * float(np.sqrt(square)), "unit": unit, "ratio": float(ratio),
            "p_value": float(p_value)}  # fmt: skip


def where(seen: Sequence[tuple[Observation, Scene, np.ndarray]], scale: float, unit: str) -> Rows:
    """Of the nine parts of the cloth. ratio: of the rms there to that of all of it."""
    squares: dict[str, list[tuple[float, float]]] = {}
    for observation, scene, field in seen:
        place = observation.material / [scene.width, scene.height]
        third = np.minimum((3 * place).astype(int), 2)
        counted = observation.visible * observation.coordinates
        every = np.square(field).sum(axis=2)
        whole = every.sum() / max(counted.sum(), 1)
        for down in range(3):
            for across in range(3):
                mine = (third[:, 1] == down) & (third[:, 0] == across)
                if counted[:, mine].sum() and whole > 0:
                    name = f"{DOWN[down]} {ACROSS[across]}"
                    squares.setdefault(name, []).append((every[:, mine].sum() / counted[:, mine].sum(), whole))
    out = []
    for name, pairs in squares.items():
        part, whole = np.array(pairs).T
        ratio = np.log(np.maximum(part, 1e-300) / whole) / 2
        out.append(row("where", name, part.mean(), np.exp(ratio.mean()), len(squares) * above_zero(ratio), scale, unit))
    return [{**one, "p_value": min(one["p_value"], 1.0)} for one in out]


def above_zero(values: np.ndarray) -> float:
    """p: how often a mean as high comes of values about zero (Student's t, one side)."""
    if len(values) < 2 or values.std() == 0:
        return 1.0
    return float(student_above(values.mean() / values.std(ddof=1) * np.sqrt(len(values)), len(values) - 1))


def when(seen: Sequence[tuple[Observation, Scene, np.ndarray]], scale: float, unit: str, seed: int) -> Rows:
    """Of the phases of the motion. ratio: of the rms in it to that of all of it."""
    some = [observation.visible.any(axis=1) for observation, _, _ in seen]
    series = [per_frame(observation, field)[k] for (observation, _, field), k in zip(seen, some, strict=True)]
    told = [{name: frames[k] for name, frames in phases_of(*one).items()} for one, k in zip(seen, some, strict=True)]
    names = sorted({name for one in told for name, frames in one.items() if frames.sum() >= LEAST_FRAMES})
    if not names:
        return []
    # Of a phase that a recording does not have (grips that stand still have none), no frame is in it.
    phases = [
        {name: one.get(name, np.zeros(len(s), bool)) for name in names} for one, s in zip(told, series, strict=True)
    ]

    def ratios(drawn: Sequence[np.ndarray]) -> np.ndarray:
        out = []
        for name in names:
            mine = [s[p[name]].mean() / s.mean() for s, p in zip(drawn, phases, strict=True)
                    if p[name].sum() >= LEAST_FRAMES and s.mean() > 0]  # fmt: skip
            out.append(float(np.mean(mine)) if mine else 1.0)
        return np.array(out)

    random = np.random.default_rng(seed)
    chance = np.array([ratios([moved_round(s, random) for s in series]) for _ in range(LOOP.permutations)])
    middle, spread = chance.mean(axis=0), np.maximum(chance.std(axis=0), 1e-12)
    found, most = ratios(series), ((chance - middle) / spread).max(axis=1)
    out = []
    for k, name in enumerate(names):
        p_value = (1 + (most >= (found[k] - middle[k]) / spread[k]).sum()) / (1 + len(most))
        square = np.mean([s[p[name]].mean() for s, p in zip(series, phases, strict=True) if p[name].any()])
        out.append(row("when", name, float(square), np.sqrt(found[k]), p_value, scale, unit))
    return out


def per_frame(observation: Observation, field: np.ndarray) -> np.ndarray:
    """(T,) m², mean square of a residual (T, N, 3) over what was seen of each frame."""
    counted = observation.visible.sum(axis=1) * observation.coordinates
    return np.asarray(np.square(field).sum(axis=(1, 2)) / np.maximum(counted, 1))


def phases_of(observation: Observation, scene: Scene, field: np.ndarray) -> Mapping[str, np.ndarray]:
    """Which frames (T,) are in each phase: by what the grips do, and by how fast the cloth moves; in none of the latter
    where that is not known.

    Speeds are the fit's, which is what was measured and `field` (T, N, 3) m together: those of the measured positions
    have the noise of the residual, which would then seem to be larger where the cloth is fast.
    """
    x = np.where(observation.visible[..., None], observation.position + field, np.nan)
    speed = speeds(x, observation.time)
    known = np.isfinite(speed)
    if not known.any():
        return grip_phases(observation.time, scene)
    slow, fast = np.quantile(speed[known], [1 / 3, 2 / 3])
    cloth = {"the cloth is slow": speed <= slow, "the cloth is fast": speed >= fast}
    return grip_phases(observation.time, scene) | cloth


def speeds(x: np.ndarray, time: np.ndarray) -> np.ndarray:
    """(T,) m/s, mean over nodes of positions (T, N, 3) m that are known in neighbouring frames; NaN where none is."""
    jump = np.linalg.norm(np.diff(x, axis=0) / np.diff(time)[:, None, None], axis=2)
    seen = np.isfinite(jump)
    count = seen.sum(axis=1)
    speed = np.where(count > 0, np.where(seen, jump, 0.0).sum(axis=1) / np.maximum(count, 1), np.nan)
    before, after = np.append(np.nan, speed), np.append(speed, np.nan)
    return np.where(np.isnan(before), after, np.where(np.isnan(after), before, (before + after) / 2))


def grip_phases(time: np.ndarray, scene: Scene) -> dict[str, np.ndarray]:
    """Of the grips: before they move, while they speed up, slow down, turn or pause, and after they stopped; none of a
    sheet that nobody holds, and where they never move. Frames in which they move evenly are in none. Noise of the
    grips' log, as this shows it, is no motion: one frame that it gave a speed would be the first or the last to move.
    """
    if not len(scene.grip_material):
        return {}
    every = scene.grip_position.reshape(len(scene.grip_time), -1).T

    def at(when: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(when, scene.grip_time, one) for one in every], axis=1)

    def speed(when: np.ndarray) -> np.ndarray:
        """Rms over the grips: hands that part and meet have a middle that stands still."""
        away = at(when + SPEED_OVER / 2) - at(when - SPEED_OVER / 2)
        return np.sqrt(np.square(away).sum(axis=1) / len(scene.grip_material)) / SPEED_OVER

    now, change = speed(time), speed(time + SPEED_OVER / 2) - speed(time - SPEED_OVER / 2)
    noise = grip_noise(scene.grip_time, scene.grip_position) * np.sqrt(2 * 3) / SPEED_OVER  # two places, three ways
    moving = now > max(MOVES * now.max(), SURELY * noise, 1e-9)
    if not moving.any():
        return {}
    first, last = int(np.argmax(moving)), len(time) - 1 - int(np.argmax(moving[::-1]))
    frame = np.arange(len(time))
    still = ~moving & (frame > first) & (frame < last)
    pause = still & longer_than(PAUSE, time, still)
    return {
        "before the grips move": frame < first, "the grips speed up": moving & (change > MOVES * now),
        "the grips slow down": moving & (change < -MOVES * now), "the grips turn": still & ~pause,
        "the grips pause": pause, "after the grips stopped": frame > last,
    }  # fmt: skip


def longer_than(least: float, time: np.ndarray, frames: np.ndarray) -> np.ndarray:
    """Which frames (T,) are in a stretch of neighbouring `frames` (T,) that lasts longer than `least` s."""
    out = np.zeros(len(time), dtype=bool)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], frames, [False]]).astype(int)))
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        out[begin:end] = time[end - 1] - time[begin] > least
    return out
