"""`clock_offset`: camera and grips do not share a clock."""

import numpy as np

from clothbench import Parameter, ParameterSpace


class ClockOffset:
    name = "clock_offset"
    version = 1
    place = "sensor"
    family = "clock"
    summary = "positions are stamped late or early against the grips"
    by_recording = ("delay",)
    parameters = ParameterSpace(
        (
            Parameter(
                "delay", "τ", "s", (-0.5, 0.5), "linear", 0.02, "how much later than it was a position is stamped",
                "sensor latency: a frame stamped t shows the cloth at t − τ", null=0.0,
            ),
        )
    )  # fmt: skip

    def times(self, time: np.ndarray, phi: np.ndarray) -> np.ndarray:
        """When the cloth was as a frame stamped `time` (T,) s shows it."""
        return time - phi[0]
