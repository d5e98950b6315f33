"""`mass_spring`: the grid of springs and dampers of Provot (1995), as fitted in
"Cloth mechanical parameter estimation and simulation for optimized robotic manipulation", section 5.2.

Structural springs join neighbours, shear springs the diagonals of a cell, flexion springs nodes two apart. k1 is
shared by structural and shear springs, k2 belongs to the flexion springs, and all springs have the damping ratio ζ,
c = 2ζ√(k m); `spring_grid` says where this departs from the paper. Flexion springs resist bending only to fourth
order in the curvature (a bent spring is a chord), so the sheet has no bending rigidity in the sense of a plate's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from clothbench import ClothbenchError, Effect, Material, Parameter, ParameterSpace, Scene
from clothbench.modelling import BoundEffects, grid_shape
from clothbench_models.mass_spring_kernels import damped_up_to
from clothbench_models.mass_spring_simulation import LACKS, SpringOptions, SpringSimulation
from clothbench_models.orthotropy import refuse_ratios

CALM = 0.05  # damping ratio with which a sheet settles: more only asks for shorter steps
SOURCE = "Provot 1995; Cloth mechanical parameter estimation … for optimized robotic manipulation, section 5.2"

STAGES = np.arange(1, 17)  # of damping in a step; with one it lags by that step
REACH = np.array([damped_up_to(stages) for stages in STAGES[1:]])  # of the rate of damping times the step
# Of a step, measured on 143 nodes, beside a step of a single stage without effects, which is 1; and the same again for
# effects: what each adds is for nobody to know, and a run with one of amount 0 has to be the run without it.
WORK = np.where(STAGES == 1, 1.0, 1.6 + 0.6 * STAGES) + 1.0

PARAMETERS = ParameterSpace(
    (
        Parameter("k1", "k₁", "N/m", (1.0, 1000.0), "log", 60.0, "stiffness of structural and shear springs", SOURCE),
        Parameter("k2", "k₂", "N/m", (0.01, 100.0), "log", 1.0, "stiffness of flexion springs", SOURCE),
        Parameter("zeta", "ζ", "1", (0.001, 1.0), "log", 0.05, "damping ratio of every spring, c = 2ζ√(k m)", SOURCE),
    )
)

# What is searched for in a type of textile: structural springs hold the threads' lengths, flexion springs do what is
# left. Shear springs share k1 and hold a limp cloth up, so that it has to be the lower, the limper it is: 1 N/m lets a
# cloth of 0.2 kg/m² stretch by six percent at the rim of a drapemeter.
TEXTILES: dict[str, dict[str, float | tuple[float, float]]] = {
    "soft": {"k1": 1.0, "k2": (1e-4, 10.0), "zeta": 0.05},
    "medium": {"k1": 15.0, "k2": (1e-3, 30.0), "zeta": 0.05},
    "stiff": {"k1": 50.0, "k2": (0.01, 100.0), "zeta": 0.05},
}


class MassSpring:
    """Provot's mass-spring-damper sheet, explicit leapfrog; see the module for equations and sources.

    resolution: nodes along (u, v) or one number for the longer side, where the scene does not say;
    dt: time step [s], or None for the largest stable one of each parameter set times 0.9, with strong damping taken in
    several stages of each step where that is less work (`relax`; with a stated step, where it is too long for one);
    step_scale: multiplies that step, with as many stages (0.5 halves it, to see what the step costs in accuracy);
    precision: "double", or "single", which is
    twice as fast, a quarter faster with effects, which stay in double (a smoothly moving sheet differs by micrometres;
    one that folds without damping is chaotic, and then any rounding grows); strain_limit: strain beyond which
    structural and shear springs are drawn together again after each step (Provot 1995, section 5: 0.1), or None for
    springs that stay linear. Thirty sweeps a step leave something: a sheet of 0.3 m and 0.3 kg/m² on 13 to 25
    nodes a side, with limits from 0.02 to 0.1, is over them by 0.004 at most with k₁ = 60 N/m, where it would stretch
    by 0.1 to 0.2 without one, by 0.02 with 10 N/m (0.6 to 0.9), by 0.03 to 0.08 with 2 N/m (2 to 4).
    """

    name = "mass_spring"
    version = 8
    lacks = LACKS
    kind = "explicit"
    parameters = PARAMETERS
    textiles = TEXTILES
    capabilities = frozenset(
        {"dynamic", "static", "effects", "contact", "carried_contact", "self_contact", "moving_start", "outline"}
    )

    bench_options: tuple[dict[str, str], ...] = ({}, {"precision": "single"})
    # Of six springs, the adding of their forces and the step of one node, its damping of one stage: counted in
    # `mass_spring_kernels`.
    work_per_node_step: Mapping[str, float] = {"operations": 216, "roots": 12, "numbers": 213}

    def __init__(
        self, resolution: int | Sequence[int] = 13, dt: float | None = None, step_scale: float = 1.0,
        precision: str = "double", strain_limit: float | None = None,
    ):  # fmt: skip
        self.options = SpringOptions(resolution, dt, step_scale, precision, strain_limit)
        self.options.check(self.name)

    def prepare(self, scene: Scene, effects: Sequence[Effect] = ()) -> MassSpringSimulation:
        bound = BoundEffects(self.parameters, tuple(effects))
        return MassSpringSimulation(scene, grid_shape(scene, self.options.resolution), bound, self.options)

    def of_material(self, material: Material, scene: Scene) -> np.ndarray:
        """Parameters (3,) of a textbook material: the tensile stiffness of a strip that is free to narrow.

        The lattice has C11 = C22 = C = 2 k1 + 4 k2 (a flexion spring is two cells long) and C12 = C66 = k1, so a free
        strip has C − k1²/C. k2 is as small as it gets. Shear springs share k1: the shear stiffness comes out as k1,
        whatever the material's, and there is a cross contraction of 1/2. All of this is of square cells; of others,
        where the diagonals have other moduli (`spring_grid`), the lattice is stiffer along their longer side.
        """
        refuse_ratios(self.name, material)
        if material.bending > 0:
            raise ClothbenchError(
                "mass_spring: has no small-strain bending rigidity; flexion springs resist bending only to fourth order"
            )
        k2 = self.parameters["k2"].bounds[0]
        stretch, own = material.stretch, 4 * k2
        if stretch <= own:
            raise ClothbenchError(
                f"mass_spring: has a stretch of more than {own:g} N/m, which its flexion springs hold; "
                f"found {stretch:g} N/m"
            )
        half = stretch - 2 * own  # 3 k1² − 2 half k1 = 4 k2 (stretch − 4 k2)
        k1 = (half + np.sqrt(half**2 + 3 * own * (stretch - own))) / 3
        return np.array([k1, k2, material.stretch_damping / self._viscosity(k1, k2, scene)])

    def material_of(self, theta: np.ndarray, scene: Scene) -> Material:
        """The inverse, of square cells, too: no bending rigidity, and dampings c = 2ζ√(k m) that depend on the mesh."""
        k1, k2, zeta = (float(value) for value in theta[:3])
        whole = 2 * k1 + 4 * k2
        return Material(0.0, whole - k1**2 / whole, k1, 0.0, zeta * self._viscosity(k1, k2, scene))

    def _viscosity(self, k1: float, k2: float, scene: Scene) -> float:
        """Of a strip [N·s/m] whose springs have ζ = 1: dashpots c1 and c2 lie as the springs do, and while it narrows
        as these make it, by the share ν, it loses (2 c1 + 4 c2)(1 + ν²) − 2 ν c1.
        """
        c1, c2 = (2 * float(np.sqrt(k * self._node_mass(scene))) for k in (k1, k2))
        narrower = k1 / (2 * k1 + 4 * k2)
        return (2 * c1 + 4 * c2) * (1 + narrower**2) - 2 * narrower * c1

    def _node_mass(self, scene: Scene) -> float:
        """Mass of a node inside the sheet [kg]."""
        nu, nv = grid_shape(scene, self.options.resolution)
        return scene.areal_density * scene.width * scene.height / ((nu - 1) * (nv - 1))


@dataclass(frozen=True, eq=False)
class MassSpringSimulation(SpringSimulation):
    """One scene on one grid, ready for batches of parameter sets: k1 N/m, k2 N/m, ζ, then the effects'."""

    safety = 0.9  # with it 432 sets from all over the bounds run to their end; of the stable step itself, 420 do
    limited = 4  # structural and shear springs

    def stiffness(self, theta: np.ndarray) -> np.ndarray:
        return theta[:, :2]

    def dashpots(self, theta: np.ndarray) -> np.ndarray:
        return 2 * theta[:, 2:3] * np.sqrt(theta[:, :2] * self.grid.node_mass)

    def calmed(self, theta: np.ndarray) -> np.ndarray:
        """With little damping, where long steps are stable: what hangs still does not depend on it."""
        out = theta.copy()
        out[:, 2] = CALM
        return out

    def stable_step(self, theta: np.ndarray) -> np.ndarray:
        """Leapfrog with a lagging damping force; ω² and the damping rate are bounded by the flat sheet's."""
        omega, rate = self.frequency_and_damping(theta)
        half = rate / (2 * omega)
        return (2 / omega) * (np.sqrt(1 + half**2) - half)

    def stages_and_step(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Those of least work: several stages allow leapfrog its own step, 2/ω, or one as long as they hold for."""
        omega, rate = self.frequency_and_damping(theta)
        longest = np.minimum(2 / omega[:, None], REACH / np.maximum(rate, 1e-300)[:, None])
        steps = np.column_stack([self.stable_step(theta), longest])
        best = (WORK / steps).argmin(axis=1)
        return STAGES[best], steps[np.arange(len(theta)), best]

    def stages_for(self, theta: np.ndarray, step: float) -> np.ndarray:
        """As many as make the step stable, if any do."""
        omega, rate = self.frequency_and_damping(theta)
        fewest = STAGES[np.minimum(1 + np.searchsorted(REACH, rate * step), len(STAGES) - 1)]
        return np.where((self.stable_step(theta) < step) & (step <= 2 / omega), fewest, 1)

    def square_and_rate(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        omega, rate = self.frequency_and_damping(theta)
        return omega**2, rate

    def frequency_and_damping(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Bounds on ω and on the rate of damping (B,) 1/s: the flat sheet's."""
        k1, k2, zeta = theta[:, :3].T
        one, two = self.grid.largest_eigenvalues
        node, light = self.grid.node_mass, self.effects.lightest(theta)
        omega = np.sqrt((k1 * one + k2 * two + self.stiffest_effect(theta)) / light)
        return omega, 2 * zeta * (np.sqrt(k1 * node) * one + np.sqrt(k2 * node) * two) / light
