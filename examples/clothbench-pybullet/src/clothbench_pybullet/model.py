"""`pybullet_cloth`: a sheet in PyBullet's deformable world, stepped by Bullet.

Every edge of a triangle is a spring f = k (|d| − L) with a dashpot c along it; if `bending` is not 0, so is every pair
of nodes two edges apart. Springs are stepped explicitly (symplectic Euler), dashpots implicitly (Bullet's
btDeformableMassSpringForce and btDeformableBodySolver). README.md says what the numbers are worth in N/m of cloth.
"""

from __future__ import annotations

import importlib.util
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from clothbench import ClothbenchError, Effect, Material, Parameter, ParameterSpace, Rollout, Scene, Stated
from clothbench.modelling import (
    DIVERGED,
    OK,
    BoundEffects,
    GridBatch,
    GridSimulation,
    check_number,
    check_resolution,
    grid_shape,
)

from clothbench_pybullet.march import SETTLE, march
from clothbench_pybullet.mesh import springs, triangles, write_obj
from clothbench_pybullet.world import Cloth

GUIDE = "PyBullet Quickstart Guide, loadSoftBody"
LATTICE = "springs along the edges of right triangles whose diagonals alternate, in an endless sheet"
TENSILE, SHEAR = 4 / 3, 1 / 2  # N/m of cloth that a spring of 1 N/m makes in it: C11 = 3/2, C12 = C66 = 1/2
SAFETY = 0.8  # of the longest stable step without dashpots


class PybulletCloth:
    """resolution: nodes along (u, v) or one number for the longer side, where the scene does not say; dt: time step [s]
    (None: four fifths of what is stable); step_scale: multiplies it.
    """

    name = "pybullet_cloth"
    version = 2
    kind = "explicit"
    built_on = ("pybullet",)
    repeatability = 1e-5  # m: a sheet that is let go at 1 µm/s may still creep this far
    capabilities = frozenset({"dynamic", "static"})
    parameters = ParameterSpace(
        (
            Parameter("stiffness", "k", "N/m", (1.0, 1000.0), "log", 30.0, "springElasticStiffness of an edge", GUIDE),
            Parameter("damping", "c", "N·s/m", (0.0, 2e-2), "linear", 1e-4, "springDampingStiffness", GUIDE, 0.0),
            Parameter("bending", "b", "N/m", (0.0, 10.0), "linear", 0.5, "springBendingStiffness", GUIDE, 0.0),
        )
    )

    documented = (
        Stated("stretch", "4/3 springElasticStiffness [N/m]", lambda theta: TENSILE * float(theta[0]), LATTICE),
        Stated("shear", "1/2 springElasticStiffness [N/m]", lambda theta: SHEAR * float(theta[0]), LATTICE),
    )

    def __init__(self, resolution: int | Sequence[int] = 13, dt: float | None = None, step_scale: float = 1.0):
        check_resolution(self.name, resolution)
        check_number(self.name, "dt", dt, 0.0)
        check_number(self.name, "step_scale", step_scale, 0.0, 1.0)
        self.resolution, self.dt, self.step_scale = resolution, dt, step_scale

    @staticmethod
    def skip_reason() -> str | None:
        """What to install; None when PyBullet is there."""
        return None if importlib.util.find_spec("pybullet") else "pip install pybullet"

    def skip(self, scene: Scene) -> str | None:
        return "pybullet_cloth: is set up without contact" if scene.obstacles or scene.thickness > 0 else None

    def of_material(self, material: Material, scene: Scene) -> np.ndarray:
        """Parameters (3,) of a textbook material: its tensile stiffness; shear follows as 3/8 of that, and bending
        springs resist only what is bent a lot (README.md).
        """
        if material.bending > 0 or material.bending_ratio != 1 or material.stretch_ratio != 1:
            raise ClothbenchError(
                "pybullet_cloth: has no bending rigidity at small curvature, and no warp and weft; bending springs are "
                "springs from node to node two edges apart"
            )
        stiffness = material.stretch / TENSILE
        return np.array([stiffness, material.stretch_damping / material.stretch * stiffness, 0.0])

    def prepare(self, scene: Scene, effects: Sequence[Effect] = ()) -> PybulletSimulation:
        if reason := self.skip_reason() or self.skip(scene):
            raise ClothbenchError(reason)
        if effects:
            raise ClothbenchError(f"pybullet_cloth: takes no effects, found {effects[0].name!r}; leave it out")
        shape = grid_shape(scene, self.resolution)
        return PybulletSimulation(scene, shape, BoundEffects(self.parameters, ()), self.dt, self.step_scale)


@dataclass(frozen=True, eq=False)
class PybulletSimulation(GridSimulation):
    """One scene on a grid, ready for batches of parameter sets."""

    dt: float | None
    step_scale: float
    threads = False  # PyBullet's clients are numbered by a counter of the process

    @cached_property
    def faces(self) -> np.ndarray:
        return triangles(self.shape)

    def steps(self, theta: np.ndarray) -> np.ndarray:
        """Time steps (B,) s for theta (B, P): ω² ≤ 2 Σ k / m over the springs at a node that has most of them."""
        if self.dt is not None:
            return np.full(len(theta), self.dt * self.step_scale)
        joined, apart = (np.asarray(ends.sum(axis=1)).ravel() for ends in springs(self.faces, self.nodes))
        stiffest = (theta[:, :1] * joined + theta[:, 2:] * apart).max(axis=1)
        return SAFETY * self.step_scale * np.sqrt(2 * self.mass / self.nodes / stiffest)

    @property
    def mass(self) -> float:
        """Of the whole sheet [kg]."""
        return self.scene.areal_density * self.scene.width * self.scene.height

    def run(self, theta: np.ndarray) -> Rollout:
        """Simulate theta (B, P), k N/m, c N·s/m, b N/m, one after the other."""
        theta = self.parameters.check(theta)
        batch = GridBatch(self, theta, self.steps(theta), SETTLE[1])
        with tempfile.TemporaryDirectory() as folder:
            mesh = Path(folder) / "sheet.obj"
            write_obj(mesh, self.uv, self.faces)
            for b in batch.members.tolist():
                cloth = Cloth(mesh, self.mass, self.scene.gravity, *theta[b].tolist())
                lost, batch.steps[b] = march(cloth, batch, b)
                batch.status[b] = DIVERGED if lost else OK
        return batch.rollout()
