"""`heavy_hem`: a strip along the lower edge that is folded and sewn, and heavier for it."""

import numpy as np

from clothbench import Parameter, ParameterSpace, effect_kernel
from clothbench_effects.cut_strip import add_strip
from clothbench_effects.sheet_kernels import add_overlap, helper, nodal_cloth


@helper(allocates=True)
def find_hem(sheet, density, width, state):
    """What each node carries of the strip [kg], into state[1:]; state[0] says that it is known.

    The strip is all cloth that lies lower than its own width above the lowest point of the cloth, on a sheet that is
    cut along an outline, or whose hems lie beside its grid, as on any other: of a disc a segment. Its total is right on
    every mesh, its first moment wherever the strip lies between nodes of the cloth.
    """
    state[0] = 1.0
    if sheet.outline.shape[0] > 0:
        add_strip(sheet, sheet.outline[:, 1].max() - width, state[1:])
    else:
        add_lowest(sheet, width, state[1:])
    for i in range(1, state.shape[0]):
        state[i] *= density


@helper(allocates=True)
def add_lowest(sheet, width, share):
    """share_k += ∫ N_k over what lies lower than `width` m above the lowest node of the cloth, (n,) m²: by the part of
    each triangle that does; of one that is not all cloth, as if it were spread evenly.
    """
    foot = -np.inf
    for i in range(sheet.uv.shape[0]):
        if sheet.area[i] > 0.0:
            foot = max(foot, sheet.uv[i, 1])
    low, high = np.array([-np.inf, foot - width]), np.array([np.inf, np.inf])
    for face in range(sheet.triangles.shape[0]):
        add_overlap(sheet, face, low, high, share)
    if sheet.columns == 0:
        whole = nodal_cloth(sheet)
        for i in range(whole.shape[0]):
            if whole[i] > 0.0:  # slivers of cloth beside an outline lie in no triangle, but their nodes carry them
                share[i] *= sheet.area[i] / whole[i]


@effect_kernel(allocates=False)
def weigh(t, dt, x, v, f, sheet, p, state):
    """f += m g, m = ρ_h ∫ N dA over the strip of width w along the lower edge."""
    if p[0] == 0.0:
        return
    if state[0] == 0.0:
        find_hem(sheet, p[0], p[1], state)
    for c in range(3):
        for i in range(x.shape[1]):
            f[c, i] += state[1 + i] * sheet.gravity[c]


@effect_kernel(allocates=False)
def bear(t, dt, x, v, mass, sheet, p, state):
    """ΔM = m I with the same m."""
    if p[0] == 0.0:
        return
    if state[0] == 0.0:
        find_hem(sheet, p[0], p[1], state)
    for c in range(3):
        for i in range(x.shape[1]):
            mass[c, i] += state[1 + i]


SOURCE = "how the sheet was sewn: each further layer adds the cloth's own areal density"


class HeavyHem:
    name = "heavy_hem"
    version = 4
    place = "dynamics"
    family = "mass"
    law = "mass along the lower edge"
    normals = False
    summary = "a hem along the lower edge, with its weight"
    force = staticmethod(weigh)
    inertia = staticmethod(bear)
    parameters = ParameterSpace(
        (
            Parameter(
                "areal_density", "ρ_h", "kg/m²", (0.0, 1.0), "linear", 0.1, "what the hem adds per area", SOURCE,
                null=0.0,
            ),
            Parameter("width", "w", "m", (0.002, 0.1), "log", 0.015, "width of the hem", SOURCE),
        )
    )  # fmt: skip

    def state_size(self, sheet):
        return 1 + len(sheet.uv)
