"""`grip_slip`: at some moment the cloth slips down in its grips."""

import numpy as np

from clothbench import Parameter, ParameterSpace

DURATION = 0.05  # s
SOURCE = "tracked markers beside the grips"


class GripSlip:
    """Modelled as grips that sit lower (along −z) from then on: the same material points stay held.

    The step s³ (10 − 15 s + 6 s²) lasts 50 ms and is sampled where the grips have stamps, so a slip between two
    stamps that are further apart is drawn out to their distance.
    """

    name = "grip_slip"
    version = 2
    place = "boundary"
    family = "grip"
    summary = "cloth that slips down in its grips, once"
    by_recording = ("distance", "time")
    parameters = ParameterSpace(
        (
            Parameter(
                "distance", "d", "m", (0.0, 0.03), "linear", 0.003, "how far it slips", SOURCE, null=0.0,
            ),
            Parameter(
                "time", "t_s", "s", (0.0, 60.0), "linear", 0.2, "when it begins, from the grips' first stamp", SOURCE,
            ),
        )
    )  # fmt: skip

    def grips(self, time: np.ndarray, position: np.ndarray, phi: np.ndarray) -> np.ndarray:
        s = np.clip((time - time[0] - phi[1]) / DURATION, 0.0, 1.0)
        step = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
        return position - phi[0] * step[:, None, None] * np.array([0.0, 0.0, 1.0])
