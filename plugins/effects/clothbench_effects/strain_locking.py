"""`strain_locking`: loops and crimp give way until the yarns lie straight; then the cloth pulls back."""

import numpy as np

from clothbench import Parameter, ParameterSpace

SHARPNESS = 6.0  # e⁶ ≈ 400: at the locking strain next to nothing but the exponential is left
SOURCE = "exponential law of soft tissue: Fung 1967, Elasticity of soft tissues in simple elongation"
STEEPEST = 60.0  # exponent at which it is cut off, so that a search meets large numbers, no infinite ones


class StrainLocking:
    """T = A g(6 ε/ε_l) / g(6) with g(y) = eʸ − 1 − y, ε the stretch less 1; below ε = 0 there is nothing.

    Without slope and force at ε = 0: those are the model's own. Curves only.
    """

    name = "strain_locking"
    version = 1
    place = "dynamics"
    summary = "tension that grows exponentially with stretch, as the yarns lock"
    parameters = ParameterSpace(
        (
            Parameter("tension", "A", "N/m", (0.0, 1e3), "linear", 20.0, "tension at that strain", SOURCE, null=0.0),
            Parameter("strain", "ε_l", "1", (0.02, 5.0), "log", 0.4, "strain at which the yarns lock", SOURCE),
        )
    )  # fmt: skip

    def curve(self, stretch: np.ndarray, phi: np.ndarray) -> np.ndarray:
        return phi[0] * beyond(SHARPNESS * np.maximum(stretch - 1, 0) / phi[1]) / beyond(SHARPNESS)


def beyond(y):
    """eʸ − 1 − y."""
    y = np.minimum(y, STEEPEST)
    return np.expm1(y) - y
