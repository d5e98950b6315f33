"""`lift`: the part of the air's pressure that acts across the motion of an inclined sheet."""

import numpy as np

from clothbench import Parameter, ParameterSpace, effect_kernel


@effect_kernel(allocates=False)
def deflect(t, dt, x, v, f, sheet, p, state):
    """f −= ½ ρ_air A C_L (v·n) (|v| n − (v·n) v/|v|): ½ ρ_air A C_L v² sin α cos α at an angle of attack α.

    It lies in the plane of v and n, at right angles to v, so it does no work; like all pressure it acts against the
    side of the sheet that meets the air. v is against the room: a wind that is named beside it is not in it. It is the
    quasi-steady lift of a plate whose flow separates beyond a few degrees (Andersen, Pesavento and Wang 2005).
    """
    if p[0] == 0.0:
        return
    for i in range(x.shape[1]):
        speed = np.sqrt(v[0, i] * v[0, i] + v[1, i] * v[1, i] + v[2, i] * v[2, i])
        if speed == 0.0:
            continue
        nx, ny, nz = sheet.normal[0, i], sheet.normal[1, i], sheet.normal[2, i]
        along = v[0, i] * nx + v[1, i] * ny + v[2, i] * nz
        push = 0.5 * sheet.air_density * sheet.area[i] * p[0] * along
        back = along / speed
        f[0, i] -= push * (speed * nx - back * v[0, i])
        f[1, i] -= push * (speed * ny - back * v[1, i])
        f[2, i] -= push * (speed * nz - back * v[2, i])


class Lift:
    name = "lift"
    version = 1
    place = "dynamics"
    at_rest = False
    family = "air"
    summary = "lift of a sheet that moves at an angle through the air"
    force = staticmethod(deflect)
    parameters = ParameterSpace(
        (
            Parameter(
                "coefficient", "C_L", "1", (0.0, 3.0), "linear", 0.5, "lift over ½ ρ_air A v² sin α cos α",
                "Andersen, Pesavento and Wang 2005, J. Fluid Mech. 541, quasi-steady model", null=0.0,
            ),
        )
    )  # fmt: skip
