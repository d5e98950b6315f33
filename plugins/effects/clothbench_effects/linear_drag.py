"""`linear_drag`: drag in proportion to the velocity, the same in every direction.

In still air: a wind that is named beside it has a drag of its own.
"""

from clothbench import Parameter, ParameterSpace, effect_kernel


@effect_kernel(allocates=False)
def push_back(t, dt, x, v, f, sheet, p, state):
    """f −= b A v."""
    if p[0] == 0.0:
        return
    for i in range(x.shape[1]):
        drag = p[0] * sheet.area[i]
        f[0, i] -= drag * v[0, i]
        f[1, i] -= drag * v[1, i]
        f[2, i] -= drag * v[2, i]


class LinearDrag:
    name = "linear_drag"
    version = 1
    place = "dynamics"
    at_rest = False
    family = "air"
    normals = False
    summary = "air drag, linear in velocity"
    force = staticmethod(push_back)
    parameters = ParameterSpace(
        (
            Parameter(
                "coefficient", "b", "kg/(m²·s)", (0.0, 1.0), "linear", 0.1, "force per area and velocity",
                "slow viscous flow, Lamb, Hydrodynamics, art. 339; also Rayleigh's mass damping, b = α ρ", null=0.0,
            ),
        )
    )  # fmt: skip
