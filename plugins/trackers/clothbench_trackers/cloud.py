"""`cloud`: recordings of kind "points" as they are; which point is which stays unknown."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from clothbench import ClothbenchError, Observation, PointCloud, read_points


class Cloud:
    """All points count that were seen while it is known where the grips were, with the noise that the recording states.

    Metrics have to do without their identity, as `chamfer` and `hausdorff` do.
    """

    name = "cloud"
    version = 1
    kinds = frozenset({"points"})

    def track(self, source: PointCloud | Path) -> Observation:
        """`source`: a recording of kind "points", or its file; `material` is its lattice, which is simulated."""
        if not isinstance(source, PointCloud | str | Path):
            raise ClothbenchError(f"cloud: found {type(source).__name__}, expected a recording of kind 'points'")
        r = source if isinstance(source, PointCloud) else read_points(source)
        if not r.counts.any():
            raise ClothbenchError(
                f"{r.path or r.name}: variable 'position': found no point in any frame between the grips' first stamp "
                f"and their last, expected some; put both on one clock"
            )
        position = np.where(r.visible[..., None], r.position, np.nan)
        return Observation(r.time, position, r.counts, r.noise_sigma, r.lattice, cloud=True)
