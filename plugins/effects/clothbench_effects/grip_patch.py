"""`grip_patch`: grips hold a patch of cloth, not a point.

It belongs to the grips, but acts through forces: a model pins single nodes, whatever their number.
"""

import numpy as np

from clothbench import Parameter, ParameterSpace, effect_kernel
from clothbench_effects.sheet_kernels import add_overlap, helper, nodal_cloth

OMEGA = 150.0  # rad/s: far above what a swinging sheet does, slow enough for the steps of an explicit model
LONGEST = 0.75  # of a step times ω: a softer patch in steps above 5 ms; of 1, steps that extrapolate are not stable


@helper(allocates=True)
def take_hold(x, sheet, size, state):
    """Remember how much of each node its grip covers, which grip that is, and where the node is seen from it.

    state: 0 or 1 if taken hold; then coverage, grip and offset (3) m of every node.
    """
    n = x.shape[1]
    whole, part = nodal_cloth(sheet), np.zeros(n)
    for grip in range(sheet.gripped):
        middle = sheet.uv[sheet.held[grip]]
        part[:] = 0.0
        for face in range(sheet.triangles.shape[0]):
            add_overlap(sheet, face, middle - 0.5 * size, middle + 0.5 * size, part)
        for i in range(n):
            memory = state[1 + 5 * i : 6 + 5 * i]
            if whole[i] > 0.0 and part[i] / whole[i] > memory[0]:
                memory[0], memory[1] = part[i] / whole[i], grip
                for c in range(3):
                    memory[2 + c] = x[c, i] - sheet.grip[c, grip]
    state[0] = 1.0


@effect_kernel(allocates=False)
def clasp(t, dt, x, v, f, sheet, p, state):
    """f −= m k [ω² (x − x_g − d) + 2ω (v − v_g)/(1 + 2ω k Δt)], k the share that is covered.

    A spring to the place d beside the grip at which the node was first, which the step does not weaken: what else pulls
    at the node does not know of it. The damping, critical in short steps, is that of an implicit one. Where another
    effect (`grip_offset`, `grip_rotation`) holds the grips elsewhere, d still is beside where they were recorded, since
    it is there that a sheet begins to settle: the two together hold it askew.
    """
    if p[0] == 0.0:
        return
    if state[0] == 0.0:
        take_hold(x, sheet, p[0], state)
    omega = OMEGA if OMEGA * dt <= LONGEST else LONGEST / dt
    for i in range(x.shape[1]):
        memory = state[1 + 5 * i : 6 + 5 * i]
        if memory[0] == 0.0:
            continue
        grip, held = int(memory[1]), sheet.held[int(memory[1])]
        hold = sheet.mass[i] * memory[0]
        damping = 2.0 * omega / (1.0 + 2.0 * omega * memory[0] * dt)
        for c in range(3):
            away = x[c, i] - sheet.grip[c, grip] - memory[2 + c]
            drift = v[c, i] - v[c, held]
            f[c, i] -= hold * (omega**2 * away + damping * drift)


class GripPatch:
    name = "grip_patch"
    version = 4
    place = "dynamics"
    family = "grip"
    normals = False
    summary = "grips that hold a square patch each, not a point (a matter of the grips, though done by forces)"
    force = staticmethod(clasp)
    parameters = ParameterSpace(
        (
            Parameter(
                "size", "s", "m", (0.0, 0.1), "linear", 0.02, "side of the square patch about each grip, along u and v",
                "size of the gripper's jaws", null=0.0,
            ),
        )
    )  # fmt: skip

    def state_size(self, sheet):
        return 1 + 5 * len(sheet.uv)

    def restraint(self, phi):
        return (OMEGA**2, 2 * OMEGA) if phi[0] > 0 else (0.0, 0.0)
