"""`cma_es`: the evolution strategy of the package `cma`, in the scaled space."""

from __future__ import annotations

import numpy as np

from clothbench import ParameterSpace
from clothbench_optimizers.search import (
    GeneratorSearch,
    Steps,
    check_between,
    check_start,
    check_whole,
    spread,
    worst_last,
)  # fmt: skip


class CmaEs(GeneratorSearch):
    """CMA-ES (Hansen 2016, The CMA evolution strategy: a tutorial), one batch a generation, restarted from the best
    point when it has converged before the budget is spent.

    start: "look" begins at the best of a Sobol spread of one generation, "defaults" at the defaults; sigma: first step
    size, in units of the scaled ranges; population: members of a generation (None: 4 + 3 ln P).
    """

    name = "cma_es"
    version = 1
    needs_residual = False

    def __init__(
        self, space: ParameterSpace, *, seed: int, budget: int, start: str = "look", sigma: float = 0.25,
        population: int | None = None,
    ):  # fmt: skip
        check_start(self.name, start)
        check_between(self.name, "sigma", sigma, 0.0, 2.0)
        if population is not None:
            check_whole(self.name, "population", population, 4)
        self.begin, self.sigma = start, sigma
        self.population = population or 4 + int(3 * np.log(len(space)))
        super().__init__(space, seed=seed, budget=budget)

    def steps(self) -> Steps:
        points = spread(self, self.population if self.begin == "look" else 0)
        value = worst_last((yield points).value)
        best, lowest = points[int(np.argmin(value))], float(value.min())
        self.start = self.space.from_unit(best)
        while True:  # until the budget is spent
            strategy = self._strategy(best)
            while not strategy.stop():
                asked = np.clip(strategy.ask(), 0.0, 1.0)
                evaluation = yield asked
                strategy.tell(list(asked), finite(evaluation.value).tolist())
                value = worst_last(evaluation.value)
                if value.min() < lowest:
                    best, lowest = asked[int(np.argmin(value))], float(value.min())

    def _strategy(self, here: np.ndarray):
        import cma

        count = len(self.space)
        options = {
            "bounds": [[0.0] * count, [1.0] * count], "popsize": self.population, "verbose": -9, "verb_log": 0,
            "randn": self._normal, "seed": np.nan,  # its own generator, not numpy's global one
        }  # fmt: skip
        if count == 1:  # pycma fails as it limits the only step of a search, which a flat or stepped error lets grow
            options["maxstd_boundrange"] = np.inf
        return cma.CMAEvolutionStrategy(here, self.sigma, options)

    def _normal(self, *shape: int) -> np.ndarray:
        return self.random.standard_normal(shape)


def finite(value: np.ndarray) -> np.ndarray:
    """Values (B,); what could not be computed is as bad as the worst that could, and 1 more: finite, as pycma asks."""
    known = value[np.isfinite(value)]
    return np.where(np.isfinite(value), value, (known.max() if len(known) else 0.0) + 1.0)
