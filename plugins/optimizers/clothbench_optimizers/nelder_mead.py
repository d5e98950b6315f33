"""`nelder_mead`: SciPy's downhill simplex as a search that is asked and told."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Generator
from typing import Any

import numpy as np

from clothbench import Evaluation, ParameterSpace
from clothbench_optimizers.search import (
    GeneratorSearch,
    Steps,
    check_between,
    check_start,
    check_whole,
    simplex_about,
    spread,
    worst_last,
)  # fmt: skip

WORST = float(np.finfo(float).max) / 8  # what could not be computed: finite, since SciPy takes differences of values
Walk = Generator[np.ndarray, Evaluation, tuple[np.ndarray, float]]


class NelderMead(GeneratorSearch):
    """Nelder and Mead 1965 with coefficients that suit the dimension (Gao and Han 2012), within bounds, restarted about
    the best point until a restart gains less than `tolerance` of the value.

    start: "look" begins at the best of `starts` points spread by a Sobol sequence and the defaults, "defaults" at the
    defaults; size: of the first simplex, in units of the scaled ranges; a restart halves it. A descent ends where its
    simplex is within 1e-3 of the scaled ranges, or within a tenth of `size` where that is less. First looks and new
    simplices are batches, without the corner at the best point, which is known; the moves between them are one point
    each.
    """

    name = "nelder_mead"
    version = 2
    needs_residual = False

    def __init__(
        self, space: ParameterSpace, *, seed: int, budget: int, start: str = "look", starts: int = 16,
        size: float = 0.2, tolerance: float = 1e-3,
    ):  # fmt: skip
        check_start(self.name, start)
        check_between(self.name, "size", size, 0.0, 1.0)
        check_between(self.name, "tolerance", tolerance, 0.0, 1.0)
        check_whole(self.name, "starts", starts, 1)
        self.begin, self.starts, self.size, self.tolerance = start, starts, size, tolerance
        super().__init__(space, seed=seed, budget=budget)

    def steps(self) -> Steps:
        look = min(self.starts, self.budget // 4) if self.begin == "look" else 0
        if not look:
            self.start = self.space.defaults
        points = spread(self, look)
        value = worst_last((yield points).value)
        best, lowest = points[int(np.argmin(value))], float(value.min())
        self.start, size = self.space.from_unit(best), self.size
        while True:
            here, found = yield from self._descend(best, lowest, size)
            if not np.isfinite(min(found, lowest)):  # all of it was lost: a smaller simplex would be, too
                best, lowest = yield from self._elsewhere()
                self.start = self.space.from_unit(best)
                continue
            gain, best, lowest = lowest - found, (here if found < lowest else best), min(found, lowest)
            if not gain > self.tolerance * abs(lowest):
                return "converged"
            size /= 2

    def _elsewhere(self) -> Walk:
        """A point that could be simulated, and its value: drawn until there is one, or the budget is spent."""
        while True:
            points = self.random.random((self.starts, len(self.space)))
            value = worst_last((yield points).value)
            if np.isfinite(value).any():
                return points[int(np.argmin(value))], float(value.min())

    def _descend(self, here: np.ndarray, value: float, size: float) -> Walk:
        """From a point of known value (infinite: it was lost)."""
        from scipy.optimize import minimize

        simplex = simplex_about(here, size)
        told = [value, *worst_last((yield simplex[1:]).value)]
        near = min(1e-3, self.size / 10)
        options = {"initial_simplex": simplex, "adaptive": True, "xatol": near, "fatol": np.inf, "maxfev": 10**6}

        def search(value_of: Callable[[np.ndarray], float]) -> Any:
            bounds = [(0.0, 1.0)] * len(here)
            return minimize(value_of, here, method="Nelder-Mead", bounds=bounds, options=options)

        known = {corner.tobytes(): min(v, WORST) for corner, v in zip(simplex, told, strict=True)}
        found = yield from asked(search, known)
        return found.x, float(found.fun) if found.fun < WORST else np.inf


def asked(search: Callable[[Callable], Any], known: dict[bytes, float]) -> Generator[np.ndarray, Evaluation, Any]:
    """Turn `search(function)`, which owns its loop, inside out: its questions are yielded one by one.

    It runs in a thread that waits for each answer; leaving the generator ends it. known: values by the point's bytes.
    """
    questions: queue.Queue[Any] = queue.Queue(1)
    answers: queue.Queue[float | None] = queue.Queue(1)

    def value_of(point: np.ndarray) -> float:
        if (value := known.get(np.asarray(point).tobytes())) is None:
            questions.put(np.array(point))
            if (value := answers.get()) is None:
                raise Abandoned
            known[np.asarray(point).tobytes()] = value
        return value

    def run() -> None:
        try:
            questions.put(("done", search(value_of)))
        except BaseException as fault:
            questions.put(("failed", fault))

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        while not isinstance(question := questions.get(), tuple):
            evaluation = yield question[None]
            answers.put(min(float(worst_last(evaluation.value)[0]), WORST))
    except GeneratorExit:
        answers.put(None)
        thread.join()
        raise
    thread.join()
    if question[0] == "failed":
        raise question[1]
    return question[1]


class Abandoned(Exception):
    """The caller has left the search: nobody will answer."""
