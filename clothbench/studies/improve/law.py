"""The law of a missing force: the sparsest sum of terms that predicts it on recordings left out, beside chance.

Its error on recordings left out is also what the terms are chosen by, and so somewhat too small.

The force itself comes from the balance of torques (`balance`), without a model. Damping of all motion alike is taken
away first, since every model has some. Terms join one by one (forward selection), each for what it takes off the error
on recordings left out; whether the first of them beats chance is asked of the same series set out of step in time
(surrogate data, with the max-statistic over all terms, as `permutation` does for effects).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clothbench.core.optional import law_of_force
from clothbench.core.statistics import jackknife_half_width
from clothbench.studies.improve.balance import Term, terms
from clothbench.studies.improve.motion import Motion, steady_axes
from clothbench.studies.improve.settings import LOOP

MOST_TERMS = 3
LEAST_SHARE = 0.5  # of what stands above the noise on recordings left out, that a law has to take off
LEAST_FALL = 0.05  # the same of each further term
ALIKE = 0.98  # of what the first term takes off
SWELL = 0.5  # s, over which the size of a series is taken
LEAST_SWELL = 0.02  # of a series' rms


@dataclass(frozen=True)
class Amount:
    """The coefficient of a term with its 95 % interval, in the term's unit."""

    term: Term
    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Law:
    """What a missing force goes with.

    amounts: of its terms; damping: kg/(m²·s), of all motion alike, beside them; p_value: of the first term, over all;
    before, after: N·m rms of the torque on recordings left out, by which the terms were chosen, without and with the
    law; noise: N·m, σ of the torque; alike: other terms that alone would predict as much as the first, within `ALIKE`.
    """

    amounts: tuple[Amount, ...]
    damping: float
    p_value: float
    before: float
    after: float
    noise: float
    alike: tuple[Term, ...] = ()

    @property
    def formula(self) -> str:
        """ "f = −0.64 |v_n| v_n n" with the amounts in place of k: all forces, and what else is said of them after."""
        parts: list[str] = []
        beside: list[str] = []
        for amount in self.amounts:
            force, _, equation = amount.term.formula.partition(", ")
            negative = force.startswith("−") != (amount.value < 0)
            body = force.removeprefix("−").replace("k", f"{abs(amount.value):.3g}", 1)
            parts.append(("−" if negative else "+" if parts else "") + (" " if parts else "") + body)
            beside += [equation] if equation else []
        return ", ".join(["f = " + " ".join(parts), *beside])


@dataclass(frozen=True, eq=False)
class Series:
    """The torques of several recordings, each with the same say. missing: (T,) N·m of each; damping: of each, at
    1 kg/(m²·s); columns: (T, K) of each, of K terms at a coefficient of 1; noise: N·m; step: s, between two values;
    slot (K,) and positive (K,): see `Term`.
    """

    missing: list[np.ndarray]
    damping: list[np.ndarray]
    columns: list[np.ndarray]
    noise: float
    step: float
    slot: list[int]
    positive: np.ndarray

    def allowed(self, chosen: Sequence[int]) -> bool:
        """Whether the chosen terms come to no negative mass."""
        return bool((self.amounts(chosen)[1:][self.positive[list(chosen)]] >= 0).all())

    def damped(self, chosen: Sequence[int]) -> bool:
        """Whether what is beside the chosen terms is damping, or may be none: a term that makes up for what brings
        energy in describes nothing.
        """
        damping = self.amounts(chosen)[0]
        return bool(damping >= 0 or damping + jackknife(self, chosen)[0] >= 0)

    def errors(self, chosen: Sequence[int], missing: Sequence[np.ndarray] | None = None) -> np.ndarray:
        """(R,) mean square on each recording, of a fit to all others with the chosen terms."""
        given = self.missing if missing is None else missing
        parts = [self._equations(r, chosen, given[r]) for r in range(len(given))]
        hessian, gradient = (np.sum([part[k] for part in parts], axis=0) for k in range(2))
        out = []
        for r, (own_hessian, own_gradient) in enumerate(parts):
            solution = solved(hessian - own_hessian, gradient - own_gradient)
            out.append(np.mean((given[r] - self._design(r, chosen) @ solution) ** 2))
        return np.array(out)

    def amounts(self, chosen: Sequence[int], without: int | None = None) -> np.ndarray:
        """(1 + C,) the damping and the coefficients of the chosen terms, from all recordings or all but one."""
        parts = [self._equations(r, chosen, q) for r, q in enumerate(self.missing) if r != without]
        return solved(*(np.sum([part[k] for part in parts], axis=0) for k in range(2)))

    def _design(self, r: int, chosen: Sequence[int]) -> np.ndarray:
        return np.column_stack([self.damping[r], self.columns[r][:, list(chosen)]])

    def _equations(self, r: int, chosen: Sequence[int], missing: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        design = self._design(r, chosen)
        return design.T @ design / len(missing), design.T @ missing / len(missing)


def solved(hessian: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """Least squares whose columns differ in size by orders of magnitude."""
    scale = np.sqrt(np.maximum(np.diag(hessian), 1e-300))
    return np.linalg.lstsq(hessian / np.outer(scale, scale), gradient / scale, rcond=1e-8)[0] / scale


def law_of(motions: Sequence[Motion], seed: int = 0) -> Law | None:
    """The law of what acts on the sheet from outside beside damping; None where nothing beats chance, explains enough,
    or can be told from fewer than three recordings.
    """
    if len(motions) < LOOP.least_recordings:
        return None
    known = [term for term in terms(steady_axes(motions)) if all(m.sees(term.force(m)) for m in motions)]
    series = Series(
        [m.missing[m.counted] for m in motions], [m.torque(-m.v)[m.counted] for m in motions],
        [np.column_stack([m.torque(term.force(m)) for term in known])[m.counted] for m in motions],
        float(np.sqrt(np.mean([m.missing_sigma**2 for m in motions]))),
        float(np.median(np.concatenate([np.diff(m.time) for m in motions]))),
        [term.slot for term in known], np.array([term.positive for term in known]),
    )  # fmt: skip
    before = series.errors(())
    above = before.mean() - series.noise**2
    if rms(before) <= LOOP.floor_factor * series.noise:
        return None
    chosen, after = selected(series, before)
    if not chosen or before.mean() - after.mean() < LEAST_SHARE * above:
        return None
    p_value = chance(series, chosen[0], before, seed)
    damping, *values = series.amounts(chosen)
    half = jackknife(series, chosen)[1:]
    if p_value >= LOOP.significance or (np.abs(values) <= half).any():
        return None
    amounts = tuple(
        Amount(known[k], float(v), float(v - h), float(v + h)) for k, v, h in zip(chosen, values, half, strict=True)
    )
    alike = tuple(known[k] for k in as_good_as(series, chosen[0], before))
    return Law(amounts, float(damping), p_value, rms(before), rms(after), series.noise, alike)


def as_good_as(series: Series, first: int, before: np.ndarray) -> list[int]:
    """Other terms that alone take off as much as the first does, or next to it: powers of one velocity can hardly be
    told apart.
    """

    def fall(term: int) -> float:
        return float(before.mean() - series.errors([term]).mean())

    others = [k for k in range(len(series.slot)) if k != first and series.allowed([k])]
    return [k for k in others if fall(k) >= ALIKE * fall(first)]


def told_by(law: Law | None, effect: Any) -> bool:
    """Whether an effect's force goes with what the law's first term goes with, which is the one that beats chance, or
    with what cannot be told from that.
    """
    if law is None or not (mine := law_of_force(effect)):
        return False
    return mine in {term.law for term in (law.amounts[0].term, *law.alike)}


def rms(squares: np.ndarray) -> float:
    return float(np.sqrt(squares.mean()))


def selected(series: Series, before: np.ndarray) -> tuple[list[int], np.ndarray]:
    """Terms by their numbers, as long as each helps in all recordings but one and takes off enough; and the mean square
    with them on each recording (R,).
    """
    chosen: list[int] = []
    errors, count = before, series.columns[0].shape[1]
    for _ in range(MOST_TERMS):
        taken = {series.slot[k] for k in chosen}
        free = [[*chosen, k] for k in range(count) if series.slot[k] not in taken]
        rest = [new[-1] for new in free if series.allowed(new) and series.damped(new)]
        if not rest:
            break
        found = {k: series.errors([*chosen, k]) for k in rest}
        best = min(found, key=lambda k: found[k].mean())
        above = max(before.mean() - series.noise**2, 0.0)
        least = (LEAST_FALL if chosen else LOOP.least_explained) * above
        helped = (found[best] < errors).sum() >= len(errors) - 1
        value, half = series.amounts([*chosen, best])[-1], jackknife(series, [*chosen, best])[-1]
        if not helped or abs(value) <= half or errors.mean() - found[best].mean() < max(least, 1e-300):
            break
        chosen, errors = [*chosen, best], found[best]
    return chosen, errors


def chance(series: Series, first: int, before: np.ndarray, seed: int) -> float:
    """p: how often the best single term predicts as much as the `first` does, of series out of step with the motion."""
    random, count = np.random.default_rng(seed), series.columns[0].shape[1]

    def best(drawn: Sequence[np.ndarray]) -> float:
        null = series.errors((), drawn).mean()
        return max(1 - series.errors([k], drawn).mean() / null for k in range(count))

    damping = series.amounts(())[0]
    rest = [q - damping * d for q, d in zip(series.missing, series.damping, strict=True)]
    found, at_least = 1 - series.errors([first]).mean() / before.mean(), 1
    # A burst set elsewhere meets nothing that moves, and no term explains it: what chance does would look like little.
    swells = [swell_of(r, max(1, round(SWELL / series.step))) for r in rest]
    for _ in range(LOOP.permutations):
        drawn = [out_of_step(r, swell, random) for r, swell in zip(rest, swells, strict=True)]
        at_least += bool(best(drawn) >= found)
    return at_least / (1 + LOOP.permutations)


def out_of_step(values: np.ndarray, swell: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """The series (T,) moved round in time, and either sign; as large as it is, `swell` (T,), where it is so."""
    return random.choice([-1.0, 1.0]) * swell * moved_round(values / swell, random)


def swell_of(values: np.ndarray, count: int) -> np.ndarray:
    """(T,) how large a series (T,) is about each of its values: rms over so many, and never next to nothing."""
    from scipy.ndimage import uniform_filter1d

    square = uniform_filter1d(np.square(values), min(count, len(values)), mode="nearest")
    return np.sqrt(np.maximum(square, LEAST_SWELL**2 * np.mean(values**2)) + 1e-300)


def moved_round(values: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Values (T, ...) moved round a circle of themselves and their reverse: no jump comes in where the end meets the
    beginning.
    """
    at = (np.arange(len(values)) + random.integers(2 * len(values))) % (2 * len(values))
    return values[np.minimum(at, 2 * len(values) - 1 - at)]


def jackknife(series: Series, chosen: Sequence[int]) -> np.ndarray:
    """(1 + C,) half widths of 95 % intervals: how far the amounts move when one recording is left out."""
    moved = np.array([series.amounts(chosen, without=r) for r in range(len(series.missing))])
    return jackknife_half_width(moved - moved.mean(axis=0))
