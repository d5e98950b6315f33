"""`bending_hysteresis`: yarns rub against each other when cloth bends, so it does not bend back quite the same way."""

import numpy as np

from clothbench import Parameter, ParameterSpace, effect_kernel
from clothbench.modelling import lean_kernel
from clothbench_effects.deformation import add_couples, bent

FAR = 1e4  # times the curvature at which yarns slip: beyond any that cloth has
VANISHED = 32.0  # exponent y from which exp(−y), 1e-14, may stand for 0


@lean_kernel
def decay(y):
    """exp(−y) − 1 for y ≥ 0, within 2e-12 of its value; without branches, so that loops over it use the vector unit.

    −2 t/(1 + t) with t = tanh(y/16) from Lambert's continued fraction, doubled three times: e(2y) = e(y) (2 + e(y)).
    """
    s = (y if y < VANISHED else VANISHED) / 16.0
    q = s * s
    top = s * (945.0 + q * (105.0 + q))
    e = -2.0 * top / (945.0 + q * (420.0 + 15.0 * q) + top)
    e *= 2.0 + e
    e *= 2.0 + e
    return e * (2.0 + e)


@lean_kernel
def follow(couple, before, now, limit, scale):
    """Take couples (S,) from curvatures `before` to `now`, and `before` along."""
    rate = 1.0 / scale
    for e in range(now.shape[0]):
        change = now[e] - before[e]
        aim = limit if change > 0.0 else -limit
        couple[e] = couple[e] + (couple[e] - aim) * decay(abs(change) * rate)
    for e in range(now.shape[0]):
        before[e] = now[e]


@effect_kernel
def rub(t, dt, x, v, f, sheet, p, state):
    """Couples per width M of dM/dκ = (M_c/κ₀) (1 − sgn(κ̇) M/M_c), for κ_uu, κ_vv and κ_uv of each triangle (Dahl 1968).

    Solved exactly for the change of κ since the last step, M → ±M_c + (M ∓ M_c) exp(−|Δκ|/κ₀): nothing depends on
    the step or the rate. state: 0 before the first step, when M = 0; then κ and M, three each, of all triangles.
    The first step is that in which a sheet sets out to settle: yarns rub on that way, too, which is made up, and where
    the sheet rests depends on its first shape, by a millimetre.
    """
    if p[0] == 0.0:
        return
    shape, slots = bent(x, sheet), sheet.slots.shape[1]
    before = state[1 : 1 + 3 * slots].reshape((3, slots))
    couple = state[1 + 3 * slots : 1 + 6 * slots].reshape((3, slots))
    if state[0] == 0.0:
        for c in range(3):
            for e in range(slots):
                before[c, e] = shape.curvature[c, e]
    state[0] = 1.0
    for c in range(3):
        follow(couple[c], before[c], shape.curvature[c], p[0], p[1])
    add_couples(f, sheet, shape, couple)


SOURCE = "Dahl 1968, A solid friction model; for cloth: Miguel et al. 2013, Modeling internal friction in cloth"


class BendingHysteresis:
    name = "bending_hysteresis"
    version = 1
    place = "dynamics"
    family = "bending"
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

    def limits(self, phi):
        return {"bending stiffness, as of yarns that never slip": np.asarray(phi) * FAR}

    def state_size(self, sheet):
        return 1 + 6 * sheet.slots.shape[1]

    def stiffness(self, phi):
        return 0.0, 2.0 * phi[0] / phi[1]  # just after turning back, where M = −M_c sgn(κ̇)
