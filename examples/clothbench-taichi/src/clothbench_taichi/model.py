"""`taichi_springs`: a sheet of springs and dashpots, stepped by a kernel in the Taichi language.

The physics is that of the cloth that Taichi's documentation builds: every node is tied to all neighbours up to two
cells away in the plane of the grid, a spring pulls with Y (|d|/L − 1), a dashpot with c times the speed along it, and
velocities decay by e^(−γ dt), in symplectic Euler steps. The code is this distribution's own: grips that move, masses
from the areal density, springs along a border with half of everything, double precision, and one thread per parameter
set. Y is k times a cell's width, so that membranes do not depend on the mesh.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from clothbench import ClothbenchError, Effect, Parameter, ParameterSpace, Rollout, Scene
from clothbench.modelling import DIVERGED, OK, BoundEffects, GridBatch, GridSimulation, check_resolution, grid_shape

DOCS = "Taichi documentation, Write a cloth simulation"
# (Δi, Δj) of the families of springs: along the lines, along the diagonals, and two cells long
FAMILIES = ((1, 0), (0, 1), (1, 1), (-1, 1), (2, 0), (0, 2))
SAFETY = 0.5  # of the longest stable step without dashpots
SETTLE = (1.5, 20.0)  # s, least and most that the sheet is given to come to rest
CALM = 15.0  # 1/s, decay of velocities while it does
AT_REST = 1e-6  # m/s


class TaichiSprings:
    """resolution: nodes along (u, v) or one number for the longer side, where the scene does not say; step_scale:
    multiplies the time step, half of what is stable.
    """

    name = "taichi_springs"
    version = 1
    kind = "explicit"
    capabilities = frozenset({"dynamic", "static"})
    parameters = ParameterSpace(
        (
            Parameter("stiffness", "k", "N/m", (1.0, 1000.0), "log", 30.0, "Y over a cell's width", DOCS),
            Parameter("dashpot", "c", "N·s/m", (0.0, 1e-2), "linear", 1e-4, "dashpot along every spring", DOCS, 0.0),
            Parameter("drag", "γ", "1/s", (0.0, 10.0), "linear", 0.5, "decay of velocities", DOCS, 0.0),
        )
    )

    def __init__(self, resolution: int | Sequence[int] = 13, step_scale: float = 1.0):
        check_resolution(self.name, resolution)
        if not 0 < step_scale <= 1:
            raise ClothbenchError(
                f"taichi_springs: step_scale is {step_scale!r}, expected a number above 0 and at most 1"
            )
        self.resolution, self.step_scale = resolution, step_scale

    @staticmethod
    def skip_reason() -> str | None:
        """What to install; None when Taichi is there."""
        return None if importlib.util.find_spec("taichi") else "pip install taichi"

    def skip(self, scene: Scene) -> str | None:
        return "taichi_springs: knows no contact" if scene.obstacles or scene.thickness > 0 else None

    def prepare(self, scene: Scene, effects: Sequence[Effect] = ()) -> TaichiSimulation:
        if reason := self.skip_reason() or self.skip(scene):
            raise ClothbenchError(reason)
        if effects:
            raise ClothbenchError(f"taichi_springs: takes no effects, found {effects[0].name!r}; leave it out")
        shape = grid_shape(scene, self.resolution)
        return TaichiSimulation(scene, shape, BoundEffects(self.parameters, ()), self.step_scale)


@dataclass(frozen=True, eq=False)
class TaichiSimulation(GridSimulation):
    """One scene on a grid, ready for batches of parameter sets."""

    step_scale: float
    threads = False  # Taichi has its own

    def run(self, theta: np.ndarray) -> Rollout:
        """Simulate theta (B, P), k N/m, c N·s/m, γ 1/s, all at once."""
        from clothbench_taichi import kernels

        theta = self.parameters.check(theta)
        pairs, share, rest, width = springs(self.shape, self.sheet.uv)
        # Each spring shakes its ends with ω² ≤ 2 k (1/m + 1/m) at most, and a node feels those that end at it.
        stiff, damped = (np.zeros(self.nodes) for _ in range(2))
        for end in pairs.T:
            np.add.at(stiff, end, 2 * share * width / rest)
            np.add.at(damped, end, 2 * share)
        square = theta[:, 0] * (stiff / self.sheet.mass).max()
        rate = theta[:, 1] * (damped / self.sheet.mass).max()
        dt = SAFETY * self.step_scale * 2 / (rate + np.sqrt(square))
        batch = GridBatch(self, theta, dt, SETTLE[1])
        members = batch.members
        late = np.maximum(batch.times[members] - self.scene.start_time, 0.0) / dt[members, None]
        before = np.floor(late).astype(np.int64)
        stops = np.stack([before, before + 1], axis=2).reshape(len(members), -1)
        order = np.argsort(stops, axis=1, kind="stable")  # two frames may lie within one step
        inorder = np.full((*stops.shape, self.nodes, 3), np.nan)
        grips = self.sheet.held[: self.sheet.gripped]
        steps = kernels.march(
            batch.shape, self.sheet.mass, np.array(self.scene.gravity, dtype=float), pairs, share * width, rest, share,
            theta[members], dt[members], grips, batch.knots, np.ascontiguousarray(batch.curves[0]),
            self.scene.start_time, SETTLE if self.anchored else (0.0, 0.0), CALM, AT_REST, batch.bounds(),
            np.take_along_axis(stops, order, axis=1), inorder,
        )  # fmt: skip
        seen = np.take_along_axis(inorder, np.argsort(order, axis=1)[:, :, None, None], axis=1)
        line = batch.interpolator(seen)
        part = (late - before)[:, :, None, None]
        batch.position[members] = (1 - part) * line[:, 0::2] + part * line[:, 1::2]
        held, pins = batch.held_points, batch.pins_of_points
        for row, b in enumerate(members.tolist()):
            lost = np.isnan(batch.position[b]).any()
            batch.status[b], batch.steps[b] = DIVERGED if lost else OK, steps[row]
            if not lost:
                batch.position[b][:, held] = self.scene.grips_at(batch.times[b])[:, pins]
        return batch.rollout()


def springs(shape: tuple[int, int], uv: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Pairs (C, 2), shares (C,), lengths (C,) m of all springs, and the width of a cell [m]; node number j·nu + i.

    share: ½ along a border, where a spring stands for half as much cloth.
    """
    nu, nv = shape
    j, i = (a.ravel() for a in np.mgrid[:nv, :nu])
    pairs, shares = [], []
    for di, dj in FAMILIES:
        inside = (i + di >= 0) & (i + di < nu) & (j + dj < nv)
        first = (j * nu + i)[inside]
        side = (np.isin(j, (0, nv - 1)) & (dj == 0)) | (np.isin(i, (0, nu - 1)) & (di == 0))
        pairs.append(np.stack([first, first + dj * nu + di], axis=1))
        shares.append(np.where(side, 0.5, 1.0)[inside])
    joined, share = np.concatenate(pairs), np.concatenate(shares)
    rest = np.linalg.norm(uv[joined[:, 1]] - uv[joined[:, 0]], axis=1)
    cell = np.sqrt(np.ptp(uv, axis=0).prod() / ((nu - 1) * (nv - 1)))
    return joined, share, rest, float(cell)
