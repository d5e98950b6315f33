"""`hem`: a swatch is seamed, and the seam weighs something. Ten lines of physics that any model can be given."""

from clothbench import Parameter, ParameterSpace, effect_kernel
from clothbench.modelling import kernel


@kernel
def on_border(uv, i):
    """Whether node i lies on the border of the sheet; uv (n, 2) m starts at 0 and ends at its size."""
    return uv[i, 0] <= 0.0 or uv[i, 1] <= 0.0 or uv[i, 0] >= uv[-1, 0] or uv[i, 1] >= uv[-1, 1]


@kernel
def length_per_node(uv):
    """The border's length over the number of nodes on it [m]."""
    count = 0
    for i in range(uv.shape[0]):
        count += on_border(uv, i)
    return 2.0 * (uv[-1, 0] + uv[-1, 1]) / count


@effect_kernel
def weigh(t, dt, x, v, f, sheet, p, state):
    """f += Δm g on the border's nodes, with Δm = λ · (length of the border) / (nodes on it)."""
    extra = p[0] * length_per_node(sheet.uv)
    for i in range(x.shape[1]):
        if on_border(sheet.uv, i):
            for c in range(3):
                f[c, i] += extra * sheet.gravity[c]


@effect_kernel
def resist(t, dt, x, v, mass, sheet, p, state):
    """ΔM = Δm I on the border's nodes."""
    extra = p[0] * length_per_node(sheet.uv)
    for i in range(x.shape[1]):
        if on_border(sheet.uv, i):
            for c in range(3):
                mass[c, i] += extra


class Hem:
    name = "hem"
    version = 1
    place = "dynamics"
    summary = "a seam along the border makes it heavier"
    force = staticmethod(weigh)
    inertia = staticmethod(resist)
    parameters = ParameterSpace(
        (
            Parameter(
                "mass", "λ", "kg/m", (0.0, 0.02), "linear", 0.002, "mass of the seam per length of the border",
                "two folds of 5 mm of a 0.2 kg/m² fabric weigh 0.002 kg/m", null=0.0,
            ),
        )
    )  # fmt: skip
