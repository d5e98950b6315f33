"""`total_mass`: the cloth weighs more or less than stated, as it does when damp."""

from clothbench import Parameter, ParameterSpace, effect_kernel


@effect_kernel(allocates=False)
def weigh(t, dt, x, v, f, sheet, p, state):
    """f += (r − 1) m g."""
    if p[0] == 1.0:
        return
    for i in range(x.shape[1]):
        for c in range(3):
            f[c, i] += (p[0] - 1.0) * sheet.mass[i] * sheet.gravity[c]


@effect_kernel(allocates=False)
def bear(t, dt, x, v, mass, sheet, p, state):
    """ΔM = (r − 1) m I."""
    if p[0] == 1.0:
        return
    for i in range(x.shape[1]):
        for c in range(3):
            mass[c, i] += (p[0] - 1.0) * sheet.mass[i]


class TotalMass:
    """A lighter sheet vibrates faster, by 1/√r: models are told, whose step depends on that."""

    name = "total_mass"
    version = 2
    place = "dynamics"
    family = "mass"
    normals = False
    summary = "cloth heavier or lighter than stated"
    force = staticmethod(weigh)
    inertia = staticmethod(bear)
    parameters = ParameterSpace(
        (
            Parameter(
                "ratio", "r", "1", (0.7, 1.5), "linear", 1.05, "true areal density over the stated one",
                "ISO 139: cloth takes up several percent of water with the air's humidity", null=1.0,
            ),
        )
    )  # fmt: skip

    def lightest(self, phi):
        return min(1.0, phi[0])
