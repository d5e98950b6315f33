"""The mesh that targets share: that on which the models are proved, from the scene of the twin."""

from __future__ import annotations

import numpy as np

from clothbench import ParameterSpace, Sheet, Twin
from clothbench.modelling import BoundEffects, GridSimulation, grid_shape

NODES = 13  # along the longer side, where the scene does not say


def sheet_of_twin(twin: Twin) -> tuple[Sheet, np.ndarray]:
    """The sheet, flat, and the shape (n, 3) m from which it settles, held where its grips first are; where it is cut
    along an outline, without the nodes that no cloth is at.
    """
    grid = GridSimulation(twin.scene, grid_shape(twin.scene, NODES), BoundEffects(ParameterSpace(), ()))
    sheet, start = grid.sheet, grid.start[0].copy()
    start[sheet.held[: sheet.gripped]] = first_pose(twin)  # a shape to settle from only comes near it
    cloth = sheet.mass > 0
    cloth[sheet.held[: sheet.gripped]] = True
    number = np.cumsum(cloth) - 1
    return sheet._replace(
        uv=sheet.uv[cloth], mass=sheet.mass[cloth], area=sheet.area[cloth], triangles=number[sheet.triangles],
        held=number[sheet.held[cloth[sheet.held]]], outline=sheet.outline[:0],
    ), start[cloth]  # fmt: skip


def first_pose(twin: Twin) -> np.ndarray:
    """Where the grips are when the sheet begins to settle in them, (G, 3) m."""
    scene = twin.scene
    return scene.grips_at(np.array([scene.start_time]))[0] if len(scene.grip_material) else np.zeros((0, 3))


def grip_nodes(twin: Twin, sheet: Sheet) -> np.ndarray:
    """Numbers of the nodes that are held, in the order of the scene's grips (G,)."""
    return np.array(sheet.held[: len(twin.scene.grip_material)], dtype=int)


def clamped_nodes(twin: Twin, sheet: Sheet) -> np.ndarray:
    """Numbers of the nodes that lie between a disc and the plate upon it, and never move."""
    return np.array(sheet.held[len(twin.scene.grip_material) :], dtype=int)


def margin(twin: Twin) -> list[str]:
    """A line on a sheet that is cut along an outline, of which a mesh holds whole triangles only."""
    if twin.scene.outline is None:
        return []
    return ["outline: the cut goes along whole triangles of the mesh, which are as stiff as if no outline crossed them"]
