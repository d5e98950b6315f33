"""Ten fabrics whose fold heights were measured by hand and turned into a weight-to-bending-stiffness ratio.

"Automatic Material Properties Estimation for the Physics-Based Robotic Garment Folding", table I: mean height μ_h of
the free fold, its 2σ_h, and η_b(μ_h) = ρ/D with ρ per area. The paper's η_b is not the exact loop's, c³/(g h³) with
c = 0.9066: that gives from 6 % less (15 mm) to 33 % more (28 mm), where 1 mm of rounding is 11 to 25 % of η_b.
"""

from __future__ import annotations

import fnmatch
from collections.abc import Sequence
from dataclasses import dataclass

from clothbench.core.errors import ClothbenchError


@dataclass(frozen=True)
class Fabric:
    """height, spread: m, mean and two standard deviations of the fold's height; eta: η_b [m⁻⁴·s²] at the mean,
    eta_low and eta_high where the fold is two standard deviations higher and lower.
    """

    name: str
    height: float
    spread: float
    eta: float
    eta_low: float
    eta_high: float


FABRICS = (
    Fabric("coating", 0.020, 0.0034, 8.5e3, 5.1e3, 1.6e4),
    Fabric("chanel", 0.028, 0.0039, 2.6e3, 1.7e3, 4.2e3),
    Fabric("twill", 0.019, 0.0046, 8.9e3, 4.5e3, 2.3e4),
    Fabric("denim", 0.023, 0.0031, 5.2e3, 3.4e3, 8.3e3),
    Fabric("terry cloth", 0.025, 0.0028, 3.9e3, 2.8e3, 5.7e3),
    Fabric("plain weave", 0.025, 0.0034, 4.0e3, 2.7e3, 6.4e3),
    Fabric("herringbone", 0.021, 0.0025, 6.5e3, 4.6e3, 9.7e3),
    Fabric("georgette", 0.015, 0.0017, 2.4e4, 1.6e4, 4.1e4),
    Fabric("chiffon", 0.013, 0.0023, 3.5e4, 1.8e4, 1.5e5),
    Fabric("wool suiting", 0.018, 0.0018, 1.1e4, 8.0e3, 1.5e4),
)


def chosen_fabrics(patterns: Sequence[str]) -> list[str]:
    """Names of fabrics in the table's order; "*" means every one. `suite.select` of the studies that fold."""
    found = [f.name for f in FABRICS if any(fnmatch.fnmatch(f.name, p) for p in patterns)]
    if not found:
        names = ", ".join(f.name for f in FABRICS)
        raise ClothbenchError(f"setting 'suite.select' {list(patterns)} matches no fabric; there are: {names}")
    return found


def fabric_named(name: str) -> Fabric:
    return next(f for f in FABRICS if f.name == name)
