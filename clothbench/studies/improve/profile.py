"""Along bent valleys: how far an amount can go if the other parameters make up for it.

A hem twice as heavy and half as wide is nearly the same hem. Where the error has such a valley, the tangent at the fit
leaves it soon: intervals to first order end too early, and a search that creeps along it may stop in a ripple. So each
amount is set apart and the others are fitted again (profile likelihood: Venzon and Moolgavkar 1988, A method for
computing profile-likelihood-based confidence intervals), with the Jacobian that is known and learns from every step
(Broyden 1965).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from clothbench.estimation.trials import Trial, evaluate
from clothbench.studies.improve.fitting import GAIN, Fitted, better_of, freedom, normal_equations, solve
from clothbench.studies.improve.judge import TIED, amounts_of
from clothbench.studies.improve.problem import Problem

Known = tuple[np.ndarray, np.ndarray, np.ndarray]  # a point in the unit cube, the residual there, and its Jacobian

AWAY, FARTHEST = 1.5, 12.0  # times the half-width to be reported: how far each parameter is set apart at first, at last
STEEP = 2.0  # times too much: if the root of the rise is that high at a place, one nearer by is asked for
CORRECTIONS = 5  # Gauss-Newton steps of the others at each of these: too few, and a valley is taken for its wall
GLANCES = 2  # such steps where a leap lands, which is searched from if it is worth it
LEAP, LEAPS = 2.0, 4  # by which factor an amount is changed at once, and how often at most
LANDING = 1  # rounds of the search after each, where a comparison of candidates is all that it is for


@dataclasses.dataclass(frozen=True, eq=False)
class Place:
    """Where an amount was set apart and the others fitted again.

    far: of that amount from the fit; change: of all parameters (P,); both in the unit cube. rise: root of that of the
    mean square [m].
    """

    far: float
    rise: float
    change: np.ndarray


@dataclasses.dataclass(eq=False)
class Walk:
    """One amount on its way up or down a valley; lengths in the unit cube.

    parameter: its place in the space; room: how far its bound is; reach: two intervals' ends to first order, which of
    them is reported last; top: by how much the root of the mean square rises there [m]; tangent: change of all (P,) for
    one of it. own: places of this walk; others: of the other walks, where the error has hardly risen.
    """

    parameter: int
    sign: float
    room: float
    reach: np.ndarray
    top: np.ndarray
    tangent: np.ndarray
    own: list[Place] = dataclasses.field(default_factory=list)
    others: list[Place] = dataclasses.field(default_factory=list)

    def bracket(self, top: float) -> tuple[Place, Place | None]:
        """The last place where the error has not risen by `top`, and the next beyond it, where it has."""
        start = Place(0.0, 0.0, np.zeros(len(self.tangent)))
        within = [start, *(p for p in (*self.own, *self.others) if p.rise < top)]
        last = max(within, key=lambda p: p.far)
        return last, min((p for p in self.own if p.far > last.far), key=lambda p: p.far, default=None)

    def ends(self) -> np.ndarray:
        """(2,) how far the amount can go; between two places the root of the rise is taken to grow evenly."""
        out = self.reach.copy()
        for k, top in enumerate(self.top):
            last, beyond = self.bracket(top)
            end = last.far
            if beyond is not None:
                end += (top - last.rise) / (beyond.rise - last.rise) * (beyond.far - last.far)
            out[k] = max(out[k], end)
        return out

    def next(self) -> np.ndarray | None:
        """Change (P,) of all parameters at the place to be asked for next; None where the end is known."""
        last, beyond = self.bracket(self.top[1])
        half = self.reach[1]
        if beyond is None:
            far = min(max(2 * last.far, AWAY * half), self.room)
            done = last.far >= min(FARTHEST * half, self.room)
        else:
            far = (last.far + beyond.far) / 2
            done = beyond.rise <= STEEP * self.top[1] or beyond.far - last.far <= half
        if done:
            return None
        return far * (last.change / last.far if last.far else self.tangent)


def profiled(problem: Problem, fitted: Fitted) -> tuple[Fitted, Fitted, int]:
    """The fit with wider intervals of its effects' parameters where their valleys are bent, never narrower ones; the
    same with intervals to be reported; and how many parameter sets that took.

    An interval to first order is where the mean square has risen by some amount; here that is how far the parameter
    can go, along its valley, before it really has. What is reported holds every amount that leaves hardly more than the
    best, as much as tells two candidates apart that correct alike; but not "nothing", if the first interval does not.
    """
    space, unit = fitted.space, fitted.space.to_unit(fitted.theta)
    ends = np.array([space.to_unit(end) for end in (fitted.low, fitted.high)])
    null = space.to_unit(np.array([np.nan if p.null is None else p.null for p in space]))
    hessian, _ = normal_equations(fitted.residual, fitted.jacobian)
    free = freedom(hessian, len(fitted.residual))
    walks = [
        walk(hessian, i, (2 * side - 1.0), abs(ends[side, i] - unit[i]), abs(side - unit[i]), free[i], fitted.rms)
        for i in range(len(problem.space(())), len(unit))
        for side in (0, 1)
        if 0.0 < ends[side, i] < 1.0 and ends[side, i] != unit[i] and free[i] > 0
    ]
    if not walks:
        return fitted, fitted, 0
    evaluations = walked(problem, fitted, walks)
    out = [ends, ends.copy()]
    for one in walks:
        narrow, reported = one.ends()
        from_null = one.sign * (null[one.parameter] - unit[one.parameter])  # above 0 where it goes towards nothing
        if narrow < from_null <= reported:
            reported = narrow
        for end, far in zip(out, (narrow, reported), strict=True):
            end[int(one.sign > 0), one.parameter] = np.clip(unit[one.parameter] + one.sign * far, 0.0, 1.0)
    narrow, wide = (
        dataclasses.replace(fitted, low=space.from_unit(low), high=space.from_unit(high)) for low, high in out
    )
    return narrow, wide, evaluations


def walk(hessian: np.ndarray, i: int, sign: float, reach: float, room: float, free: float, rms: float) -> Walk:
    """From a fit with this error [m], along the valley of parameter i, whose interval to first order is `reach`."""
    both = np.array([reach, max(reach, np.sqrt(2 * TIED * rms**2 * free))])
    return Walk(i, sign, room, both, both / np.sqrt(free), sign * along(hessian, i))


def walked(problem: Problem, fitted: Fitted, walks: Sequence[Walk]) -> int:
    """Let each walk come to its end, all of them at once; how many parameter sets that took."""
    trials, unit, evaluations = problem.trials(fitted.effects, "fit"), fitted.space.to_unit(fitted.theta), 0
    while going := [(one, change) for one in walks if (change := one.next()) is not None]:
        which = np.array([one.parameter for one, _ in going])
        where = unit + np.array([change for _, change in going])
        best, found, asked = refitted(trials, fitted, which, where, CORRECTIONS)
        evaluations += asked
        rise = np.sqrt(np.maximum(best - fitted.rms**2, 0.0))
        for (one, change), high, point in zip(going, rise, found, strict=True):
            one.own.append(Place(abs(change[one.parameter]), high, point - unit))
            # Where it has got to without much of a rise is in the others' intervals too, and they go on from there.
            for other in walks:
                far = other.sign * (point - unit)[other.parameter]
                if other is not one and high < other.top[1] and far > 0:
                    other.others.append(Place(far, high, point - unit))
    return evaluations


def leaped(
    problem: Problem, fitted: Fitted, leaps: int = LEAPS, rounds: int = LANDING, worse: float = 0.0
) -> tuple[Fitted, int]:
    """The fit, or a better one on the other side of what its search ended in; and how many parameter sets that took.

    Each amount of the last effect is doubled, and halved, with the others fitted again; where that is better, or by
    no more than the share `worse` of the mean square is not, the search goes on from there for so many `rounds`, if it
    can still come below the fit; and so forth while it pays, `leaps` times at most.
    """
    evaluations = 0
    for _ in range(leaps):
        space, unit = fitted.space, fitted.space.to_unit(fitted.theta)
        hessian, _ = normal_equations(fitted.residual, fitted.jacobian)
        which, where = [], []
        for i in amounts_of(space, fitted.effects[-1]):
            null = space.parameters[i].null
            for factor in (LEAP, 1 / LEAP):
                there = fitted.theta.copy()
                there[i] = np.clip(null + factor * (fitted.theta[i] - null), space.low[i], space.high[i])
                step = space.to_unit(there)[i] - unit[i]
                if step:
                    which.append(i)
                    where.append(unit + step * along(hessian, i))
        if not which:
            break
        trials = problem.trials(fitted.effects, "fit")
        best, found, asked = refitted(trials, fitted, np.array(which), np.array(where), GLANCES)
        evaluations += asked
        before = fitted.rms**2
        for k in np.argsort(best):
            if best[k] <= (1 + worse) * before:
                start = space.from_unit(found[k])
                fitted, count = better_of(problem, fitted, start, rounds, goal=fitted.rms**2)
                evaluations += count
        if fitted.rms**2 >= (1 - GAIN) * before:
            break
    return fitted, evaluations


def refitted(
    trials: list[Trial], fitted: Fitted, which: np.ndarray, where: np.ndarray, corrections: int
) -> tuple[np.ndarray, np.ndarray, int]:
    """At each of `where` (W, P), in the unit cube, parameter `which` (W,) held and the others fitted again, by so many
    `corrections`: the mean squares (W,) m², infinite where nothing could be simulated, the points (W, P), and how many
    sets that took.
    """
    unit, count = fitted.space.to_unit(fitted.theta), len(fitted.residual)
    best, found, evaluations = np.full(len(which), np.inf), np.tile(unit, (len(which), 1)), 0
    known = [(unit, fitted.left / np.sqrt(count), fitted.tangent / np.sqrt(count))] * len(which)
    for correction in range(corrections + 1):
        where = np.clip(where, 0.0, 1.0)
        residual = evaluate(trials, fitted.space.from_unit(where))[0].residual
        assert residual is not None
        evaluations += len(where)
        square = np.sum(residual**2, axis=1)
        better = square < best  # false for what could not be simulated
        best[better], found[better] = square[better], where[better]
        if correction < corrections:
            known = [learned(*one) for one in zip(known, where, residual, strict=True)]
            where = np.array([others_fitted(*one, i) for one, i in zip(known, which, strict=True)])
    return best, found, evaluations


def along(hessian: np.ndarray, i: int) -> np.ndarray:
    """How all parameters (P,) go with parameter i, to first order, if the others stay fitted; 1 for i itself."""
    others = np.arange(len(hessian)) != i
    out = np.ones(len(hessian))
    out[others] = solve(hessian[np.ix_(others, others)], -hessian[others, i])
    return out


def learned(known: Known, where: np.ndarray, residual: np.ndarray) -> Known:
    """What is known of the residual (M,) and its Jacobian (M, P) after it was seen at one more point (P,)."""
    before, left, jacobian = known
    step = where - before
    if not (np.isfinite(residual).all() and step.any()):
        return known
    missed = residual - left - jacobian @ step
    return where, residual, jacobian + np.outer(missed, step / (step @ step))


def others_fitted(where: np.ndarray, residual: np.ndarray, jacobian: np.ndarray, i: int) -> np.ndarray:
    """One Gauss-Newton step (P,) of all parameters but i, which is held."""
    free = np.arange(len(where)) != i
    columns = jacobian[:, free]
    out = where.copy()
    out[free] += solve(columns.T @ columns, -columns.T @ residual)
    return out
