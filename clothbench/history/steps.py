"""Steps of a series: where its level changed by more than noise does.

Values y of n commits, with a noise σ that is the same for all. PELT (Killick, Fearnhead and Eckley 2012, Optimal
detection of changepoints with a linear computational cost), by `ruptures`, cuts them so that Σ (y − mean of the part)²
/ σ² + penalty · cuts is the least there is. A cut at a given place lowers the sum by z², z being the difference of both
means in units of its standard error; noise alone exceeds χ²₁(1 − α / (n − 1)) at one of the n − 1 places in at most α
of all series, and that is the penalty. Steps that are within the slack of the gate are then taken back, smallest first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clothbench.core.errors import ClothbenchError

ALPHA = 0.01  # share of series without any step in which one is told
NORMAL = 1.959964  # half-width of a 95 % interval, in σ
FEWEST = 6  # values from which on their own scatter tells a noise
SCATTER = 1.4826 / 2**0.5  # σ of normal values over the median |difference| of neighbours
NOTHING = 1e-12  # share of the largest value that counts as no noise at all


@dataclass(frozen=True)
class Step:
    """at: number of the first value of the new level; before, after: both levels; half: of the 95 % interval of their
    difference; all in the unit of the values.
    """

    at: int
    before: float
    after: float
    half: float


def steps_of(values: Sequence[float], sigma: float, slack: float, absolute: float = 0.0) -> list[Step]:
    """The steps of a series of finite values with a noise sigma.

    slack: share of the level before that is no step, and absolute: what is none whatever the level.
    """
    y = np.asarray(values, dtype=float)
    if len(y) < 2:
        return []
    cuts = _cuts(y, max(sigma, NOTHING * float(np.abs(y).max()), np.finfo(float).tiny))
    while cuts:
        steps = _steps(y, cuts, sigma)
        sizes = [abs(s.after - s.before) / (slack * abs(s.before) + absolute + np.finfo(float).tiny) for s in steps]
        smallest = int(np.argmin(sizes))
        if sizes[smallest] > 1.0:
            return steps
        del cuts[smallest]
    return []


def noise_of(values: Sequence[float], halves: Sequence[float]) -> float | None:
    """σ of a series: what its 95 % intervals say or how its values scatter, whichever is more; None where neither is
    known. halves: half-widths, NaN where there is none. Scatter is of neighbours, so that a step does not count.
    """
    known = np.asarray(halves, dtype=float)
    stated = float(np.median(known[np.isfinite(known)])) / NORMAL if np.isfinite(known).any() else None
    scatter = SCATTER * float(np.median(np.abs(np.diff(values)))) if len(values) >= FEWEST else None
    return max((sigma for sigma in (stated, scatter) if sigma is not None), default=None)


def _cuts(y: np.ndarray, sigma: float) -> list[int]:
    from scipy.stats import chi2

    try:
        import ruptures
    except ImportError as fault:
        raise ClothbenchError(
            "steps of a history are found by ruptures, which is not installed: pip install 'clothbench[history]'"
        ) from fault
    penalty = float(chi2.isf(ALPHA / (len(y) - 1), 1))
    search = ruptures.Pelt(model="l2", min_size=1, jump=1).fit(((y - y.mean()) / sigma)[:, None])
    return search.predict(pen=penalty)[:-1]


def _steps(y: np.ndarray, cuts: list[int], sigma: float) -> list[Step]:
    parts = np.split(y, cuts)
    return [
        Step(at, float(a.mean()), float(b.mean()), NORMAL * sigma * (1 / len(a) + 1 / len(b)) ** 0.5)
        for at, a, b in zip(cuts, parts, parts[1:], strict=False)
    ]
