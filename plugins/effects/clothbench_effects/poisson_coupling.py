"""`poisson_coupling`: cloth that is pulled along one yarn system narrows along the other."""

from clothbench import Parameter, ParameterSpace, effect_kernel
from clothbench_effects.deformation import add_tensions, fibres, strains


@effect_kernel
def couple_yarns(t, dt, x, v, f, sheet, p, state):
    """Tensions T_u = C_12 ε_v and T_v = C_12 ε_u, of the energy C_12 ε_u ε_v per area."""
    if p[0] == 0.0:
        return
    fibre = fibres(x, sheet)
    add_tensions(f, sheet, fibre, p[0] * strains(fibre, sheet)[::-1])


class PoissonCoupling:
    """The energy alone has no minimum: with the model's own stiffnesses it must keep (C_12 + own)² < C_11 C_22."""

    name = "poisson_coupling"
    version = 1
    place = "dynamics"
    family = "stretch"
    normals = False
    summary = "cross contraction between warp and weft"
    force = staticmethod(couple_yarns)
    parameters = ParameterSpace(
        (
            Parameter(
                "coupling", "C₁₂", "N/m", (-50.0, 200.0), "linear", 10.0, "weft tension per warp strain and vice versa",
                "Timoshenko and Woinowsky-Krieger, Theory of Plates and Shells, art. 83 (orthotropic sheet)", null=0.0,
            ),
        )
    )  # fmt: skip

    def stiffness(self, phi):
        return abs(phi[0]), 0.0
