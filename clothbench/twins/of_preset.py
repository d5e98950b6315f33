"""The twin of a class of fabrics: the middle of its ranges, as a sheet of 30 cm that hangs from two corners."""

from __future__ import annotations

from clothbench.core.twin import Twin
from clothbench.estimation.prior import hanging
from clothbench.reference.presets import preset

SIZE = 0.3  # m


def twin_of_preset(name: str) -> Twin:
    """Raises a ClothbenchError where there is no such class."""
    one = preset(name)
    numbers = {"bending": one.bending, **{q: one.numbers[q] for q in ("areal_density", "stretch", "shear")}}
    spread = {quantity: (number.low, number.high) for quantity, number in numbers.items()}
    scene = hanging(SIZE, SIZE, one.numbers["areal_density"].value)
    sources = {quantity: number.source for quantity, number in one.numbers.items()}
    return Twin(f"preset {name}, {one.about}", scene, one.material, spread, "range of the class", {}, sources)
