"""`start_friction`: yarns that stick to each other before they begin to slide."""

import numpy as np

from clothbench import Parameter, ParameterSpace

SOURCE = "Grosberg and Kedia 1966, The initial load-extension modulus of woven fabrics"


class StartFriction:
    """T = T_f (1 − e^(−ε/ε_f)), ε the stretch less 1: soon all there, then the same. For loading; curves only."""

    name = "start_friction"
    version = 1
    place = "dynamics"
    family = "stretch"
    summary = "friction between yarns, which has to be overcome at the start and then stays"
    parameters = ParameterSpace(
        (
            Parameter("tension", "T_f", "N/m", (0.0, 100.0), "linear", 1.0, "tension of sliding", SOURCE, null=0.0),
            Parameter("strain", "ε_f", "1", (1e-3, 0.1), "log", 0.01, "strain within which they begin to", SOURCE),
        )
    )  # fmt: skip

    def curve(self, stretch: np.ndarray, phi: np.ndarray) -> np.ndarray:
        return -phi[0] * np.expm1(-np.maximum(stretch - 1, 0) / phi[1])
