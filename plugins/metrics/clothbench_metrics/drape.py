"""`drape`: drape coefficient and folds of simulated drapes beside those of captures, several objectives at once."""

from __future__ import annotations

import math
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

USUAL = tuple(q.name for q in QUANTITIES)
GOALS = (
    *(Objective(q.name, q.unit, f"distance in {q.meaning}") for q in QUANTITIES),
    Objective("curve_distance", "mm", "distance in r(φ), root mean square over the angles after the best rotation"),
)
NAMES = tuple(goal.name for goal in GOALS)
SCALE = np.array([*(q.scale for q in QUANTITIES), 1e3])  # of 1 in the goal's unit
FOLDS, CURVE = NAMES.index("folds"), NAMES.index("curve_distance")
LEAST_SPREAD = np.array([0.005, 0.5, 0.5e-3, 0.02, 0.5e-3])  # of each quantity: what two looks at one drape differ by
DRAWS = 400  # of the floor
STARTS = 4  # drapes of one set of parameters, as scenes have them unless `scene.starts` says so


class Drape:
    """How far simulated drapes are from captures of the fabric, in each of several quantities.

    Drapes are multistable: neither a capture nor a simulation from one first shape says how many folds there are, so
    distributions are compared, all captures with all first shapes. Of the number of folds the distance is Wasserstein's
    first (the mean shift that turns one distribution into the other), of the others the difference of the means. Each
    counts in units of the spread between captures (their standard deviation), and the value is the root mean square of
    that over the quantities.

    A further quantity, that counts only if it is asked for, is how far the outlines themselves lie apart: the root mean
    square of the difference in r(φ) of a simulated drape and a capture, turned until it is least, and of the drapes and
    the captures Wasserstein's first with that for a distance. Its spread is the mean of it between captures of
    different specimens; it has no sign, so that least squares lower it itself.

    There is no trace: sets are compared, in several quantities, of which no single capture has a part of its own.

    quantities: which of drape_coefficient, folds, depth, unevenness and curve_distance (all but the last); least_fold:
    m, prominence of a fold; starts: how many drapes of a model the floor is for (`scene.starts`).
    """

    name = "drape"
    version = 3
    unit = "sd"
    kinds = frozenset({"silhouette"})
    scalarisation = "root mean square over the objectives, each in standard deviations between captures"

    def __init__(self, quantities: Sequence[str] = USUAL, least_fold: float = 2e-3, starts: int = STARTS):
        some = isinstance(quantities, Sequence) and not isinstance(quantities, str) and len(quantities) > 0
        if not some or not all(q in NAMES for q in quantities):
            raise ClothbenchError(f"drape: quantities is {quantities!r}, expected some of {', '.join(NAMES)}")
        if not isinstance(least_fold, int | float) or isinstance(least_fold, bool) or not 0 < least_fold < 0.05:
            raise ClothbenchError(f"drape: least_fold is {least_fold!r}, expected metres above 0 and below 0.05")
        if not isinstance(starts, int) or isinstance(starts, bool) or starts < 1:
            raise ClothbenchError(f"drape: starts is {starts!r}, expected a whole number, 1 or above")
        self.starts = starts
        self.which, self.least = [NAMES.index(name) for name in NAMES if name in quantities], float(least_fold)
        self.objectives = tuple(GOALS[k] for k in self.which)
        self._known: weakref.WeakKeyDictionary[Outlines, np.ndarray] = weakref.WeakKeyDictionary()
        self._apart: weakref.WeakKeyDictionary[Outlines, np.ndarray] = weakref.WeakKeyDictionary()

    def __call__(self, observation: Observation, rollout: Rollout) -> Score:
        seen, captured = self._captured(observation)
        if (count := rollout.position.shape[2]) != (wanted := len(observation.material)):
            raise ClothbenchError(f"drape: found a rollout of {count} points, expected the {wanted} of a drape")
        simulated, curves = self.simulated(seen, rollout)
        away = _distances(simulated, captured, curves)
        spread = _spread(captured, self._between(seen))
        scaled = (away / spread)[:, self.which]
        signed = np.column_stack([simulated.mean(axis=1) - captured.mean(axis=0), away[:, CURVE]]) / spread
        scale = SCALE[self.which]
        return Score(
            np.sqrt(np.mean(scaled**2, axis=1)), self.unit, residual=signed[:, self.which] / np.sqrt(len(self.which)),
            objectives=away[:, self.which] * scale, spread=spread[self.which] * scale,
        )  # fmt: skip

    def simulated(self, seen: Outlines, rollout: Rollout) -> tuple[np.ndarray, np.ndarray]:
        """Of all drapes of a rollout the quantities (B, S, 4), and how far their outlines are from those that were
        captured (B, S, T) m, 0 if nobody asked.
        """
        radius = outlines_of_points(rollout.position, (0.0, 0.0, 0.0), seen.plate_radius)
        quantities = drape_quantities(radius, seen.plate_radius, seen.disc_radius, self.least)
        curves = np.zeros((*radius.shape[:2], len(seen.radius)))
        if CURVE in self.which:
            curves = np.array([curve_distances(one, seen.radius) for one in radius]).reshape(curves.shape)
        return quantities, curves

    def _between(self, seen: Outlines) -> np.ndarray:
        """How far the outlines of captures of different specimens are apart (T, T) m, of one specimen all its captures;
        NaN of others, 0 if nobody asked.
        """
        if CURVE not in self.which:
            return np.zeros((len(seen.radius),) * 2)
        if seen not in self._apart:
            same = seen.sample[:, None] == seen.sample
            if same.all():
                same = np.eye(len(same), dtype=bool)
            self._apart[seen] = np.where(same, np.nan, curve_distances(seen.radius, seen.radius))
        return self._apart[seen]

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
        of = [np.flatnonzero(seen.sample == s) for s in samples]
        between = self._between(seen)
        curves = curve_distances(seen.radius, seen.radius) if CURVE in self.which else between
        for _ in range(DRAWS):
            chosen = np.concatenate([of[k] for k in random.integers(len(of), size=len(of))])
            others = np.array([random.choice(of[k]) for k in random.integers(len(of), size=self.starts)])
            pair, both = np.ix_(others, chosen), np.ix_(chosen, chosen)
            drawn.append(self._value(captured[others], captured[chosen], curves[pair], between[both]))
        return float(np.mean(drawn))

    def interval(self, observation: Observation, rollout: Rollout, seed: int) -> tuple[float, float]:
        """95 % interval of the first member's value, from leaving out each specimen, and each first shape, in turn.

        Both are chance of their own, so their half-widths (the jackknife's, with Student's t) are added as squares. It
        does not go below 0. NaN of a single specimen or a single first shape: nobody knows what another would be like.
        """
        seen, captured = self._captured(observation)
        simulated, curves = (of_all[0] for of_all in self.simulated(seen, rollout))
        between = self._between(seen)
        samples, shapes = np.unique(seen.sample), np.arange(len(simulated))
        if min(len(samples), len(shapes)) < 2 or not np.isfinite(simulated).all():
            return float("nan"), float("nan")
        here = self._value(simulated, captured, curves, between)
        fewer_specimens = [
            self._value(simulated, captured[left], curves[:, left], between[np.ix_(left, left)])
            for left in (seen.sample != s for s in samples)
        ]
        fewer_shapes = [self._value(simulated[shapes != k], captured, curves[shapes != k], between) for k in shapes]
        moved = [np.array(values)[:, None] - here for values in (fewer_specimens, fewer_shapes)]
        half = float(np.hypot(*[jackknife_half_width(m)[0] for m in moved]))
        return max(here - half, 0.0), here + half

    def _value(self, simulated: np.ndarray, captured: np.ndarray, curves: np.ndarray, between: np.ndarray) -> float:
        """The value of simulated drapes (S, 4) beside captures (T, 4), whose outlines are curves (S, T) m apart, those
        of the captures between (T, T) m.
        """
        away = _distances(simulated[None], captured, curves[None])[0] / _spread(captured, between)
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


def curve_distances(some: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Root mean square difference [m] of outlines (S, K) m and (T, L) m, each turned by as many of the K
    angles as make it least, (S, T); NaN of an outline that is not known.
    """
    count = some.shape[1]
    if others.shape[1] != count:
        at = np.linspace(0, others.shape[1], count, endpoint=False)
        others = np.array([np.interp(at, np.arange(len(r) + 1), np.append(r, r[0])) for r in others])
    product = np.fft.rfft(some)[:, None] * np.fft.rfft(others).conj()
    turn = np.fft.irfft(product, count).argmax(
        axis=-1
    )  # the squares are least where Σ some(φ + turn) others(φ) is most
    angle = (turn[..., None] + np.arange(count)) % count
    turned = np.take_along_axis(np.broadcast_to(some[:, None], angle.shape), angle, axis=-1)
    return np.sqrt(np.mean((turned - others) ** 2, axis=-1))


def transported(cost: np.ndarray) -> float:
    """Wasserstein's first distance of S and T things, all of the same weight, that are cost (S, T) apart; 0 of none."""
    from scipy.optimize import linear_sum_assignment

    if not cost.any():
        return 0.0
    common = math.lcm(*cost.shape)
    whole = cost.repeat(common // cost.shape[0], axis=0).repeat(common // cost.shape[1], axis=1)
    return float(whole[linear_sum_assignment(whole)].mean())


def _spread(captured: np.ndarray, between: np.ndarray) -> np.ndarray:
    """Standard deviation between captures (T, 4) of each quantity, and the mean of what is known of the distances
    between their outlines (T, T), none below what two looks differ by (5,).
    """
    spread = captured.std(axis=0, ddof=1) if len(captured) > 1 else np.zeros(len(USUAL))
    known = between[np.isfinite(between)]
    return np.maximum([*spread, known.mean() if known.size else 0.0], LEAST_SPREAD)


def _distances(simulated: np.ndarray, captured: np.ndarray, curves: np.ndarray) -> np.ndarray:
    """How far simulated drapes (B, S, 4) are from captures (T, 4) in each quantity, and how far in their outlines, that
    are curves (B, S, T) m apart, (B, 5).
    """
    out = np.abs(simulated.mean(axis=1) - captured.mean(axis=0))
    levels = np.linspace(0, 1, 241)[:-1] + 1 / 480  # W₁ is the mean distance between quantiles
    ours = np.quantile(simulated[:, :, FOLDS], levels, axis=1, method="inverted_cdf").T
    out[:, FOLDS] = np.abs(ours - np.quantile(captured[:, FOLDS], levels, method="inverted_cdf")).mean(axis=1)
    known = np.isfinite(simulated).all(axis=(1, 2))
    moved = [transported(cost) if ok else np.nan for cost, ok in zip(curves, known, strict=True)]
    return np.column_stack([np.where(np.isfinite(simulated).all(axis=1), out, np.nan), moved])
