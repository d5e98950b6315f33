"""`baraff_witkin`: triangles with stretch, shear and bend conditions (Baraff and Witkin 1998, Large steps in cloth
simulation), as fitted to video by Bhat et al. 2003 (Estimating cloth simulation parameters from video).

Every condition C has the energy E = k/2 CᵀC and the damping −k_d ∂C/∂x Ċ. Energies are linear in a triangle's area a,
so that parameters do not depend on the mesh (Bhat et al., section 3): C_stretch = √a (|w_u| − 1, |w_v| − 1),
C_shear = √a w_u·w_v, and C_bend = √a (x_uu, x_vv, √2 x_uv), the curvatures over the patch of a triangle and its three
neighbours (`bending`), in place of the single hinge's angle, whose stiffness depends on mesh and direction.
With `orthotropic`, warp and weft differ: k_stretch and k_bend are the geometric means of both.
The air takes f = −a (k_N |v_N|²/(1 + k_f |v_N|²) v̂_N + k_T v_T), the drag of Bhat et al., section 3, here node by
node with its own velocity, normal and area, there triangle by triangle with the mean velocity of each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from clothbench import Effect, Material, Parameter, ParameterSpace, Rollout, Scene, check_choice
from clothbench.modelling import (
    OK,
    RESTS,
    SETTLES,
    BoundEffects,
    Cover,
    GridBatch,
    GridSimulation,
    check_number,
    check_resolution,
    cloth_of_cells,
    grid_shape,
    layers_of,
    obstacle_table,
    tributary,
)
from clothbench_models import baraff_witkin_kernels as kernels
from clothbench_models.bending import Diagonals, ThreadBending, bending_matrix
from clothbench_models.orthotropy import (
    BEND_RATIO,
    OPTION,
    STRETCH_RATIO,
    check_orthotropic,
    refuse_ratios,
    softer_share,
)
from clothbench_models.sheet_forces import TRIANGLES

SCHEMES = {"implicit_euler": kernels.EULER, "bdf2": kernels.BDF2, "rk45": kernels.RK45}
STEP = {"implicit_euler": 1e-3, "bdf2": 2e-3, "rk45": 5e-3}
TOLERANCE = {"implicit_euler": 1e-4, "bdf2": 1e-4, "rk45": 1e-6}
BHAT, BARAFF = "Bhat et al. 2003, section 3", "Baraff and Witkin 1998, section 4"


def _parameter(name, symbol, unit, low, high, default, meaning, source, null=None):
    return Parameter(name, symbol, unit, (low, high), "log" if low > 0 else "linear", default, meaning, source, null)


PARAMETERS = ParameterSpace(
    (
        _parameter("bend", "k_bend", "N·m", 1e-7, 1e-2, 1e-5, "bending rigidity", f"{BARAFF}.3; {BHAT}"),
        _parameter("stretch", "k_stretch", "N/m", 5.0, 5000.0, 200.0, "tensile stiffness of warp and weft", BARAFF),
        _parameter("shear", "k_shear", "N/m", 1.0, 5000.0, 50.0, "shear stiffness", BARAFF),
        _parameter("bend_damping", "k_d,bend", "N·m·s", 1e-9, 1e-4, 2e-7, "damping of bending", f"{BARAFF}.5"),
        _parameter("stretch_damping", "k_d,stretch", "N·s/m", 1e-4, 20.0, 0.02, "damping of stretch", f"{BARAFF}.5"),
        _parameter("shear_damping", "k_d,shear", "N·s/m", 1e-4, 20.0, 0.02, "damping of shear", f"{BARAFF}.5"),
        _parameter("quadratic_drag", "k_N", "kg/m³", 0.0, 10.0, 0.6, "drag across the sheet", BHAT, 0.0),
        _parameter("linear_drag", "k_T", "kg/(m²·s)", 0.0, 10.0, 0.02, "drag along it", BHAT, 0.0),
        _parameter("drag_decline", "k_f", "s²/m²", 0.0, 10.0, 0.05, "how drag levels off", BHAT, 0.0),
    )
)

ORTHOTROPIC = PARAMETERS.joined(ParameterSpace((BEND_RATIO, STRETCH_RATIO)))

# What is searched for in a type of textile at rest: threads hold their lengths, and nothing moves.
THREADS = {
    "stretch": 100.0, "bend_damping": 2e-7, "stretch_damping": 0.02, "shear_damping": 0.02, "quadratic_drag": 0.6,
    "linear_drag": 0.02, "drag_decline": 0.05,
}  # fmt: skip
TEXTILES: dict[str, dict[str, float | tuple[float, float]]] = {
    "soft": {**THREADS, "bend": (1e-7, 1e-5), "shear": (1.0, 100.0)},
    "medium": {**THREADS, "bend": (1e-6, 1e-4), "shear": (1.0, 100.0)},
    "stiff": {**THREADS, "bend": (1e-5, 1e-3), "shear": (1.0, 100.0)},
}


class BaraffWitkin:
    """Sheet of triangles with implicit or adaptive explicit steps; see the module for equations and sources.

    resolution: nodes along (u, v) or one number for the longer side, where the scene does not say;
    integrator: "bdf2" (default; second order), "implicit_euler" (the first paper's; damps the motion itself) or "rk45"
    (Dormand and Prince 1980, adaptive: Bhat et al. used one such); dt: time step [s], for rk45 the longest;
    step_scale: multiplies it; tolerance: what the linear solver leaves of a step's residual, or for rk45 the largest
    error that a step may make [m]; orthotropic: two parameters more, what warp has over weft in bending and in stretch,
    damping in proportion.
    """

    name = "baraff_witkin"
    version = 9
    kind = "implicit"
    parameters = PARAMETERS
    textiles = TEXTILES
    capabilities = frozenset(
        {"dynamic", "static", "effects", "contact", "carried_contact", "self_contact", "moving_start", "outline"}
    )
    repeatability = 1e-5  # m: what the tolerance of the linear solver leaves open
    bench_options: tuple[dict[str, str], ...] = ({}, {"integrator": "implicit_euler"})

    def __init__(
        self, resolution: int | Sequence[int] = 13, integrator: str = "bdf2", dt: float | None = None,
        step_scale: float = 1.0, tolerance: float | None = None, orthotropic: bool = False,
    ):  # fmt: skip
        check_choice(self.name, "integrator", integrator, SCHEMES)
        check_resolution(self.name, resolution)
        check_number(self.name, "dt", dt, 0.0)
        check_number(self.name, "step_scale", step_scale, 0.0, 100.0, optional=False)
        check_number(self.name, "tolerance", tolerance, 0.0, 0.1)
        self.resolution, self.integrator = resolution, integrator
        self.tolerance = TOLERANCE[integrator] if tolerance is None else tolerance
        self.dt = (STEP[integrator] if dt is None else dt) * step_scale
        self.orthotropic = check_orthotropic(self.name, orthotropic)
        if orthotropic:
            self.parameters = ORTHOTROPIC

    def prepare(self, scene: Scene, effects: Sequence[Effect] = ()) -> BaraffWitkinSimulation:
        bound = BoundEffects(self.parameters, tuple(effects))
        shape = grid_shape(scene, self.resolution)
        scheme = SCHEMES[self.integrator]
        return BaraffWitkinSimulation(scene, shape, bound, scheme, self.dt, self.tolerance, self.orthotropic)

    def of_material(self, material: Material, scene: Scene) -> np.ndarray:
        """The parameters (9,) or (11,) of a textbook material, shear damped as stretch is: no air."""
        slide = material.stretch_damping * material.shear / material.stretch
        elastic = [material.bending, material.stretch, material.shear]
        dampings = [material.bending_damping, material.stretch_damping, slide]
        ratios = [material.bending_ratio, material.stretch_ratio] if self.orthotropic else []
        if not self.orthotropic:
            refuse_ratios(self.name, material, OPTION)
        return np.array([*elastic, *dampings, 0, 0, 0, *ratios], dtype=float)

    def material_of(self, theta: np.ndarray, scene: Scene) -> Material:
        """The first five parameters and the ratios are the material's own; damping of shear and the air have no place
        in it.
        """
        return Material(*(float(value) for value in (*theta[:5], *(theta[9:11] if self.orthotropic else ()))))


@dataclass(frozen=True, eq=False)
class BaraffWitkinSimulation(GridSimulation):
    """One scene on one grid, ready for batches of parameter sets."""

    scheme: int
    dt: float
    tolerance: float
    orthotropic: bool = False

    @cached_property
    def bending(self) -> Diagonals:
        return bending_matrix(self.sheet)

    @cached_property
    def thread_bending(self) -> ThreadBending:
        return ThreadBending.of(self.sheet)

    @cached_property
    def edges(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return triangle_edges(self.lines, (self.scene.width, self.scene.height), self.cover)

    def run(self, theta: np.ndarray) -> Rollout:
        """Simulate theta (B, P): the nine parameters (eleven of an orthotropic sheet), then the effects'."""
        theta = self.parameters.check(theta)
        batch = GridBatch(self, theta, np.full(len(theta), self.dt), 0.0)
        batch.hang()
        return batch.run(lambda b: self._march(batch, b))

    def _march(self, batch: GridBatch, b: int) -> tuple[int, int]:
        """Simulate member b into the batch's arrays → status, steps."""
        scene, theta = self.scene, batch.theta[b : b + 1]
        begins, result = batch.begin(b), np.zeros(3, np.int64)
        obstacles, layers, terms = obstacle_table(scene), layers_of(scene, self.sheet), batch.effect_terms(b)
        size, sampling = max(scene.width, scene.height), batch.sampling(b)

        def march(scheme, tolerance, begins, inner, effects, sampling):
            kernels.march(scheme)(
                scheme, TRIANGLES, begins, self.shape[0], batch.sheet(), *inner, theta[0, 6:9].copy(),
                *effects, terms, batch.grips(b), obstacles, layers, batch.clock(b, tolerance), size, sampling, result,
            )  # fmt: skip

        if begins.settles == SETTLES:  # by the implicit loop, whatever the scheme
            unseen = sampling._replace(times=np.zeros(0))
            inner = self._inner(self.effects.resting(theta))
            march(kernels.BDF2, TOLERANCE["bdf2"], begins, inner, batch.settling_kernels, unseen)
            begins, result[0] = begins._replace(settles=RESTS), self.settled(result[0])
        if result[0] == OK:
            march(self.scheme, self.tolerance, begins, self._inner(theta), batch.kernels, sampling)
        return int(result[0]), int(result[1])

    def _inner(self, theta: np.ndarray) -> tuple[kernels.Membrane, kernels.Plate]:
        """The inner forces of one parameter set (1, P)."""
        bend, stretch, shear, bend_damping, stretch_damping, shear_damping = theta[0, :6]
        bend_ratio, stretch_ratio = theta[0, 9:11] if self.orthotropic else (1.0, 1.0)
        bending = self.thread_bending.matrix(bend_ratio) if self.orthotropic else self.bending
        root = np.sqrt(stretch_ratio)
        lengths, over, shares = self.edges
        stiffness = np.array([stretch * root, stretch / root, shear])
        dampings = np.array([stretch_damping * root, stretch_damping / root, shear_damping])
        membrane = kernels.Membrane(lengths, over, shares * stiffness[:, None], shares * dampings[:, None])
        # Effects act along any thread, and the matrix has to know of it along the softer one, too.
        stiffer = self.effects.stiffness(theta)[0] / np.array([stiffness[:2].min(), softer_share(bend_ratio)])
        return membrane, kernels.Plate(bending.offsets, bending.values, bend, bend_damping, stiffer)


def triangle_edges(
    lines: tuple[np.ndarray, np.ndarray], size: tuple[float, float], cover: Cover | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What the compiled forces need of a grid with lines at u (nu,) and v (nv,) m, of a sheet of that size [m].

    Rest lengths (2, P) m of u- and v-edges, 1/h (2, P) of the cells, and stiffness (3, P) of u-edges, v-edges and shear
    for moduli of 1 N/m, of what of it is cloth; P = the nodes and nu + 1 places before and after them.
    """
    u, v = lines
    hu, hv = np.append(np.diff(u), 0.0), np.append(np.diff(v), 0.0)
    over_u, over_v = (np.divide(1, h, out=np.zeros_like(h), where=h > 0) for h in (hu, hv))
    high, wide, whole = edge_widths(lines, size, cover)
    ones = np.ones((len(v), len(u)))
    inside = ones * (hu > 0) * (hv > 0)[:, None]
    lengths = np.stack([ones * hu, ones * hv[:, None]])
    stiffness = np.stack([high * over_u, over_v[:, None] * wide, whole * np.outer(hv, hu) / 2])
    over = np.stack([inside * over_u, inside * over_v[:, None]])
    return tuple(padded(rows) for rows in (lengths, over, stiffness))  # type: ignore[return-value]


def edge_widths(
    lines: tuple[np.ndarray, np.ndarray], size: tuple[float, float], cover: Cover | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The width of cloth that each node's u-edge and v-edge stand for (nv, nu) m; how much cloth its cell stands for,
    of what fits into it.

    The outermost lines and cells stand for all that is beyond them: a grip beside the hem has moved its line inwards.
    """
    u, v = lines
    ones = np.ones((len(v), len(u)))
    if cover is None:
        cells = np.pad(cloth_of_cells(lines, size), ((0, 1), (0, 1)))
        return tributary(v, size[1])[:, None] * ones, tributary(u, size[0]) * ones, cells
    return cover.widths(1, 0), cover.widths(0, 1), np.pad(cover.cells, ((0, 1), (0, 1)))


def padded(rows: np.ndarray) -> np.ndarray:
    """Rows over the nodes of a grid (R, nv, nu) laid out flat, with nu + 1 zeros before and after."""
    margin = rows.shape[2] + 1
    return np.pad(rows.reshape(len(rows), -1), ((0, 0), (margin, margin)))
