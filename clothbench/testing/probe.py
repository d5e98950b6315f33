"""What checks of models and effects share: a throw-away effect, and values at which effects vanish or act."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from clothbench.core.parameters import Parameter, ParameterSpace
from clothbench.core.protocols import Effect
from clothbench.modelling.curves import acts_on_sheets
from clothbench.modelling.kernels import effect_kernel
from clothbench.modelling.sheet import Sheet
from clothbench.plugins.discovery import catalogue


@effect_kernel
def push_sideways(t, dt, x, v, f, sheet, p, state):
    """f += m p: a uniform acceleration along y; `state` counts the steps, which must not disturb anyone."""
    state[0] += 1.0
    for i in range(x.shape[1]):
        f[1, i] += sheet.mass[i] * p[0]


class SidewaysPush:
    """An effect that certainly acts, to be put beside another one."""

    name = "conformance_push"
    version = 1
    place = "dynamics"
    summary = "a uniform acceleration, for the conformance kit only"
    force = staticmethod(push_sideways)
    parameters = ParameterSpace(
        (
            Parameter(
                "acceleration",
                "a",
                "m/s²",
                (0.0, 5.0),
                "linear",
                1.0,
                "acceleration along y",
                "none",
                null=0.0,
            ),
        )
    )

    def state_size(self, sheet: Sheet) -> int:
        return 1 + 32 * sheet.slots.shape[1]  # more than others have, whose memory is then longer than they asked for


def null_values(effect: Effect) -> np.ndarray:
    """Values (P,) at which the effect vanishes; a parameter without a null value is at its default."""
    return np.array([p.default if p.null is None else p.null for p in effect.parameters], dtype=float)


def acting_values(effect: Effect) -> Iterator[np.ndarray]:
    """Values (P,) at some of which the effect should act: the defaults, then points across the bounds.

    Several, since an effect may do nothing at some: one that sets in at a certain time, or a ratio of 1.
    """
    candidates = [effect.parameters.defaults]
    candidates += [effect.parameters.from_unit(np.full(len(effect.parameters), at)) for at in (0.7, 0.35, 0.02, 0.98)]
    null = null_values(effect)
    yield from (c for c in candidates if not np.array_equal(c, null))


def installed_effects() -> tuple[Effect, ...]:
    """Every effect on sheets in the catalogue that can be made, and whose terms are compiled; one that cannot, or whose
    are not, is its own author's concern.
    """
    return tuple(
        effect
        for effect in catalogue().made("effects")[0].values()
        if acts_on_sheets(effect)
        and all(hasattr(term, "py_func") for stage in ("force", "inertia") if (term := getattr(effect, stage, None)))
    )
