"""How the page of calibrations says numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from clothbench.studies.calibration.ranking import Overall


def size(value: float | None) -> str:
    """Three digits: "0.00012", "3.68", "1130"; a dash where there is no number."""
    if value is None or not math.isfinite(value):
        return "–"
    if value == 0 or 1e-3 <= abs(value) < 1e5:
        digits = 2 if value == 0 else max(0, 2 - math.floor(math.log10(abs(value))))
        return f"{value:.{digits}f}"
    return f"{value:.2e}".replace("e-0", "e-").replace("e+0", "e")


def counted(count: int, word: str) -> str:
    return f"{count} {word}" + ("" if count == 1 else "s")


def times(one: Overall) -> str:
    """ "1.8 times as far off (95 % interval 1.4 … 2.2, 15 recordings)", of a way beside the best."""
    sure = (
        f"95\u00a0% interval {one.low:.2f} … {one.high:.2f}, " if one.low is not None and one.high is not None else ""
    )
    if math.isinf(one.ratio):
        return f"off where the other errs by 0 throughout ({counted(one.recordings, 'recording')})"
    return f"{one.ratio:.2f} times as far off ({sure}{counted(one.recordings, 'recording')})"


def listed(names: Sequence[str], most: int = 4) -> str:
    """ "a, b and c", "a, b, c, d and 3 more"."""
    shown = list(names[:most])
    if more := len(names) - len(shown):
        return f"{', '.join(shown)} and {more} more"
    return " and ".join(filter(None, (", ".join(shown[:-1]), *shown[-1:])))


def case_name(rows: Sequence[dict[str, Any]]) -> Callable[[str, str], str]:
    """(suite, case) → what a case is called on the page and in addresses: with its suite where there are several."""
    several = len({r["suite"] for r in rows}) > 1
    return lambda suite, case: f"{suite} · {case}" if several else case


def headed(rows: Sequence[dict[str, Any]]) -> Callable[[str, str], str]:
    """(suite, words) → a section's heading: with its suite where there are several."""
    several = len({r["suite"] for r in rows}) > 1
    return lambda suite, words: f"{suite}: {words}" if several else words[:1].upper() + words[1:]
