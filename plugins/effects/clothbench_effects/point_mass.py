"""`point_mass`: something small and heavy on the cloth, such as a marker, a button or a clip."""

from clothbench import Parameter, ParameterSpace, effect_kernel
from clothbench_effects.sheet_kernels import helper


@helper(allocates=True)
def find_place(sheet, u, v, state):
    """The triangle that holds the point and its barycentric weights there; of a point off a sheet that has been cut, or
    beside the grid, of the place in the nearest triangle with no weight below 0. state: 0 or 1 if known, nodes,
    weights. u, v: shares of how far the cloth reaches.
    """
    state[0] = 1.0
    edge = sheet.outline if sheet.outline.shape[0] > 0 else sheet.uv  # beside the nodes: cut, or grips lie inside it
    left, top = edge[:, 0].min(), edge[:, 1].min()
    u, v = left + u * (edge[:, 0].max() - left), top + v * (edge[:, 1].max() - top)
    deepest, place = -1e300, 0
    for face in range(sheet.triangles.shape[0]):
        # Rounding must not let a point on an edge fall between two triangles: take the one that it is deepest in.
        inside = min(weight(sheet, face, 0, u, v), weight(sheet, face, 1, u, v), weight(sheet, face, 2, u, v))
        if inside > deepest:
            deepest, place = inside, face
    whole = 0.0
    for k in range(3):
        state[1 + k] = sheet.triangles[place, k]
        state[4 + k] = max(weight(sheet, place, k, u, v), 0.0)
        whole += state[4 + k]
    if deepest < 0.0:
        for k in range(3):
            state[4 + k] /= whole


@helper
def weight(sheet, face, k, u, v):
    """Barycentric coordinate of the point (u, v) m in a triangle that belongs to its corner k."""
    corner = sheet.uv[sheet.triangles[face, k]]
    return 1.0 + sheet.gradient[face, 0, k] * (u - corner[0]) + sheet.gradient[face, 1, k] * (v - corner[1])


@effect_kernel(allocates=False)
def weigh(t, dt, x, v, f, sheet, p, state):
    """f += m λ_k g on the three nodes around the mass, λ_k its barycentric coordinates."""
    if p[0] == 0.0:
        return
    if state[0] == 0.0:
        find_place(sheet, p[1], p[2], state)
    for k in range(3):
        for c in range(3):
            f[c, int(state[1 + k])] += p[0] * state[4 + k] * sheet.gravity[c]


@effect_kernel(allocates=False)
def bear(t, dt, x, v, mass, sheet, p, state):
    """ΔM = m λ_k I on the same nodes: it moves continuously as the mass does, and its total is m on every mesh."""
    if p[0] == 0.0:
        return
    if state[0] == 0.0:
        find_place(sheet, p[1], p[2], state)
    for k in range(3):
        for c in range(3):
            mass[c, int(state[1 + k])] += p[0] * state[4 + k]


SOURCE = "weigh it, and see where it is"


class PointMass:
    name = "point_mass"
    version = 4
    place = "dynamics"
    family = "mass"
    normals = False
    summary = "a small mass on the cloth, such as a marker"
    force = staticmethod(weigh)
    inertia = staticmethod(bear)
    parameters = ParameterSpace(
        (
            Parameter("mass", "m", "kg", (0.0, 0.02), "linear", 0.001, "its mass", SOURCE, null=0.0),
            Parameter("u", "u", "1", (0.0, 1.0), "linear", 0.5, "where it sits, as a share of the width", SOURCE),
            Parameter("v", "v", "1", (0.0, 1.0), "linear", 0.9, "where it sits, as a share of the height", SOURCE),
        )
    )  # fmt: skip

    def state_size(self, sheet):
        return 7
