"""`frame_rate`: the camera takes more, or fewer, frames a second than its file says."""

import numpy as np

from clothbench import Camera, Parameter, ParameterSpace
from clothbench_effects.at_other_times import at_other_times


class FrameRate:
    """A frame stamped t shows the cloth at t₀ + r (t − t₀), t₀ the first frame's stamp."""

    name = "frame_rate"
    version = 1
    place = "sensor"
    family = "clock"
    summary = "a video that runs too fast or too slow (pictures)"
    parameters = ParameterSpace(
        (
            Parameter(
                "ratio", "r", "1", (0.8, 1.2), "linear", 1.01, "true time between frames over the stated one",
                "a clock before the camera", null=1.0,
            ),
        )
    )  # fmt: skip

    def sights(self, time: np.ndarray, position: np.ndarray, camera: Camera, phi: np.ndarray) -> np.ndarray:
        if phi[0] == 1.0:
            return position
        wanted = time[0] + phi[0] * (time - time[0])
        return at_other_times(time, position, np.broadcast_to(wanted[:, None], position.shape[:2]))
