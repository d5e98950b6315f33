"""`load_offset`: a load cell that was not set to zero with the sample in it."""

import numpy as np

from clothbench import Parameter, ParameterSpace


class LoadOffset:
    """Curves only."""

    name = "load_offset"
    version = 1
    place = "sensor"
    family = "load"
    summary = "forces read too high or too low by the same amount"
    parameters = ParameterSpace(
        (
            Parameter(
                "force", "F₀", "N", (-5.0, 5.0), "linear", 0.2, "what the load cell shows of a slack sample",
                "zero of the load cell, with the lower clamp's weight", null=0.0,
            ),
        )
    )  # fmt: skip

    def weighed(self, stretch: np.ndarray, force: np.ndarray, phi: np.ndarray) -> np.ndarray:
        return force + phi[0]
