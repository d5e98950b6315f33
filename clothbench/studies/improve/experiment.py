"""What would tell tied effects apart: recorded motions done otherwise, simulated with either fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clothbench.studies.improve.evidence import Case
from clothbench.studies.improve.fitted import Fitted
from clothbench.studies.improve.problem import Problem

# Times the way and times the speed of a recorded motion, with their words; what a robot that did the one can do.
MOTIONS = {
    (2.0, 1.0): "twice as far", (1.0, 2.0): "twice as fast", (1.0, 0.5): "half as fast",
    (2.0, 0.5): "twice as far, half as fast",
}  # fmt: skip


@dataclass(frozen=True)
class Experiment:
    """A motion by which two fits differ most: `case` moved as `how` says, for so many `seconds`; apart: rms over nodes
    and time, base unit.
    """

    case: str
    how: str
    seconds: float
    apart: float


def parting_experiment(one: tuple[Problem, Fitted], other: tuple[Problem, Fitted]) -> Experiment | None:
    """Of all recorded motions done otherwise the one in which two fits differ most, before either is fitted again; None
    where recordings have no motion that could be done otherwise, or none of it could be simulated.

    Each fit comes with its problem, which holds what is each recording's own of it.
    """
    found = []
    for case in one[0].of_split("fit"):
        for (way, speed), how in MOTIONS.items():
            if (moved := case.moved(way, speed)) is not None:
                apart = float(np.sqrt(np.mean((seen(moved, *one) - seen(moved, *other)) ** 2)))
                found += [Experiment(case.name, how, moved.duration, apart)] if np.isfinite(apart) else []
    return max(found, key=lambda e: e.apart, default=None)


def seen(case: Case, problem: Problem, fitted: Fitted) -> np.ndarray:
    """What the sensor would see of a case with this fit; NaN where it cannot be simulated."""
    (trial,) = problem.restricted(case).trials(fitted.effects, "fit")
    return case.simulated(trial.simulation.run(fitted.theta[None]))
