"""`bending_anisotropy`: warp and weft bend differently; each gets a rigidity of its own on top of the model's.

As rigidities in N·m and not as a ratio, because an effect must act on any model and any simulator alike, and of most
it cannot know what rigidity they have: a ratio of an unknown number is none.
"""

import numpy as np

from clothbench import Parameter, ParameterSpace, effect_kernel
from clothbench_effects.deformation import add_linear_bending


@effect_kernel(allocates=False)
def straighten(t, dt, x, v, f, sheet, p, state):
    """f −= A (D_u W_uu c_uu + D_v W_vv c_vv): energy per area ½ (D_u |∂²x/∂u²|² + D_v |∂²x/∂v²|²), linear in x.

    On a sheet that only bends |∂²x/∂u²| is the warp's curvature.
    """
    if p[0] == 0.0 and p[1] == 0.0:
        return
    add_linear_bending(f, x, sheet, p[0], p[1])


SOURCE = "Peirce 1930, The handle of cloth as a measurable quantity: flexural rigidity of warp and weft"


class BendingAnisotropy:
    name = "bending_anisotropy"
    version = 1
    place = "dynamics"
    family = "bending"
    normals = False
    summary = "bending rigidity of warp and weft beyond the model's own"
    force = staticmethod(straighten)
    parameters = ParameterSpace(
        (
            Parameter("warp", "D_u", "N·m", (0.0, 1e-3), "linear", 1e-5, "extra rigidity along u", SOURCE, null=0.0),
            Parameter("weft", "D_v", "N·m", (0.0, 1e-3), "linear", 0.0, "extra rigidity along v", SOURCE, null=0.0),
        )
    )  # fmt: skip

    def limits(self, phi):
        return {"bending stiffness, the same in both directions": np.full(2, np.mean(phi))}

    def stiffness(self, phi):
        return 0.0, max(phi)
