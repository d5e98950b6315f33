"""`clamp_slack`: a sample that lay loose, or was already drawn, when its length was taken."""

import numpy as np

from clothbench import Parameter, ParameterSpace


class ClampSlack:
    """The true unloaded distance is (1 + s) times the one that stretches are stated by. Curves only."""

    name = "clamp_slack"
    version = 2
    place = "boundary"
    rank = 1  # before it slips, cloth is pulled: what slips does so by the cloth's own stretch
    family = "clamp"
    summary = "zero of the stretch off: a sample loose or already drawn between its clamps at the start"
    parameters = ParameterSpace(
        (
            Parameter(
                "slack", "s", "1", (-0.3, 0.3), "linear", 0.02, "cloth between the clamps beyond the stated length",
                "slack mounting and pretension of tensile tests: ISO 13934-1", null=0.0,
            ),
        )
    )  # fmt: skip

    def clamped(self, stretch: np.ndarray, phi: np.ndarray) -> np.ndarray:
        return stretch / (1 + phi[0])
