"""`lens_distortion`: the lens bends the picture more, or less, than its calibration says."""

import numpy as np

from clothbench import Camera, Parameter, ParameterSpace, to_world


class LensDistortion:
    """x_d = x (1 + k₁ r²) about the optical axis, at unit focal length (Brown 1966, its first term)."""

    name = "lens_distortion"
    version = 1
    place = "sensor"
    family = "camera"
    summary = "a lens that bends the picture otherwise than is known (pictures)"
    parameters = ParameterSpace(
        (
            Parameter(
                "radial", "k1", "1", (-0.5, 0.5), "linear", 0.02, "radial distortion beyond the calibrated one",
                "calibration with a chessboard", null=0.0,
            ),
        )
    )  # fmt: skip

    def sights(self, time: np.ndarray, position: np.ndarray, camera: Camera, phi: np.ndarray) -> np.ndarray:
        if phi[0] == 0.0:
            return position
        seen = camera.in_view(position)
        flat = seen[..., :2] / seen[..., 2:]
        bent = flat * (1 + phi[0] * (flat**2).sum(axis=-1, keepdims=True))
        there = np.concatenate([bent * seen[..., 2:], seen[..., 2:]], axis=-1)
        return to_world(there, camera)
