"""`frame_rotation`: camera and grips do not share their axes."""

import numpy as np

from clothbench import Parameter, ParameterSpace
from clothbench_effects.turn import middle, turned

SOURCE = "extrinsic calibration of the camera; about the cloth's middle, so that it does not shift it as well"


class FrameRotation:
    """By the rotation vector (r_x, r_y, r_z), about the centroid of all positions in all frames."""

    name = "frame_rotation"
    version = 1
    place = "sensor"
    family = "camera"
    summary = "the camera's frame turned against the grips'"
    by_recording = ("rx", "ry", "rz")
    parameters = ParameterSpace(
        (
            Parameter("rx", "r_x", "rad", (-0.2, 0.2), "linear", 0.0, "rotation vector, x", SOURCE, null=0.0),
            Parameter("ry", "r_y", "rad", (-0.2, 0.2), "linear", 0.0, "rotation vector, y", SOURCE, null=0.0),
            Parameter("rz", "r_z", "rad", (-0.2, 0.2), "linear", 0.01, "rotation vector, z", SOURCE, null=0.0),
        )
    )  # fmt: skip

    def positions(self, time: np.ndarray, position: np.ndarray, points: np.ndarray, phi: np.ndarray) -> np.ndarray:
        angle = float(np.linalg.norm(phi))
        if angle == 0.0:
            return position
        return turned(position, middle(position), phi / angle, angle)
