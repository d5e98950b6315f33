"""`steady_wind`: air that moves past the sheet, the same everywhere and always.

What the wind w changes: drag(v − w) − drag(v), with the drag of `quadratic_drag`. Together with that effect and the
same coefficients it is drag in moving air, exactly.
"""

from clothbench import Parameter, ParameterSpace, effect_kernel
from clothbench_effects.sheet_kernels import add_wind


@effect_kernel
def blow(t, dt, x, v, f, sheet, p, state):
    """f += drag(v − w) − drag(v), drag(v) = −½ ρ_air A (C_N |v_n| v_n + C_T |v_t| v_t)."""
    if p[0] == 0.0 and p[1] == 0.0 and p[2] == 0.0:
        return
    for i in range(x.shape[1]):
        add_wind(f, i, sheet, v, p[0], p[1], p[2], p[3], p[4])


SOURCE = "Hoerner, Fluid-Dynamic Drag, ch. 3: drag depends on the velocity relative to the air"


class SteadyWind:
    name = "steady_wind"
    version = 1
    place = "dynamics"
    summary = "a steady, uniform wind"
    force = staticmethod(blow)
    parameters = ParameterSpace(
        (
            Parameter("wx", "w_x", "m/s", (-2.0, 2.0), "linear", 0.0, "wind along x", SOURCE, null=0.0),
            Parameter("wy", "w_y", "m/s", (-2.0, 2.0), "linear", 0.2, "wind along y", SOURCE, null=0.0),
            Parameter("wz", "w_z", "m/s", (-2.0, 2.0), "linear", 0.0, "wind along z", SOURCE, null=0.0),
            Parameter("normal", "C_N", "1", (0.0, 4.0), "linear", 1.0, "drag coefficient across the sheet", SOURCE),
            Parameter("tangential", "C_T", "1", (0.0, 0.5), "linear", 0.02, "friction coefficient along it", SOURCE),
        )
    )  # fmt: skip
