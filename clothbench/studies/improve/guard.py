"""Stage 4: is it more than chance? The recording is the unit of evidence; frames of one recording hang together.

The null distribution comes from the residual itself, with its own autocorrelation, set out of step with the
candidates: moved round in time within each recording, turned about the vertical, mirrored left to right and upside
down, each recording by its own draw. The share that the best of *all* candidates then explains is what chance gives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clothbench.studies.improve.attribution import Probe
from clothbench.studies.improve.curves import CurveCase
from clothbench.studies.improve.fitting import Fitted
from clothbench.studies.improve.problem import Case

DRAWS, AT_ONCE = 199, 20
NOTHING = 1e-6  # share of a candidate's squares; less than that is rounding and the error of differences


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
    base = span_of(fitted.tangent)
    spans = []
    for probe in found:
        columns = np.vstack(probe.columns) * fitted.scale[:, None]
        spans.append(span_of(columns - base @ (base.T @ columns), np.square(columns).sum()))
    random = np.random.default_rng(seed)
    fields = [field_of(case, r) for case, r in zip(cases, fitted.residual, strict=True)]
    chance = []
    for first in range(0, DRAWS, AT_ONCE):  # of long recordings, all would not fit into memory
        drawn = [
            np.concatenate([scrambled(case, f, random) for case, f in zip(cases, fields, strict=True)])
            for _ in range(first, min(first + AT_ONCE, DRAWS))
        ]
        chance.append(explained(base, spans, np.array(drawn) * fitted.scale).max(axis=1, initial=0.0))
    return Shares(explained(base, spans, fitted.left[None])[0], np.concatenate(chance))


def span_of(columns: np.ndarray, of: float | None = None) -> np.ndarray:
    """An orthonormal basis (M, k) of what the columns (M, K) span, less what is next to nothing beside squares `of`."""
    size, turn = np.linalg.eigh(columns.T @ columns)
    kept = size > NOTHING * (size.sum() if of is None else of) + 1e-300
    return columns @ (turn[:, kept] / np.sqrt(size[kept]))


def explained(base: np.ndarray, spans: Sequence[np.ndarray], residuals: np.ndarray) -> np.ndarray:
    """(D, K): the share of each residual (D, M), less what the base takes up, that each of K spans explains."""
    total = np.square(residuals).sum(axis=1) - np.square(residuals @ base).sum(axis=1)
    # Spans are at right angles to the base, so it need not be taken from the residuals first.
    parts = [np.square(residuals @ span).sum(axis=1) for span in spans]
    return np.array(parts).reshape(len(spans), len(residuals)).T / total[:, None]


def field_of(case: Case, residual: np.ndarray) -> np.ndarray:
    """The residual (M,) back on its frames and nodes (T, N, 3), 0 where nothing was seen; a curve's as it is."""
    if isinstance(case, CurveCase):
        return residual
    out = np.zeros(case.observation.position.shape)
    out[case.observation.visible] = residual.reshape(-1, 3)
    return out


def scrambled(case: Case, field: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """The residual out of step: moved round in time, turned about the vertical, up and down exchanged or not, mirrored
    left to right or not; (M,).
    """
    if isinstance(case, CurveCase):
        return case.scrambled(field, random)
    # Round a circle of the motion and its reverse, so that no jump comes in where the end meets the beginning.
    frames = len(field)
    at = (np.arange(frames) + random.integers(2 * frames)) % (2 * frames)
    moved = field[np.minimum(at, 2 * frames - 1 - at)]
    angle = random.uniform(0, 2 * np.pi)
    c, s = np.cos(angle), np.sin(angle)
    turned = moved @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, random.choice([-1.0, 1.0])]])
    if random.random() < 0.5:
        turned = turned[:, mirror(case.observation.material)]
    return turned[case.observation.visible].ravel()


def mirror(material: np.ndarray) -> np.ndarray:
    """For every material point (N, 2) the one nearest to its mirror image, left to right."""
    low, high = material[:, 0].min(), material[:, 0].max()
    image = np.stack([low + high - material[:, 0], material[:, 1]], axis=1)
    return np.argmin(((image[:, None] - material[None]) ** 2).sum(axis=2), axis=1)
