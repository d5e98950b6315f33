"""`stretch_stiffening`: yarns are crimped; once pulled straight the cloth gets stiffer with strain."""

import numpy as np

from clothbench import Parameter, ParameterSpace, effect_kernel
from clothbench_effects.deformation import add_tensions, fibres, strains

STRAIGHT = 0.1  # strain at which the yarns are straight: from there on the stiffness stays, so that it has a bound


@effect_kernel
def pull_tight(t, dt, x, v, f, sheet, p, state):
    """Tension T = B ε² along warp and weft where ε = |∂x/∂u| − 1 > 0 (energy per area B ε³/3).

    Above ε₁ = 10 % it goes on along the tangent, T = B (2 ε ε₁ − ε₁²).
    """
    if p[0] == 0.0:
        return
    fibre = fibres(x, sheet)
    strain = strains(fibre, sheet)
    for c in range(2):
        row = strain[c]
        for e in range(row.shape[0]):
            pulled = row[e] if row[e] > 0.0 else 0.0
            crimped = pulled if pulled < STRAIGHT else STRAIGHT
            row[e] = p[0] * (2.0 * pulled - crimped) * crimped
    add_tensions(f, sheet, fibre, strain)


class StretchStiffening:
    name = "stretch_stiffening"
    version = 1
    place = "dynamics"
    family = "stretch"
    normals = False
    summary = "tension that grows with the square of the strain, as crimped yarns are pulled straight"
    force = staticmethod(pull_tight)
    parameters = ParameterSpace(
        (
            Parameter(
                "stiffening", "B", "N/m", (0.0, 2e4), "linear", 2e3, "tension per width over strain squared",
                "Peirce 1937, The geometry of cloth structure, on crimp: second-order term of tension", null=0.0,
            ),
        )
    )  # fmt: skip

    def stiffness(self, phi):
        return 2.0 * phi[0] * STRAIGHT, 0.0

    def curve(self, stretch: np.ndarray, phi: np.ndarray) -> np.ndarray:
        strain = np.maximum(stretch - 1, 0)
        crimped = np.minimum(strain, STRAIGHT)
        return phi[0] * (2 * strain - crimped) * crimped
