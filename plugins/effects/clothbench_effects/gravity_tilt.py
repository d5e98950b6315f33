"""`gravity_tilt`: the frame of the recording does not stand upright."""

import numpy as np

from clothbench import Parameter, ParameterSpace, effect_kernel


@effect_kernel(allocates=False)
def tilt(t, dt, x, v, f, sheet, p, state):
    """f += m (R g − g), R = R_y(β) R_x(α): gravity turned about x, then about y.

    It turns the weight that the model gives the sheet, not what other effects add to it: beside a mass that is found as
    well, the angle is that of all the weight times the share that is the sheet's own.
    """
    if p[0] == 0.0 and p[1] == 0.0:
        return
    gx, gy, gz = sheet.gravity[0], sheet.gravity[1], sheet.gravity[2]
    ca, sa, cb, sb = np.cos(p[0]), np.sin(p[0]), np.cos(p[1]), np.sin(p[1])
    ty, down = ca * gy - sa * gz, sa * gy + ca * gz
    tx, tz = cb * gx + sb * down, cb * down - sb * gx
    for i in range(x.shape[1]):
        f[0, i] += sheet.mass[i] * (tx - gx)
        f[1, i] += sheet.mass[i] * (ty - gy)
        f[2, i] += sheet.mass[i] * (tz - gz)


SOURCE = "calibration of the motion-capture frame against a plumb line"


class GravityTilt:
    name = "gravity_tilt"
    version = 1
    place = "dynamics"
    family = "gravity"
    normals = False
    summary = "a recording whose vertical is not quite vertical"
    force = staticmethod(tilt)
    parameters = ParameterSpace(
        (
            Parameter("about_x", "α", "rad", (-0.2, 0.2), "linear", 0.02, "gravity turned about x", SOURCE, null=0.0),
            Parameter("about_y", "β", "rad", (-0.2, 0.2), "linear", 0.0, "gravity turned about y", SOURCE, null=0.0),
        )
    )  # fmt: skip
