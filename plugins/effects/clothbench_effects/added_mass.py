"""`added_mass`: a sheet that accelerates along its normal takes some air with it."""

from clothbench import Parameter, ParameterSpace, effect_kernel


@effect_kernel
def carry_air(t, dt, x, v, f, sheet, p, state):
    """f ← f − r/(1 + r) (f·n) n with r = m_a/ρ: inverts (ρ I + m_a n nᵀ) a = f for the bare mass ρ.

    Added-mass tensor of a thin plate, which resists normal acceleration only (Lamb, Hydrodynamics, art. 71).
    """
    for i in range(x.shape[1]):
        ratio = p[0] * sheet.area[i] / sheet.mass[i]
        along = f[0, i] * sheet.normal[0, i] + f[1, i] * sheet.normal[1, i] + f[2, i] * sheet.normal[2, i]
        for c in range(3):
            f[c, i] -= ratio / (1.0 + ratio) * along * sheet.normal[c, i]


class AddedMass:
    name = "added_mass"
    version = 1
    place = "dynamics"
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
