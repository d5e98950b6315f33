"""`quadratic_drag`: pressure drag of a sheet in air, quadratic in the normal velocity, with a tangential part."""

import numpy as np

from clothbench import Parameter, ParameterSpace, effect_kernel


@effect_kernel
def push_back(t, dt, x, v, f, sheet, p, state):
    """f −= ½ ρ_air A (C_N |v_n| v_n + C_T |v_t| v_t), v_n and v_t the velocity along and across the normal n."""
    for i in range(x.shape[1]):
        nx, ny, nz = sheet.normal[0, i], sheet.normal[1, i], sheet.normal[2, i]
        along = v[0, i] * nx + v[1, i] * ny + v[2, i] * nz
        tx, ty, tz = v[0, i] - along * nx, v[1, i] - along * ny, v[2, i] - along * nz
        pressure = 0.5 * sheet.air_density * sheet.area[i]
        normal = pressure * p[0] * abs(along) * along
        tangential = pressure * p[1] * np.sqrt(tx * tx + ty * ty + tz * tz)
        f[0, i] -= normal * nx + tangential * tx
        f[1, i] -= normal * ny + tangential * ty
        f[2, i] -= normal * nz + tangential * tz


SOURCE = "Hoerner, Fluid-Dynamic Drag, ch. 3; Bhat et al. 2003, section 3, for the split"


class QuadraticDrag:
    name = "quadratic_drag"
    version = 1
    place = "dynamics"
    summary = "air drag, quadratic in normal velocity"
    force = staticmethod(push_back)
    parameters = ParameterSpace(
        (
            Parameter(
                "normal", "C_N", "1", (0.0, 4.0), "linear", 1.0, "drag coefficient across the sheet", SOURCE, null=0.0
            ),
            Parameter(
                "tangential",
                "C_T",
                "1",
                (0.0, 0.5),
                "linear",
                0.02,
                "friction coefficient along the sheet",
                SOURCE,
                null=0.0,
            ),
        )
    )
