"""Stage 4: is it more than chance? A permutation test with the max-statistic over all candidates.

The recording is the unit of evidence; frames of one recording hang together. The null distribution comes from the
residual itself, with its own autocorrelation, set out of step with the candidates, each recording by its own draw
(`Case.surrogates`). The share of its variance that the best of *all* candidates then explains is what chance gives
(Westfall and Young 1993, Resampling-based multiple testing).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from clothbench.studies.improve.attribution import Probe
from clothbench.studies.improve.evidence import Case
from clothbench.studies.improve.fitted import Fitted
from clothbench.studies.improve.settings import LOOP


@dataclass(frozen=True, eq=False)
class PermutationTest:
    """What each probe explains of the residual that a refit of the base would leave, and what chance would.

    explained: (K,), share of the variance that each of K probes explains;
    null: (D, K), the same of each of D surrogates.
    """

    explained: np.ndarray
    null: np.ndarray

    @cached_property
    def null_maxima(self) -> np.ndarray:
        """(D,) the largest share over all probes in each surrogate."""
        return self.null.max(axis=1, initial=0.0)

    def p_value(self, probe: int) -> float:
        return float((1 + (self.null_maxima >= self.explained[probe]).sum()) / (1 + len(self.null_maxima)))

    def p_alone(self, probes: Sequence[int]) -> float:
        """Of the best of these probes, over them alone: for an effect that was asked about before it was looked for."""
        mine = list(probes)
        at_least = self.null[:, mine].max(axis=1) >= self.explained[mine].max()
        return float((1 + at_least.sum()) / (1 + len(at_least)))

    @property
    def least(self) -> float:
        """The p-value of the most that chance can do: of few cases with few surrogates, many draws are the same."""
        most = self.null_maxima.max(initial=0.0) * (1 - 1e-9)
        return float((1 + (self.null_maxima >= most).sum()) / (1 + len(self.null_maxima)))

    def why_not(self, p_value: float) -> str:
        """Why a candidate with that p-value is not told from chance; "" if it is."""
        if p_value < LOOP.significance:
            return ""
        if self.least >= LOOP.significance:
            return f"too few to tell: here no p can lie below {self.least:.2g} (p = {p_value:.2g})"
        return f"explains no more than chance would (p = {p_value:.2g})"


def permutation_test(
    cases: Sequence[Case],
    fitted: Fitted,
    found: Sequence[Probe],
    seed: int,
    least_own: float = 0.0,
    least_cases: int = 1,
) -> PermutationTest:
    """The test of these probes beside the `fitted` base. least_own: as in `SearchSettings`; least_cases: of how many
    recordings chance is told at least; of fewer nothing is told from it (p = 1).
    """
    base = span_of(fitted.weighted_jacobian)
    spans = []
    for probe in found:
        columns = np.vstack(probe.columns) * fitted.weights[:, None]
        spans.append(span_of(columns - base @ (base.T @ columns), np.square(columns).sum(), least_own))
    explained = explained_variance(base, spans, fitted.weighted_residual[None])[0]
    if len(cases) < least_cases:
        return PermutationTest(explained, np.full((LOOP.permutations, len(found)), np.inf))
    random = np.random.default_rng(seed)
    draws = [case.surrogates(r) for case, r in zip(cases, fitted.residual, strict=True)]
    null, count, batch = [], LOOP.permutations, LOOP.permutation_batch
    for first in range(0, count, batch):  # of long recordings, all would not fit into memory
        drawn = [np.concatenate([draw(random) for draw in draws]) for _ in range(first, min(first + batch, count))]
        null.append(explained_variance(base, spans, np.array(drawn) * fitted.weights))
    return PermutationTest(explained, np.concatenate(null))


def span_of(columns: np.ndarray, of: float | None = None, least: float = 0.0) -> np.ndarray:
    """An orthonormal basis (M, k) of what the columns (M, K) span, less what is next to nothing beside squares `of`, or
    less than the share `least` of them.
    """
    size, turn = np.linalg.eigh(columns.T @ columns)
    kept = size > max(LOOP.rank_tolerance, least) * (size.sum() if of is None else of) + 1e-300
    return columns @ (turn[:, kept] / np.sqrt(size[kept]))


def explained_variance(base: np.ndarray, spans: Sequence[np.ndarray], residuals: np.ndarray) -> np.ndarray:
    """(D, K): the share of each residual (D, M), less what the base takes up, that each of K spans explains."""
    total = np.square(residuals).sum(axis=1) - np.square(residuals @ base).sum(axis=1)
    # Spans are at right angles to the base, so it need not be taken from the residuals first.
    parts = [np.square(residuals @ span).sum(axis=1) for span in spans]
    return np.array(parts).reshape(len(spans), len(residuals)).T / total[:, None]
