"""Stage 4: is it more than chance? The recording is the unit of evidence; frames of one recording hang together.

The null distribution comes from the residual itself, with its own autocorrelation, set out of step with the
candidates: moved round in time within each recording, turned about the vertical and mirrored left to right, each
recording by its own draw. The share that the best of *all* candidates then explains is what chance gives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clothbench.loop.attribution import Probe, outside, weights
from clothbench.loop.fitting import Fitted
from clothbench.loop.problem import Case

DRAWS = 199


@dataclass(frozen=True, eq=False)
class Shares:
    """What each probe explains of the residual that a refit would leave, and what chance would.

    share: (K,) for K probes; chance: (D,) the largest share over all probes in each draw.
    """

    share: np.ndarray
    chance: np.ndarray

    def p_value(self, probe: int) -> float:
        return float((1 + (self.chance >= self.share[probe]).sum()) / (1 + len(self.chance)))


def shares(cases: Sequence[Case], fitted: Fitted, found: Sequence[Probe], seed: int) -> Shares:
    scale = weights(fitted.residual)
    base = np.vstack(fitted.jacobian) * scale[:, None]
    spans = []
    for probe in found:
        columns = outside(base, np.vstack(probe.columns) * scale[:, None])
        spans.append(span_of(columns))
    rest = outside(base, (np.concatenate(fitted.residual) * scale)[:, None])[:, 0]
    observed = explained(spans, rest)
    random = np.random.default_rng(seed)
    fields = [field_of(case, r) for case, r in zip(cases, fitted.residual, strict=True)]
    chance = []
    for _ in range(DRAWS):
        moved = [scrambled(case, f, random) for case, f in zip(cases, fields, strict=True)]
        other = outside(base, (np.concatenate(moved) * scale)[:, None])[:, 0]
        chance.append(explained(spans, other).max())
    return Shares(observed, np.array(chance))


def span_of(columns: np.ndarray) -> np.ndarray:
    """An orthonormal basis (M, k) of the columns; those that are nothing but rounding are left out."""
    u, s, _ = np.linalg.svd(columns, full_matrices=False)
    return u[:, s > 1e-3 * s.max(initial=0.0)] if s.size and s[0] > 0 else u[:, :0]


def explained(spans: Sequence[np.ndarray], residual: np.ndarray) -> np.ndarray:
    total = residual @ residual
    return np.array([float(np.square(q.T @ residual).sum() / total) for q in spans])


def field_of(case: Case, residual: np.ndarray) -> np.ndarray:
    """The residual (M,) back on its frames and nodes (T, N, 3), 0 where nothing was seen."""
    out = np.zeros(case.observation.position.shape)
    out[case.observation.visible] = residual.reshape(-1, 3)
    return out


def scrambled(case: Case, field: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """The residual out of step: moved round in time, turned about the vertical, mirrored or not; (M,)."""
    moved = np.roll(field, random.integers(1, len(field)), axis=0)
    angle = random.uniform(0, 2 * np.pi)
    c, s = np.cos(angle), np.sin(angle)
    turned = moved @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    if random.random() < 0.5:
        turned = turned[:, mirror(case.observation.material)]
    return turned[case.observation.visible].ravel()


def mirror(material: np.ndarray) -> np.ndarray:
    """For every material point (N, 2) the one nearest to its mirror image, left to right."""
    low, high = material[:, 0].min(), material[:, 0].max()
    image = np.stack([low + high - material[:, 0], material[:, 1]], axis=1)
    return np.argmin(((image[:, None] - material[None]) ** 2).sum(axis=2), axis=1)
