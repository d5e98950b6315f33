"""What every compiled time loop here does beside its own physics: grips, effects, looking for the end."""

from __future__ import annotations

import numpy as np
from numba import njit, types
from numba.extending import overload

from clothbench.effects import FORCE

SLOTS = 8  # places for dynamics effects in a loop
OK, DIVERGED = 0, 1

_fast = njit(cache=True, error_model="numpy", nogil=True)


@_fast
def grip_point(knots, curve, t, segment, g, c):
    """Coordinate c of grip g at time t on a piecewise cubic (4, K−1, G, 3), constant beyond its ends."""
    s = min(max(t, knots[0]), knots[-1]) - knots[segment]
    return ((curve[0, segment, g, c] * s + curve[1, segment, g, c]) * s + curve[2, segment, g, c]) * s + curve[
        3, segment, g, c
    ]


@_fast
def advance_segment(knots, t, segment):
    """The piece of the curve in which t lies, searched forwards from `segment`."""
    while segment < knots.shape[0] - 2 and t >= knots[segment + 1]:
        segment += 1
    return segment


@_fast
def apply_effects(effects, stages, n_effects, t, dt, x, v, f, extra, sheet, parameters, state):
    """Add the forces of all effects to f (3, n) N and what they add to each node's mass to extra (6, n) kg.

    Returns whether any mass was added: then the caller owes `bear_inertia`, or the full mass tensors.
    """
    heavier = False
    for k in range(n_effects):
        if stages[k] == FORCE:
            effects[k](t, dt, x, v, f, sheet, parameters[k], state[k])
        else:
            if not heavier:
                extra[:] = 0.0
            heavier = True
            effects[k](t, dt, x, v, extra, sheet, parameters[k], state[k])
    return heavier


@_fast
def fastest(v, lane, lanes):
    """Largest speed of a node of one lane [m/s]."""
    top = 0.0
    for e in range(lane, v.shape[1], lanes):
        top = max(top, v[0, e] ** 2 + v[1, e] ** 2 + v[2, e] ** 2)
    return np.sqrt(top)


@_fast
def is_lost(x, lane, lanes, limit):
    """Whether a coordinate of this lane has left ±limit or is not a number."""
    for c in range(3):
        for e in range(lane, x.shape[1], lanes):
            if not abs(x[c, e]) < limit:
                return True
    return False


def as_double(array):
    """The array itself if it is double; effects are not offered in single precision, where this only settles types."""


@overload(as_double)
def _as_double(array):
    if array.dtype == types.float64:
        return lambda array: array
    return lambda array: array.astype(np.float64)
