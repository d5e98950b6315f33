"""`xpbd`: a grid of springs stepped by extended position-based dynamics (Macklin, Müller and Chentanez 2016).

The method of game engines and of many robot simulators, with one sweep over the springs per small step (Macklin et
al. 2019). The springs are those of Provot (1995): k1 for neighbours and diagonals, k2 for nodes two apart. So k1 and
k2 can be held against what `mass_spring` finds; where they differ, the stepping is to blame and not the cloth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from clothbench import Effect, Parameter, ParameterSpace, Rollout, Scene
from clothbench.modelling import BoundEffects, GridBatch, GridSimulation, check_number, check_resolution, grid_shape

from clothbench_xpbd import kernels

PROVOT = "Provot 1995, section 3"
# (Δi, Δj, is flexion) of the six families of springs
FAMILIES = ((1, 0, False), (0, 1, False), (1, 1, False), (-1, 1, False), (2, 0, True), (0, 2, True))


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

    def __init__(self, resolution: int | Sequence[int] = (13, 13), dt: float = 5e-4):
        check_resolution(self.name, resolution)
        check_number(self.name, "dt", dt, 0.0)
        self.resolution, self.dt = resolution, dt

    def refined(self, factor: float) -> Xpbd:
        """The same with a time step `factor` times smaller, for whoever wants to know what the step costs."""
        return Xpbd(self.resolution, self.dt / factor)

    def prepare(self, scene: Scene, effects: Sequence[Effect] = ()) -> XpbdSimulation:
        bound = BoundEffects(self.parameters, tuple(effects))
        return XpbdSimulation(scene, grid_shape(scene, self.resolution), bound, self.dt)


@dataclass(frozen=True, eq=False)
class XpbdSimulation(GridSimulation):
    """One scene on a grid, ready for batches of parameter sets; dt: s."""

    dt: float

    def run(self, theta: np.ndarray) -> Rollout:
        """Simulate theta (B, P): k1 N/m, k2 N/m, τ s, then the effects' parameters; several members at a time."""
        theta = self.parameters.check(theta)
        batch = GridBatch(self, theta, np.full(len(theta), self.dt), kernels.SETTLE[1])
        shape, (pairs, share, flexion) = np.ascontiguousarray(batch.shape.T), springs(self.shape)
        rest = np.linalg.norm(self.sheet.uv[pairs[:, 1]] - self.sheet.uv[pairs[:, 0]], axis=1)
        march = kernels.march()

        def simulate(b: int) -> tuple[int, int]:
            k1, k2, tau = theta[b, :3]
            own = kernels.Springs(pairs, rest, 1 / (share * np.where(flexion, k2, k1)), tau)
            return march(
                shape.copy(), batch.sheet(), self.shape[0], own, *batch.kernels, batch.effect_terms(b), batch.grips(b),
                batch.clock(b), batch.sampling(b),
            )  # fmt: skip

        return batch.run(simulate)


def springs(shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs (C, 2), shares (C,) and whether flexion (C,) of all springs of a grid; node number j·nu + i.

    share: stiffness in units of k1 or k2, ½ along a border.
    """
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
