"""`frame_scale`: the camera's metre is not quite a metre."""

import numpy as np

from clothbench import Parameter, ParameterSpace
from clothbench_effects.turn import middle


class FrameScale:
    """About the centroid of all positions in all frames."""

    name = "frame_scale"
    version = 1
    place = "sensor"
    family = "camera"
    summary = "lengths seen too long or too short"
    parameters = ParameterSpace(
        (
            Parameter(
                "ratio", "s", "1", (0.9, 1.1), "linear", 1.005, "length seen over true length",
                "scale of the camera's calibration target", null=1.0,
            ),
        )
    )  # fmt: skip

    def positions(self, time: np.ndarray, position: np.ndarray, points: np.ndarray, phi: np.ndarray) -> np.ndarray:
        return position + (phi[0] - 1.0) * (position - middle(position))
