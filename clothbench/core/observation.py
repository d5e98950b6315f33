"""The observation: what a tracker made of a recording, ready to be compared with a rollout."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clothbench.core.camera import View
from clothbench.core.errors import ClothbenchError


@dataclass(frozen=True, eq=False)
class Observation:
    """Tracked material points. Arrays are read-only.

    time: (T,) s; position: (T, N, 3) m, NaN where not known; visible: (T, N) bool, what was measured (a tracker may
    fill a gap with a position, but that stays invisible and never counts); sigma: m, standard deviation
    of one coordinate (NaN = not known); material: (N, 2) m; view: what was made of a camera's images, or None; eye:
    (3,) m, where the camera stood, or None.
    """

    time: np.ndarray
    position: np.ndarray
    visible: np.ndarray
    sigma: float
    material: np.ndarray
    view: View | None = None
    eye: np.ndarray | None = None

    def __post_init__(self) -> None:
        for name in ("time", "position", "visible", "material"):
            array = np.array(getattr(self, name))
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        frames, nodes = self.visible.shape
        if (
            self.position.shape != (frames, nodes, 3)
            or self.time.shape != (frames,)
            or self.material.shape != (nodes, 2)
        ):
            raise ClothbenchError(
                f"observation: found position {self.position.shape}, time {self.time.shape}, "
                f"material {self.material.shape}, "
                f"visible {self.visible.shape}, expected (T, N, 3), (T,), (N, 2), (T, N)"
            )
        if self.view is not None and len(self.view.silhouette) != frames:
            raise ClothbenchError(f"observation: found a view of {len(self.view.silhouette)} frames, expected {frames}")
        if not np.isfinite(self.position[self.visible]).all():
            raise ClothbenchError("observation: found a visible node whose position is not finite")
