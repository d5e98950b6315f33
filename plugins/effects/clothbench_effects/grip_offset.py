"""`grip_offset`: the cloth is held beside the point that was tracked."""

import numpy as np

from clothbench import Parameter, ParameterSpace

SOURCE = "distance between the tracked point of a gripper and where it holds the cloth"


class GripOffset:
    name = "grip_offset"
    version = 1
    place = "boundary"
    family = "grip"
    summary = "grips shifted against their recorded positions"
    by_recording = ("dx", "dy", "dz")
    parameters = ParameterSpace(
        (
            Parameter("dx", "δ_x", "m", (-0.05, 0.05), "linear", 0.0, "all grips shifted along x", SOURCE, null=0.0),
            Parameter("dy", "δ_y", "m", (-0.05, 0.05), "linear", 0.005, "all grips shifted along y", SOURCE, null=0.0),
            Parameter("dz", "δ_z", "m", (-0.05, 0.05), "linear", 0.0, "all grips shifted along z", SOURCE, null=0.0),
        )
    )  # fmt: skip

    def grips(self, time: np.ndarray, position: np.ndarray, phi: np.ndarray) -> np.ndarray:
        return position + phi
