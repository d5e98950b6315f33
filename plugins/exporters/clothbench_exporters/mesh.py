"""The mesh that targets share: that on which the models are proved, from the scene of the twin."""

from __future__ import annotations

import numpy as np

from clothbench import ParameterSpace, Sheet, Twin
from clothbench.modelling import BoundEffects, GridSimulation, grid_shape

NODES = 13  # along the longer side, where the scene does not say


def sheet_of_twin(twin: Twin) -> tuple[Sheet, np.ndarray]:
    """The sheet, flat, and the shape (n, 3) m from which it settles into its grips' first pose."""
    grid = GridSimulation(twin.scene, grid_shape(twin.scene, NODES), BoundEffects(ParameterSpace(), ()))
    return grid.sheet, grid.start[0]


def grip_nodes(twin: Twin, sheet: Sheet) -> np.ndarray:
    """Numbers of the nodes that are held, in the order of the scene's grips (G,)."""
    return np.array(sheet.held[: len(twin.scene.grip_material)], dtype=int)
