"""`newton`: the cloth of Newton (on Warp) as a cloth model, on the CPU and in single precision.

Membrane triangles of the stable neo-Hookean kind and a bending element on every inner edge, as `add_cloth_mesh`
makes them; the parameters are its arguments. What they mean depends on the solver (read in the kernels of Newton 1.8,
`_src/solvers/semi_implicit/kernels_particle.py` and `_src/solvers/vbd/particle_vbd_kernels.py`), so each solver has
its own list, with the units that its formulas imply:

- `semi_implicit` (symplectic Euler): P = k_e F + k_a (J − 1 − k_e/k_a) ∂J/∂F + k_d (Ḟ + J̇ ∂J/∂F), so Lamé's λ is
  k_a − k_e, and k_d also brakes rotation. Bending forces l θ k_e d with |d| a length: the stiffness of a hinge is
  2 A l k_e (l its length, A half the area of both triangles), hence N/m².
- `vbd` (vertex block descent, backward Euler): k_e and k_a are Lamé's μ and λ, k_d acts on the rate of FᵀF, and the
  stiffness of a hinge is l k_e, hence N.

Neither bending stiffness is that of a material: on a finer mesh the same value makes another cloth.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from clothbench import ClothbenchError, Effect, Material, Parameter, ParameterSpace, Scene, Sheet, Stated, check_choice
from clothbench.modelling import (
    BoundEffects,
    GridSimulation,
    check_number,
    check_resolution,
    gradient_weights,
    grid_shape,
)
from clothbench_models.orthotropy import refuse_ratios
from clothbench_models.peers import missing
from clothbench_models.peers.external import ExternalSimulation, reason_to_skip, refuse_mass

if TYPE_CHECKING:
    from clothbench_models.peers.newton_sheet import Cloth, NewtonSheet

SAFETY = 0.8  # share of the largest stable step that is used
IMPLICIT_STEP = 2e-3  # s
VISCOSITY = {"semi_implicit": 2.0, "vbd": 4.0}  # N·s/m of a strip that is pulled, for each unit of tri_kd
SOURCE = "Newton 1.8, ModelBuilder.add_cloth_mesh and kernels of the solver "


def _space(solver: str, rows: Sequence[tuple]) -> ParameterSpace:
    return ParameterSpace(tuple(Parameter(*row, SOURCE + solver) for row in rows))


PARAMETERS = {
    "semi_implicit": _space(
        "SolverSemiImplicit",
        (
            ("tri_ke", "k_e", "N/m", (5.0, 1000.0), "log", 50.0, "membrane: shear modulus times thickness, μ"),
            ("tri_ka", "k_a", "N/m", (5.0, 1000.0), "log", 50.0, "membrane: resistance to a change of area, λ + μ"),
            ("tri_kd", "k_d", "N·s/m", (1e-7, 1e-1), "log", 1e-3, "membrane: viscosity times thickness"),
            ("edge_ke", "b_e", "N/m²", (1e-2, 1e2), "log", 1.0, "bending: hinge stiffness over 2 A l"),
            ("edge_kd", "b_d", "N·s/m⁴", (1e-3, 1e1), "log", 0.1, "bending: hinge damping over 4 A² l"),
        ),
    ),
    "vbd": _space(
        "SolverVBD",
        (
            ("tri_ke", "k_e", "N/m", (5.0, 1000.0), "log", 50.0, "membrane: Lamé's μ times thickness"),
            ("tri_ka", "k_a", "N/m", (0.0, 1000.0), "linear", 10.0, "membrane: Lamé's λ times thickness"),
            ("tri_kd", "k_d", "N·s/m", (1e-5, 1e-1), "log", 1e-3, "membrane: viscosity, on the rate of FᵀF"),
            ("edge_ke", "b_e", "N", (1e-5, 1e-1), "log", 1e-3, "bending: hinge stiffness over its length"),
            ("edge_kd", "b_d", "N·s", (1e-8, 1e-4), "log", 1e-6, "bending: hinge damping over its length"),
        ),
    ),
}

# Newton's documentation says no more of its attributes than this, and nothing of what the solvers make of them.
ATTRIBUTES = (
    "Newton 1.8, Model.tri_materials and Model.edge_bending_properties, "
    "https://newton-physics.github.io/newton/stable/api/_generated/newton.Model.html"
)
DOCUMENTED = (
    Stated("bending", "edge_ke [N·m/rad]", lambda p: float(p[3]), ATTRIBUTES),
    Stated("stretch", "4 tri_ke (tri_ka + tri_ke) / (tri_ka + 2 tri_ke) [Pa]",
           lambda p: float(4 * p[0] * (p[1] + p[0]) / (p[1] + 2 * p[0])), ATTRIBUTES),
    Stated("shear", "tri_ke [Pa]", lambda p: float(p[0]), ATTRIBUTES),
    Stated("stretch_damping", "tri_kd [Pa·s]", lambda p: float(p[2]), ATTRIBUTES),
    Stated("bending_damping", "edge_kd [N·s]", lambda p: float(p[4]), ATTRIBUTES),
)  # fmt: skip


class Newton:
    """Newton's cloth; see the module for its physics.

    solver: "semi_implicit" (explicit steps) or "vbd" (implicit); resolution: nodes along (u, v) or one number for the
    longer side, where the scene does not say; dt: time step [s], or None for the largest stable one times 0.8
    ("semi_implicit") or 2 ms ("vbd"); step_scale: multiplies that step; iterations: sweeps of "vbd" per step, too few
    of which leave the cloth too soft.
    """

    name = "newton"
    version = 3
    parameters = PARAMETERS["semi_implicit"]
    capabilities = frozenset({"dynamic", "static", "effects", "moving_start"})
    precision = "single"
    documented = DOCUMENTED
    repeatability = 5e-6  # m: rounding alone carries a sheet up to a micrometre away
    built_on = ("newton",)
    bench_options: tuple[dict[str, str], ...] = ()  # `clothbench bench` measures the peers of that name

    def __init__(
        self, solver: str = "semi_implicit", resolution: int | Sequence[int] = 13, dt: float | None = None,
        step_scale: float = 1.0, iterations: int = 20,
    ):  # fmt: skip
        check_choice("newton", "solver", solver, PARAMETERS)
        check_resolution("newton", resolution)
        check_number("newton", "dt", dt, 0.0)
        check_number("newton", "step_scale", step_scale, 0.0, 1.2, optional=False)
        check_number("newton", "iterations", iterations, 0.0, optional=False)
        if iterations != int(iterations):  # half a sweep would be none, of which the sheet falls apart
            raise ClothbenchError(f"newton: iterations is {iterations!r}, expected a whole number above 0")
        self.solver, self.resolution, self.dt, self.step_scale = solver, resolution, dt, step_scale
        self.iterations = int(iterations)
        self.parameters = PARAMETERS[solver]
        self.kind = "explicit" if solver == "semi_implicit" else "implicit"

    @staticmethod
    def skip_reason() -> str | None:
        """What to install; None when Newton is there."""
        return missing("newton", "newton")

    def skip(self, scene: Scene) -> str | None:
        return reason_to_skip("newton", scene)

    def of_material(self, material: Material, scene: Scene) -> np.ndarray:
        """λ = 0 and μ half the stretch; a hinge stiffness with which this scene's mesh bends like the material."""
        refuse_ratios("newton", material)
        if not math.isclose(material.shear, material.stretch / 2, rel_tol=1e-3):
            raise ClothbenchError(
                "newton: a membrane without cross contraction has shear = stretch/2, it has no parameter for "
                f"{material.shear:g} N/m beside {material.stretch:g} N/m"
            )
        space, shear = self.parameters, material.stretch / 2
        shape = grid_shape(scene, self.resolution)
        sheet = GridSimulation(scene, shape, BoundEffects(space, ())).sheet
        hinge = material.bending / unit_bending(sheet, self.solver)
        area, edge_kd = shear if self.solver == "semi_implicit" else 0.0, space["edge_kd"].bounds[0]
        if material.bending_damping > 0:
            if material.bending == 0:
                raise ClothbenchError(
                    "newton: a hinge is damped in proportion to its stiffness, it has no parameter for a "
                    f"bending_damping of {material.bending_damping:g} N·m·s beside a bending of 0; state a bending"
                )
            edge_kd = material.bending_damping / material.bending * hinge / self._brake(sheet)
        tri_kd = material.stretch_damping / VISCOSITY[self.solver]
        return np.array([shear, area, max(space["tri_kd"].bounds[0], tri_kd), hinge, edge_kd])

    def material_of(self, theta: np.ndarray, scene: Scene) -> Material:
        """Of a membrane free to narrow, 4μ(λ + μ)/(λ + 2μ) and μ; of the hinges, what this mesh makes of them."""
        mu, area, tri_kd, hinge, edge_kd = (float(value) for value in theta[:5])
        semi = self.solver == "semi_implicit"
        lam = area - mu if semi else area
        sheet = GridSimulation(scene, grid_shape(scene, self.resolution), BoundEffects(self.parameters, ())).sheet
        rigidity = unit_bending(sheet, self.solver)
        stretch = 4 * mu * (lam + mu) / (lam + 2 * mu)
        damping = edge_kd * self._brake(sheet) * rigidity
        return Material(hinge * rigidity, stretch, mu, damping, VISCOSITY[self.solver] * tri_kd)

    def _brake(self, sheet: Sheet) -> float:
        """What makes of edge_kd over edge_ke the time by which a hinge's damping lags its stiffness: 2 A for
        "semi_implicit", whose hinges have 4 A² l edge_kd and 2 A l edge_ke, of the mean triangle here.
        """
        if self.solver != "semi_implicit":
            return 1.0
        _, area = gradient_weights(sheet.uv, sheet.triangles)
        return 2 * float(area.mean())

    def prepare(self, scene: Scene, effects: Sequence[Effect] = ()) -> NewtonSimulation:
        if reason := self.skip(scene):
            raise ClothbenchError(reason)
        joined = BoundEffects(self.parameters, tuple(effects))
        if self.solver != "semi_implicit":
            refuse_mass(joined, f"newton with solver={self.solver}")
        shape = grid_shape(scene, self.resolution)
        return NewtonSimulation(scene, shape, joined, self.solver, self.dt, self.step_scale, self.iterations)


@dataclass(frozen=True, eq=False)
class NewtonSimulation(ExternalSimulation):
    """One scene ready for Newton."""

    solver: str
    dt: float | None
    step_scale: float
    iterations: int

    at_rest = 1e-5
    threads = False  # Warp records and replays one graph at a time

    def engine(self, theta: np.ndarray) -> NewtonSheet:
        from clothbench_models.peers.newton_sheet import Cloth, NewtonSheet

        cloth = Cloth(tuple(theta[:5].tolist()), self.solver, self.iterations)
        return NewtonSheet(self.sheet, cloth, self.sheet.held, self._step(cloth, theta))

    def _step(self, cloth: Cloth, theta: np.ndarray) -> float:
        """The time step [s]: symplectic Euler with a lagging damping force must resolve the stiffest mode."""
        if self.dt is not None:
            return self.dt * self.step_scale
        if self.solver == "vbd":
            return IMPLICIT_STEP * self.step_scale
        from clothbench_models.peers.newton_sheet import stiffest

        square, rate = stiffest(self.sheet, cloth)
        light = self.effects.lightest(theta[None])[0]
        omega = math.sqrt((square + self.stiffest_effect(theta[None])[0]) / light)
        half = rate / light / (2 * omega)
        held = self.restrained_step(theta[None], np.array([omega**2]), np.array([2 * half * omega]))[0]
        return self.step_scale * min(SAFETY * (2 / omega) * (math.sqrt(1 + half**2) - half), held)


def unit_bending(sheet: Sheet, solver: str) -> float:
    """Bending rigidity D [N·m] of the mesh with edge_ke = 1: the mean over cylinders about u and about v.

    A hinge bends by the jump of the slope across it, θ = |∇w₁ − ∇w₂|, of the surface w = κ u²/2; the energy of all
    hinges, ½ Σ k θ², is ½ D κ² times the sheet's area. Newton knows the triangles as they lie on the flat sheet, and
    not that those along a hem may stand for cloth beside them.
    """
    seen: dict[tuple[int, int], int] = {}
    pairs, lengths = [], []
    for f, corners in enumerate(sheet.triangles.tolist()):
        for k in range(3):
            edge = tuple(sorted((corners[k], corners[k - 1])))
            if edge in seen:
                pairs.append((seen[edge], f))
                lengths.append(math.dist(sheet.uv[edge[0]], sheet.uv[edge[1]]))
            seen[edge] = f
    one, two = np.array(pairs).T
    stiffness = np.array(lengths)
    if solver == "semi_implicit":
        _, area = gradient_weights(sheet.uv, sheet.triangles)
        stiffness = stiffness * (area[one] + area[two])
    total = 0.0
    for axis in range(2):
        slope = np.einsum("fdm,fm->fd", sheet.gradient, (sheet.uv[:, axis] ** 2 / 2)[sheet.triangles])
        total += float(stiffness @ ((slope[one] - slope[two]) ** 2).sum(axis=1))
    return total / 2 / float(sheet.face_area.sum())
