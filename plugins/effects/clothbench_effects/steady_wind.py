"""`steady_wind`: air that moves past the sheet, the same everywhere and always, and the drag through which it acts.

It takes the place of `quadratic_drag`, which it becomes when the air is still: named beside it, drag would count twice.
"""

from clothbench import Parameter, ParameterSpace, effect_kernel
from clothbench_effects.sheet_kernels import add_drag


@effect_kernel(allocates=False)
def blow(t, dt, x, v, f, sheet, p, state):
    """f −= ½ ρ_air A (C_N |u_n| u_n + C_T |u_t| u_t) with u = v − w, the velocity against the air."""
    if p[0] == 0.0 and p[1] == 0.0:
        return
    for i in range(x.shape[1]):
        add_drag(f, i, sheet, v[0, i] - p[2], v[1, i] - p[3], v[2, i] - p[4], p[0], p[1])


SOURCE = "Hoerner, Fluid-Dynamic Drag, ch. 3: drag depends on the velocity relative to the air"


class SteadyWind:
    name = "steady_wind"
    version = 1
    place = "dynamics"
    family = "wind"
    summary = "a steady, uniform wind, and the quadratic drag through which it acts"
    by_recording = ("wx", "wy", "wz")
    force = staticmethod(blow)
    parameters = ParameterSpace(
        (
            Parameter(
                "normal", "C_N", "1", (0.0, 4.0), "linear", 1.0, "drag coefficient across the sheet", SOURCE, null=0.0
            ),
            Parameter(
                "tangential", "C_T", "1", (0.0, 0.5), "linear", 0.02, "friction coefficient along the sheet", SOURCE,
                null=0.0,
            ),
            Parameter("wx", "w_x", "m/s", (-2.0, 2.0), "linear", 0.0, "wind along x", SOURCE),
            Parameter("wy", "w_y", "m/s", (-2.0, 2.0), "linear", 0.2, "wind along y", SOURCE),
            Parameter("wz", "w_z", "m/s", (-2.0, 2.0), "linear", 0.0, "wind along z", SOURCE),
        )
    )  # fmt: skip
