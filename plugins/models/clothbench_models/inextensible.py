"""`inextensible`: quadrilaterals that neither stretch nor shear, bend isometrically and are damped after Rayleigh.

ρ M φ̈ = F_g − θ K φ − D φ̇ − ∇Cᵀ λ, C(φ) = 0, D = α M + β K (Coltraro, Experimental validation of an inextensible
cloth model, eq. 1): M the lumped area of each node, K quadratic bending (`bending`), C the lengths of all mesh lines
and the angle of every cell, solved by implicit steps with fast projection (Goldenthal et al. 2007, Efficient
simulation of inextensible cloth). ρ is measured, not fitted, as in the paper: it is the scene's areal density.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from clothbench import Effect, Material, Parameter, ParameterSpace, Rollout, Scene, check_choice
from clothbench.modelling import (
    OK,
    SETTLES,
    BoundEffects,
    GridBatch,
    GridSimulation,
    check_number,
    check_resolution,
    grid_shape,
    layers_of,
    obstacle_table,
)
from clothbench_models import baraff_witkin_kernels as triangles
from clothbench_models import inextensible_kernels as kernels
from clothbench_models.baraff_witkin import edge_widths, padded, triangle_edges
from clothbench_models.bending import Diagonals, ThreadBending, bending_matrix
from clothbench_models.inextensible_constraints import Constraints
from clothbench_models.orthotropy import BEND_RATIO, OPTION, check_orthotropic, refuse_ratios, softer_share
from clothbench_models.sheet_forces import CELLS

SCHEMES = {"implicit_euler": kernels.EULER, "bdf2": kernels.BDF2}
STEP = {"implicit_euler": 1e-3, "bdf2": 2e-3}
IMPACT_STEP = 5e-4  # s, at most, where the sheet may hit something: the tension of one step is the next one's guess
TAUT = 2e4  # N/m, what "inextensible" means: a 0.3 m sheet of 0.2 kg/m² hangs 10 µm longer
COLTRARO = "Coltraro, Experimental validation of an inextensible cloth model, eq. 1"

PARAMETERS = ParameterSpace(
    (
        Parameter("theta", "θ", "N·m", (1e-7, 1e-2), "log", 1e-5, "bending rigidity, factor of K", COLTRARO),
        Parameter("alpha", "α", "kg/(m²·s)", (0.0, 5.0), "linear", 1.5, "damping as the area, D = αM + βK", COLTRARO),
        Parameter("beta", "β", "N·m·s", (0.0, 1e-4), "linear", 2e-6, "damping of bending, D = αM + βK", COLTRARO),
    )
)
ORTHOTROPIC = PARAMETERS.joined(ParameterSpace((BEND_RATIO,)))


class Inextensible:
    """Inextensible sheet with implicit steps and fast projection; see the module for equations and sources.

    resolution: nodes along (u, v) or one number for the longer side, where the scene does not say;
    integrator: "bdf2" (default; second order) or "implicit_euler" (the paper's, which damps the motion itself);
    dt: time step [s] (None: 2 ms, for implicit Euler 1 ms, where there is contact 0.5 ms); step_scale: multiplies it;
    tolerance: strain that the projection leaves, which has to fall with dt, as its square: 1e-5 costs a swing with air
    0.001 mm in steps of 2 ms, but 0.05 to 0.25 mm in steps of 0.25 ms, and 1e-6 there 0.002 to 0.005; shear: N/m,
    stiffness that stands for the cells' angle constraint (None: as stiff as the mesh lines); orthotropic: one parameter
    more, what warp has over weft in bending.
    """

    name = "inextensible"
    version = 10
    lacks: Mapping[str, str] = {"stretch": "its threads do not stretch"}
    kind = "implicit"
    parameters = PARAMETERS
    capabilities = frozenset(
        {"dynamic", "static", "effects", "contact", "carried_contact", "self_contact", "moving_start", "outline"}
    )
    repeatability = 1e-5  # m: what the tolerance of the projection leaves open
    bench_options: tuple[dict[str, str], ...] = ({},)

    def __init__(
        self, resolution: int | Sequence[int] = 13, integrator: str = "bdf2", dt: float | None = None,
        step_scale: float = 1.0, tolerance: float = 1e-5, shear: float | None = None, orthotropic: bool = False,
    ):  # fmt: skip
        check_choice(self.name, "integrator", integrator, SCHEMES)
        check_resolution(self.name, resolution)
        check_number(self.name, "dt", dt, 0.0)
        check_number(self.name, "step_scale", step_scale, 0.0, 100.0, optional=False)
        check_number(self.name, "tolerance", tolerance, 0.0, 0.1, optional=False)
        check_number(self.name, "shear", shear, 0.0)
        self.resolution, self.integrator, self.tolerance = resolution, integrator, tolerance
        self.shear = TAUT if shear is None else shear
        self.dt, self.step_scale = dt, step_scale
        self.orthotropic = check_orthotropic(self.name, orthotropic)
        if orthotropic:
            self.parameters = ORTHOTROPIC

    def prepare(self, scene: Scene, effects: Sequence[Effect] = ()) -> InextensibleSimulation:
        bound, shape = BoundEffects(self.parameters, tuple(effects)), grid_shape(scene, self.resolution)
        dt = STEP[self.integrator] if self.dt is None else self.dt
        if self.dt is None and (scene.obstacles or scene.thickness > 0):
            dt = min(dt, IMPACT_STEP)
        scheme = SCHEMES[self.integrator]
        return InextensibleSimulation(
            scene, shape, bound, scheme, dt * self.step_scale, self.tolerance, self.shear, self.orthotropic
        )

    def of_material(self, material: Material, scene: Scene) -> np.ndarray:
        """θ, α, β (3,) and the ratio of an orthotropic sheet, of a textbook material: its bending and the damping of
        that; stretching is not modelled.
        """
        alike = dataclasses.replace(material, stretch_ratio=1.0)
        if not self.orthotropic:
            refuse_ratios(self.name, alike, OPTION)
        ratio = [material.bending_ratio] if self.orthotropic else []
        return np.array([material.bending, 0.0, material.bending_damping, *ratio])

    def material_of(self, theta: np.ndarray, scene: Scene) -> Material:
        """A cloth that bends and does not stretch; α, which brakes every motion, has no place in a material."""
        bending = float(theta[0])
        ratio = float(theta[3]) if self.orthotropic else 1.0
        return Material(bending, math.inf, math.inf, float(theta[2]), 0.0, ratio)


@dataclass(frozen=True, eq=False)
class InextensibleSimulation(GridSimulation):
    """One scene on one grid, ready for batches of parameter sets."""

    scheme: int
    dt: float
    tolerance: float
    shear: float
    orthotropic: bool = False

    @cached_property
    def bending(self) -> Diagonals:
        return bending_matrix(self.sheet)

    @cached_property
    def thread_bending(self) -> ThreadBending:
        return ThreadBending.of(self.sheet)

    @cached_property
    def constraints(self) -> Constraints:
        """Rest lengths (2, P) m of u- and v-edges; (3, P): 1/L, 1/L, 1/√(h_u h_v), 0 where there is none; and how
        little each gives way (3, P) m/N. P = the nodes and nu + 1 places before and after them.
        """
        (u, v), (nu, nv) = self.lines, self.shape
        hu, hv = np.append(np.diff(u), 0.0), np.append(np.diff(v), 0.0)
        ones = np.ones((nv, nu))
        high, wide, whole = edge_widths(self.lines, (self.scene.width, self.scene.height), self.cover)
        lengths = np.stack([ones * hu, ones * hv[:, None]])
        cells = np.sqrt(lengths[0] * lengths[1])
        three = np.stack([*lengths, cells])
        cloth = np.stack([high, wide, whole])
        share = np.divide(1.0, three, out=np.zeros_like(three), where=(three > 0) & (cloth > 0))
        # An edge of length L and width w of a sheet of k N/m gives way by L/(k w) a newton; a cell by one over k.
        one = np.stack([lengths[0] / TAUT, lengths[1] / TAUT, (cells > 0) / self.shear])
        give = np.divide(one, cloth, out=np.zeros_like(one), where=cloth > 0)
        return Constraints(padded(lengths), padded(share), padded(give))

    def calmed(self, theta: np.ndarray) -> np.ndarray:
        """With one damping: what hangs still does not depend on it."""
        out = theta.copy()
        out[:, 1:3] = PARAMETERS.defaults[1:3]
        return out

    def run(self, theta: np.ndarray) -> Rollout:
        """Simulate theta (B, P): θ N·m, α kg/(m²·s), β N·m·s, the ratio of an orthotropic sheet, then the effects'."""
        theta = self.parameters.check(theta)
        batch = GridBatch(self, theta, np.full(len(theta), self.dt), 0.0)
        batch.hang()
        return batch.run(lambda b: self._march(batch, b))

    def _march(self, batch: GridBatch, b: int) -> tuple[int, int]:
        """Simulate member b into the batch's arrays → status, steps."""
        scene, theta = self.scene, batch.theta[b : b + 1]
        bend, alpha, beta = theta[0, :3]
        begins, result = batch.begin(b), np.zeros(3, np.int64)
        ratio = theta[0, 3] if self.orthotropic else 1.0
        bending = self.thread_bending.matrix(ratio) if self.orthotropic else self.bending
        softer = np.array([TAUT, softer_share(ratio)])
        settling, moving = (self.effects.stiffness(t)[0] / softer for t in (self.effects.resting(theta), theta))
        plate = triangles.Plate(bending.offsets, bending.values, bend, 0.0, settling)
        obstacles, layers, sampling = obstacle_table(scene), layers_of(scene, self.sheet), batch.sampling(b)
        terms, grips = batch.effect_terms(b), batch.grips(b)  # what effects remember of the settling goes on in the run
        if begins.settles == SETTLES:  # the same sheet with stiff springs for constraints finds rest in a few rounds
            rest_lengths, over, unit = triangle_edges(self.lines, (scene.width, scene.height), self.cover)
            stiff = unit * np.array([[TAUT], [TAUT], [2 * self.shear]])  # of a cell, not a triangle
            membrane = triangles.Membrane(rest_lengths, over, stiff, np.zeros_like(stiff))
            triangles.march(triangles.BDF2)(
                triangles.BDF2, CELLS, begins, self.shape[0], batch.sheet(), membrane,
                plate, np.zeros(3), *batch.settling_kernels, terms, grips, obstacles, layers,
                batch.clock(b, 1e-4), max(scene.width, scene.height), sampling._replace(times=np.zeros(0)), result,
            )  # fmt: skip
            result[0] = self.settled(result[0])
        if result[0] == OK:
            kernels.march()(
                self.scheme, begins, self.shape[0], batch.sheet(), self.constraints,
                plate._replace(damping=beta, stiffer=moving), alpha, *batch.kernels, terms, grips, obstacles,
                layers, batch.clock(b, self.tolerance), sampling, result,
            )  # fmt: skip
        return int(result[0]), int(result[1])
