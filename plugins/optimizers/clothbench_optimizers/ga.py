"""`ga`: the genetic algorithm of
"Cloth mechanical parameter estimation and simulation for optimized robotic manipulation", section 5.1.
"""

from __future__ import annotations

import numpy as np

from clothbench import ClothbenchError, ParameterSpace, check_choice
from clothbench_optimizers.search import GeneratorSearch, Steps, check_whole, worst_last

BITS = 16  # per parameter, as in the paper
DECODINGS = ("own", "linear")


class GeneticAlgorithm(GeneratorSearch):
    """Chromosomes of 16 bits per parameter; population 20, 50 generations.

    Each generation keeps the best unchanged, adds one mutant of it, and fills up with the children of pairs chosen by
    tournament: single-point crossover, but for one pair in ten, then bit mutation of all. (The paper says both that
    pairs which are not crossed pass without any further change and that all 18 strings go through all three operators;
    this is the latter.) It leaves open the tournament's size (here 3), the mutation rate (here one bit per chromosome
    on average), and how bits are mapped between the bounds. The kept best is not simulated again.

    decoding: "own", bits count on each parameter's own scale, which for stiffnesses is logarithmic; "linear", from
    bound to bound.
    """

    name = "ga"
    version = 1
    needs_residual = False

    def __init__(
        self, space: ParameterSpace, *, seed: int, budget: int,
        population: int = 20, generations: int = 50, tournament: int = 3, crossover: float = 0.9,
        decoding: str = "own",
    ):  # fmt: skip
        for name, value, least in (
            ("population", population, 3),
            ("generations", generations, 1),
            ("tournament", tournament, 1),
        ):
            check_whole(self.name, name, value, least)
        if not isinstance(crossover, int | float) or isinstance(crossover, bool) or not 0 <= crossover <= 1:
            raise ClothbenchError(f"ga: crossover is {crossover!r}, expected a number from 0 to 1")
        check_choice(self.name, "decoding", decoding, DECODINGS)
        self.decoding = decoding
        self.population, self.generations = population, generations
        self.tournament, self.crossover = tournament, crossover
        super().__init__(space, seed=seed, budget=budget)

    def steps(self) -> Steps:
        length = BITS * len(self.space)
        genes = self.random.integers(0, 2, (self.population, length), dtype=np.int8)
        value = worst_last((yield self._decoded(genes)).value)
        for _ in range(self.generations - 1):
            best = int(np.argmin(value))
            children = self._next_generation(genes, value, genes[best])
            scores = worst_last((yield self._decoded(children)).value)
            genes = np.vstack([genes[best : best + 1], children])
            value = np.concatenate([value[best : best + 1], scores])
        return f"{self.generations} generations"

    def _decoded(self, genes: np.ndarray) -> np.ndarray:
        """Bits (B, 16·P) → the space's unit cube (B, P)."""
        share = decode(genes)
        if self.decoding == "own":
            return share
        return self.space.to_unit(self.space.low + share * (self.space.high - self.space.low))

    def _next_generation(self, genes: np.ndarray, value: np.ndarray, best: np.ndarray) -> np.ndarray:
        """A mutant of the best (with at least one bit changed) and population − 2 children."""
        mutant = self._mutate(best[None])
        at = self.random.integers(best.size)
        mutant[0, at] = 1 - best[at]
        parents = genes[self._winners(value, self.population - 2)]
        return np.vstack([mutant, self._mutate(self._cross(parents))])

    def _winners(self, value: np.ndarray, count: int) -> np.ndarray:
        """Tournament selection: the best of a few drawn at random, `count` times."""
        drawn = self.random.integers(0, len(value), (count, self.tournament))
        return drawn[np.arange(count), np.argmin(value[drawn], axis=1)]

    def _cross(self, parents: np.ndarray) -> np.ndarray:
        """Swap the tails of neighbouring pairs behind a random point."""
        children = parents.copy()
        for k in range(0, len(parents) - 1, 2):
            if self.random.random() < self.crossover:
                point = self.random.integers(1, parents.shape[1])
                children[k, point:], children[k + 1, point:] = parents[k + 1, point:], parents[k, point:]
        return children

    def _mutate(self, genes: np.ndarray) -> np.ndarray:
        return genes ^ (self.random.random(genes.shape) < 1.0 / genes.shape[1]).astype(np.int8)


def decode(genes: np.ndarray) -> np.ndarray:
    """Bits (B, 16·P) → unit cube (B, P), most significant bit first."""
    words = genes.reshape(len(genes), -1, BITS) @ (1 << np.arange(BITS - 1, -1, -1, dtype=np.int64))
    return words / (2**BITS - 1)
