"""What a user may say of the experiments: what the robot can do, how long they last, what they are ranked by."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields

from clothbench.core.errors import ClothbenchError

INFORMATION, TIE = "information", "tie"


@dataclass(frozen=True)
class Wanted:
    """max_speed: m/s and max_acceleration: m/s², of a grip; reach: m, how far a grip may go from where it began;
    durations: s, of the motions, rising; rank: "information" (all parameters together), "tie" (how far apart tied
    effects would be), or a parameter's name; None: by the tie where there is one; draws: parameter sets, drawn as the
    recordings leave them open, at which each experiment is looked at beside the fit; best: so many experiments are
    shown and written; grips: names of those that the robot has; None: all.
    """

    max_speed: float = 0.5
    max_acceleration: float = 5.0
    reach: float = 0.15
    durations: tuple[float, ...] = (1.0, 2.0, 4.0)
    rank: str | None = None
    draws: int = 4
    best: int = 5
    grips: tuple[str, ...] | None = None


WORDS = tuple(field.name for field in fields(Wanted))


def wanted_of(words: Mapping[str, str]) -> Wanted:
    """From words as they were given, by name; what is no number or makes no sense is refused in one line."""
    read: dict[str, object] = {}
    for name in ("max_speed", "max_acceleration", "reach"):
        if name in words:
            read[name] = above_zero(name, words[name])
    for name, least in (("draws", 0), ("best", 1)):
        if name in words:
            read[name] = whole(name, words[name], least)
    if "durations" in words:
        parts = words["durations"].removeprefix("[").removesuffix("]").split(",")
        read["durations"] = tuple(sorted({above_zero("durations", part) for part in parts}))
    if "grips" in words:
        parts = words["grips"].removeprefix("[").removesuffix("]").split(",")
        read["grips"] = tuple(part.strip() for part in parts)
    if "rank" in words:
        read["rank"] = words["rank"]
    return Wanted(**read)  # type: ignore[arg-type]


def above_zero(name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0):
        raise ClothbenchError(f"setting {name!r} is {text!r}, expected a number above 0")
    return value


def whole(name: str, text: str, least: int) -> int:
    if not text.isdecimal() or int(text) < least:
        raise ClothbenchError(f"setting {name!r} is {text!r}, expected a whole number, {least} or above")
    return int(text)
