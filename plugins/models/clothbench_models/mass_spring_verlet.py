"""`mass_spring_verlet`: the particle grid of "A hybrid evolutionary algorithm for tuning a cloth-simulation model"
(Mongus, Repnik, Mernik and Žalik, Applied Soft Computing 12, 2012), section 2.

Springs join each particle to the four nearest in every horizontal (H1…H4), vertical (V1…V4) and diagonal (D1…D4)
direction; position Verlet moves it, with a share of the last displacement lost to the textile's inner friction:

    x_i = x_{i−1} + (1 − c Δt)(x_{i−1} − x_{i−2}) + a_i Δt²

The text at hand breaks off where it comes to that loss; here c is one per second, and stiffnesses are per width of
cloth as `spring_grid` has it, so that neither depends on step or mesh. The membrane does not either, as long as cells
are square (of others `spring_grid` tells what the diagonals do): a sheet has C11 = Σ k² (H_k + D_k), C22 =
Σ k² (V_k + D_k), C12 = C66 = Σ k² D_k. What does depend on the mesh is the reach of the long springs. They resist
bending only as chords that shorten, an energy of about (k h κ)⁴ per area for cells of h: bending fades on finer
grids. And within k cells of a border, fewer of them pass.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clothbench import ClothbenchError, Effect, Material, Parameter, ParameterSpace, Scene
from clothbench.modelling import BoundEffects, grid_shape, leapfrog_step
from clothbench_models.mass_spring_simulation import LACKS, SpringOptions, SpringSimulation
from clothbench_models.orthotropy import refuse_ratios
from clothbench_models.spring_grid import Families

SOURCE = "Mongus et al., A hybrid evolutionary algorithm for tuning a cloth-simulation model, 2012, section 2"
REACH = 4  # springs to the nearest four particles
DIRECTIONS = (("H", "horizontal", (1, 0)), ("V", "vertical", (0, 1)), ("D", "diagonal", (1, 1)))
STIFFNESS = {1: (1.0, 1000.0, 60.0), 2: (0.01, 100.0, 1.0), 3: (0.01, 100.0, 0.3), 4: (0.01, 100.0, 0.1)}  # N/m


# What is searched for in a type of textile. Springs to the next particle hold the threads' lengths, whatever the cloth;
# diagonal ones shear; those farther away bend, and the softer the cloth, the weaker and the fewer of them count.
THREADS = {"H1": 50.0, "V1": 50.0, "damping": 1.0}
TEXTILES: dict[str, dict[str, float | tuple[float, float]]] = {
    "soft": {
        **THREADS, "D1": (0.005, 2.0), "H2": (1e-4, 0.1), "V2": (1e-4, 0.1), "D2": (1e-4, 0.1), "H3": (1e-5, 0.01),
        "V3": (1e-5, 0.01), "D3": 1e-5, "H4": 1e-5, "V4": 1e-5, "D4": 1e-5,
    },
    "medium": {
        **THREADS, "D1": (0.1, 20.0), "H2": (1e-3, 10.0), "V2": (1e-3, 10.0), "D2": (0.01, 5.0), "H3": (1e-4, 1.0),
        "V3": (1e-4, 1.0), "D3": (1e-4, 0.5), "H4": (1e-4, 0.1), "V4": (1e-4, 0.1), "D4": 1e-4,
    },
    "stiff": {
        **THREADS, "D1": (0.5, 50.0), "H2": (0.01, 30.0), "V2": (0.01, 30.0), "D2": (0.1, 10.0), "H3": (1e-3, 10.0),
        "V3": (1e-3, 10.0), "D3": (1e-3, 3.0), "H4": (1e-3, 3.0), "V4": (1e-3, 3.0), "D4": (1e-4, 1.0),
    },
}  # fmt: skip


def _families() -> Families:
    """All sixteen, the shortest first; parameters are numbered H1…H4, V1…V4, D1…D4."""
    found = []
    for k in range(1, REACH + 1):
        found += [(k, 0, k - 1), (0, k, REACH + k - 1), (k, k, 2 * REACH + k - 1), (-k, k, 2 * REACH + k - 1)]
    return tuple(found)


def _parameters() -> ParameterSpace:
    springs = [
        Parameter(
            f"{letter}{k}", f"{letter}{'₁₂₃₄'[k - 1]}", "N/m", STIFFNESS[k][:2], "log", STIFFNESS[k][2],
            f"stiffness of {direction} springs to the particle {k} away", SOURCE,
        )
        for letter, direction, _ in DIRECTIONS
        for k in range(1, REACH + 1)
    ]  # fmt: skip
    loss = Parameter("damping", "c", "1/s", (0.0, 20.0), "linear", 1.0, "share of the velocity lost per second", SOURCE)
    return ParameterSpace((*springs, loss))


class MassSpringVerlet:
    """Particles with springs to the four nearest in each direction, position Verlet; see the module.

    resolution: nodes along (u, v) or one number for the longer side, where the scene does not say;
    dt: time step [s], or None for the largest stable one of each parameter set times 0.8; step_scale: multiplies
    that step; precision: "double", or "single".
    """

    name = "mass_spring_verlet"
    version = 6
    lacks = LACKS
    kind = "explicit"
    parameters = _parameters()
    textiles = TEXTILES
    capabilities = frozenset(
        {"dynamic", "static", "effects", "contact", "carried_contact", "self_contact", "moving_start", "outline"}
    )

    def __init__(
        self, resolution: int | Sequence[int] = 13, dt: float | None = None, step_scale: float = 1.0,
        precision: str = "double",
    ):  # fmt: skip
        self.options = SpringOptions(resolution, dt, step_scale, precision)
        self.options.check(self.name)

    def prepare(self, scene: Scene, effects: Sequence[Effect] = ()) -> VerletSimulation:
        bound = BoundEffects(self.parameters, tuple(effects))
        return VerletSimulation(scene, grid_shape(scene, self.options.resolution), bound, self.options)

    def of_material(self, material: Material, scene: Scene) -> np.ndarray:
        """Parameters (13,) of a textbook material: only the shortest springs count, and nothing is lost.

        With C11 = H1 + D1, C22 = V1 + D1 and C12 = C66 = D1, strips that are free to narrow have C11 − D1²/C22 and
        C22 − D1²/C11 as their tensile stiffness, in the ratio of C11 to C22; the geometric mean of both is C − D1²/C
        with C² = C11 C22. There remains a cross contraction of D1/C22 and D1/C11. Cells are taken for square.
        """
        refuse_ratios(self.name, dataclasses.replace(material, stretch_ratio=1.0))
        if material.bending > 0:
            raise ClothbenchError(
                "mass_spring_verlet: has no small-strain bending rigidity; springs resist bending only to fourth order"
            )
        whole = (material.stretch + math.hypot(material.stretch, 2 * material.shear)) / 2
        root, theta = math.sqrt(material.stretch_ratio), self.parameters.low
        across, down = whole * root - material.shear, whole / root - material.shear
        if min(across, down) <= 0:
            raise ClothbenchError(
                f"mass_spring_verlet: no lattice of springs has a shear of {material.shear:g} N/m beside "
                f"{min(material.along('stretch')):.4g} N/m along its softer threads"
            )
        theta[[0, REACH, 2 * REACH]] = across, down, material.shear
        theta[-1] = 0.0
        return theta

    def material_of(self, theta: np.ndarray, scene: Scene) -> Material:
        """All springs count, those r cells long r² times, as in `of_material`; no bending, no damping."""
        reach = np.arange(1, REACH + 1) ** 2
        across, down, diagonal = (float(reach @ theta[k * REACH : (k + 1) * REACH]) for k in range(3))
        along, beside = across + diagonal, down + diagonal
        whole = math.sqrt(along * beside)
        return Material(0.0, whole - diagonal**2 / whole, diagonal, stretch_ratio=along / beside)


@dataclass(frozen=True, eq=False)
class VerletSimulation(SpringSimulation):
    """One scene on one grid, ready for batches of parameter sets: H1…H4, V1…V4, D1…D4 N/m, c 1/s, the effects'."""

    families = _families()

    def stiffness(self, theta: np.ndarray) -> np.ndarray:
        return theta[:, : 3 * REACH]

    def calmed(self, theta: np.ndarray) -> np.ndarray:
        """Without loss, as it settles anyway: it only asks for shorter steps."""
        out = theta.copy()
        out[:, 3 * REACH] = 0.0
        return out

    def loss(self, theta: np.ndarray) -> np.ndarray:
        return theta[:, 3 * REACH].copy()

    def stable_step(self, theta: np.ndarray) -> np.ndarray:
        """Of Verlet with loss, ω² Δt² < 4 − 2 c Δt; there c Δt stays below 1 where c is not far above ω."""
        return leapfrog_step(*self.square_and_rate(theta))

    def square_and_rate(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self.fastest_square(theta), self.loss(theta)
