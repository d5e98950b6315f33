"""`least_squares`: batched Levenberg–Marquardt, the modern yardstick beside the papers' searches."""

from __future__ import annotations

from collections.abc import Generator

import numpy as np

from clothbench import ClothbenchError, Evaluation, ParameterSpace
from clothbench_optimizers.search import GeneratorSearch, Steps, check_between, check_whole, spread

Walk = Generator[np.ndarray, Evaluation, np.ndarray]  # returns which parameters (P,) could not be moved at its end
Differences = Generator[np.ndarray, Evaluation, tuple[np.ndarray, np.ndarray]]
LONGEST = 0.5  # of the scaled range that a difference may reach, since there is room for it to one side or the other
DAMPINGS = np.array([0.1, 1.0, 10.0, 100.0])  # tried at once, in units of the current damping


class LeastSquares(GeneratorSearch):
    """Gauss–Newton steps with Marquardt's damping in the scaled space (Marquardt 1963), on batches.

    starts: points of a scrambled Sobol sequence (the defaults are one more); walks: from how many of the best of them
    to walk, one after the other; difference: step of the forward differences, in units of the scaled range, long enough
    to look over the ripples that folding cloth leaves in the error; tolerance: relative gain in the sum of squares
    below which so many rounds in a row, `patience`, end a walk. Each round simulates the Jacobian's points as one
    batch, where the last one gained more than that, then four dampings as another.
    """

    name = "least_squares"
    version = 3
    needs_residual = True

    def __init__(
        self, space: ParameterSpace, *, seed: int, budget: int,
        starts: int = 31, walks: int = 2, difference: float = 0.03, tolerance: float = 1e-3, patience: int = 2,
    ):  # fmt: skip
        for name, value, least in (("starts", starts, 0), ("walks", walks, 1), ("patience", patience, 1)):
            check_whole(self.name, name, value, least)
        check_between(self.name, "difference", difference, 0.0, LONGEST)
        check_between(self.name, "tolerance", tolerance, 0.0, 1.0)
        self.starts, self.walks, self.difference = starts, walks, difference
        self.tolerance, self.patience = tolerance, patience
        super().__init__(space, seed=seed, budget=budget)

    def steps(self) -> Steps:
        # No more than a third of the budget goes into looking around.
        starts = min(self.starts, max(0, self.budget // 3 - 1))
        points = spread(self, starts)
        evaluation = yield points
        cost = sums_of_squares(self.name, evaluation)
        if not np.isfinite(cost).any():
            return "no start could be simulated"
        self.start = self.space.from_unit(points[int(np.argmin(cost))])
        held = np.zeros(len(self.space), dtype=bool)
        for best in np.argsort(cost)[: self.walks]:
            if np.isfinite(cost[best]):
                held |= yield from self._walk(points[best], evaluation.residual[best], cost[best])
        return ended(self.space, held)

    def _walk(self, here: np.ndarray, residual: np.ndarray, cost_here: float) -> Walk:
        """Descend from one point until `patience` rounds in a row gain next to nothing."""
        damping, idle, jacobian, held = 0.01, 0, None, np.zeros(len(here), dtype=bool)
        while idle < self.patience:
            if jacobian is None:
                jacobian, held = yield from differences(self.name, here, residual, self.difference)
            trials, used = proposals(here, jacobian, residual, damping)
            evaluation = yield trials
            cost = sums_of_squares(self.name, evaluation)
            best = int(np.argmin(cost))
            gain = (cost_here - cost[best]) / max(cost_here, np.finfo(float).tiny)
            if gain > 0:
                here, residual, cost_here, damping = trials[best], evaluation.residual[best], cost[best], used[best]
                jacobian = None if gain >= self.tolerance else jacobian
            else:
                damping *= DAMPINGS[-1]
            idle = idle + 1 if gain < self.tolerance else 0
        return held


def differences(name: str, here: np.ndarray, residual: np.ndarray, difference: float) -> Differences:
    """Jacobian (M, P) at a point of the unit cube (P,), by one-sided differences; and which parameters (P,) could not
    be moved, since runs are lost to either side: their columns are 0. What is lost to one side is tried to the other.
    """
    way = np.where(here + difference <= 1.0, difference, -difference)
    rows, held = np.zeros((len(here), len(residual))), np.ones(len(here), dtype=bool)
    for away in (way, np.clip(here - way, 0.0, 1.0) - here):
        which = np.flatnonzero(held & (np.abs(away) >= difference / 2))
        if not len(which):
            break
        shifted = yield here + np.diag(away)[which]
        good = np.isfinite(sums_of_squares(name, shifted))
        rows[which[good]] = (shifted.residual[good] - residual) / away[which[good], None]
        held[which[good]] = False
    return rows.T, held


def ended(space: ParameterSpace, held: np.ndarray) -> str:
    """What is said of a walk that came to its end: that it converged, but for parameters (P,) that could not move."""
    names = ", ".join(name for name, stays in zip(space.names, held, strict=True) if stays)
    return f"converged, but runs are lost to either side of {names}" if names else "converged"


def sums_of_squares(name: str, evaluation: Evaluation) -> np.ndarray:
    """Σ r² (B,) of each member, infinite where it or the value could not be computed; name: the optimizer's that needs
    them.
    """
    if evaluation.residual is None:
        raise ClothbenchError(f"{name}: this metric has no residuals; choose another metric or optimizer")
    with np.errstate(over="ignore"):
        cost = np.einsum("br,br->b", evaluation.residual, evaluation.residual)
    return np.where(np.isfinite(cost) & np.isfinite(evaluation.value), cost, np.inf)


def proposals(
    here: np.ndarray, jacobian: np.ndarray, residual: np.ndarray, damping: float
) -> tuple[np.ndarray, np.ndarray]:
    """Damped Gauss–Newton points (4, P) inside the unit cube, and the damping of each.

    A parameter that stands on its bound and wants to leave is held there, so that it does not spoil the others' step.
    """
    gradient, hessian = jacobian.T @ residual, jacobian.T @ jacobian
    free = ~(((here <= 0) & (gradient > 0)) | ((here >= 1) & (gradient < 0)))
    scale = np.maximum(np.diag(hessian), 1e-12 * max(hessian.max(), np.finfo(float).tiny))
    points = []
    for factor in DAMPINGS * damping:
        step = np.zeros_like(here)
        damped = hessian[np.ix_(free, free)] + factor * np.diag(scale[free])
        step[free] = -np.linalg.lstsq(damped, gradient[free], rcond=None)[0]
        points.append(np.clip(here + step, 0.0, 1.0))
    return np.array(points), DAMPINGS * damping
