"""`quadratic_drag`: pressure drag of a sheet in air, quadratic in the normal velocity, with a tangential part."""

from clothbench import Parameter, ParameterSpace, effect_kernel
from clothbench_effects.sheet_kernels import add_drag


@effect_kernel(allocates=False)
def push_back(t, dt, x, v, f, sheet, p, state):
    """f −= ½ ρ_air A (C_N |v_n| v_n + C_T |v_t| v_t), v_n and v_t the velocity along and across the normal n."""
    if p[0] == 0.0 and p[1] == 0.0:
        return
    for i in range(x.shape[1]):
        add_drag(f, i, sheet, v[0, i], v[1, i], v[2, i], p[0], p[1])


SOURCE = "Hoerner, Fluid-Dynamic Drag, ch. 3; Bhat et al. 2003, section 3, for the split"


class QuadraticDrag:
    name = "quadratic_drag"
    version = 1
    place = "dynamics"
    at_rest = False
    family = "air"
    law = "normal velocity squared"
    summary = "air drag, quadratic in normal velocity"
    force = staticmethod(push_back)
    parameters = ParameterSpace(
        (
            Parameter(
                "normal", "C_N", "1", (0.0, 4.0), "linear", 1.0, "drag coefficient across the sheet", SOURCE, null=0.0
            ),
            Parameter(
                "tangential", "C_T", "1", (0.0, 0.5), "linear", 0.02, "friction coefficient along the sheet", SOURCE,
                null=0.0,
            ),
        )
    )  # fmt: skip
