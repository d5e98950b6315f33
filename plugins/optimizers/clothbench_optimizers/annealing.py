"""`annealing`: the continuous simulated annealing by which Bhat et al. 2003 (section 6) fit cloth to video."""

from __future__ import annotations

import itertools
from collections.abc import Generator

import numpy as np

from clothbench import Evaluation, ParameterSpace
from clothbench_optimizers.search import (
    GeneratorSearch,
    Steps,
    check_between,
    check_start,
    check_whole,
    simplex_about,
    sobol,
    worst_last,
)  # fmt: skip

Walk = Generator[np.ndarray, Evaluation, None]
RESET = 3.0  # the simplex is spanned anew about the best each time the temperature has fallen by this factor


class Annealing(GeneratorSearch):
    """Downhill simplex whose corners are judged with thermal fluctuations (Press et al., Numerical Recipes, 10.9), so
    that uphill moves are taken as Metropolis' rule has it, on a temperature that falls geometrically with every
    evaluation; each time it has fallen by 3, the simplex is spanned anew about the best point, at half its size, but
    not before it has had as many evaluations to move as it has corners: a small budget must not go into simplices.

    start: "look" begins with an exhaustive grid of `levels` values for each parameter (the paper: 4), "defaults" at the
    space's defaults. gridded: how many of the leading parameters the grid covers (None: all), the others get one random
    guess each, as the paper gave its dynamic parameters; share: of the budget, that the grid may take: of a larger
    one, points spread by a Sobol sequence are taken. temperature: at the start, over the spread of the first simplex;
    final: temperature at the end of the budget, over that at the start; size: of the first simplex, in units of the
    scaled ranges. Batched where the method allows it: grid, new simplices, contractions about the best.
    """

    name = "annealing"
    version = 2
    needs_residual = False

    def __init__(
        self, space: ParameterSpace, *, seed: int, budget: int, start: str = "look", levels: int = 4,
        gridded: int | None = None, share: float = 0.4, temperature: float = 0.3, final: float = 1e-3,
        size: float = 0.2,
    ):  # fmt: skip
        check_start(self.name, start)
        check_whole(self.name, "levels", levels, 2)
        if gridded is not None:
            check_whole(self.name, "gridded", gridded, 1)
        for name, number, low, high in (
            ("share", share, 0.0, 1.0), ("temperature", temperature, 0.0, 100.0), ("final", final, 0.0, 1.0),
            ("size", size, 0.0, 1.0),
        ):  # fmt: skip
            check_between(self.name, name, number, low, high)
        self.begin, self.levels, self.gridded = start, levels, len(space) if gridded is None else gridded
        self.temperature_now = np.nan
        self.share, self.temperature, self.final, self.size = share, temperature, final, size
        super().__init__(space, seed=seed, budget=budget)

    def steps(self) -> Steps:
        here, lowest = self.space.to_unit(self.space.defaults), np.inf
        if self.begin == "look":
            points = self._grid(max(1, int(self.share * self.budget)))
            value = worst_last((yield points).value)
            here, lowest = points[int(np.argmin(value))], float(value.min())
        self.start = self.space.from_unit(here)
        walk = Walker(self, here, lowest)
        yield from walk.anneal(max(self._left, 1))
        return "cooled down"

    def _grid(self, most: int) -> np.ndarray:
        """The grid in the unit cube, or as many of its points as allowed; the middles of equal parts of each range.

        The paper's start values lie on the ends of its ranges too; bounds here are wider, so that ends say little.
        """
        count = min(self.gridded, len(self.space))
        line = (np.arange(self.levels) + 0.5) / self.levels
        if self.levels**count <= most:
            cells = np.array(list(itertools.product(line, repeat=count)))
        else:
            cells = np.unique(line[(sobol(count, self.random, most) * self.levels).astype(int)], axis=0)
        guess = self.random.random(len(self.space) - count)
        return np.hstack([cells, np.broadcast_to(guess, (len(cells), len(guess)))])


class Walker:
    """The simplex on its way: corner (P + 1, P), value (P + 1,), and the best point met so far (P,) with its value."""

    def __init__(self, search: Annealing, here: np.ndarray, lowest: float):
        self.random, self.settings = search.random, search
        self.best, self.lowest = here, lowest
        self.corner, self.value = here[None], np.array([np.inf])
        self.spent = 0

    def anneal(self, budget: int) -> Walk:
        """Moves until the budget is spent; the temperature follows the evaluations."""
        settings, size = self.settings, self.settings.size
        yield from self._span(size)
        while self.spent < budget and not np.isfinite(self.lowest):  # nothing to walk towards yet: look elsewhere
            yield from self._ask(self.random.random(self.corner.shape))
            if np.isfinite(self.lowest):
                yield from self._span(size)
        known = self.value[np.isfinite(self.value)]
        hot = settings.temperature * max(float(np.ptp(known)) if len(known) else 0.0, np.finfo(float).tiny)
        level, since = hot, self.spent
        while self.spent < budget:
            now = hot * settings.final ** (self.spent / budget)
            if now < level / RESET and self.spent - since >= len(self.corner):
                level, size = now, size / 2
                yield from self._span(size)
                since = self.spent
                continue
            settings.temperature_now = now
            yield from self._move(now)

    def _ask(self, points: np.ndarray) -> Generator[np.ndarray, Evaluation, np.ndarray]:
        points = np.atleast_2d(points)
        value = worst_last((yield points).value)
        self.spent += len(points)
        if value.min() < self.lowest:
            self.best, self.lowest = points[int(np.argmin(value))], float(value.min())
        return value

    def _span(self, size: float) -> Walk:
        """A new simplex about the best point; its first corner is known unless nothing is yet."""
        self.corner = simplex_about(self.best, size)
        if np.isfinite(self.lowest):
            self.value = np.concatenate([[self.lowest], (yield from self._ask(self.corner[1:]))])
        else:
            self.value = yield from self._ask(self.corner)

    def _move(self, temperature: float) -> Walk:
        """One step of the simplex: reflect the worst corner, then stretch, shorten, or draw all in about the best.

        Corners seem worse than they are by a random amount, trials better: that is Metropolis' rule at `temperature`.
        """
        seeming = self.value + temperature * self.random.exponential(size=len(self.value))
        order = np.argsort(seeming)
        low, next_high, high = seeming[order[0]], seeming[order[-2]], order[-1]
        tried = yield from self._try(high, -1.0, seeming[high], temperature)
        if tried <= low:
            yield from self._try(high, 2.0, tried, temperature)
        elif tried >= next_high:
            worst = min(tried, seeming[high])
            if (yield from self._try(high, 0.5, worst, temperature)) >= worst:
                yield from self._draw_in(order[0])

    def _try(
        self, high: int, factor: float, limit: float, temperature: float
    ) -> Generator[np.ndarray, Evaluation, float]:
        """A trial at `factor` times the worst corner's way from the middle of the others; kept if below `limit`."""
        middle = np.delete(self.corner, high, axis=0).mean(axis=0)
        point = mirrored(middle + factor * (self.corner[high] - middle))
        (value,) = yield from self._ask(point)
        seeming = value - temperature * self.random.exponential()
        if seeming < limit:
            self.corner[high], self.value[high] = point, value
        return float(seeming)

    def _draw_in(self, low: int) -> Walk:
        others = np.arange(len(self.corner)) != low
        self.corner[others] = (self.corner[others] + self.corner[low]) / 2
        self.value[others] = yield from self._ask(self.corner[others])


def mirrored(unit: np.ndarray) -> np.ndarray:
    """Points put back into the unit cube as a mirror on its faces would show them."""
    folded = np.abs(np.mod(unit + 1.0, 2.0) - 1.0)
    return np.clip(folded, 0.0, 1.0)
