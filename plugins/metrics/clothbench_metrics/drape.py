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
    jackknife_half_width,
    outlines_of_points,
)

NAMES = tuple(q.name for q in QUANTITIES)
FOLDS = NAMES.index("folds")
LEAST_SPREAD = np.array([0.005, 0.5, 0.5e-3, 0.02])  # of each quantity: what two looks at one drape differ by
DRAWS = 400  # of the floor
STARTS = 4  # drapes of one set of parameters, as scenes have them unless `scene.starts` says so


class Drape:
    """How far simulated drapes are from captures of the fabric, in each of several quantities.

    Drapes are multistable: neither a capture nor a simulation from one first shape says how many folds there are, so
    distributions are compared, all captures with all first shapes. Of the number of folds the distance is Wasserstein's
    first (the mean shift that turns one distribution into the other), of the others the difference of the means. Each
    counts in units of the spread between captures (their standard deviation), and the value is the root mean square of
    that over the quantities.

    quantities: which of drape_coefficient, folds, depth and unevenness; least_fold: m, prominence of a fold; starts:
    how many drapes of a model the floor is for (`scene.starts`).
    """

    name = "drape"
    version = 2
    unit = "sd"
    kinds = frozenset({"silhouette"})
    scalarisation = "root mean square over the objectives, each in standard deviations between captures"

    def __init__(self, quantities: Sequence[str] = NAMES, least_fold: float = 2e-3, starts: int = STARTS):
        some = isinstance(quantities, Sequence) and not isinstance(quantities, str) and len(quantities) > 0
        if not some or not all(q in NAMES for q in quantities):
            raise ClothbenchError(f"drape: quantities is {quantities!r}, expected some of {', '.join(NAMES)}")
        if not isinstance(least_fold, int | float) or isinstance(least_fold, bool) or not 0 < least_fold < 0.05:
            raise ClothbenchError(f"drape: least_fold is {least_fold!r}, expected metres above 0 and below 0.05")
        if not isinstance(starts, int) or isinstance(starts, bool) or starts < 1:
            raise ClothbenchError(f"drape: starts is {starts!r}, expected a whole number, 1 or above")
        self.starts = starts
        self.which, self.least = [NAMES.index(name) for name in NAMES if name in quantities], float(least_fold)
        self.objectives = tuple(
            Objective(q.name, q.unit, f"distance in {q.meaning}") for q in (QUANTITIES[k] for k in self.which)
        )
        self._known: weakref.WeakKeyDictionary[Outlines, np.ndarray] = weakref.WeakKeyDictionary()

    def __call__(self, observation: Observation, rollout: Rollout) -> Score:
        seen, captured = self._captured(observation)
        if (count := rollout.position.shape[2]) != (wanted := len(observation.material)):
            raise ClothbenchError(f"drape: found a rollout of {count} points, expected the {wanted} of a drape")
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
        """What a perfect model would score on average: `starts` of the fabric's own drapes, of other specimens, against
        as many specimens as were captured. NaN of a single specimen, which does not tell how specimens differ.

        Both sides are drawn from the captures, specimen by specimen, always with the same seed. What is drawn scatters
        less than other specimens would, by (K − 1)/K, and so does the spread in which it is measured.
        """
        seen, captured = self._captured(observation)
        samples = np.unique(seen.sample)
        if len(samples) < 2:
            return float("nan")
        random, drawn = np.random.default_rng(0), []
        of = [captured[seen.sample == s] for s in samples]
        for _ in range(DRAWS):
            chosen = random.integers(len(of), size=len(of))
            others = [random.choice(of[k]) for k in random.integers(len(of), size=self.starts)]
            drawn.append(self._value(np.array(others), np.concatenate([of[k] for k in chosen])))
        return float(np.mean(drawn))

    def interval(self, observation: Observation, rollout: Rollout, seed: int) -> tuple[float, float]:
        """95 % interval of the first member's value, from leaving out each specimen, and each first shape, in turn.

        Both are chance of their own, so their half-widths (the jackknife's, with Student's t) are added as squares. It
        does not go below 0. NaN of a single specimen or a single first shape: nobody knows what another would be like.
        """
        seen, captured = self._captured(observation)
        simulated = self.simulated(seen, rollout)[0]
        samples, shapes = np.unique(seen.sample), np.arange(len(simulated))
        if min(len(samples), len(shapes)) < 2 or not np.isfinite(simulated).all():
            return float("nan"), float("nan")
        here = self._value(simulated, captured)
        fewer_specimens = [self._value(simulated, captured[seen.sample != s]) for s in samples]
        fewer_shapes = [self._value(simulated[shapes != k], captured) for k in shapes]
        moved = [np.array(values)[:, None] - here for values in (fewer_specimens, fewer_shapes)]
        half = float(np.hypot(*[jackknife_half_width(m)[0] for m in moved]))
        return max(here - half, 0.0), here + half

    def _value(self, simulated: np.ndarray, captured: np.ndarray) -> float:
        """The value of simulated drapes (S, 4) beside captures (T, 4)."""
        away = _distances(simulated[None], captured)[0] / _spread(captured)
        return float(np.sqrt(np.mean(away[self.which] ** 2)))

    def _captured(self, observation: Observation) -> tuple[Outlines, np.ndarray]:
        """The outlines that were seen, and their quantities (T, 4), read once."""
        seen = observation.outlines
        if seen is None:
            raise ClothbenchError("drape: the recording shows no drapes; give recordings of kind 'silhouette'")
        if not len(seen.radius):
            raise ClothbenchError("drape: the recording holds no capture, expected at least one")
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
