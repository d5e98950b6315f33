"""`plastic_bending`: cloth that was bent sharply stays bent, as at a fold that was pressed.

An elastic element that yields, beside the model's own bending, which does not: below the yield curvature it is one more
rigidity and loses nothing; above, its moment stays what it was at yield, and what is bent beyond that is not undone.
A strip bent to κ_m and let go keeps R (κ_m − κ_y)/(R + D), with D the model's own rigidity, but R κ_y/D at most: what
was bent farther than (2 + R/D) κ_y yields once more on its way back.
"""

import numpy as np

from clothbench import Parameter, ParameterSpace, effect_kernel
from clothbench.modelling import lean_kernel
from clothbench_effects.deformation import add_couples, bent

FAR = 1e6  # 1/m, a curvature beyond any that cloth has


@lean_kernel
def give_way(couple, set_, now, rigidity, limit):
    """Couples (S,) R (κ − κ_p) at curvatures `now`; what is bent beyond ± limit goes into κ_p, in `set_`, for good."""
    for e in range(now.shape[0]):
        elastic = now[e] - set_[e]
        if elastic > limit:
            elastic = limit
        elif elastic < -limit:
            elastic = -limit
        set_[e] = now[e] - elastic
        couple[e] = rigidity * elastic


@effect_kernel
def keep(t, dt, x, v, f, sheet, p, state):
    """Couples per width M = R (κ − κ_p), |κ − κ_p| ≤ κ_y, for κ_uu, κ_vv and κ_uv of each triangle by itself.

    state: κ_p [1/m], three for each triangle; 0, as woven, in the shape from which a sheet sets out to settle. What
    yields on that way, which is made up, is kept: where such a sheet rests depends on that shape, by a millimetre.
    Nothing depends on the step or the rate.
    """
    if p[0] == 0.0:
        return
    shape, slots = bent(x, sheet), sheet.slots.shape[1]
    kept = state[: 3 * slots].reshape((3, slots))
    couple = kept.copy()
    for c in range(3):
        give_way(couple[c], kept[c], shape.curvature[c], p[0], p[1])
    add_couples(f, sheet, shape, couple)


SOURCE = "Prandtl 1928, an elastic element that slips (elastic, ideally plastic), in bending"


class PlasticBending:
    name = "plastic_bending"
    version = 1
    place = "dynamics"
    normals = False
    summary = "bending that yields, so that folds stay"
    family = "bending"
    force = staticmethod(keep)
    parameters = ParameterSpace(
        (
            Parameter(
                "rigidity", "R", "N·m", (0.0, 1e-3), "linear", 1e-5, "bending rigidity that yields, beside the model's",
                SOURCE, null=0.0,
            ),
            Parameter(
                "curvature", "κ_y", "1/m", (1.0, 1000.0), "log", 50.0, "curvature at which it yields", SOURCE,
            ),
        )
    )  # fmt: skip

    def limits(self, phi):
        return {"bending stiffness that never yields": np.array([phi[0], FAR])}

    def state_size(self, sheet):
        return 3 * sheet.slots.shape[1]

    def stiffness(self, phi):
        return 0.0, phi[0]
