"""Stage 6: the verdict on the held-out recordings, as `verdict.json` (schema 1)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy.stats import t as student

from clothbench.loop.fitting import Fitted
from clothbench.loop.improve import AT_THE_FLOOR, Outcome
from clothbench.loop.problem import Problem
from clothbench.loop.residual import correction

SCHEMA = 1
EXPLAINED = 0.6  # share of the mean square above the floor that named effects leave at most `1 −` this much of


def held_out_errors(problem: Problem, fitted: Fitted) -> list[float]:
    """rms [mm] of each held-out recording, the mesh's own error taken away as on the fit recordings."""
    plain = dataclasses.replace(problem, corrections={})
    if not plain.of_split("held_out"):
        return []
    changes = correction(plain, fitted, "held_out")
    names = [case.name for case in plain.of_split("held_out")]
    judged = dataclasses.replace(plain, corrections=dict(zip(names, changes, strict=True)))
    out = []
    for trial in judged.trials(fitted.effects, "held_out"):
        out.append(float(trial.metric(trial.observation, trial.simulation.run(fitted.theta[None])).value[0]))
    return out


def pooled(values: Sequence[float]) -> float | None:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else None


def paired_interval(before: Sequence[float], after: Sequence[float]) -> list[float | None]:
    """95 % interval of the mean fall of the error over recordings [mm] (Student's t; wide for few recordings)."""
    fall = np.subtract(before, after)
    if len(fall) < 2:
        return [None, None]
    half = student.ppf(0.975, len(fall) - 1) * fall.std(ddof=1) / np.sqrt(len(fall))
    return [float(fall.mean() - half), float(fall.mean() + half)]


def word(outcome: Outcome) -> str:
    """complete, attributed, tied or unexplained."""
    final, floor = outcome.final, outcome.floor
    assert final is not None
    named = [r for r in outcome.rounds if r.named]
    if not named:
        return "complete" if final.rms <= AT_THE_FLOOR * floor else "unexplained"
    left = (final.rms**2 - floor**2) / max(outcome.base.rms**2 - floor**2, 1e-12)
    if left > 1 - EXPLAINED:
        return "unexplained"
    return "tied" if any(len(r.named) > 1 for r in named) else "attributed"
