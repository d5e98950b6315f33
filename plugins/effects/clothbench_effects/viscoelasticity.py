"""`viscoelasticity`: stress that a deformation causes and that fades while it lasts."""

import numpy as np

from clothbench import Parameter, ParameterSpace, effect_kernel
from clothbench_effects.sheet_kernels import add_couples, add_tension, curvatures, normal_of, stretch


@effect_kernel
def relax(t, dt, x, v, f, sheet, p, state):
    """A Maxwell element beside the model's own elasticity: ṡ = ė − s/τ, M = D₁ s_κ, T = E₁ s_ε.

    e: κ_uu, κ_vv, κ_uv and ε_u, ε_v of each triangle; s: what has not relaxed yet. Exact where e changes evenly over
    a step: s → s exp(−h) + Δe (1 − exp(−h))/h, h = Δt/τ (Simo and Hughes 1998, section 10.3). Where no time passes
    between two calls a model is letting the cloth settle, and that has all the time to relax: s = 0.
    state: 0 before the first step, the time of the last, then e and s of every triangle, five each.
    """
    if p[0] == 0.0 and p[1] == 0.0:
        return
    passed = t - state[1]
    started = state[0] != 0.0 and passed > 0.0
    state[0], state[1] = 1.0, t
    kept, share = 0.0, 0.0
    if started:
        h = passed / p[2]
        kept = np.exp(-h)
        share = -np.expm1(-h) / h
    for face in range(sheet.triangles.shape[0]):
        memory = state[2 + 10 * face : 12 + 10 * face]
        if p[0] != 0.0:
            normal = normal_of(x, sheet, face)
            now = curvatures(x, sheet, face, normal)
            for c in range(3):
                memory[5 + c] = kept * memory[5 + c] + share * (now[c] - memory[c])
                memory[c] = now[c]
            add_couples(f, x, sheet, face, normal, p[0] * memory[5], p[0] * memory[6], p[0] * memory[7])
        if p[1] != 0.0:
            for c in range(2):
                strain = stretch(x, sheet, face, c)
                memory[8 + c] = kept * memory[8 + c] + share * (strain - memory[3 + c])
                memory[3 + c] = strain
                add_tension(f, x, sheet, face, c, p[1] * memory[8 + c])


SOURCE = "Maxwell 1867; Simo and Hughes 1998, Computational Inelasticity, section 10.3"


class Viscoelasticity:
    name = "viscoelasticity"
    version = 1
    place = "dynamics"
    normals = False
    summary = "stress relaxation in bending and stretch"
    force = staticmethod(relax)
    parameters = ParameterSpace(
        (
            Parameter(
                "bending", "D₁", "N·m", (0.0, 1e-3), "linear", 1e-5, "rigidity that relaxes", SOURCE, null=0.0
            ),
            Parameter(
                "stretch", "E₁", "N/m", (0.0, 500.0), "linear", 0.0, "tensile stiffness that relaxes", SOURCE, null=0.0
            ),
            Parameter("time", "τ", "s", (0.005, 20.0), "log", 0.2, "time in which stress falls to 1/e", SOURCE),
        )
    )  # fmt: skip

    def state_size(self, sheet):
        return 2 + 10 * len(sheet.triangles)

    def stiffness(self, phi):
        return phi[1], phi[0]
