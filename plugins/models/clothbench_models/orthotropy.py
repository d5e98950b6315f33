"""What a woven cloth has along the warp over what it has along the weft: parameters shared by the models that tell
them apart.

A model's own stiffness k is then the geometric mean: k_warp = k √r and k_weft = k/√r, so that it keeps its meaning and
its bounds, and r = 1 is the sheet that is alike along both. Warp runs along u, weft along v.
"""

from __future__ import annotations

import math

from clothbench import ClothbenchError, Material, Parameter

PEIRCE = "Peirce 1930, The handle of cloth as a measurable quantity"
KAWABATA = "Kawabata 1980, The standardization and analysis of hand evaluation"

BEND_RATIO = Parameter("bend_ratio", "r_b", "1", (0.1, 10.0), "log", 1.0, "bending rigidity, warp over weft", PEIRCE)
STRETCH_RATIO = Parameter(
    "stretch_ratio", "r_s", "1", (0.1, 10.0), "log", 1.0, "tensile stiffness, warp over weft", KAWABATA
)


OPTION = "; make it with orthotropic=true"


def check_orthotropic(model: str, value: bool) -> bool:
    """The option itself; refuses what is neither true nor false."""
    if not isinstance(value, bool):
        raise ClothbenchError(f"{model}: orthotropic is {value!r}, expected true or false")
    return value


def softer_share(ratio: float) -> float:
    """What the softer of warp and weft has of their geometric mean."""
    return min(math.sqrt(ratio), 1.0 / math.sqrt(ratio))


def refuse_ratios(model: str, material: Material, remedy: str = "") -> None:
    """Refuse a material that differs along warp and weft, for a model that is alike along both."""
    for quantity in ("bending", "stretch"):
        ratio = getattr(material, f"{quantity}_ratio")
        if ratio != 1.0:
            raise ClothbenchError(
                f"{model}: has one {quantity} stiffness for warp and weft, found a material with {ratio:g} times as "
                f"much along the warp{remedy}"
            )
