"""`simple_ea` and `hybrid_ea`: evolution towards a front of several objectives, without and with what the hybrid adds
(Mongus, Repnik, Mernik and Žalik, Applied Soft Computing 12, 2012; the text at hand ends before the algorithm, so this
is one in kind).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from clothbench import Evaluation, ParameterSpace, on_front
from clothbench_optimizers.search import GeneratorSearch, Steps, check_between, check_whole, spread

WORST = 1e150  # what a lost run has in every objective, finite, as its square is; what is no better counts as lost
NEIGHBOURS = 3.0  # times the parameters + 1, evaluated points that a local model is fitted to
SHRINK, GROW, SMALLEST = 0.5, 1.5, 0.005  # of the trust radius, in units of the scaled ranges


class SimpleEa(GeneratorSearch):
    """NSGA-II (Deb et al. 2002) as pymoo has it: simulated binary crossover, polynomial mutation, crowding distances.

    population: members of a generation. Of a metric with one value the front is that of one objective. Lost runs are
    worse than any other.
    """

    name = "simple_ea"
    version = 1
    needs_residual = False

    def __init__(self, space: ParameterSpace, *, seed: int, budget: int, population: int = 20):
        check_whole(self.name, "population", population, 4)
        self.population = population
        self.lost = 0
        super().__init__(space, seed=seed, budget=budget)

    def tell(self, theta: np.ndarray, evaluation: Evaluation) -> None:
        self.lost += int((~np.isfinite(evaluation.value)).sum())
        super().tell(theta, evaluation)
        if self.done and self.lost:
            self.stopped += f", {self.lost} runs lost"

    def steps(self) -> Steps:
        asked = spread(self, self.population - 1)[: self.population]
        wanted = self.judged((yield asked))
        strategy = self._strategy(asked, wanted.shape[1])
        while True:  # until the budget is spent
            strategy(asked, wanted)
            asked = strategy(None, None)
            wanted = self.judged((yield asked))

    def judged(self, evaluation: Evaluation) -> np.ndarray:
        """The objectives (B, M) of an evaluation; its value alone where it has none, and `WORST` of lost runs."""
        rows = evaluation.value[:, None] if evaluation.objectives is None else evaluation.objectives
        known = (np.isfinite(rows) & (rows < WORST)).all(axis=1)
        return np.where(known[:, None], rows, WORST)

    def _strategy(self, first: np.ndarray, objectives: int) -> Callable[[Any, Any], Any]:
        """pymoo's algorithm behind one function: told points (B, P) and objectives (B, M), or asked for the next."""
        from pymoo.algorithms.moo.nsga2 import NSGA2
        from pymoo.core.evaluator import Evaluator
        from pymoo.core.population import Population
        from pymoo.core.problem import Problem
        from pymoo.core.termination import NoTermination
        from pymoo.problems.static import StaticProblem

        problem = Problem(n_var=first.shape[1], n_obj=objectives, xl=0.0, xu=1.0)
        algorithm = NSGA2(pop_size=self.population, sampling=first)
        algorithm.setup(problem, termination=NoTermination(), seed=int(self.random.integers(2**31)), verbose=False)

        def strategy(points: np.ndarray | None, wanted: np.ndarray | None) -> np.ndarray | None:
            if points is None:
                return np.clip(algorithm.ask().get("X"), 0.0, 1.0)
            members = Population.new("X", points)
            Evaluator().eval(StaticProblem(problem, F=wanted), members)
            algorithm.tell(infills=members)
            return None

        algorithm.ask()
        return strategy


class HybridEa(SimpleEa):
    """`simple_ea` with two things more in every generation.

    Local search on the front: `local` of its members, the nearest to all goals first, then others at random, take a
    step that a linear model says is downhill: fitted to the signed differences of the points evaluated around it,
    within a radius that grows with success and shrinks without (a Gauss–Newton step without derivatives, as in DFO-GN,
    Cartis and Roberts 2019). Where a metric gives no differences the step is a random one of that length.
    The stability domain: with a fixed step some parameters blow the model up. A child whose nearest evaluated
    neighbour was lost is brought half-way towards the nearest one that was not, until it is on its side: the border is
    closed in on, instead of being crossed again and again. What was lost is counted and said at the end.
    """

    name = "hybrid_ea"
    version = 1

    def __init__(
        self, space: ParameterSpace, *, seed: int, budget: int, population: int = 20, local: int = 6,
        radius: float = 0.2,
    ):  # fmt: skip
        check_whole(self.name, "local", local, 1)
        check_between(self.name, "radius", radius, 0.0, 1.0)
        self.local, self.radius = local, radius
        super().__init__(space, seed=seed, budget=budget, population=population)

    def steps(self) -> Steps:
        asked = spread(self, self.population - 1)[: self.population]
        evaluation = yield asked
        wanted = self.judged(evaluation)
        seen = _Seen(asked, wanted, evaluation.residual)
        strategy = self._strategy(asked, wanted.shape[1])
        strategy(asked, wanted)
        while True:  # until the budget is spent
            children = np.array([seen.stable(child) for child in strategy(None, None)])
            bases = self._bases(seen)
            steps = np.array([seen.stable(self._step(seen, base)) for base in bases]).reshape(-1, len(self.space))
            asked = np.vstack([steps, children])  # what is cut off where the budget ends are children
            evaluation = yield asked
            wanted = self.judged(evaluation)
            for base, reached in zip(bases, wanted, strict=False):
                self._judge(_total(seen.wanted[base]), _total(reached))
            seen.add(asked, wanted, evaluation.residual)
            strategy(asked, wanted)

    def _bases(self, seen: _Seen) -> list[int]:
        """Numbers of the evaluated points from which local search goes on."""
        front = seen.front()
        if not len(front):
            return []
        nearest = front[np.argsort([_total(row) for row in seen.wanted[front]], kind="stable")]
        first, rest = nearest[: (self.local + 1) // 2], nearest[(self.local + 1) // 2 :]
        others = self.random.permutation(rest)[: self.local - len(first)]
        return [int(k) for k in (*first, *others)]

    def _step(self, seen: _Seen, base: int) -> np.ndarray:
        """Where local search goes from an evaluated point (P,)."""
        here, count = seen.points[base], len(self.space)
        near = seen.near(here, int(NEIGHBOURS * (count + 1)))
        away = self.radius * self.random.standard_normal(count) / np.sqrt(count)
        if seen.residual is None or len(near) < count + 2:
            return np.clip(here + away, 0.0, 1.0)
        moves = seen.points[near] - here
        distance = np.linalg.norm(moves, axis=1)
        weight = 1.0 / (1.0 + (distance / self.radius) ** 2)
        rows = np.column_stack([np.ones(len(near)), moves])
        ridge = 1e-3 * np.eye(count + 1)
        left = rows.T @ (weight[:, None] * rows) + ridge
        fitted = np.linalg.solve(left, rows.T @ (weight[:, None] * seen.residual[near]))
        value, slope = seen.residual[base], fitted[1:].T  # (R,), (R, P)
        damping = 1e-2 * np.trace(slope.T @ slope) / count + 1e-12
        step = -np.linalg.solve(slope.T @ slope + damping * np.eye(count), slope.T @ value)
        size = np.linalg.norm(step)
        step *= min(1.0, self.radius / size) if size > 0 else 0.0
        return np.clip(here + step + 0.2 * away, 0.0, 1.0)

    def _judge(self, before: float, after: float) -> None:
        """A step that paid lets the next ones be longer."""
        factor = GROW if after < before else SHRINK ** (1.0 / self.local)
        self.radius = float(np.clip(self.radius * factor, SMALLEST, 0.5))


class _Seen:
    """All points evaluated so far: points (E, P) of the unit cube, wanted (E, M), residual (E, R) or None."""

    def __init__(self, points: np.ndarray, wanted: np.ndarray, residual: np.ndarray | None):
        self.points, self.wanted, self.residual = points, wanted, residual

    def add(self, points: np.ndarray, wanted: np.ndarray, residual: np.ndarray | None) -> None:
        self.points, self.wanted = np.vstack([self.points, points]), np.vstack([self.wanted, wanted])
        if self.residual is not None and residual is not None:
            self.residual = np.vstack([self.residual, residual])

    @property
    def sound(self) -> np.ndarray:
        """Which runs were not lost, (E,) bool."""
        return np.asarray((self.wanted < WORST).all(axis=1))

    def front(self) -> np.ndarray:
        """Numbers of the sound points that no other is as good as in all objectives."""
        return np.flatnonzero(on_front(np.where(self.sound[:, None], self.wanted, np.nan)))

    def near(self, here: np.ndarray, count: int) -> np.ndarray:
        """Numbers of the sound points nearest to one (P,), that with known differences."""
        able = np.flatnonzero(self.sound)
        if self.residual is not None:
            able = able[np.isfinite(self.residual[able]).all(axis=1)]
        return able[np.argsort(((self.points[able] - here) ** 2).sum(axis=1), kind="stable")[:count]]

    def stable(self, point: np.ndarray) -> np.ndarray:
        """The point (P,), or half-way and half-way again towards the nearest sound one, until that is its nearest."""
        sound = self.sound
        if sound.all() or not sound.any():
            return point
        for _ in range(8):
            away = ((self.points - point) ** 2).sum(axis=1)
            nearest = int(away.argmin())
            if sound[nearest]:
                break
            point = (point + self.points[sound][int(away[sound].argmin())]) / 2
        return point


def _total(row: np.ndarray) -> float:
    """One number for objectives (M,) that are all on one scale."""
    return float(np.sqrt(np.mean(np.square(row))))
