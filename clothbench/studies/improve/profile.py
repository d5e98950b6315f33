"""Profile likelihood: how far an amount can go if the other parameters make up for it.

A hem twice as heavy and half as wide is nearly the same hem. Where the error has such a valley, the tangent at the fit
leaves it soon, and intervals to first order end too early. So each amount is held at one value after the other and the
others are fitted again (Venzon and Moolgavkar 1988, A method for computing profile-likelihood-based confidence
intervals).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from clothbench.studies.improve.constrained import conditional_direction, constrained_fits
from clothbench.studies.improve.fitted import Fitted, inverse_curvature, normal_equations
from clothbench.studies.improve.problem import Problem
from clothbench.studies.improve.settings import LOOP

ROUNDING = 1e-9  # of a distance


@dataclasses.dataclass(frozen=True, eq=False)
class ProfilePoint:
    """Where an amount was held and the others fitted again.

    distance: of that amount from the fit, in the unit cube;
    rise: root of how much higher the mean square is there, base unit;
    change: (P,) of all parameters from the fit, in the unit cube.
    """

    distance: float
    rise: float
    change: np.ndarray


@dataclasses.dataclass(eq=False)
class ProfilePath:
    """The profile of one amount on one side of the fit, point by point; lengths in the unit cube.

    parameter: its number in the space;
    sign: +1 upwards, −1 downwards;
    room: how far its bound is;
    reach: (2,) two intervals' ends to first order, the one that is reported last;
    threshold: (2,) by how much the root of the mean square has risen there, base unit;
    tangent: (P,) change of all parameters for one of it, to first order;
    own: points of this path;
    others: points of other paths where the error has hardly risen.
    """

    parameter: int
    sign: float
    room: float
    reach: np.ndarray
    threshold: np.ndarray
    tangent: np.ndarray
    own: list[ProfilePoint] = dataclasses.field(default_factory=list)
    others: list[ProfilePoint] = dataclasses.field(default_factory=list)

    def bracket(self, threshold: float) -> tuple[ProfilePoint, ProfilePoint | None]:
        """The last point where the error has not risen by `threshold`, and the next beyond it, where it has."""
        start = ProfilePoint(0.0, 0.0, np.zeros(len(self.tangent)))
        within = [start, *(p for p in (*self.own, *self.others) if p.rise < threshold)]
        last = max(within, key=lambda p: p.distance)
        return last, min((p for p in self.own if p.distance > last.distance), key=lambda p: p.distance, default=None)

    def ends(self) -> np.ndarray:
        """(2,) how far the amount can go; between two points the root of the rise is taken to grow evenly."""
        out = self.reach.copy()
        for k, threshold in enumerate(self.threshold):
            last, beyond = self.bracket(threshold)
            end = last.distance
            if beyond is not None:
                end += (threshold - last.rise) / (beyond.rise - last.rise) * (beyond.distance - last.distance)
            out[k] = max(out[k], end)
        return out

    def next(self) -> np.ndarray | None:
        """Change (P,) of all parameters at the point to be asked for next; None where the end is known."""
        last, beyond = self.bracket(self.threshold[1])
        half = self.reach[1]
        if beyond is None:
            distance = min(max(2 * last.distance, LOOP.profile_start * half), self.room)
            # A point at the bound comes back a rounding before it, and would be asked for again for ever.
            done = last.distance >= (1 - ROUNDING) * min(LOOP.profile_end * half, self.room)
        else:
            distance = (last.distance + beyond.distance) / 2
            near = beyond.distance - last.distance <= half
            done = beyond.rise <= LOOP.profile_overshoot * self.threshold[1] or near
        if done:
            return None
        return distance * (last.change / last.distance if last.distance else self.tangent)


def profile_intervals(problem: Problem, fitted: Fitted) -> tuple[Fitted, Fitted, int]:
    """The fit with wider intervals of its effects' parameters where their valleys are bent, never narrower ones; the
    same with intervals to be reported; and how many parameter sets that took.

    An interval to first order is where the mean square has risen by some amount; here that is how far the parameter
    can go, along its valley, before it really has. What is reported holds every amount that leaves hardly more than the
    best, as much as tells two candidates apart that correct alike; but not "nothing", if the first interval does not.
    """
    space, unit = fitted.space, fitted.space.to_unit(fitted.theta)
    ends = np.array([space.to_unit(end) for end in (fitted.low, fitted.high)])
    null = space.to_unit(np.array([np.nan if p.null is None else p.null for p in space]))
    paths = paths_of(fitted, unit, ends, len(problem.space(())))
    if not paths:
        return fitted, fitted, 0
    evaluations = follow(problem, fitted, paths)
    out = [ends, ends.copy()]
    for path in paths:
        narrow, reported = path.ends()
        to_null = path.sign * (null[path.parameter] - unit[path.parameter])  # above 0 where it goes towards nothing
        if narrow < to_null <= reported:
            reported = narrow
        for end, distance in zip(out, (narrow, reported), strict=True):
            end[int(path.sign > 0), path.parameter] = np.clip(unit[path.parameter] + path.sign * distance, 0.0, 1.0)
    narrow, wide = (
        dataclasses.replace(fitted, low=space.from_unit(low), high=space.from_unit(high)) for low, high in out
    )
    return narrow, wide, evaluations


def paths_of(fitted: Fitted, unit: np.ndarray, ends: np.ndarray, base: int) -> list[ProfilePath]:
    """A path for each end of an interval that lies within the bounds, of all parameters but the `base`'s. unit: (P,)
    the fit, ends: (2, P) of the intervals to first order, in the unit cube.
    """
    hessian, _ = normal_equations(fitted.residual, fitted.jacobian)
    free = inverse_curvature(hessian, len(fitted.residual))
    out = []
    for i in range(base, len(unit)):
        for side in (0, 1):
            if not (0.0 < ends[side, i] < 1.0 and ends[side, i] != unit[i] and free[i] > 0):
                continue
            sign, reach = 2 * side - 1.0, abs(ends[side, i] - unit[i])
            both = np.array([reach, max(reach, np.sqrt(2 * LOOP.tie_margin * fitted.rms**2 * free[i]))])
            tangent = sign * conditional_direction(hessian, i)
            out.append(ProfilePath(i, sign, abs(side - unit[i]), both, both / np.sqrt(free[i]), tangent))
    return out


def follow(problem: Problem, fitted: Fitted, paths: Sequence[ProfilePath]) -> int:
    """Let each path come to its end, all of them at once; how many parameter sets that took."""
    trials, unit, evaluations = problem.trials(fitted.effects, "fit"), fitted.space.to_unit(fitted.theta), 0
    while going := [(path, change) for path in paths if (change := path.next()) is not None]:
        which = np.array([path.parameter for path, _ in going])
        where = unit + np.array([change for _, change in going])
        best, found, asked = constrained_fits(trials, fitted, which, where, LOOP.profile_steps)
        evaluations += asked
        rise = np.sqrt(np.maximum(best - fitted.rms**2, 0.0))
        for (path, change), high, point in zip(going, rise, found, strict=True):
            path.own.append(ProfilePoint(abs(change[path.parameter]), high, point - unit))
            # Where it has got to without much of a rise is in the others' intervals too, and they go on from there.
            for other in paths:
                distance = other.sign * (point - unit)[other.parameter]
                if other is not path and high < other.threshold[1] and distance > 0:
                    other.others.append(ProfilePoint(distance, high, point - unit))
    return evaluations
