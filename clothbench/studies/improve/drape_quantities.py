"""What is read off the drapes of a specimen, side by side: see `drapes`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clothbench.core.drape import DRAPE_COEFFICIENT, Outlines, Quantity, drape_coefficient
from clothbench.core.statistics import student_above, student_quantile
from clothbench.recordings.silhouette import SIDES

QUANTITIES = (
    DRAPE_COEFFICIENT,
    Quantity("elongation", "a₂", "mm", 1e3, "second harmonic of the outline, along a line of the picture"),
)
ELONGATION = 1  # its number
CONTRASTS = (  # (in words, number of the quantity)
    ("drape coefficient, face up less face down", 0),
    ("elongation, mean of both sides", 1),
    ("elongation, half of face up less face down", 1),
)
FACES = (1, 2)  # sides, up and down
LEAST_SPECIMENS = 3
PAIRS = ("the same side of a specimen", "the two sides of a specimen", "different specimens")
PERMUTATIONS = 999
LEAST_SPREAD = np.array([0.01, 0.7e-3])  # of each quantity: what other first shapes change of a simulated drape


@dataclass(frozen=True, eq=False)
class Specimen:
    """The drapes of one specimen: means over the captures of each side.

    sides: (S,) numbers of `SIDES`, those of any recording;
    mean: (S, Q) SI, of S sides, NaN where a side was not captured; known: (S, Q) bool, where it was, M times in all;
    spread: (M,) between specimens, SI; labels: (M,) in words; across: (S,) m, the elongation's other part, along lines
    that lie halfway between, which is 0 in the mean where drapes are long along a thread.
    """

    sides: tuple[int, ...]
    mean: np.ndarray
    known: np.ndarray
    spread: np.ndarray
    labels: tuple[str, ...]
    across: np.ndarray


def elongation(radius: np.ndarray) -> np.ndarray:
    """A exp(2iψ) m of outlines (..., K) m: r(φ) has the second harmonic A cos 2(φ − ψ)."""
    turn = 2 * np.pi * np.arange(radius.shape[-1]) / radius.shape[-1]
    return 2 * np.mean(radius * np.exp(2j * turn), axis=-1)


def specimens_of(
    seen: Sequence[Outlines], side: Sequence[np.ndarray], fitted: Sequence[bool]
) -> tuple[list[list[tuple[int, Specimen]]], tuple[int, ...]]:
    """The specimens of each of several recordings of one fabric, by number; and which sides were up in any.

    fitted: which recordings are to be fitted. The line along which drapes are long is taken from these alone; specimens
    are taken to lie with their threads along the same lines of the picture, and to be turned over about a thread.
    """
    sides = tuple(sorted({int(s) for each in side for s in each}))
    values = [
        np.stack([drape_coefficient(o.radius, o.plate_radius, o.disc_radius), elongation(o.radius)], axis=1)
        for o in seen
    ]
    means: list[dict[int, np.ndarray]] = [
        {int(k): _means(v[o.sample == k], s[o.sample == k], sides) for k in np.unique(o.sample)}
        for o, v, s in zip(seen, values, side, strict=True)
    ]
    # A side that only recordings held out have says nothing of the line.
    captured = np.isin(sides, np.concatenate([s for s, fit in zip(side, fitted, strict=True) if fit]))
    known = np.stack([m[captured] for each, fit in zip(means, fitted, strict=True) if fit for m in each.values()])
    turn = line_of(known[..., 1])
    spread = spread_of(np.stack([_along(m, turn) for m in known]))
    return [[(k, _specimen(m, turn, spread, sides)) for k, m in each.items()] for each in means], sides


def alike(seen: Sequence[Outlines], side: Sequence[np.ndarray], seed: int) -> list[dict[str, Any]]:
    """How much the captures of one fabric look like each other in the picture: mean correlation of their outlines over
    pairs of the same side of a specimen, of its two sides, and of different specimens; and how often captures dealt out
    to specimens and sides by chance correlate as much.

    Drapes that are laid on anew fold anew. Where captures of one side do not, folds are remembered, or the cloth was
    not laid on anew; the pictures do not tell which, and the captures are not as many drapes.
    """
    radius = np.concatenate([o.radius - o.radius.mean(axis=1, keepdims=True) for o in seen])
    shape = radius / np.maximum(np.linalg.norm(radius, axis=1, keepdims=True), 1e-300)
    correlation = shape @ shape.T
    numbers = [np.stack([np.full(len(o.sample), n), o.sample], axis=1) for n, o in enumerate(seen)]
    specimen = np.unique(np.concatenate(numbers), axis=0, return_inverse=True)[1].ravel()
    up = np.concatenate([np.asarray(s) for s in side])
    upper = np.triu(np.ones(correlation.shape, dtype=bool), 1)
    same, turned = specimen[:, None] == specimen, up[:, None] != up
    rows, random = [], np.random.default_rng(seed)
    for name, pairs in zip(PAIRS, (same & ~turned & upper, same & turned & upper, ~same & upper), strict=True):
        if not pairs.any():
            continue
        mean, at_least = float(correlation[pairs].mean()), 1
        for _ in range(PERMUTATIONS):
            order = random.permutation(len(correlation))
            at_least += bool(correlation[np.ix_(order, order)][pairs].mean() >= mean)
        p_value = at_least / (PERMUTATIONS + 1)
        rows.append({"pairs": name, "number": int(pairs.sum()), "correlation": mean, "p_value": p_value})
    return rows


def contrasts(field: np.ndarray, sides: Sequence[int]) -> np.ndarray:
    """What symmetry forbids, of quantities (..., S, Q) of S `sides`: what `CONTRASTS` name (..., C), NaN where a side
    is not known; between faces only where it was told which was up.
    """
    covers, long = field[..., 0], field[..., 1]
    if not set(FACES) <= set(sides):
        nothing = np.full(long.shape[:-1], np.nan)
        return np.stack([nothing, long.mean(-1), nothing], axis=-1)
    up, down = (list(sides).index(face) for face in FACES)
    halves = long[..., up] / 2, long[..., down] / 2
    return np.stack([covers[..., up] - covers[..., down], halves[0] + halves[1], halves[0] - halves[1]], axis=-1)


def asymmetries(specimens: Sequence[Specimen], line_from_these: bool = True) -> list[dict[str, Any]]:
    """What the drapes themselves say, without any model: mean of each contrast over specimens with its 95 % interval
    along the line, and p. None of it could be if faces and threads were alike. line_from_these: as in `contrast_means`.
    """
    if len(specimens) < LEAST_SPECIMENS:  # none at all where nothing was held out
        return []
    across = [s.across for s in specimens] if line_from_these else None
    means, rows = contrast_means([s.mean for s in specimens], specimens[0].sides, across), []
    half, p_value = means.half_width(0.05), means.p_value
    for k, (name, quantity) in enumerate(CONTRASTS):
        if means.number[k] < LEAST_SPECIMENS:
            continue
        mean, q = means.mean[k], QUANTITIES[quantity]
        rows.append(
            {"contrast": name, "mean": q.scale * mean, "low": q.scale * (mean - half[k]),
             "high": q.scale * (mean + half[k]), "unit": q.unit, "p_value": float(p_value[k]),
             "number": int(means.number[k])}
        )  # fmt: skip
    return rows


@dataclass(frozen=True, eq=False)
class ContrastMeans:
    """Means (C,) of contrasts over specimens, SI, 0 where too few are known; their standard errors (C,), which no row
    of drapes that happen to be alike makes smaller than first shapes do; number (C,) of specimens; p_value (C,) of
    means of 0.
    """

    mean: np.ndarray
    error: np.ndarray
    number: np.ndarray
    p_value: np.ndarray

    def half_width(self, level: float) -> np.ndarray:
        """Half of the interval (C,) outside of which chance leads with a probability of `level`."""
        return -student_quantile(level / 2, np.maximum(self.number - 1, 1)) * self.error


def contrast_means(
    fields: Sequence[np.ndarray], sides: Sequence[int], across: Sequence[np.ndarray] | None = None
) -> ContrastMeans:
    """Of quantities, or what a model leaves of them, (S, Q) SI of each specimen; a side of `sides` (S,) that none of
    them has is left out.

    p is Student's. Where the line was chosen from these specimens, along which they are then long by chance already,
    across: (S,) m of each; p of an elongation is that of both its parts together, whatever the line.
    """
    captured = np.isfinite(fields).any(axis=(0, 2))
    seen, sides = np.stack([field[captured] for field in fields]), np.array(sides)[captured].tolist()
    values = contrasts(seen, sides)
    number = np.isfinite(values).sum(axis=0)
    values = np.where(number >= LEAST_SPECIMENS, values, 0.0)
    least = LEAST_SPREAD[[quantity for _, quantity in CONTRASTS]]
    spread = np.maximum(np.nanstd(values, axis=0, ddof=1), least)
    mean, error = np.nanmean(values, axis=0), spread / np.sqrt(np.maximum(number, 1))
    p_value = 2 * student_above(np.abs(mean) / error, np.maximum(number - 1, 1))
    if across is not None:
        other = contrasts(np.stack([seen[..., 0], np.stack([each[captured] for each in across])], axis=-1), sides)
        for k, (_, quantity) in enumerate(CONTRASTS):
            if quantity == ELONGATION and number[k] >= LEAST_SPECIMENS:
                p_value[k] = beside_nothing(np.stack([values[:, k], other[:, k]], axis=1), least[k])
    return ContrastMeans(mean, error, number, p_value)


def beside_nothing(pairs: np.ndarray, least: float) -> float:
    """p of a mean of 0 of pairs (N, 2): Hotelling's T², (N − 2)/(2(N − 1)) T² as F(2, N − 2), which is the same for
    every line. least: spread below which none is taken to be.
    """
    pairs = pairs[np.isfinite(pairs).all(axis=1)]
    count, mean = len(pairs), pairs.mean(axis=0)
    variance, axes = np.linalg.eigh(np.cov(pairs.T))
    square = count * float(np.sum((mean @ axes) ** 2 / np.maximum(variance, least**2)))
    return float((1 + square / (count - 1)) ** (-(count - 2) / 2))


def line_of(elongations: np.ndarray) -> complex:
    """exp(2iψ) of the line along which, or across which, specimens (N, S) complex m are long on each side: the
    principal axis of the sides' means.
    """
    mean = np.nanmean(elongations, axis=0)
    square = complex(np.sum(mean**2))
    return np.sqrt(square) / np.sqrt(abs(square)) if square else 1.0 + 0j


def spread_of(values: np.ndarray) -> np.ndarray:
    """Standard deviation between specimens (N, S, Q) of one side, pooled over sides (Q,)."""
    count = np.isfinite(values).sum(axis=0)
    away = values - np.nanmean(values, axis=0)
    freedom = np.maximum(count - 1, 0).sum(axis=0)
    squares = np.nansum(away**2, axis=(0, 1))
    return np.maximum(np.sqrt(np.divide(squares, freedom, out=np.zeros_like(squares), where=freedom > 0)), LEAST_SPREAD)


def _means(values: np.ndarray, side: np.ndarray, sides: Sequence[int]) -> np.ndarray:
    """Means (S, Q) complex over the captures (T, Q) of each side, NaN where there is none."""
    empty = np.full(values.shape[1], np.nan + 0j)
    return np.stack([values[side == s].mean(axis=0) if (side == s).any() else empty for s in sides])


def _along(mean: np.ndarray, turn: complex) -> np.ndarray:
    """Means (S, Q) with the elongation along the line that `turn` stands for."""
    return np.stack([mean[:, 0].real, (mean[:, 1] / turn).real], axis=1)


def _specimen(seen: np.ndarray, turn: complex, spread: np.ndarray, sides: Sequence[int]) -> Specimen:
    mean = _along(seen, turn)
    known = np.isfinite(mean)
    at = np.argwhere(known)
    words = {0: "", 1: " face up", 2: " face down"}
    assert set(words) == set(SIDES)
    labels = tuple(QUANTITIES[q].name.replace("_", " ") + words[sides[s]] for s, q in at)
    return Specimen(tuple(sides), mean, known, spread[at[:, 1]], labels, (seen[:, 1] / turn).imag)
