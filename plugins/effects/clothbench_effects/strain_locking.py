"""`strain_locking`: loops and crimp give way until the yarns lie straight; then the cloth pulls back."""

import numpy as np

from clothbench import Parameter, ParameterSpace

SOURCE = "exponential law of soft tissue: Fung 1967, Elasticity of soft tissues in simple elongation"
STEEPEST = 60.0  # exponent at which it is cut off, so that a search meets large numbers, no infinite ones


class StrainLocking:
    """T = T₀ (e^(bε) − 1 − bε), ε the stretch less 1; below ε = 0 there is nothing.

    Without slope and force at ε = 0: those are the model's own. Curves only.
    """

    name = "strain_locking"
    version = 1
    place = "dynamics"
    family = "stretch"
    summary = "tension that grows exponentially with stretch, as the yarns lock"
    parameters = ParameterSpace(
        (
            Parameter("rate", "b", "1", (0.0, 60.0), "linear", 6.0, "growth of tension per strain", SOURCE, null=0.0),
            Parameter("tension", "T₀", "N/m", (1e-4, 1e3), "log", 0.3, "tension it grows from", SOURCE),
        )
    )

    def curve(self, stretch: np.ndarray, phi: np.ndarray) -> np.ndarray:
        y = np.minimum(phi[0] * np.maximum(stretch - 1, 0), STEEPEST)
        return phi[1] * (np.expm1(y) - y)
