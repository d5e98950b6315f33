"""`iterative_least_squares`: least squares that goes on from the last estimate whenever there is a new measurement.

Petrík et al., Automatic Material Properties Estimation for the Physics-Based Robotic Garment Folding, algorithm 1:
after each measurement argmin J over η_b and T_δ. The paper does not say how it is found; here by damped Gauss–Newton
steps (Levenberg–Marquardt), as in `least_squares`.
"""

from __future__ import annotations

import numpy as np

from clothbench import Evaluation, ParameterSpace
from clothbench_optimizers.least_squares import LONGEST, differences, ended, proposals, sums_of_squares
from clothbench_optimizers.search import GeneratorSearch, Steps, check_between, check_whole, worst_last


class IterativeLeastSquares(GeneratorSearch):
    """Looks at the space's defaults and along every logarithmic parameter, which may be decades off, or, where there is
    none, at points at random; begins at the best of these.

    scan: how many points along each of these parameters, or at random (these for a third of the budget at most);
    difference: step of the forward differences, in units of the scaled range; tolerance: relative gain in the sum of
    squares below which two rounds in a row end the search.
    `renew()` tells of a new measurement: what was told before no longer holds, and the search sets out from where it
    stood. The budget is that of one measurement.
    """

    name = "iterative_least_squares"
    version = 2
    needs_residual = True

    def __init__(
        self, space: ParameterSpace, *, seed: int, budget: int,
        scan: int = 13, difference: float = 1e-3, tolerance: float = 1e-4,
    ):  # fmt: skip
        check_whole(self.name, "scan", scan, 1)
        check_between(self.name, "difference", difference, 0.0, LONGEST)
        check_between(self.name, "tolerance", tolerance, 0.0, 1.0)
        self.scan, self.difference, self.tolerance = scan, difference, tolerance
        self.here, self.least = space.to_unit(space.defaults), np.inf
        super().__init__(space, seed=seed, budget=budget)

    def renew(self) -> None:
        """A new measurement has come."""
        self.done, self.stopped, self._left, self.least = False, "", self.budget, np.inf
        self._search = self._descend(self.here[None])
        self._next = next(self._search)

    def tell(self, theta: np.ndarray, evaluation: Evaluation) -> None:
        """The next walk sets out from the best of the batch that spends the budget, too, even if it was cut."""
        asked = self._next[: len(theta)]
        super().tell(theta, evaluation)
        if self._left <= 0:
            cost = sums_of_squares(self.name, evaluation)
            if cost.min() < self.least:
                self.here, self.least = asked[int(np.argmin(cost))], cost.min()

    def steps(self) -> Steps:
        log = [i for i, p in enumerate(self.space) if p.scale == "log"]
        points = [self.here]
        for i in log:
            for share in np.linspace(0.0, 1.0, self.scan):
                points.append(np.where(np.arange(len(self.here)) == i, share, self.here))
        if not log:  # nothing to look along: points at random tell where the search can begin at all
            points += list(self.random.random((min(self.scan, self.budget // 3), len(self.here))))
        return (yield from self._descend(np.array(points)))

    def _descend(self, starts: np.ndarray) -> Steps:
        """Damped Gauss–Newton steps from the best of some points."""
        evaluation: Evaluation = yield starts
        cost = sums_of_squares(self.name, evaluation)
        first = int(np.argmin(worst_last(cost)))
        if not np.isfinite(cost[first]):
            return "no start could be simulated"
        self.here, residual, self.least = starts[first], evaluation.residual[first], cost[first]
        damping, idle = 1e-3, 0
        while idle < 2:
            jacobian, held = yield from differences(self.name, self.here, residual, self.difference)
            trials, used = proposals(self.here, jacobian, residual, damping)
            evaluation = yield trials
            cost = sums_of_squares(self.name, evaluation)
            best = int(np.argmin(cost))
            gain = (self.least - cost[best]) / max(self.least, np.finfo(float).tiny)
            if gain > 0:
                assert evaluation.residual is not None  # it has a sum of squares
                self.here, residual, damping = trials[best], evaluation.residual[best], used[best]
                self.least = cost[best]
            else:
                damping *= 100.0
            idle = idle + 1 if gain < self.tolerance else 0
        return ended(self.space, held)
