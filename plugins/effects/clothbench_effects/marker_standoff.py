"""`marker_standoff`: what is seen are markers that stand off the cloth, on one side of it."""

import numpy as np

from clothbench import Parameter, ParameterSpace

NEIGHBOURS = 8


class MarkerStandoff:
    """Along u × v, from the affine map that fits a point and its nearest neighbours best, in the least-squares sense.

    A point whose neighbours all lie on one line with it has no normal and stays where it is.
    """

    name = "marker_standoff"
    version = 1
    place = "sensor"
    family = "camera"
    summary = "markers that stand off the cloth"
    parameters = ParameterSpace(
        (
            Parameter(
                "distance", "h", "m", (-0.02, 0.02), "linear", 0.005, "height over the cloth, above 0 along u × v",
                "radius and base of the markers", null=0.0,
            ),
        )
    )  # fmt: skip

    def positions(self, time: np.ndarray, position: np.ndarray, points: np.ndarray, phi: np.ndarray) -> np.ndarray:
        return position if phi[0] == 0.0 else position + phi[0] * normals(position, points)


def normals(position: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Unit normals (T, N, 3) along u × v of points at material coordinates (N, 2) m; zero where there is none."""
    apart = np.linalg.norm(points[:, None] - points[None], axis=-1)
    near = np.argsort(apart, axis=1, kind="stable")[:, : NEIGHBOURS + 1]  # each point itself comes first
    beside = points[near] - points[near].mean(axis=1, keepdims=True)
    weights = np.linalg.pinv(beside, rcond=1e-6)  # (N, 2, k)
    along = np.einsum("nck,tnkx->tncx", weights, position[:, near])
    normal = np.cross(along[:, :, 0], along[:, :, 1])
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.divide(normal, length, out=np.zeros_like(normal), where=length > 1e-6)
