"""Fitted parameters as the page judges them: what the data determine, and whether a known truth was found."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from clothbench.display.html import group

Rows = Sequence[dict[str, Any]]
WIDE = 0.5  # share of the range that was searched from which on an interval determines nothing
FAR = 30.0  # times the lower end that the upper one is, from which on a range is seen on a logarithmic axis


@dataclass(frozen=True)
class Estimate:
    """One parameter of one cell. low, high: its 95 % interval, which holds the value; lower, upper: the range that was
    searched; log: whether that is walked in powers; all in `unit`, None where not known; condition: of the cell's fit.
    """

    key: str
    name: str
    symbol: str
    unit: str
    meaning: str
    value: float | None
    low: float | None
    high: float | None
    lower: float | None
    upper: float | None
    log: bool
    at_bound: bool
    truth: float | None
    condition: float | None = None

    def place(self, value: float) -> float:
        """Where a value stands in the range that was searched, from 0 to 1."""
        assert self.lower is not None
        assert self.upper is not None
        ends = [self.lower, self.upper, min(max(value, self.lower), self.upper)]
        low, high, at = map(math.log, ends) if self.log else ends
        return (at - low) / (high - low) if high > low else 0.0

    @property
    def share(self) -> float | None:
        """The part of the range that its interval covers."""
        if None in (self.low, self.high, self.lower, self.upper):
            return None
        return self.place(self.high or 0.0) - self.place(self.low or 0.0)

    @property
    def why_not(self) -> str:
        """Why the data do not determine it; nothing where they do."""
        if self.value is None:
            return "no value"
        if self.low is None or self.high is None:
            return "no interval"
        if self.at_bound:
            return "at its bound, which chose it and not the data"
        if self.share is not None and self.share >= WIDE:
            return "any value of the range would do" if self.share > 0.99 else (
                f"its interval covers {self.share:.0%} of the range"
            )  # fmt: skip
        return ""

    @property
    def determined(self) -> bool:
        return not self.why_not

    @property
    def found(self) -> bool | None:
        """Whether the interval of a determined parameter holds the truth; None where that is not known."""
        if self.truth is None or not self.determined or self.low is None or self.high is None:
            return None
        return self.low <= self.truth <= self.high


def estimates(parameters: Rows) -> list[Estimate]:
    """Every row of the table of parameters; where an older version kept no range, the widest interval stands for it."""
    ranges = {name: _widest(some) for name, some in group(parameters, lambda p: p["name"]).items()}
    return [_estimate(p, ranges[p["name"]]) for p in parameters]


def _estimate(p: dict[str, Any], widest: tuple[float | None, float | None]) -> Estimate:
    searched = p.get("lower"), p.get("upper")
    lower, upper = next((ends for ends in (searched, widest) if _is_range(*ends)), (None, None))
    far = lower is not None and upper is not None and 0 < lower < upper / FAR
    log = lower is not None and lower > 0 and (p["scale"] == "log" if p.get("scale") else far)
    low, high = contained(p["value"], p["low"], p["high"])
    return Estimate(
        p["key"], p["name"] or "–", p["symbol"], p["unit"], p["meaning"], p["value"], low, high, lower, upper, log,
        bool(p["at_bound"]), p.get("truth"), p.get("condition"),
    )  # fmt: skip


def _is_range(lower: float | None, upper: float | None) -> bool:
    return lower is not None and upper is not None and -math.inf < lower < upper < math.inf


def _widest(some: Rows) -> tuple[float | None, float | None]:
    ends = [p[n] for p in some for n in ("low", "high", "value", "truth") if p.get(n) is not None]
    return (min(ends), max(ends)) if ends else (None, None)


def contained(value: float | None, low: float | None, high: float | None) -> tuple[float | None, float | None]:
    """An interval widened to hold its value: one of an older version may leave it out by a little."""
    if value is None or low is None or high is None:
        return low, high
    return min(low, value), max(high, value)
