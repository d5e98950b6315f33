"""`frame_rate`: the camera takes more, or fewer, frames a second than its file says."""

import numpy as np

from clothbench import Camera, Parameter, ParameterSpace


class FrameRate:
    """A frame stamped t shows the cloth at t₀ + r (t − t₀), t₀ the first frame's stamp."""

    name = "frame_rate"
    version = 2
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

    def times(self, time: np.ndarray, phi: np.ndarray) -> np.ndarray:
        """When the cloth was as frames stamped `time` (T,) s show it, after the last stamp, too."""
        return time if phi[0] == 1.0 else time[0] + phi[0] * (time - time[0])

    def sights(self, time: np.ndarray, position: np.ndarray, camera: Camera, phi: np.ndarray) -> np.ndarray:
        """Of a camera's frames only: positions (T, N, 3) m are those of `times` already."""
        return position
