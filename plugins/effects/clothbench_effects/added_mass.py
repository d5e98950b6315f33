"""`added_mass`: a sheet that accelerates along its normal takes some air with it."""

from clothbench import Parameter, ParameterSpace, effect_kernel


@effect_kernel(allocates=False)
def carry_air(t, dt, x, v, mass, sheet, p, state):
    """ΔM = m_a A n nᵀ: a thin plate's added mass resists acceleration along its normal n only.

    Lamb, Hydrodynamics, art. 71.
    """
    for i in range(x.shape[1]):
        nx, ny, nz = sheet.normal[0, i], sheet.normal[1, i], sheet.normal[2, i]
        air = p[0] * sheet.area[i]
        mass[0, i] += air * nx * nx
        mass[1, i] += air * ny * ny
        mass[2, i] += air * nz * nz
        mass[3, i] += air * ny * nz
        mass[4, i] += air * nx * nz
        mass[5, i] += air * nx * ny


class AddedMass:
    name = "added_mass"
    version = 1
    place = "dynamics"
    at_rest = False
    family = "air"
    law = "normal acceleration"
    summary = "air carried along by the normal acceleration"
    inertia = staticmethod(carry_air)
    parameters = ParameterSpace(
        (
            Parameter(
                "areal_density", "m_a", "kg/m²", (0.0, 0.5), "linear", 0.05, "mass of the air carried along per area",
                "Lamb, Hydrodynamics, art. 71; for a plate of width w about π ρ_air w/4", null=0.0,
            ),
        )
    )  # fmt: skip
