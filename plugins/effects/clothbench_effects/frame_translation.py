"""`frame_translation`: camera and grips do not share their origin."""

import numpy as np

from clothbench import Parameter, ParameterSpace

SOURCE = "extrinsic calibration of the camera"


class FrameTranslation:
    name = "frame_translation"
    version = 1
    place = "sensor"
    family = "camera"
    summary = "the camera's frame shifted against the grips'"
    by_recording = ("dx", "dy", "dz")
    parameters = ParameterSpace(
        (
            Parameter("dx", "d_x", "m", (-0.05, 0.05), "linear", 0.0, "seen shifted along x", SOURCE, null=0.0),
            Parameter("dy", "d_y", "m", (-0.05, 0.05), "linear", 0.002, "seen shifted along y", SOURCE, null=0.0),
            Parameter("dz", "d_z", "m", (-0.05, 0.05), "linear", 0.0, "seen shifted along z", SOURCE, null=0.0),
        )
    )  # fmt: skip

    def positions(self, time: np.ndarray, position: np.ndarray, points: np.ndarray, phi: np.ndarray) -> np.ndarray:
        return position + phi
