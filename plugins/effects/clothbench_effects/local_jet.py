"""`local_jet`: a draught, as from a fan or a vent: air that moves along a horizontal line and dies away beside it.

w = s exp(−r²/R²) (cos a, sin a, 0), r the distance from the line through the centre. As for `steady_wind` the force
is drag(v − w) − drag(v), here with C_N = 1, the value of a flat plate, and no friction along the sheet.
"""

import numpy as np

from clothbench import Parameter, ParameterSpace, effect_kernel
from clothbench_effects.sheet_kernels import add_wind


@effect_kernel
def blow(t, dt, x, v, f, sheet, p, state):
    """f += drag(v − w) − drag(v), w = s exp(−r²/R²) (cos a, sin a, 0)."""
    if p[0] == 0.0:
        return
    ax, ay = np.cos(p[1]), np.sin(p[1])
    for i in range(x.shape[1]):
        beside = (x[1, i] - p[3]) * ax - (x[0, i] - p[2]) * ay
        above = x[2, i] - p[4]
        speed = p[0] * np.exp(-(beside * beside + above * above) / (p[5] * p[5]))
        add_wind(f, i, sheet, v, speed * ax, speed * ay, 0.0, 1.0, 0.0)


SOURCE = "Schlichting, Boundary-Layer Theory, ch. 24: profiles of a round jet are close to a Gaussian"
WHERE = "world frame of the scene"


class LocalJet:
    name = "local_jet"
    version = 1
    place = "dynamics"
    summary = "a draught along a horizontal line"
    force = staticmethod(blow)
    parameters = ParameterSpace(
        (
            Parameter("speed", "s", "m/s", (0.0, 3.0), "linear", 0.5, "speed on the line", SOURCE, null=0.0),
            Parameter("azimuth", "a", "rad", (-np.pi, np.pi), "linear", 1.5, "its direction, from x towards y", WHERE),
            Parameter("x", "x_0", "m", (-2.0, 2.0), "linear", 0.0, "a point of the line, x", WHERE),
            Parameter("y", "y_0", "m", (-2.0, 2.0), "linear", 0.0, "a point of the line, y", WHERE),
            Parameter("z", "z_0", "m", (-2.0, 2.0), "linear", 0.5, "height of the line", WHERE),
            Parameter("radius", "R", "m", (0.05, 2.0), "log", 0.3, "where the speed has dropped to 1/e", SOURCE),
        )
    )  # fmt: skip
