"""`air_memory`: the air before a sheet follows its motion late: added mass to slow motion, drag to fast.

Of air that is still far away: a wind that is named beside it is not in its w.
"""

from __future__ import annotations

import numpy as np

from clothbench import Parameter, ParameterSpace, effect_kernel


@effect_kernel(allocates=False)
def hold_back(t, dt, x, v, f, sheet, p, state):
    """f −= A (h (v_n − w) + b v_n) n, τ ẇ = v_n − w.

    w: m/s, normal velocity of the air that a node moves. To motion of angular frequency ω this is a drag of
    b + h (ωτ)²/(1 + (ωτ)²) and an added mass of h τ/(1 + (ωτ)²): all mass where motion is slow, all drag where it is
    fast. Exact where v_n changes evenly over a step: y = v_n − w goes to y exp(−s) + Δv_n (1 − exp(−s))/s, s = Δt/τ. At
    first, and where no time passes between two calls (a model lets the cloth settle), y = 0.
    state: 0 before the first step, the time of the last, then v_n and y of all nodes.
    """
    if p[0] == 0.0 and p[1] == 0.0:
        return
    count, passed = x.shape[1], t - state[1]
    kept, share = 0.0, 0.0
    if state[0] != 0.0 and passed > 0.0:
        s = passed / p[2]
        kept = np.exp(-s)
        share = -np.expm1(-s) / s
    state[0], state[1] = 1.0, t
    before, behind = state[2 : 2 + count], state[2 + count : 2 + 2 * count]
    for i in range(count):
        nx, ny, nz = sheet.normal[0, i], sheet.normal[1, i], sheet.normal[2, i]
        along = v[0, i] * nx + v[1, i] * ny + v[2, i] * nz
        behind[i] = kept * behind[i] + share * (along - before[i])
        before[i] = along
        push = sheet.area[i] * (p[0] * behind[i] + p[1] * along)
        f[0, i] -= push * nx
        f[1, i] -= push * ny
        f[2, i] -= push * nz


SOURCE = "one relaxation time in place of the history of Basset 1888; Lamb, Hydrodynamics, arts. 68, 71"


class AirMemory:
    name = "air_memory"
    version = 1
    place = "dynamics"
    at_rest = False
    family = "air"
    law = "past normal velocity"
    summary = "air that follows the sheet late: added mass to slow motion, drag to fast"
    force = staticmethod(hold_back)
    parameters = ParameterSpace(
        (
            Parameter(
                "coefficient", "h", "kg/(m²·s)", (0.0, 5.0), "linear", 0.1,
                "force per area and velocity before the air follows", SOURCE, null=0.0,
            ),
            Parameter(
                "steady", "b", "kg/(m²·s)", (0.0, 1.0), "linear", 0.0, "the same once it has", SOURCE, null=0.0
            ),
            Parameter("time", "τ", "s", (0.01, 2.0), "log", 0.15, "time in which it follows, to 1/e", SOURCE),
        )
    )  # fmt: skip

    def state_size(self, sheet):
        return 2 + 2 * sheet.area.shape[0]
