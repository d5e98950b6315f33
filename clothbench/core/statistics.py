"""Student's t, as intervals and tests of several rooms want it, noise among neighbours, points that fill a cube evenly.

The quantiles are those of scipy.stats to the last bit, from scipy.special, which scipy loads when the first is asked
for: scipy.stats takes half a second to import and this a quarter, which every command would wait for.
"""

from __future__ import annotations

import math

import numpy as np
import scipy

NORMAL = 1.4826  # times the median absolute value of what is normally distributed about 0: its σ
FEW = {1: 2.198, 2: 2.007}  # differences: how often σ² the square of `noise_of_each` is, of normal values
HIGHER = (4, 5, 6, 7)  # orders of differences that have less of fast motion left than the third
SHOWN = 8  # differences of one series, for a higher order to have a say on it: of fewer it tells too little
BY_CHANCE = 2.0  # over the root of how many differences there are: the share by which one order tells less by chance
WITHOUT_NOISE = 1e-3  # of the most that a series shows as its noise: one that shows less was written without any


def student(freedom: float, of: int = 1) -> float:
    """Half-width of a two-sided 95 % interval in standard errors; NaN without a degree of freedom. of: so many
    intervals that all hold at once in 95 % of cases or more (Bonferroni).
    """
    return float(scipy.special.stdtrit(freedom, 1 - 0.025 / of))


def student_quantile(level: float, freedom: np.ndarray) -> np.ndarray:
    """Where Student's t lies below with the probability `level`, for degrees of freedom (N,)."""
    return np.asarray(scipy.special.stdtrit(freedom, level))


def student_above(value: np.ndarray | float, freedom: np.ndarray | float) -> np.ndarray:
    """How often Student's t is above a value, (N,) or one (the survival function)."""
    return np.asarray(scipy.special.stdtr(freedom, -np.asarray(value)))


def fisher_quantile(level: float, numerator: float, denominator: float) -> float:
    """Where Fisher's F lies below with the probability `level`."""
    return float(scipy.special.fdtri(numerator, denominator, level))


def t_interval(values: np.ndarray, of: int = 1) -> tuple[float, float]:
    """95 % interval of the mean of at least two values (N,), Student's t; of: as `student` has it."""
    half = student(len(values) - 1, of) * values.std(ddof=1) / np.sqrt(len(values))
    return float(values.mean() - half), float(values.mean() + half)


def jackknife_half_width(moved: np.ndarray) -> np.ndarray:
    """Half-width (P,) of a 95 % interval from how far P estimates move without each of G groups (G, P).

    The moves are taken from where they should lie about: from the whole, or from their mean.
    """
    count = len(moved)
    return student(count - 1) * np.sqrt((count - 1) / count * np.square(moved).sum(axis=0))


def standing_out(values: np.ndarray, level: float = 0.05) -> np.ndarray:
    """Which of N values stand out of the spread of all of them, (N,) bool: by chance any does with a probability of
    `level` at most (Grubbs 1950, Sample criteria for testing outlying observations, Bonferroni over the values).
    """
    count, spread = len(values), values.std(ddof=1) if len(values) > 2 else 0.0
    if spread <= 1e-12 * np.abs(values).max(initial=0.0):
        return np.zeros(count, dtype=bool)
    t = student_quantile(1 - level / (2 * count), np.array(count - 2.0))
    most = (count - 1) / np.sqrt(count) * np.sqrt(t**2 / (count - 2 + t**2))
    return np.asarray(np.abs(values - values.mean()) > most * spread)


def repeated(values: np.ndarray, known: float) -> np.ndarray:
    """Which of N values (N,) are to the last digits what another one is, or what is known: no two searches come to one
    number, so that these are where a search began, or a bound, and no estimates.
    """
    return np.asarray(np.isclose(values[:, None], [*values, known], rtol=1e-9, atol=0).sum(axis=1) > 1)


def third_differences(at: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Third divided differences (M, …) of neighbouring samples (T, …) at places (T,), as `differences` has them."""
    return differences(at, values, 3)


def differences(at: np.ndarray, values: np.ndarray, order: int) -> np.ndarray:
    """Divided differences (M, …) of some order, of neighbouring samples (T, …) at places (T,) that rise, in units of
    their σ: what is smooth is hardly left, and of faster motion less with every order. Samples with others missing
    between them, as far apart as twice as many usually are, have no say: the curve would pass for noise.
    """
    if len(at) <= order:
        return np.zeros((0, *values.shape[1:]))
    some = np.stack([at[k : len(at) - order + k] for k in range(order + 1)], axis=1)
    apart = some[:, :, None] - some[:, None] + np.eye(order + 1)  # 1 on the diagonal: left out of the product
    weight = 1 / apart.prod(axis=2)
    weight /= np.sqrt(np.square(weight).sum(axis=1, keepdims=True))
    near = some[:, order] - some[:, 0] <= 2 * np.median(some[:, order] - some[:, 0])
    parts = [(weight[near, k] * values[k : len(at) - order + k][near].T).T for k in range(order + 1)]
    return np.asarray(np.sum(parts, axis=0))


def noise_among_neighbours(at: np.ndarray, values: np.ndarray, least: float = 0.0) -> float:
    """σ of white noise on C series (T, C) at places (T,) that rise, NaN where a sample is missing: the rms of what each
    shows as its own, which is no less than `least`; NaN where none is long enough. Series without noise do not count.

    Third differences show it. Where what is measured moves fast beside the samples, much of it passes for noise in
    them: they tell by so much too much as one of the higher orders tells less of the same series, if that is no chance.
    """
    noise, share = noise_and_share(at, values, least)
    return share * noise


def noise_and_share(at: np.ndarray, values: np.ndarray, least: float = 0.0) -> tuple[float, float]:
    """What third differences show as the noise of `noise_among_neighbours`, and what share of it higher ones show."""
    third, count = noise_of_each(at, values, 3)
    if not count.any():
        return math.nan, 1.0
    third = np.maximum(third, least)
    noisy, share = (count > 0) & (third >= WITHOUT_NOISE * third[count > 0].max()), 1.0
    for order in HIGHER:
        each, differ = noise_of_each(at, values, order)
        known = noisy & (differ >= SHOWN)
        if known.any() and (before := weighted_rms(third[known], differ[known])) > 0:
            less = weighted_rms(np.maximum(each, least)[known], differ[known]) / before
            share = min(share, less) if less < 1 - BY_CHANCE / math.sqrt(differ[known].sum()) else share
    return weighted_rms(third[noisy], count[noisy]), share


def noise_of_each(at: np.ndarray, values: np.ndarray, order: int) -> tuple[np.ndarray, np.ndarray]:
    """σ of each of C series (T, C) as its differences of an order show it, (C,), 0 where it has none; and how many it
    has (C,). It is their median absolute value, which jumps hardly change; of n of them its square comes out too large
    by (order + 5)/(2n + 2), found by simulation, and of one or two as `FEW` has it.
    """
    found = differences(at, values, order)
    count = np.isfinite(found).sum(axis=0)
    each, some = np.zeros(count.shape), count > 0
    if some.any():
        n = count[some]
        too_large = np.select([n == few for few in FEW], list(FEW.values()), 1 + (order + 5) / (2 * n + 2))
        each[some] = NORMAL * np.nanmedian(np.abs(found[:, some]), axis=0) / np.sqrt(too_large)
    return each, count


def weighted_rms(values: np.ndarray, weight: np.ndarray) -> float:
    return float(np.sqrt(np.average(np.square(values), weights=weight)))


def sobol(dimensions: int, random: np.random.Generator, count: int) -> np.ndarray:
    """The first points (count, D) of a scrambled Sobol sequence in the unit cube."""
    from scipy.stats import qmc

    return qmc.Sobol(dimensions, rng=random).random(2 ** int(np.ceil(np.log2(max(count, 1)))))[:count]


def uncut_half(value: float, low: float, high: float) -> float:
    """Half the width of the interval of an error, which may have been cut at 0: the longer of its sides."""
    return max(high - value, value - low)
