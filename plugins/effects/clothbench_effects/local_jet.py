"""`local_jet`: a draught, as from a fan or a vent: air that moves along a horizontal line and dies away beside it.

w = s exp(−r²/R²) (cos a, sin a, 0), r the distance from the line through the centre. As `steady_wind` it takes the
place of `quadratic_drag`: it is the drag against that air, without friction along the sheet.
"""

import numpy as np

from clothbench import Parameter, ParameterSpace, effect_kernel
from clothbench_effects.sheet_kernels import add_drag


@effect_kernel(allocates=False)
def blow(t, dt, x, v, f, sheet, p, state):
    """f −= ½ ρ_air A C_N |u_n| u_n with u = v − w, w = s exp(−r²/R²) (cos a, sin a, 0)."""
    if p[0] == 0.0:
        return
    ax, ay = np.cos(p[2]), np.sin(p[2])
    for i in range(x.shape[1]):
        beside = (x[1, i] - p[4]) * ax - (x[0, i] - p[3]) * ay
        above = x[2, i] - p[5]
        speed = p[1] * np.exp(-(beside * beside + above * above) / (p[6] * p[6]))
        add_drag(f, i, sheet, v[0, i] - speed * ax, v[1, i] - speed * ay, v[2, i], p[0], 0.0)


SOURCE = "Schlichting, Boundary-Layer Theory, ch. 24: profiles of a round jet are close to a Gaussian"
DRAG = "Hoerner, Fluid-Dynamic Drag, ch. 3"
WHERE = "world frame of the scene"


class LocalJet:
    name = "local_jet"
    version = 1
    place = "dynamics"
    family = "wind"
    summary = "a draught along a horizontal line, and the quadratic drag through which it acts"
    force = staticmethod(blow)
    parameters = ParameterSpace(
        (
            Parameter(
                "normal", "C_N", "1", (0.0, 4.0), "linear", 1.0, "drag coefficient across the sheet", DRAG, null=0.0
            ),
            Parameter("speed", "s", "m/s", (0.0, 3.0), "linear", 0.5, "speed on the line", SOURCE),
            Parameter("azimuth", "a", "rad", (-np.pi, np.pi), "linear", 1.5, "its direction, from x towards y", WHERE),
            Parameter("x", "x_0", "m", (-2.0, 2.0), "linear", 0.0, "a point of the line, x", WHERE),
            Parameter("y", "y_0", "m", (-2.0, 2.0), "linear", 0.0, "a point of the line, y", WHERE),
            Parameter("z", "z_0", "m", (-2.0, 2.0), "linear", 0.5, "height of the line", WHERE),
            Parameter("radius", "R", "m", (0.05, 2.0), "log", 0.3, "where the speed has dropped to 1/e", SOURCE),
        )
    )  # fmt: skip
