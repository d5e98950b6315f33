"""What measured fabrics are like, class by class: each number with its spread, its unit and where it comes from.

Derived by `tools/make_presets.py` from public data, of which only these summaries are here. Quantities: areal_density
[kg/m²], bending_warp, bending_weft [N·m], stretch, shear [N/m]; of one fabric whose threads differ stretch_warp and
stretch_weft [N/m]; where a drapemeter was at hand drape_coefficient [%] and folds [1].
"""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from types import MappingProxyType

from clothbench.core.errors import ClothbenchError, known_names
from clothbench.core.protocols import Material


@dataclass(frozen=True)
class Range:
    """A middle value with the range in which the class lies; source says how the range was made."""

    value: float
    low: float
    high: float
    unit: str
    source: str


@dataclass(frozen=True)
class Preset:
    """A class of fabrics. numbers: by quantity; those of the mechanics are always there."""

    name: str
    about: str
    numbers: Mapping[str, Range]

    @property
    def bending(self) -> Range:
        """Of a sheet that bends alike along both threads: geometric mean of warp and weft, and the range of both."""
        warp, weft = self.numbers["bending_warp"], self.numbers["bending_weft"]
        low, high = min(warp.low, weft.low), max(warp.high, weft.high)
        return Range(math.sqrt(warp.value * weft.value), low, high, warp.unit, warp.source)

    @property
    def material(self) -> Material:
        """The middle of the class; how much more its warp resists than its weft, too, where both are known."""
        elastic = (self.bending.value, self.numbers["stretch"].value, self.numbers["shear"].value)
        return Material(*elastic, bending_ratio=self._ratio("bending"), stretch_ratio=self._ratio("stretch"))

    def _ratio(self, quantity: str) -> float:
        """Warp over weft; 1 where the threads are not told apart."""
        warp, weft = (self.numbers.get(f"{quantity}_{thread}") for thread in ("warp", "weft"))
        return warp.value / weft.value if warp and weft else 1.0


@functools.cache
def presets() -> Mapping[str, Preset]:
    """All classes by name."""
    told = json.loads((files(__package__) / "presets.json").read_text(encoding="utf-8"))
    return MappingProxyType(
        {
            name: Preset(name, one["about"], {q: Range(**number) for q, number in one["numbers"].items()})
            for name, one in told.items()
        }
    )


def preset(name: str) -> Preset:
    """The class of that name, in capitals or not; else an error that says which there are."""
    if (known := name.strip().lower()) not in presets():
        raise ClothbenchError(
            f"no preset {name!r}: there is no measured fabric of that class at hand; {known_names(known, presets())}"
        )
    return presets()[known]
