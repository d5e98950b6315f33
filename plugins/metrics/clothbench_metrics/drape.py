"""`drape`: drape coefficient and folds of simulated drapes beside those of captures, several objectives at once."""

from __future__ import annotations

import weakref
from collections.abc import Sequence

import numpy as np

from clothbench import (
    QUANTITIES,
    ClothbenchError,
    Objective,
    Observation,
    Outlines,
    Rollout,
    Score,
    drape_quantities,
    outlines_of_points,
)

NAMES = tuple(q.name for q in QUANTITIES)
FOLDS = NAMES.index("folds")
LEAST_SPREAD = np.array([0.005, 0.5, 0.5e-3, 0.02])  # of each quantity: what two looks at one drape differ by
DRAWS = 400


class Drape:
    """How far simulated drapes are from captures of the fabric, in each of several quantities.

    Drapes are multistable: neither a capture nor a simulation from one first shape says how many folds there are, so
    distributions are compared, all captures with all first shapes. Of the number of folds the distance is Wasserstein's
    first (the mean shift that turns one distribution into the other), of the others the difference of the means. Each
    counts in units of the spread between captures (their standard deviation), and the value is the root mean square of
    that over the quantities.

    quantities: which of drape_coefficient, folds, depth and unevenness; least_fold: m, prominence of a fold.
    """

    name = "drape"
    version = 1
    unit = "sd"
    kinds = frozenset({"silhouette"})
    scalarisation = "root mean square over the objectives, each in standard deviations between captures"

    def __init__(self, quantities: Sequence[str] = NAMES, least_fold: float = 2e-3):
        some = isinstance(quantities, Sequence) and not isinstance(quantities, str) and len(quantities) > 0
        if not some or not all(q in NAMES for q in quantities):
            raise ClothbenchError(f"drape: quantities is {quantities!r}, expected some of {', '.join(NAMES)}")
        if not isinstance(least_fold, int | float) or isinstance(least_fold, bool) or not 0 < least_fold < 0.05:
            raise ClothbenchError(f"drape: least_fold is {least_fold!r}, expected metres above 0 and below 0.05")
        self.which, self.least = [NAMES.index(name) for name in NAMES if name in quantities], float(least_fold)
        self.objectives = tuple(
            Objective(q.name, q.unit, f"distance in {q.meaning}") for q in (QUANTITIES[k] for k in self.which)
        )
        self._known: weakref.WeakKeyDictionary[Outlines, np.ndarray] = weakref.WeakKeyDictionary()

    def __call__(self, observation: Observation, rollout: Rollout) -> Score:
        seen, captured = self._captured(observation)
        simulated = self.simulated(seen, rollout)  # (B, S, 4)
        away = _distances(simulated, captured)
        spread = _spread(captured)
        scaled = (away / spread)[:, self.which]
        signed = ((simulated.mean(axis=1) - captured.mean(axis=0)) / spread)[:, self.which]
        scale = np.array([QUANTITIES[k].scale for k in self.which])
        return Score(
            np.sqrt(np.mean(scaled**2, axis=1)), self.unit, residual=signed / np.sqrt(len(self.which)),
            objectives=away[:, self.which] * scale, spread=spread[self.which] * scale,
        )  # fmt: skip

    def simulated(self, seen: Outlines, rollout: Rollout) -> np.ndarray:
        """The quantities of all drapes of a rollout (B, S, 4)."""
        radius = outlines_of_points(rollout.position, (0.0, 0.0, 0.0), seen.plate_radius)
        return drape_quantities(radius, seen.plate_radius, seen.disc_radius, self.least)

    def floor(self, observation: Observation) -> float:
        """What captures of one specimen are from those of the others: the same fabric, cut and laid on anew."""
        seen, captured = self._captured(observation)
        samples = np.unique(seen.sample)
        if len(samples) < 2:
            return float("nan")
        spread = _spread(captured)
        one = [
            _distances(captured[seen.sample == s][None], captured[seen.sample != s])[0][self.which]
            / spread[self.which]
            for s in samples
        ]  # fmt: skip
        return float(np.mean(np.sqrt(np.mean(np.square(one), axis=1))))

    def interval(self, observation: Observation, rollout: Rollout, seed: int) -> tuple[float, float]:
        """95 % interval of the first member's value by a bootstrap over specimens and first shapes.

        Quantiles are counted from the draws' own mean, since a drawn distance is larger than the value by what chance
        adds to it. The interval holds the value and does not go below 0.
        """
        seen, captured = self._captured(observation)
        simulated = self.simulated(seen, rollout)[0]
        if not np.isfinite(simulated).all():
            return float("nan"), float("nan")
        random, samples, drawn = np.random.default_rng(seed), np.unique(seen.sample), []
        spread = _spread(captured)

        def value(shapes: np.ndarray, drapes: np.ndarray) -> float:
            away = _distances(shapes[None], drapes)[0]
            return float(np.sqrt(np.mean((away / spread)[self.which] ** 2)))

        for _ in range(DRAWS):
            chosen = random.choice(samples, len(samples))
            again = np.concatenate([captured[seen.sample == s] for s in chosen])
            shapes = simulated[random.integers(0, len(simulated), len(simulated))]
            drawn.append(value(shapes, again))
        here = value(simulated, captured)
        below, above = np.quantile(drawn, [0.025, 0.975]) - np.mean(drawn)
        return max(here + min(float(below), 0.0), 0.0), here + max(float(above), 0.0)

    def _captured(self, observation: Observation) -> tuple[Outlines, np.ndarray]:
        """The outlines that were seen, and their quantities (T, 4), read once."""
        seen = observation.outlines
        if seen is None:
            raise ClothbenchError("drape: the recording shows no drapes; give recordings of kind 'silhouette'")
        if seen not in self._known:
            self._known[seen] = drape_quantities(seen.radius, seen.plate_radius, seen.disc_radius, self.least)
        return seen, self._known[seen]


def _spread(captured: np.ndarray) -> np.ndarray:
    """Standard deviation between captures (T, 4) of each quantity, not below what two looks differ by (4,)."""
    return np.maximum(captured.std(axis=0, ddof=1) if len(captured) > 1 else 0.0, LEAST_SPREAD)


def _distances(simulated: np.ndarray, captured: np.ndarray) -> np.ndarray:
    """How far simulated drapes (B, S, 4) are from captures (T, 4) in each quantity, (B, 4)."""
    out = np.abs(simulated.mean(axis=1) - captured.mean(axis=0))
    levels = np.linspace(0, 1, 241)[:-1] + 1 / 480  # W₁ is the mean distance between quantiles
    ours = np.quantile(simulated[:, :, FOLDS], levels, axis=1, method="inverted_cdf").T
    out[:, FOLDS] = np.abs(ours - np.quantile(captured[:, FOLDS], levels, method="inverted_cdf")).mean(axis=1)
    return np.where(np.isfinite(simulated).all(axis=1), out, np.nan)
