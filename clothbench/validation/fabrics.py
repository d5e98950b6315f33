"""Ten fabrics whose fold heights were measured by hand and turned into a weight-to-bending-stiffness ratio.

"Automatic Material Properties Estimation for the Physics-Based Robotic Garment Folding", table I: mean height μ_h of
the free fold, its 2σ_h, and η_b(μ_h) = ρ/D with ρ per area. The paper's η_b is not the exact loop's, c³/(g h³) with
c = 0.9066: that gives from 6 % less (15 mm) to 33 % more (28 mm), where 1 mm of rounding is 11 to 25 % of η_b.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Fabric:
    """height, spread: m, mean and two standard deviations of the fold's height; eta: η_b [m⁻⁴·s²]."""

    name: str
    height: float
    spread: float
    eta: float


FABRICS = (
    Fabric("coating", 0.020, 0.0034, 8.5e3),
    Fabric("chanel", 0.028, 0.0039, 2.6e3),
    Fabric("twill", 0.019, 0.0046, 8.9e3),
    Fabric("denim", 0.023, 0.0031, 5.2e3),
    Fabric("terry cloth", 0.025, 0.0028, 3.9e3),
    Fabric("plain weave", 0.025, 0.0034, 4.0e3),
    Fabric("herringbone", 0.021, 0.0025, 6.5e3),
    Fabric("georgette", 0.015, 0.0017, 2.4e4),
    Fabric("chiffon", 0.013, 0.0023, 3.5e4),
    Fabric("wool suiting", 0.018, 0.0018, 1.1e4),
)
