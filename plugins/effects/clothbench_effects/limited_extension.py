"""`limited_extension`: a cloth that cannot be stretched beyond a certain length."""

import numpy as np

from clothbench import Parameter, ParameterSpace

SOURCE = "limiting chain extensibility: Gent 1996, A new constitutive relation for rubber, in one dimension"
NEAR = 0.98  # share of the limit from which on it goes along its tangent, so that it has a value everywhere


class LimitedExtension:
    """T = A (1/(1 − x) − 1 − x), x = cε with ε the stretch less 1: a pole at ε = 1/c, where the loops are drawn out.

    Without slope and force at ε = 0: those are the model's own. Curves only.
    """

    name = "limited_extension"
    version = 1
    place = "dynamics"
    family = "stretch"
    summary = "tension that grows beyond all bounds towards a largest stretch"
    parameters = ParameterSpace(
        (
            Parameter("closeness", "c", "1", (0.0, 20.0), "linear", 0.5, "1 over the strain never reached", SOURCE,
                      null=0.0),
            Parameter("tension", "A", "N/m", (1e-2, 1e3), "log", 5.0, "twice the tension at half the limit", SOURCE),
        )
    )  # fmt: skip

    def curve(self, stretch: np.ndarray, phi: np.ndarray) -> np.ndarray:
        x = phi[0] * np.maximum(stretch - 1, 0)
        inside = np.minimum(x, NEAR)
        tangent = (x - inside) * (1 / (1 - NEAR) ** 2 - 1)
        return phi[1] * (1 / (1 - inside) - 1 - inside + tangent)
