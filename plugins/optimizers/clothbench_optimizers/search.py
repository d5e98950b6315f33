"""The ask/tell shell around a search that is written as a generator: it yields points, and is sent their evaluation."""

from __future__ import annotations

from collections.abc import Generator

import numpy as np

from clothbench import ClothbenchError, Evaluation, ParameterSpace

Steps = Generator[np.ndarray, Evaluation, str]


class GeneratorSearch:
    """An optimizer whose `steps()` yields batches in the unit cube (B, P) and returns why it stopped.

    Never asks for more than `budget` evaluations: a batch that would exceed it is cut.
    """

    def __init__(self, space: ParameterSpace, *, seed: int, budget: int):
        if budget < 1:
            raise ClothbenchError(f"optimizer: budget is {budget}, expected at least 1 evaluation")
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
        self._left -= len(theta)
        if self._left <= 0:
            self.done, self.stopped = True, "budget spent"
            return
        try:
            self._next = self._search.send(evaluation)
        except StopIteration as stop:
            self.done, self.stopped = True, stop.value


def worst_last(value: np.ndarray) -> np.ndarray:
    """Values (B,) with what could not be computed (NaN) as infinitely bad."""
    return np.where(np.isfinite(value), value, np.inf)
