"""`drag_crisis`: at speed the drag of a sheet grows less than quadratically, since the cloth yields and sheds air.

Bhat et al. 2003, section 3: f = −½ ρ_air A C_N |v_n| v_n / (1 + k_f v_n²). It takes the place of `quadratic_drag`,
which it is at low speed. In still air: a wind that is named beside it has a drag of its own.
"""

from clothbench import Parameter, ParameterSpace, effect_kernel


@effect_kernel(allocates=False)
def level_off(t, dt, x, v, f, sheet, p, state):
    """f −= ½ ρ_air A C_N |v_n| v_n / (1 + k_f v_n²)."""
    if p[0] == 0.0:
        return
    for i in range(x.shape[1]):
        nx, ny, nz = sheet.normal[0, i], sheet.normal[1, i], sheet.normal[2, i]
        across = v[0, i] * nx + v[1, i] * ny + v[2, i] * nz
        push = 0.5 * sheet.air_density * sheet.area[i] * p[0] * abs(across) * across / (1.0 + p[1] * across * across)
        f[0, i] -= push * nx
        f[1, i] -= push * ny
        f[2, i] -= push * nz


SOURCE = "Bhat et al. 2003, Estimating cloth simulation parameters from video, section 3"


class DragCrisis:
    name = "drag_crisis"
    version = 1
    place = "dynamics"
    at_rest = False
    family = "air"
    summary = "air drag, quadratic when slow, that levels off with speed"
    force = staticmethod(level_off)
    parameters = ParameterSpace(
        (
            Parameter(
                "normal", "C_N", "1", (0.0, 4.0), "linear", 1.0, "drag coefficient across the sheet when slow", SOURCE,
                null=0.0,
            ),
            Parameter(
                "falloff", "k_f", "s²/m²", (0.0, 2.0), "linear", 0.2, "drag is halved at a normal speed of 1/√k_f",
                SOURCE,
            ),
        )
    )  # fmt: skip
