"""`bending_hysteresis`: yarns rub against each other when cloth bends, so it does not bend back quite the same way."""

import numpy as np

from clothbench import Parameter, ParameterSpace, effect_kernel
from clothbench_effects.sheet_kernels import add_couples, curvatures, normal_of


@effect_kernel
def rub(t, dt, x, v, f, sheet, p, state):
    """Couples per width M of dM/dκ = (M_c/κ₀) (1 − sgn(κ̇) M/M_c), for κ_uu, κ_vv and κ_uv of each triangle (Dahl 1968).

    Solved exactly for the change of κ since the last step, M → ±M_c + (M ∓ M_c) exp(−|Δκ|/κ₀): nothing depends on
    the step or the rate. state: 0 before the first step, when M = 0; then κ and M of every triangle, three each.
    """
    if p[0] == 0.0:
        return
    started = state[0] != 0.0
    state[0] = 1.0
    for face in range(sheet.triangles.shape[0]):
        memory = state[1 + 6 * face : 7 + 6 * face]
        normal = normal_of(x, sheet, face)
        now = curvatures(x, sheet, face, normal)
        for c in range(3):
            if started:
                change = now[c] - memory[c]
                limit = p[0] if change > 0.0 else -p[0]
                memory[3 + c] = limit + (memory[3 + c] - limit) * np.exp(-abs(change) / p[1])
            memory[c] = now[c]
        add_couples(f, x, sheet, face, normal, memory[3], memory[4], memory[5])


SOURCE = "Dahl 1968, A solid friction model; for cloth: Miguel et al. 2013, Modeling internal friction in cloth"


class BendingHysteresis:
    name = "bending_hysteresis"
    version = 1
    place = "dynamics"
    normals = False
    summary = "internal friction in bending"
    force = staticmethod(rub)
    parameters = ParameterSpace(
        (
            Parameter(
                "couple", "M_c", "N", (0.0, 1e-2), "linear", 2e-4, "couple per width at which the yarns slip", SOURCE,
                null=0.0,
            ),
            Parameter(
                "curvature", "κ₀", "1/m", (1.0, 200.0), "log", 20.0, "change of curvature over which they begin to",
                SOURCE,
            ),
        )
    )  # fmt: skip

    def state_size(self, sheet):
        return 1 + 6 * len(sheet.triangles)

    def stiffness(self, phi):
        return 0.0, 2.0 * phi[0] / phi[1]  # just after turning back, where M = −M_c sgn(κ̇)
