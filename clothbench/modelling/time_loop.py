"""What every compiled time loop here does beside its own physics: grips, effects, looking for the end."""

from __future__ import annotations

from collections import namedtuple

import numpy as np
from numba import types
from numba.extending import overload

from clothbench.core.kernels import bundle_type, lean_kernel
from clothbench.modelling.bound_effects import FORCE
from clothbench.modelling.sheet import sheet_normals, wants_normals

SLOTS = 8  # places for dynamics effects in a loop
OK, DIVERGED, RESTLESS = 0, 1, 2  # how a loop ends; restless: it found no rest to begin with
GOES_ON, SETTLES, RESTS = 0, 1, 2  # how a loop begins

Terms = namedtuple("Terms", "stages count parameters state")
Terms.__doc__ = """The effects' terms of a time loop, beside their compiled functions, which a loop takes one by one: a
tuple of functions would be typed anew, slowly, at every call.

stages: (SLOTS,), FORCE or INERTIA; count: how many of the slots are used; parameters: (SLOTS, width) and state:
(SLOTS, S), of each; with one more axis in front, the members, for loops that run several at once.
"""
Grips = namedtuple("Grips", "knots curve points of_points")
Grips.__doc__ = """Where the grips are, and which of the wanted points are grips.

knots: (K,) s; curve: (4, K−1, G, 3), a piecewise cubic between them, highest power first; with one more axis in front,
the members, or 1 where all share it, for loops that run several at once; points: numbers of the wanted points that are
held, and of_points: the grip of each.
"""
Start = namedtuple("Start", "x v settles")
Start.__doc__ = """Where a loop begins. x: (3, n) m, changed in place, and v: (3, n) m/s, of all nodes; settles: whether
the sheet first comes to rest in its grips (SETTLES), hangs at rest in them already (RESTS) or goes on as it is
(GOES_ON). Of several members at once, interleaved: (3, n·members).
"""
Sampling = namedtuple("Sampling", "index weight times out")
Sampling.__doc__ = """Where and when a loop is looked at.

index: (N, k) and weight: (N, k), each wanted point as a weighted sum of k nodes; times: (T,) s; out: (T, N, 3) m, to be
filled; times and out with one more axis in front, the members, for loops that run several at once.
"""
Clock = namedtuple("Clock", "start dt tolerance limit")
Clock.__doc__ = """The steps of a loop. start: s, when it begins; dt: s; tolerance: of what each model says; limit: m,
how far from the origin a sheet may get before it counts as blown up.
"""

_d1, _d2, _i1 = types.float64[::1], types.float64[:, ::1], types.int64[::1]
_d3, _d4, _d5 = types.float64[:, :, ::1], types.float64[:, :, :, ::1], types.float64[:, :, :, :, ::1]
START = bundle_type(Start, _d2, _d2, types.int64)
TERMS = bundle_type(Terms, _i1, types.int64, _d2, _d2)
GRIPS = bundle_type(Grips, _d1, _d4, _i1, _i1)
SAMPLING = bundle_type(Sampling, types.int64[:, ::1], _d2, _d1, _d3)
CLOCK = bundle_type(Clock, *[types.float64] * 4)
# The same for loops that run several members at once.
TERMS_OF_MANY = bundle_type(Terms, _i1, types.int64, _d3, _d3)
GRIPS_OF_MANY = bundle_type(Grips, _d1, _d5, _i1, _i1)
SAMPLING_OF_MANY = bundle_type(Sampling, types.int64[:, ::1], _d2, _d2, _d4)


@lean_kernel
def grip_point(knots, curve, t, segment, g, c):
    """Coordinate c of grip g at time t on a piecewise cubic (4, K−1, G, 3), constant beyond its ends."""
    s = min(max(t, knots[0]), knots[-1]) - knots[segment]
    return ((curve[0, segment, g, c] * s + curve[1, segment, g, c]) * s + curve[2, segment, g, c]) * s + curve[
        3, segment, g, c
    ]


@lean_kernel
def grip_speed(knots, curve, t, segment, g, c):
    """The derivative of `grip_point`, 0 beyond the ends of the curve."""
    if t < knots[0] or t > knots[-1]:
        return 0.0
    s = t - knots[segment]
    return (3.0 * curve[0, segment, g, c] * s + 2.0 * curve[1, segment, g, c]) * s + curve[2, segment, g, c]


@lean_kernel
def advance_segment(knots, t, segment):
    """The piece of the curve in which t lies, searched forwards from `segment`."""
    while segment < knots.shape[0] - 2 and t >= knots[segment + 1]:
        segment += 1
    return segment


@lean_kernel
def apply_effects(effects, stages, count, t, dt, x, v, f, extra, sheet, parameters, state):
    """Add the forces of all effects to f (3, n) N and what they add to each node's mass to extra (6, n) kg.

    stages (SLOTS,), count, parameters (SLOTS, width) and state (SLOTS, S): as in `Terms`, of one member. Returns
    whether any mass was added: then the caller owes `bear_inertia`, or the full mass tensors.
    """
    heavier = False
    for k in range(count):
        if stages[k] == FORCE:
            effects[k](t, dt, x, v, f, sheet, parameters[k], state[k])
        else:
            if not heavier:
                extra[:] = 0.0
            heavier = True
            effects[k](t, dt, x, v, extra, sheet, parameters[k], state[k])
    return heavier


@lean_kernel
def fastest(v, lane, lanes):
    """Largest speed of a node of one lane [m/s]."""
    top = 0.0
    for e in range(lane, v.shape[1], lanes):
        top = max(top, v[0, e] ** 2 + v[1, e] ** 2 + v[2, e] ** 2)
    return np.sqrt(top)


@lean_kernel
def is_lost(x, lane, lanes, limit):
    """Whether a coordinate of this lane has left ±limit or is not a number."""
    for c in range(3):
        for e in range(lane, x.shape[1], lanes):
            if not abs(x[c, e]) < limit:
                return True
    return False


@lean_kernel
def add_effects(t, dt, x, v, f, nu, sheet, effects, terms, grips, segment, extra):
    """Let all effects of a grid, nu nodes a row, add to the forces f (3, n) N at time t, and to the mass.

    They are shown normals and grips as they are. Returns whether any mass was added to extra (6, n) kg: then the caller
    owes `bear_inertia`, as after `apply_effects`.
    """
    if terms.count == 0:
        return False
    if wants_normals(sheet):
        sheet_normals(x, nu, sheet)
    show_grips(sheet, grips.knots, grips.curve, t, segment)
    return apply_effects(
        effects, terms.stages, terms.count, t, dt, x, v, f, extra, sheet, terms.parameters, terms.state
    )


def as_double(array):
    """The array itself if it is double, else a copy that is: what effects, which know doubles only, are shown."""


@overload(as_double)
def _as_double(array):
    if array.dtype == types.float64:
        return lambda array: array
    return lambda array: array.astype(np.float64)


def put_back(into, of):
    """Take the numbers of a copy that `as_double` made into the array, or the array's into the copy; nothing where that
    was no copy.
    """


@overload(put_back)
def _put_back(into, of):
    if into.dtype == of.dtype:
        return lambda into, of: None

    def converted(into, of):
        for c in range(into.shape[0]):
            for e in range(into.shape[1]):
                into[c, e] = of[c, e]

    return converted


@lean_kernel
def show_grips(sheet, knots, curve, t, segment):
    """Tell the effects where the grips are at time t: fills `sheet.grip` (3, G) m."""
    for g in range(sheet.held.shape[0]):
        for c in range(3):
            sheet.grip[c, g] = grip_point(knots, curve, t, segment, g, c)


@lean_kernel
def hold_grips(x, pins, grips, t, segment):
    """Put the held nodes `pins` (G,) of shape x (3, n) m where their grips are at time t, exactly."""
    for g in range(pins.shape[0]):
        for c in range(3):
            x[c, pins[g]] = grip_point(grips.knots, grips.curve, t, segment, g, c)


@lean_kernel
def put_grips(out, points, of_points, knots, curve, t):
    """Points of a frame (N, 3) that lie on a grip are put where the grip is, exactly."""
    if points.shape[0]:
        segment = advance_segment(knots, t, 0)
        for n in range(points.shape[0]):
            for c in range(3):
                out[points[n], c] = grip_point(knots, curve, t, segment, of_points[n], c)


@lean_kernel
def write_frames(x0, v0, x1, v1, t0, t1, done, sampling, grips):
    """Write the frames due up to t1, on the cubic through positions and velocities at t0 and t1 (Hermite).

    Frames before a run begins, t0 = t1, look back along v1: a sheet that was seen to move came from somewhere. Points
    that lie on a grip are put where the grip is, exactly. Returns how many frames are written.
    """
    index, weight, times, out = sampling.index, sampling.weight, sampling.times, sampling.out
    while done < times.shape[0] and times[done] <= t1:
        h = t1 - t0
        s = min(max((times[done] - t0) / h, 0.0), 1.0) if h > 0.0 else 1.0
        a, b = (1.0 + 2.0 * s) * (1.0 - s) ** 2, s * s * (3.0 - 2.0 * s)
        p, q = s * (1.0 - s) ** 2 * h, s * s * (s - 1.0) * h if h > 0.0 else times[done] - t1
        for n in range(index.shape[0]):
            for c in range(3):
                total = 0.0
                for k in range(index.shape[1]):
                    e = index[n, k]
                    total += weight[n, k] * (a * x0[c, e] + b * x1[c, e] + p * v0[c, e] + q * v1[c, e])
                out[done, n, c] = total
        put_grips(out[done], grips.points, grips.of_points, grips.knots, grips.curve, times[done])
        done += 1
    return done
