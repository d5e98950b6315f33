"""`crease`: a line along which the cloth was folded and pressed before it was recorded, so that it rests bent there.

Free of loads, both sides of the line are flat and turned against each other by the angle α = P/D. As with
`rest_curvature` it is P = D α that is stated, since the rigidity D belongs to the model; an angle beside a rigidity of
the effect's own would be two numbers of which only the product acts. A mesh turns a little less, since it bends in
steps: by 1 % at 0.5 rad, 3 % at 1 rad, 9 % at 2 rad. A model that has no rigidity at small curvature rests wherever
its springs balance P.
"""

import numpy as np

from clothbench import Parameter, ParameterSpace, effect_kernel
from clothbench_effects.cut_strip import centre
from clothbench_effects.deformation import add_couples, bent
from clothbench_effects.sheet_kernels import cut, helper

WIDTH = 2.0  # triangles in half the hat: a mesh bends in steps, and what turns by 1 rad comes out 7 % short over one


@helper(allocates=True)
def find_line(sheet, place, direction, share):
    """Into `share` (S,) the mean of δ over each slot's triangle [1/m], so that a couple P gives P δ per width there.

    δ is a hat across the line whose integral is 1, over twice the widest triangle to either side, and is integrated
    exactly: P turns the cloth by the same angle on every mesh, and nothing jumps where the line passes a node.
    """
    across = np.array([-np.sin(direction), np.cos(direction)])
    low, high, reach, corner = np.inf, -np.inf, 0.0, np.empty((3, 2))
    hems = sheet.outline.shape[0] > 0  # beside the nodes: of a sheet that is cut, or whose grips lie inside it
    edge = sheet.outline if hems else sheet.uv
    for i in range(edge.shape[0]):
        if hems or sheet.area[i] > 0.0:
            s = across[0] * edge[i, 0] + across[1] * edge[i, 1]
            low, high = min(low, s), max(high, s)
    middle = low + place * (high - low)
    for slot in range(share.shape[0]):
        if sheet.slots[0, slot] > 0.0:
            find_corners(sheet, slot, across, middle, corner)
            reach = max(reach, WIDTH * (corner[:, 0].max() - corner[:, 0].min()))
    for slot in range(share.shape[0]):
        if sheet.slots[0, slot] > 0.0:
            find_corners(sheet, slot, across, middle, corner)
            share[slot] = mean_of_hat(corner, reach)


@helper
def find_corners(sheet, slot, across, middle, corner):
    """Corners (3, 2) m of a slot's triangle: how far across the line, and where along it."""
    nu, half = sheet.columns, sheet.slots.shape[1] // 2
    for k in range(3):
        if nu == 0:
            e = sheet.triangles[slot, k]
        elif slot < half:
            e = slot + (k > 0) + nu * (k > 1)  # as `triangle_slots` has them: e, e + 1, e + nu + 1
        else:
            e = slot - half + (k == 1) + nu * (k > 0)  # e, e + nu + 1, e + nu
        u, v = sheet.uv[e, 0], sheet.uv[e, 1]
        corner[k, 0] = across[0] * u + across[1] * v - middle
        corner[k, 1] = across[0] * v - across[1] * u


@helper(allocates=True)
def mean_of_hat(corner, reach):
    """Mean of (1 − |s|/w)/w, 0 beyond ± w, over a triangle (3, 2) m whose first coordinate is s [1/m]. On either slope
    that is linear, so that the integral is the area times the value at its centre.
    """
    one, two, total = np.empty((6, 2)), np.empty((6, 2)), 0.0
    for side in (-1.0, 1.0):
        one[:3] = corner
        count = cut(one, 3, 0, side, 0.0, two)
        count = cut(two, count, 0, -side, side * reach, one)
        size, s, _ = centre(one, count)
        if size != 0.0:
            total += size * (1.0 - side * s / reach) / reach
    return total / centre(corner, 3)[0]


@effect_kernel
def fold(t, dt, x, v, f, sheet, p, state):
    """f += A P δ ∂κ/∂x: minus the gradient of the energy −P δ κ per area, κ = a² κ_uu + 2 a b κ_uv + b² κ_vv the
    curvature across the line, (a, b) = (−sin, cos) of its direction. state: whether δ is known, then δ of each slot.
    """
    if p[0] == 0.0:
        return
    slots = sheet.slots.shape[1]
    share = state[1 : 1 + slots]
    if state[0] == 0.0:
        state[0] = 1.0
        find_line(sheet, p[1], p[2], share)
    a, b, couple = -np.sin(p[2]), np.cos(p[2]), np.empty((3, slots))
    for e in range(slots):
        couple[0, e] = -p[0] * a * a * share[e]
        couple[1, e] = -p[0] * b * b * share[e]
        couple[2, e] = -p[0] * a * b * share[e]
    add_couples(f, sheet, bent(x, sheet), couple)


SOURCE = "Timoshenko and Woinowsky-Krieger, Theory of Plates and Shells, art. 14: a plate bent by couples alone"
WHERE = "how the sheet was folded"


class Crease:
    name = "crease"
    version = 3
    place = "dynamics"
    family = "bending"
    normals = False
    summary = "a line along which the cloth was folded, and rests bent"
    force = staticmethod(fold)
    parameters = ParameterSpace(
        (
            Parameter(
                "couple", "P", "N·m", (-2e-4, 2e-4), "linear", 5e-6,
                "angle at which the line rests, times the rigidity; above 0 towards u × v", SOURCE, null=0.0,
            ),
            Parameter(
                "place", "q", "1", (0.0, 1.0), "linear", 0.5,
                "share of the way across the sheet at which it lies; along the width, from the top", WHERE,
            ),
            Parameter(
                "direction", "β", "rad", (-np.pi / 2, np.pi / 2), "linear", 0.0,
                "of the line, from along the width (u) towards the length (v)", WHERE,
            ),
        )
    )  # fmt: skip

    def state_size(self, sheet):
        return 1 + sheet.slots.shape[1]
