"""`grip_rotation`: the clamp is turned against its recorded pose."""

import numpy as np

from clothbench import Parameter, ParameterSpace
from clothbench_effects.turn import turned

SOURCE = "how square the cloth sits in its clamp"


class GripRotation:
    """Turns all grips together about the vertical (z) through their centroid, then about the line through the first
    and the last grip. The second leaves these two where they are and turns those beside the line, a clamp of some
    depth or a second row; with fewer than three grips, or all on one line, it does nothing.
    """

    name = "grip_rotation"
    version = 1
    place = "boundary"
    family = "grip"
    summary = "grips turned against their recorded pose"
    by_recording = ("about_vertical", "about_line")
    parameters = ParameterSpace(
        (
            Parameter(
                "about_vertical", "ψ", "rad", (-0.3, 0.3), "linear", 0.02, "about z through the grips' centroid",
                SOURCE, null=0.0,
            ),
            Parameter(
                "about_line", "χ", "rad", (-0.6, 0.6), "linear", 0.0, "about the line from the first to the last grip",
                SOURCE, null=0.0,
            ),
        )
    )  # fmt: skip

    def grips(self, time: np.ndarray, position: np.ndarray, phi: np.ndarray) -> np.ndarray:
        if phi[0] != 0.0:
            position = turned(position, position.mean(axis=1, keepdims=True), np.array([0.0, 0.0, 1.0]), phi[0])
        if phi[1] != 0.0 and position.shape[1] >= 2:
            line = position[:, -1:] - position[:, :1]
            length = np.linalg.norm(line, axis=-1, keepdims=True)
            line = np.divide(line, length, out=np.zeros_like(line), where=length > 0)
            position = turned(position, position[:, :1], line, phi[1])
        return position
