"""`rest_curvature`: cloth that curls by itself, as a knit at its edges or a sheet that lay rolled up.

Stated as the couple that the curl takes to flatten and not as a curvature: the curvature at which it rests is M/D,
and D belongs to the model.
"""

import numpy as np

from clothbench import Parameter, ParameterSpace, effect_kernel
from clothbench_effects.deformation import add_couples, bent


@effect_kernel
def curl(t, dt, x, v, f, sheet, p, state):
    """f += A (M_u ∂κ_uu/∂x + M_v ∂κ_vv/∂x): minus the gradient of the energy −M_u κ_uu − M_v κ_vv per area."""
    if p[0] == 0.0 and p[1] == 0.0:
        return
    couple = np.zeros((3, sheet.slots.shape[1]))
    couple[0], couple[1] = -p[0], -p[1]
    add_couples(f, sheet, bent(x, sheet), couple)


SOURCE = "Timoshenko and Woinowsky-Krieger, Theory of Plates and Shells, art. 14: a plate bent by couples alone"


class RestCurvature:
    name = "rest_curvature"
    version = 1
    place = "dynamics"
    family = "bending"
    normals = False
    summary = "cloth that curls by itself"
    force = staticmethod(curl)
    parameters = ParameterSpace(
        (
            Parameter(
                "warp", "M_u", "N", (-5e-3, 5e-3), "linear", 1e-4, "couple per width along u; above 0 towards u × v",
                SOURCE, null=0.0,
            ),
            Parameter(
                "weft", "M_v", "N", (-5e-3, 5e-3), "linear", 0.0, "couple per width along v; above 0 towards u × v",
                SOURCE, null=0.0,
            ),
        )
    )  # fmt: skip
