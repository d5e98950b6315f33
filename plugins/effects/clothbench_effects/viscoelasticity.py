"""`viscoelasticity`: stress that a deformation causes and that fades while it lasts."""

import numpy as np

from clothbench import Parameter, ParameterSpace, effect_kernel
from clothbench.modelling import lean_kernel
from clothbench_effects.deformation import add_couples, add_tensions, bent, fibres, strains


@lean_kernel
def follow(stress, before, now, kept, share):
    """Take s of all triangles, (k, S), from deformations `before` to `now`, and `before` along."""
    for c in range(now.shape[0]):
        s, was, e = stress[c], before[c], now[c]
        for slot in range(e.shape[0]):
            s[slot] = kept * s[slot] + share * (e[slot] - was[slot])
            was[slot] = e[slot]


@effect_kernel
def relax(t, dt, x, v, f, sheet, p, state):
    """A Maxwell element beside the model's own elasticity: ṡ = ė − s/τ, M = D₁ s_κ, T = E₁ s_ε.

    e: κ_uu, κ_vv, κ_uv and ε_u, ε_v of each triangle; s: what has not relaxed yet. Exact where e changes evenly over
    a step: s → s exp(−h) + Δe (1 − exp(−h))/h, h = Δt/τ (Simo and Hughes 1998, section 10.3). Where no time passes
    between two calls a model is letting the cloth settle, and that has all the time to relax: s = 0.
    state: 0 before the first step, the time of the last, then e and s of all triangles, five each.
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
    slots = sheet.slots.shape[1]
    memory = state[2 : 2 + 10 * slots].reshape((10, slots))
    if p[0] != 0.0:
        shape = bent(x, sheet)
        follow(memory[5:8], memory[:3], shape.curvature, kept, share)
        add_couples(f, sheet, shape, p[0] * memory[5:8])
    if p[1] != 0.0:
        fibre = fibres(x, sheet)
        follow(memory[8:], memory[3:5], strains(fibre, sheet), kept, share)
        add_tensions(f, sheet, fibre, p[1] * memory[8:])


FAR = 1e6  # s, longer than any recording
SOURCE = "Maxwell 1867; Simo and Hughes 1998, Computational Inelasticity, section 10.3"


class Viscoelasticity:
    name = "viscoelasticity"
    version = 2
    place = "dynamics"
    at_rest = False
    family = "bending"
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

    def limits(self, phi):
        bending, stretch, time = phi
        space = self.parameters
        shortest = space["time"].bounds[0]
        at_once = np.array([bending * time / shortest, stretch * time / shortest, shortest])
        return {
            "stiffness that never relaxes": np.array([bending, stretch, FAR]),
            "damping, as of stress that relaxes at once": np.minimum(at_once, space.high),
        }

    def state_size(self, sheet):
        return 2 + 10 * sheet.slots.shape[1]

    def stiffness(self, phi):
        return phi[1], phi[0]
