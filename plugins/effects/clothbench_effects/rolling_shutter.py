"""`rolling_shutter`: the camera reads its rows one after the other, so that the lower ones show a later moment."""

import numpy as np

from clothbench import Camera, Parameter, ParameterSpace
from clothbench_effects.at_other_times import at_other_times


class RollingShutter:
    """Row y of H shows the cloth at t + τ (y/H − ½), t the frame's stamp: of its middle row."""

    name = "rolling_shutter"
    version = 2
    place = "sensor"
    family = "clock"
    summary = "rows of a picture that are read one after the other (pictures)"
    parameters = ParameterSpace(
        (
            Parameter(
                "readout", "τ", "s", (-0.05, 0.05), "linear", 0.005, "from the first row to the last",
                "data sheet of the sensor; a flashing light", null=0.0,
            ),
        )
    )  # fmt: skip

    def sights(self, time: np.ndarray, position: np.ndarray, camera: Camera, phi: np.ndarray) -> np.ndarray:
        if phi[0] == 0.0:
            return position
        row = camera.project(position)[0][..., 1]
        late = phi[0] * (np.nan_to_num(row) / camera.size[1] - 0.5)
        return at_other_times(time, position, time[:, None] + late)
