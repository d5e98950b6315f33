"""`xpbd`: a grid of springs stepped by extended position-based dynamics (Macklin, Müller and Chentanez 2016).

The method of game engines and of many robot simulators, with one sweep over the springs per small step (Macklin et
al. 2019). The springs are those of Provot (1995): k1 for neighbours and diagonals, k2 for nodes two apart. So k1 and
k2 can be held against what `mass_spring` finds; where they differ, the stepping is to blame and not the cloth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from clothbench import ClothbenchError, Effect, Interpolator, Parameter, ParameterSpace, Rollout, Scene
from clothbench.core.parallel import for_each
from clothbench.core.scene import initial_shape
from clothbench.modelling.bound_effects import BoundEffects
from clothbench.modelling.kernels import no_effect
from clothbench.modelling.mesh import grid_triangles
from clothbench.modelling.sheet import own_sheet, sheet_of

from clothbench_xpbd import kernels

PROVOT = "Provot 1995, section 3"
# (Δi, Δj, is flexion) of the six families of springs
FAMILIES = ((1, 0, False), (0, 1, False), (1, 1, False), (-1, 1, False), (2, 0, True), (0, 2, True))
SETTLE = np.array([1.5, 20.0])  # s, least and most that the sheet is given to come to rest


class Xpbd:
    """resolution: nodes along (u, v), where the scene does not say; dt: time step [s]."""

    name = "xpbd"
    version = 1
    kind = "implicit"
    capabilities = frozenset({"dynamic", "static", "effects"})
    parameters = ParameterSpace(
        (
            Parameter("k1", "k₁", "N/m", (1.0, 1000.0), "log", 60.0, "stiffness of neighbours and diagonals", PROVOT),
            Parameter("k2", "k₂", "N/m", (0.01, 100.0), "log", 1.0, "stiffness of springs two nodes long", PROVOT),
            Parameter("tau", "τ", "s", (1e-5, 0.02), "log", 1e-3, "relaxation time of every spring, damping over "
                      "stiffness", "Macklin et al. 2016, equation 26"),
        )
    )  # fmt: skip

    def __init__(self, resolution: Sequence[int] = (13, 13), dt: float = 5e-4):
        if not dt > 0:
            raise ClothbenchError(f"xpbd: dt is {dt}, expected seconds above 0")
        self.resolution, self.dt = (int(resolution[0]), int(resolution[1])), dt

    def refined(self, factor: float) -> Xpbd:
        """The same with a time step `factor` times smaller, for whoever wants to know what the step costs."""
        return Xpbd(self.resolution, self.dt / factor)

    def prepare(self, scene: Scene, effects: Sequence[Effect] = ()) -> XpbdSimulation:
        shape = scene.resolution or self.resolution
        return XpbdSimulation(scene, shape, BoundEffects(self.parameters, effects), self.dt)


@dataclass(frozen=True, eq=False)
class XpbdSimulation:
    """One scene on a grid `shape` of (nu, nv) nodes, ready for batches of parameter sets; dt: s."""

    scene: Scene
    shape: tuple[int, int]
    effects: BoundEffects
    dt: float

    @property
    def parameters(self) -> ParameterSpace:
        return self.effects.parameters

    def run(self, theta: np.ndarray) -> Rollout:
        """Simulate theta (B, P): k1 N/m, k2 N/m, τ s, then the effects' parameters; several members at a time."""
        theta, scene, effects = self.parameters.check(theta), self.scene, self.effects
        grid = Grid.of(scene, self.shape)
        held = Interpolator.on_lines(scene.grip_material, *grid.lines)
        points = Interpolator.on_lines(scene.points, *grid.lines)
        nearest = np.take_along_axis(held.index, held.weight.argmax(axis=1)[:, None], axis=1)[:, 0]
        sheet = sheet_of(grid.uv, grid.mass, grid.area, grid.triangles, scene.gravity, scene.air_density, nearest)
        curves, times = effects.grip_curves(scene, theta), effects.times(scene, theta)
        functions, stages, used = effects.kernels(kernels.SLOTS, no_effect)
        values = effects.kernel_parameters(theta, kernels.SLOTS)
        memory = effects.kernel_state(len(theta), kernels.SLOTS, sheet)
        knots = np.array(scene.grip_time) if len(scene.grip_material) else np.zeros(2)
        on_grip = np.abs(scene.points[:, None] - scene.grip_material).max(axis=2) < 1e-9
        seen, shared = np.ascontiguousarray(np.argwhere(on_grip).T)
        start = np.ascontiguousarray(initial_shape(scene, grid.uv).T)
        position = np.empty((len(theta), scene.times.size, len(scene.points), 3))
        steps, march = np.zeros(len(theta), np.int64), kernels.march()

        def simulate(b: int) -> None:
            k1, k2, tau = theta[b, :3]
            steps[b] = march(
                start.copy(), own_sheet(sheet), self.shape[0], grid.pairs, grid.rest,
                1 / (grid.share * np.where(grid.flexion, k2, k1)), tau,
                *functions, stages, used, values[b], memory[b],
                held.index, held.weight, knots, curves[b % len(curves)], seen, shared,
                points.index, points.weight, times[b], scene.start_time, SETTLE, self.dt, position[b],
            )  # fmt: skip

        for_each(simulate, range(len(theta)))
        return self._rollout(theta, position, steps)

    def _rollout(self, theta: np.ndarray, position: np.ndarray, steps: np.ndarray) -> Rollout:
        """What the sensor makes of it; a member that left all bounds has no numbers from there on."""
        position = self.effects.seen(self.scene, theta, position)
        lost = np.logical_or.accumulate(~(np.abs(position).max(axis=(2, 3)) < 1e3), axis=1)
        position[lost] = np.nan
        gone = lost.any(axis=1)
        status = tuple("diverged" if g else "ok" for g in gone)
        reasons = tuple("the sheet left all bounds" if g else "" for g in gone)
        return Rollout(self.scene.times, position, status, steps, self.shape[0] * self.shape[1], reasons)


@dataclass(frozen=True, eq=False)
class Grid:
    """Nodes and springs. uv: (n, 2) m; mass: (n,) kg; area: (n,) m²; pairs: (C, 2), node numbers; rest: (C,) m;
    share: (C,), stiffness of each spring in units of k1 or k2, ½ along a border; flexion: (C,), which it is.
    """

    lines: tuple[np.ndarray, np.ndarray]
    uv: np.ndarray
    mass: np.ndarray
    area: np.ndarray
    triangles: np.ndarray
    pairs: np.ndarray
    rest: np.ndarray
    share: np.ndarray
    flexion: np.ndarray

    @classmethod
    def of(cls, scene: Scene, shape: tuple[int, int]) -> Grid:
        lines = np.linspace(0.0, scene.width, shape[0]), np.linspace(0.0, scene.height, shape[1])
        uv = np.stack(np.meshgrid(*lines), axis=-1).reshape(-1, 2)
        border = (uv <= 0) | (uv >= uv[-1])
        area = np.prod(uv[-1] / (np.array(shape) - 1)) / 2.0 ** border.sum(axis=1)
        pairs, share, flexion = springs(shape)
        rest = np.linalg.norm(uv[pairs[:, 1]] - uv[pairs[:, 0]], axis=1)
        return cls(lines, uv, scene.areal_density * area, area, grid_triangles(shape), pairs, rest, share, flexion)


def springs(shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs (C, 2), shares (C,) and whether flexion (C,) of all springs of a grid; node number j·nu + i."""
    nu, nv = shape
    j, i = (a.ravel() for a in np.mgrid[:nv, :nu])
    found = []
    for di, dj, is_flexion in FAMILIES:
        inside = (i + di >= 0) & (i + di < nu) & (j + dj < nv)
        first = (j * nu + i)[inside]
        side = (np.isin(j, (0, nv - 1)) & (dj == 0)) | (np.isin(i, (0, nu - 1)) & (di == 0))
        share = np.where(side, 0.5, 1.0)[inside]
        found.append((np.stack([first, first + dj * nu + di], axis=1), share, np.full(len(first), is_flexion)))
    pairs, share, flexion = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return np.ascontiguousarray(pairs), share, flexion
