"""Steps of a series: where its level changed by more than noise does.

Values y of n commits, with a noise σ that is the same for all. PELT (Killick, Fearnhead and Eckley 2012, Optimal
detection of changepoints with a linear computational cost), by `ruptures`, cuts them so that Σ (y − mean of the part)²
/ σ² + penalty · cuts is the least there is. A cut at a given place lowers the sum by z², z being the difference of both
means in units of its standard error; noise alone exceeds χ²₁(1 − α / (n − 1)) at one of the n − 1 places in at most α
of all series, and that is the penalty. Where σ is estimated from the scatter of these very values, the quantile is that
of F with as many degrees of freedom as the estimate is worth: `FREEDOM` for each value. It was found by simulation: of
4,000 to 40,000 series of normal values for each of twelve n from 6 to 60 the 99 % quantile of the penalty that leaves
no cut is that of F with 0.57 (n = 40) to 0.72 degrees of freedom for each value, and with more at n = 60. Steps that
are within the slack of the gate are then taken back, smallest first.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.statistics import NORMAL, fisher_quantile, student

ALPHA = 0.01  # share of series without any step in which one is told
WIDE = 1.959964  # half-width of a 95 % interval, in σ
FEWEST = 6  # values from which on their own scatter tells a noise
SCATTER = NORMAL / 2**0.5  # σ of normal values over the median |difference| of neighbours
FREEDOM = 0.58  # degrees of freedom of the scatter for each value, see above
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


def steps_of(
    values: Sequence[float], sigma: float, slack: float, absolute: float = 0.0, freedom: float = math.inf
) -> list[Step]:
    """The steps of a series of finite values with a noise sigma.

    slack: share of the level before that is no step, and absolute: what is none whatever the level; freedom: degrees of
    freedom of sigma, infinite where it is known.
    """
    y = np.asarray(values, dtype=float)
    if len(y) < 2:
        return []
    cuts = _cuts(y, max(sigma, NOTHING * float(np.abs(y).max()), np.finfo(float).tiny), freedom)
    while cuts:
        steps = _steps(y, cuts, sigma, freedom)
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
    return max((sigma for sigma in _noises(values, halves) if sigma is not None), default=None)


def freedom_of(values: Sequence[float], halves: Sequence[float]) -> float:
    """Degrees of freedom of `noise_of`: infinite where the intervals decide, few where few values' scatter does."""
    stated, scatter = _noises(values, halves)
    if scatter is None or (stated is not None and stated >= scatter):
        return math.inf
    return FREEDOM * len(values)


def _noises(values: Sequence[float], halves: Sequence[float]) -> tuple[float | None, float | None]:
    """σ by the intervals, and by the scatter; None where it is not known."""
    known = np.asarray(halves, dtype=float)
    stated = float(np.median(known[np.isfinite(known)])) / WIDE if np.isfinite(known).any() else None
    return stated, SCATTER * float(np.median(np.abs(np.diff(values)))) if len(values) >= FEWEST else None


def _cuts(y: np.ndarray, sigma: float, freedom: float) -> list[int]:
    from scipy.stats import chi2

    try:
        import ruptures
    except ImportError as fault:
        raise ClothbenchError(
            "steps of a history are found by ruptures, which is not installed: pip install 'clothbench[history]'"
        ) from fault
    share = ALPHA / (len(y) - 1)
    penalty = float(chi2.isf(share, 1)) if math.isinf(freedom) else fisher_quantile(1 - share, 1, freedom)
    search = ruptures.Pelt(model="l2", min_size=1, jump=1).fit(((y - y.mean()) / sigma)[:, None])
    return search.predict(pen=penalty)[:-1]


def _steps(y: np.ndarray, cuts: list[int], sigma: float, freedom: float) -> list[Step]:
    parts, wide = np.split(y, cuts), WIDE if math.isinf(freedom) else student(freedom)
    return [
        Step(at, float(a.mean()), float(b.mean()), wide * sigma * (1 / len(a) + 1 / len(b)) ** 0.5)
        for at, a, b in zip(cuts, parts, parts[1:], strict=False)
    ]
