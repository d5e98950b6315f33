"""The ask/tell shell around a search that is written as a generator: it yields points, and is sent their evaluation."""

from __future__ import annotations

from collections.abc import Generator

import numpy as np

from clothbench import ClothbenchError, Evaluation, ParameterSpace, check_choice

Steps = Generator[np.ndarray, Evaluation, str]


class GeneratorSearch:
    """An optimizer whose `steps()` yields batches in the unit cube (B, P) and returns why it stopped.

    Never asks for more than `budget` evaluations: a batch that would exceed it is cut, and `steps()` is not told of it.
    Of a whole batch that spends the budget it is told, as it may have come to its end with it. `start` (P,), in the
    parameters' units, is where the walk set out from once the look around was over (None until then, or if there is
    none).
    """

    start: np.ndarray | None = None

    def __init__(self, space: ParameterSpace, *, seed: int, budget: int):
        check_whole(getattr(self, "name", "optimizer"), "budget", budget, 1)
        if len(space) == 0:
            raise ClothbenchError("optimizer: there is no parameter to search for")
        self.space, self.budget = space, budget
        self.random = np.random.default_rng(seed)
        self.done, self.stopped = False, ""
        self._left = budget
        self._search = self.steps()
        self._next = next(self._search)

    def steps(self) -> Steps:
        raise TypeError(f"{type(self).__name__} does not say how it searches")

    def ask(self) -> np.ndarray:
        return self.space.from_unit(self._next[: self._left])

    def tell(self, theta: np.ndarray, evaluation: Evaluation) -> None:
        cut = self._left < len(self._next)
        self._left -= len(theta)
        if self._left <= 0:
            self.done, self.stopped = True, "budget spent"
        if cut:
            return
        try:
            self._next = self._search.send(evaluation)
        except StopIteration as stop:
            self.done, self.stopped = True, stop.value


def worst_last(value: np.ndarray) -> np.ndarray:
    """Values (B,) with what could not be computed (NaN) as infinitely bad."""
    return np.where(np.isfinite(value), value, np.inf)


STARTS = ("look", "defaults")


def check_start(name: str, start: str) -> None:
    check_choice(name, "start", start, STARTS)


def check_whole(name: str, what: str, value: int, least: int) -> None:
    """Refuse an option that is no whole number, `least` or more."""
    if not isinstance(value, int) or isinstance(value, bool) or value < least:
        raise ClothbenchError(f"{name}: {what} is {value!r}, expected a whole number, at least {least}")


def check_between(name: str, what: str, value: float, low: float, high: float) -> None:
    """Refuse an option that is no number above `low` and below `high`."""
    if not isinstance(value, int | float) or isinstance(value, bool) or not low < value < high:
        raise ClothbenchError(f"{name}: {what} is {value!r}, expected a number above {low:g} and below {high:g}")


def spread(search: GeneratorSearch, count: int) -> np.ndarray:
    """The defaults, then points of a scrambled Sobol sequence: (count + 1, P) of the unit cube."""
    points = sobol(len(search.space), search.random, count)
    return np.vstack([search.space.to_unit(search.space.defaults)[None], points])


def sobol(dimensions: int, random: np.random.Generator, count: int) -> np.ndarray:
    """The first points (count, D) of a scrambled Sobol sequence in the unit cube."""
    from scipy.stats import qmc  # half a second, which a mere listing of the plugins does not need

    return qmc.Sobol(dimensions, rng=random).random(2 ** int(np.ceil(np.log2(max(count, 1)))))[:count]


def simplex_about(here: np.ndarray, size: float) -> np.ndarray:
    """A corner at `here` (P,) and one for each axis `size` away, to the side with more room: (P + 1, P)."""
    away = np.where(here <= 0.5, size, -size)
    return np.vstack([here, np.clip(here + np.diag(away), 0.0, 1.0)])
