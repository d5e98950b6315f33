"""`clamp_slip`: cloth that creeps out of its clamps once it is pulled hard enough."""

import numpy as np

from clothbench import Parameter, ParameterSpace

SOURCE = "slippage of the test specimen, a reason to discard a tensile test in ISO 13934-1"


class ClampSlip:
    """From the cloth's stretch λ_s on, a share s of what the clamps move apart is cloth that comes out. Curves only."""

    name = "clamp_slip"
    version = 2
    place = "boundary"
    rank = 2  # after `clamp_slack`
    family = "clamp"
    summary = "cloth that slips out of its clamps from a certain stretch on"
    parameters = ParameterSpace(
        (
            Parameter("share", "s", "1", (0.0, 0.9), "linear", 0.1, "of the further way, slip", SOURCE, null=0.0),
            Parameter("onset", "λ_s", "1", (1.01, 3.0), "log", 1.2, "stretch at which it begins", SOURCE),
        )
    )  # fmt: skip

    def clamped(self, stretch: np.ndarray, phi: np.ndarray) -> np.ndarray:
        return stretch - phi[0] * np.maximum(stretch - phi[1], 0)
