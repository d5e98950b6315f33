"""Compiled loops of the mass-spring grids.

The grid is one flat row, structure of arrays: node (i, j) is entry j·nu + i, so every family of springs joins entry
e with entry e + s for one stride s, and springs that would wrap around the edge carry a stiffness of 0. That keeps
the loops free of branches and gathers, which is what lets the compiler use the vector unit (measured: 77 million
node-steps/s per core against about 10 for a list of edges). Small grids are too short for that: there several
parameter sets ("lanes") are interleaved, entry (j·nu + i)·lanes + lane, and the same loops run with stride s·lanes.
"""

from __future__ import annotations

import functools
from collections import namedtuple

import numpy as np
from numba import types

from clothbench.modelling import (
    DIVERGED,
    EFFECT,
    GRIPS_OF_MANY,
    LAYERS,
    OK,
    SAMPLING_OF_MANY,
    SETTLES,
    SHEET,
    SLOTS,
    TERMS_OF_MANY,
    Start,
    advance_segment,
    apart_kernel,
    apply_effects,
    as_double,
    bear_inverted,
    bundle_type,
    carry,
    fastest,
    grip_point,
    invert_inertia,
    is_lost,
    keep_apart,
    keep_out,
    kernel,
    lean_kernel,
    mobilities,
    put_back,
    put_grips,
    sheet_normals,
    show_grips,
    wants_normals,
)

__all__ = ["DIVERGED", "OK", "SLOTS", "Settling", "Springs", "run_block"]

TINY = 1e-30  # m²; keeps the length of a masked spring between two coinciding nodes above 0
CHECK_EVERY = 64  # steps between two looks for rest and for divergence
FASTEST_KEEPS = 1 / 2  # of its speed in a step, at most, whatever is damped fast (`relax`)
SWEEPS = 30  # at most, over all limited springs after one step
SLACK = 0.001  # of a spring's length; strain beyond the limit that needs no further sweep


@apart_kernel(allocates=False)
def spring_forces(x, v, stride, rest, stiffness, damping, g, begin):
    """Force of one family of springs on its first nodes, from place `begin` of g (3, begin + n) N on:

    g = [k (1 − L/l) + c (ḋ·d)/l²] d, with d = x_b − x_a, l = |d|: a linear spring and a dashpot along it
    (Provot 1995, section 3). `rest` L m, `stiffness` k N/m and `damping` c N·s/m per entry.
    """
    n = x.shape[1] - stride
    ax, ay, az = x[0, :n], x[1, :n], x[2, :n]
    bx, by, bz = x[0, stride : stride + n], x[1, stride : stride + n], x[2, stride : stride + n]
    au, av, aw = v[0, :n], v[1, :n], v[2, :n]
    bu, bv, bw = v[0, stride : stride + n], v[1, stride : stride + n], v[2, stride : stride + n]
    gx, gy, gz = g[0, begin : begin + n], g[1, begin : begin + n], g[2, begin : begin + n]
    one, tiny = x.dtype.type(1.0), x.dtype.type(TINY)  # a double constant would pull single precision up to double
    for e in range(np.uint64(n)):
        dx, dy, dz = bx[e] - ax[e], by[e] - ay[e], bz[e] - az[e]
        closing = (bu[e] - au[e]) * dx + (bv[e] - av[e]) * dy + (bw[e] - aw[e]) * dz
        inverse = one / np.sqrt(dx * dx + dy * dy + dz * dz + tiny)
        q = stiffness[e] * (one - rest[e] * inverse) + damping[e] * closing * inverse * inverse
        gx[e] = q * dx
        gy[e] = q * dy
        gz[e] = q * dz


@apart_kernel(allocates=False)
def elastic_forces(x, stride, rest, stiffness, g, begin):
    """`spring_forces` without dashpots: g = k (1 − L/l) d."""
    n = x.shape[1] - stride
    ax, ay, az = x[0, :n], x[1, :n], x[2, :n]
    bx, by, bz = x[0, stride : stride + n], x[1, stride : stride + n], x[2, stride : stride + n]
    gx, gy, gz = g[0, begin : begin + n], g[1, begin : begin + n], g[2, begin : begin + n]
    one, tiny = x.dtype.type(1.0), x.dtype.type(TINY)
    for e in range(np.uint64(n)):
        dx, dy, dz = bx[e] - ax[e], by[e] - ay[e], bz[e] - az[e]
        q = stiffness[e] * (one - rest[e] / np.sqrt(dx * dx + dy * dy + dz * dz + tiny))
        gx[e] = q * dx
        gy[e] = q * dy
        gz[e] = q * dz


@apart_kernel(allocates=False)
def elastic_forces_and_axes(x, stride, rest, stiffness, root, g, axis, begin):
    """`elastic_forces`, and √c d/l of the dashpots beside the springs, from place `begin` of axis (3, begin + n) on.

    root: √c of each, (N·s/m)^½.
    """
    n = x.shape[1] - stride
    ax, ay, az = x[0, :n], x[1, :n], x[2, :n]
    bx, by, bz = x[0, stride : stride + n], x[1, stride : stride + n], x[2, stride : stride + n]
    gx, gy, gz = g[0, begin : begin + n], g[1, begin : begin + n], g[2, begin : begin + n]
    ex, ey, ez = axis[0, begin : begin + n], axis[1, begin : begin + n], axis[2, begin : begin + n]
    one, tiny = x.dtype.type(1.0), x.dtype.type(TINY)
    for e in range(np.uint64(n)):
        dx, dy, dz = bx[e] - ax[e], by[e] - ay[e], bz[e] - az[e]
        inverse = one / np.sqrt(dx * dx + dy * dy + dz * dz + tiny)
        q = stiffness[e] * (one - rest[e] * inverse)
        gx[e], gy[e], gz[e] = q * dx, q * dy, q * dz
        inverse *= root[e]
        ex[e], ey[e], ez[e] = inverse * dx, inverse * dy, inverse * dz


@apart_kernel(allocates=False)
def add_dashpots(f, v, stride, axis, begin):
    """f += a (Δv·a) of one family of dashpots at their first nodes, − that at their second; a = √c d/l from `axis`.

    f: (3, n) N. v has `begin` zeros before its n nodes and behind them, axis before them: each node adds up the one
    that begins and the one that ends in it, at twice the arithmetic but with nothing written between.
    """
    n, back, on = f.shape[1], begin - stride, begin + stride
    u, vv, w = v[0, begin : begin + n], v[1, begin : begin + n], v[2, begin : begin + n]
    bu, bv, bw = v[0, on : on + n], v[1, on : on + n], v[2, on : on + n]
    au, av, aw = v[0, back : back + n], v[1, back : back + n], v[2, back : back + n]
    px, py, pz = axis[0, begin : begin + n], axis[1, begin : begin + n], axis[2, begin : begin + n]
    qx, qy, qz = axis[0, back : back + n], axis[1, back : back + n], axis[2, back : back + n]
    fx, fy, fz = f[0], f[1], f[2]
    for e in range(np.uint64(n)):
        p = (bu[e] - u[e]) * px[e] + (bv[e] - vv[e]) * py[e] + (bw[e] - w[e]) * pz[e]
        q = (u[e] - au[e]) * qx[e] + (vv[e] - av[e]) * qy[e] + (w[e] - aw[e]) * qz[e]
        fx[e] += p * px[e] - q * qx[e]
        fy[e] += p * py[e] - q * qy[e]
        fz[e] += p * pz[e] - q * qz[e]


@apart_kernel(allocates=False)
def next_stage(now, before, f, inverse_mass, kick, centre, slope, less):
    """before ← centre·now + slope·kick·f/m − less·before, then f ← 0: T_{j+1}(y) = 2 y T_j(y) − T_{j−1}(y)."""
    for c in range(3):
        yc, bc, fc = now[c], before[c], f[c]
        for e in range(np.uint64(yc.shape[0])):
            bc[e] = centre * yc[e] + slope * kick[e] * (fc[e] * inverse_mass[e]) - less * bc[e]
            fc[e] = 0.0


@apart_kernel(allocates=False)
def add_pairwise(f, g, begin, stride):
    """f += what springs do at their first nodes, − what they do at their second: f (3, n) N, g (3, begin + n) N.

    A node's spring forward stands `begin` places on in g, the one that ends in it `stride` places before that; where
    there is none, g is 0.
    """
    for c in range(3):
        own, forward, back = f[c], g[c, begin:], g[c, begin - stride :]
        for e in range(np.uint64(own.shape[0])):
            own[e] += forward[e] - back[e]


@apart_kernel(allocates=False)
def kick_and_drift(x, v, f, inverse_mass, weight, kick, dt, keep):
    """v ← keep·v + kick·f/m, x ← x + dt·v, then f ← weight for the next step (symplectic Euler).

    kick, dt, keep: (n,) per entry. kick is dt, or dt/2 in the first step, which turns the scheme into leapfrog.
    """
    for c in range(3):
        xc, vc, fc, wc = x[c], v[c], f[c], weight[c]
        for e in range(np.uint64(xc.shape[0])):
            w = vc[e] * keep[e] + kick[e] * (fc[e] * inverse_mass[e])
            vc[e] = w
            xc[e] += dt[e] * w
            fc[e] = wc[e]


@lean_kernel
def chebyshev(stages):
    """Centre w₀ and slope w₁ of P(z) = (1 + T_s(w₀ + w₁ z))/(1 + T_s(w₀)), with P′(0) = 1 and T_s(w₀) such that

    0 ≤ P ≤ FASTEST_KEEPS where −1 ≤ w₀ + w₁ z ≤ 1: for z from −(1 + w₀)/w₁ up, about −0.8 s², to where P grows to 1.
    """
    whole = 2.0 / FASTEST_KEEPS  # 1 + T_s(w₀)
    angle = np.arccosh(whole - 1.0) / stages
    return np.cosh(angle), whole * np.sinh(angle) / (stages * np.sinh(stages * angle))


def damped_up_to(stages: int) -> float:
    """The fastest rate of damping, times the step, for which that many stages are stable."""
    centre, slope = chebyshev.py_func(stages)
    return (1.0 + centre) / slope


@lean_kernel
def relax(v, f, fd, strides, axes, inverse_mass, heavier, inertia, kick, stages, centre, slope, work, begin):
    """v ← P(A) v, A = −kick C/m the dashpots along `axes`, P of `chebyshev`: in s stages what s² steps of Euler's do.

    P(z) = 1 + z + O(z²), a mean of 1 and of the polynomial of van der Houwen and Sommeijer (1980, On the internal
    stability of explicit, m-stage Runge–Kutta methods), damped like theirs: nearer to exp(z), and it turns nothing
    around. Theirs would take three stages for four of these. f (3, n) has to be 0 and is left so, and fd is it, or room
    for it, in double precision. work: (2, 3, begin + n + begin), 0 at both ends; axes: as `add_dashpots` reads them;
    heavier: whether effects added mass to the nodes' own, and inertia: from `invert_inertia`.
    """
    real, nodes = v.dtype.type, slice(begin, begin + v.shape[1])
    now, before = work[0], work[1]
    for c in range(3):
        own = v[c]
        for e in range(np.uint64(own.shape[0])):
            now[c, begin + e] = own[e]
    before[:] = 0.0
    value, earlier = real(1.0), real(0.0)  # of T_j(w₀), rounded as all else: what is not damped keeps its speed
    for stage in range(stages):
        for family in range(strides.shape[0]):
            add_dashpots(f, now, strides[family], axes[family], begin)
        if heavier:
            put_back(fd, f)
            bear_inverted(fd, inertia)
            put_back(f, fd)
        twice = 1.0 if stage == 0 else 2.0
        grow, less = real(twice * centre), real(twice - 1.0)
        next_stage(now[:, nodes], before[:, nodes], f, inverse_mass, kick, grow, real(twice * slope), less)
        now, before = before, now
        value, earlier = grow * value - less * earlier, value
    share = real(1.0) / (real(1.0) + value)
    for c in range(3):
        own, found = v[c], now[c, nodes]
        for e in range(np.uint64(own.shape[0])):
            own[e] = (own[e] + found[e]) * share


@apart_kernel(allocates=False)
def half_kick(v, f, inverse_mass, kick, half):
    """v ← v + kick/2·f/m, the other half of which (3, n) m/s is for behind `relax`; then f ← 0.

    Half before and half behind, so that what damping stops at once still creeps. With all of the kick before it, sheets
    stood still that ought to have come to rest: 1.5 mm on one that swung by 150.
    """
    by_two = v.dtype.type(0.5)
    for c in range(3):
        vc, fc, hc = v[c], f[c], half[c]
        for e in range(np.uint64(vc.shape[0])):
            hc[e] = by_two * kick[e] * (fc[e] * inverse_mass[e])
            vc[e] += hc[e]
            fc[e] = 0.0


@apart_kernel(allocates=False)
def half_kick_and_drift(x, v, f, half, weight, dt):
    """v ← v + half, x ← x + dt·v, then f ← weight for the next step."""
    for c in range(3):
        xc, vc, fc, hc, wc = x[c], v[c], f[c], half[c], weight[c]
        for e in range(np.uint64(xc.shape[0])):
            w = vc[e] + hc[e]
            vc[e] = w
            xc[e] += dt[e] * w
            fc[e] = wc[e]


@lean_kernel
def hold(x, v, pins, lane, lanes, knots, curve, t, segment, dt):
    """Put the held nodes of one lane where the grips are at time t; their velocity is what brought them there."""
    for g in range(pins.shape[0]):
        e = pins[g] * lanes + lane
        for c in range(3):
            p = grip_point(knots, curve, t, segment, g, c)
            v[c, e] = (p - (x[c, e] - dt * v[c, e])) / dt
            x[c, e] = p


@lean_kernel
def limit_strain(x, v, limited, strides, rest, stiffness, free, lane, lanes, limit, dt):
    """Shorten springs of the first `limited` families of one lane that are longer than (1 + limit) L to that length.

    Provot 1995, section 5: the ends move along the spring, both of them or only the one that is free, here by their
    inverse masses `free` (n·lanes,), which keeps the momentum where nodes differ in mass; and the velocities follow,
    Δv = Δx/dt. One sweep goes family by family, and row by row in each, every second sweep the other way round; each
    spring sees what those before it have done. It ends when no spring was too long by more than SLACK.
    """
    nodes = x.shape[1] // lanes
    for sweep in range(SWEEPS):
        worst = 0.0
        for k in range(limited):
            family = k if sweep % 2 == 0 else limited - 1 - k
            count = nodes - strides[family] // lanes
            for i in range(count):
                a = (i if sweep % 2 == 0 else count - 1 - i) * lanes + lane
                if stiffness[family, a] > 0.0:
                    worst = max(worst, _shorten(x, v, a, a + strides[family], rest[family, a], free, limit, dt))
        if worst <= SLACK:
            break


@lean_kernel
def _shorten(x, v, a, b, rest, free, limit, dt):
    """Bring the ends of one spring back to (1 + limit) rest; returns by how much of its rest length it was too long."""
    dx, dy, dz = x[0, b] - x[0, a], x[1, b] - x[1, a], x[2, b] - x[2, a]
    square, longest = dx * dx + dy * dy + dz * dz, (1.0 + limit) * rest
    mobility = free[a] + free[b]
    if square <= longest * longest or mobility == 0.0:
        return 0.0
    length = np.sqrt(square)
    share = (length - longest) / (length * mobility)
    for c, d in enumerate((dx, dy, dz)):
        move_a, move_b = share * free[a] * d, -share * free[b] * d
        x[c, a] += move_a
        x[c, b] += move_b
        v[c, a] += move_a / dt
        v[c, b] += move_b / dt
    return (length - longest) / rest


@lean_kernel
def write_due(x, v, lane, lanes, now, done, sampling, grips):
    """Write the frames that fall due up to `now`; returns how many of this lane are written.

    A frame is looked at a little back in time, x_mesh = x − back·v, which is exact between two steps of the scheme.
    Points that lie on a grip are put where the grip is, exactly.
    """
    index, weight, times, out = sampling.index, sampling.weight, sampling.times[lane], sampling.out[lane]
    while done < times.shape[0] and times[done] <= now:
        back = now - times[done]
        for n in range(index.shape[0]):
            for c in range(3):
                total = 0.0
                for k in range(index.shape[1]):
                    e = index[n, k] * lanes + lane
                    total += weight[n, k] * (x[c, e] - back * v[c, e])
                out[done, n, c] = total
        curve = grips.curve[lane % grips.curve.shape[0]]
        put_grips(out[done], grips.points, grips.of_points, grips.knots, curve, times[done])
        done += 1
    return done


@lean_kernel
def begin(v, settled, keep, kick, step, dashpots, damping, lane, lanes, dt, loss):
    """Begin the run proper of one lane: no velocity if it has settled, no artificial damping but the springs' own, and
    half a kick to start the leapfrog.
    """
    for e in range(lane, keep.shape[0], lanes):
        keep[e] = 1.0 - loss * dt
        kick[e] = 0.5 * dt
        step[e] = dt
        if settled:
            for c in range(3):
                v[c, e] = 0.0
        for family in range(damping.shape[0]):
            dashpots[family, e] = damping[family, e]


Springs = namedtuple(
    "Springs", "strides rest stiffness damping settle_damping damping_stages loss strain_limit limited"
)
Springs.__doc__ = """The springs of `lanes` interleaved sheets of n nodes, S families.

strides: (S,), from a spring's first node to its second, in entries; rest: (S, n·lanes) m; stiffness: (S, n·lanes) N/m;
damping: (S, n·lanes) N·s/m, or (0, 0) where springs have none, and settle_damping, the same for the time in which the
sheet settles; damping_stages: of `relax` in each step, or 1 for dashpots among the springs' own forces;
loss: (lanes,) 1/s, share of the velocity lost; strain_limit: of the first `limited` families, infinite for none.
"""
Settling = namedtuple("Settling", "time rate at_rest dt")
Settling.__doc__ = """How a sheet comes to rest in its grips. time: (2,) s, the least and the most; rate: 1/s, of its
artificial damping; at_rest: m/s, the speed that ends it; dt: (lanes,) s.
"""


Room = namedtuple(
    "Room",
    "f xd vd fd springs weights inverse_mass step kick keep dt dashpots extra inertia mobility axes roots stages half "
    "counts",
)
Room.__doc__ = """What a loop writes to beside its results, of entries, S families and `longest`, the longest stride.

f: (3, n·lanes) N; xd, vd, fd: x, v and f themselves, or room for them in double precision, which effects are shown;
springs: (S, 3, longest + n·lanes) N, of each at its first node; weights: (3, n·lanes) N;
inverse_mass 1/kg, step s, kick s and keep: (n·lanes,), see `kick_and_drift`; dt: (lanes,) s, at this time;
dashpots: (S, n·lanes) N·s/m, at this time; extra: (6, n) kg, see `apply_effects`; inertia: (8, n), from
`invert_inertia`; mobility: (n,) 1/kg, from `mobilities`;
axes, stages, half and roots: for `relax` and what stands around it, empty where damping takes one stage only;
counts: (3, lanes), the step at which the run proper began, −1 while a lane settles in its grips; the piece of the
grips' curves; how many frames are written.
"""


def _signature(real):
    """Types of `run_block`'s arguments; `real` is the precision of all that is touched for every node and step."""
    double, r2, d1, i1 = types.float64, real[:, ::1], types.float64[::1], types.int64[::1]
    springs = bundle_type(Springs, i1, r2, r2, r2, r2, types.int64, d1, double, types.int64)
    settling = bundle_type(Settling, d1, double, double, d1)
    return types.void(
        types.int64, bundle_type(Start, r2, r2, types.int64), springs, SHEET, *(EFFECT,) * SLOTS, TERMS_OF_MANY,
        GRIPS_OF_MANY, double[:, ::1], LAYERS,
        double, double, d1, settling, SAMPLING_OF_MANY, i1, i1,
    )  # fmt: skip


def _run_block(
    lanes, begins, springs, sheet,
    effect_0, effect_1, effect_2, effect_3, effect_4, effect_5, effect_6, effect_7,
    terms, grips, obstacles, layers, limit, start, dt, settling, sampling, status, steps,
):  # fmt: skip
    """Run `lanes` interleaved parameter sets from where they begin, settled first if they are to.

    Ends before the run proper where no frames are wanted, which takes a single lane: the others would move on.
    obstacles and layers: for `keep_out` and `keep_apart`, the latter with one lane only; limit: m, how far a
    sheet may get; start: s; dt: (lanes,) s; terms, grips, sampling: of that many members; status, steps: (lanes,).
    """
    strides, damping, stages = springs.strides, springs.damping, springs.damping_stages
    x, v = begins.x, begins.v
    entries, longest, settle_dt = x.shape[1], strides.max(), settling.dt
    f = np.empty((3, entries), x.dtype)
    effected = sheet.mass.shape[0] if terms.count > 0 else 0  # empty what nobody asks for
    staged, chained, padded = (entries, longest + entries, entries + 2 * longest) if stages > 1 else (0, 0, 0)
    settles = sheet.held.shape[0] > 0 and begins.settles == SETTLES
    room = Room(
        f, as_double(x), as_double(v), as_double(f),
        np.zeros((strides.shape[0], 3, longest + entries), x.dtype), np.empty((3, entries), x.dtype),
        np.empty(entries, x.dtype), np.empty(entries, x.dtype), np.empty(entries, x.dtype), np.empty(entries, x.dtype),
        settle_dt.copy() if settles else dt.copy(),
        springs.settle_damping.copy() if settles else damping,
        np.zeros((6, effected)), np.zeros((8, effected)), np.empty(effected, x.dtype),
        np.zeros((strides.shape[0], 3, chained), x.dtype), np.sqrt(damping),
        np.zeros((2, 3, padded), x.dtype), np.empty((3, staged), x.dtype),
        np.zeros((3, lanes), np.int64),
    )  # fmt: skip
    effects = (effect_0, effect_1, effect_2, effect_3, effect_4, effect_5, effect_6, effect_7)
    march(
        lanes, begins, springs, sheet, effects, terms, grips, obstacles, layers, limit, start, dt, settling, settles,
        sampling, status, steps, room, longest,
    )  # fmt: skip


@lean_kernel
def march(
    lanes, begins, springs, sheet, effects, terms, grips, obstacles, layers, limit, start, dt, settling, settles,
    sampling, status, steps, room, longest,
):  # fmt: skip
    """The loop of `run_block`, which makes room for it. longest: of the strides."""
    strides, rest, stiffness, damping = springs.strides, springs.rest, springs.stiffness, springs.damping
    loss, settle_dt, knots, curves = springs.loss, settling.dt, grips.knots, grips.curve
    mass, pins, normals, n_effects = sheet.mass, sheet.held, wants_normals(sheet), terms.count
    x, v, f, xd, vd, fd = begins.x, begins.v, room.f, room.xd, room.vd, room.fd
    g, weights, inverse_mass, step, kick, keep = (
        room.springs, room.weights, room.inverse_mass, room.step, room.kick, room.keep
    )  # fmt: skip
    dt_now, dashpots, axes, roots = room.dt, room.dashpots, room.axes, room.roots
    extra, inertia, mobility = room.extra, room.inertia, room.mobility
    began, segment, done = room.counts[0], room.counts[1], room.counts[2]
    entries, frames, held = x.shape[1], sampling.times.shape[1], pins.shape[0] > 0
    stages = springs.damping_stages
    centre, slope = chebyshev(stages)
    for e in range(entries):
        inverse_mass[e] = 1.0 / mass[e // lanes]
        step[e] = kick[e] = dt_now[e % lanes]
        keep[e] = 1.0 - loss[e % lanes] * dt_now[e % lanes]
        for c in range(3):
            f[c, e] = weights[c, e] = mass[e // lanes] * sheet.gravity[c]
    for lane in range(lanes):
        for k in range(pins.shape[0]):
            inverse_mass[pins[k] * lanes + lane] = 0.0
        if settles:
            began[lane] = -1
            for e in range(lane, entries, lanes):
                keep[e] = max(0.0, 1.0 - settling.rate * dt_now[lane])
    running, count = lanes, 0
    while running > 0:
        for lane in range(lanes):
            settled_for = count * settle_dt[lane]
            if began[lane] < 0 and count % CHECK_EVERY == 0 and settled_for > settling.time[0]:
                # The cheap question first: looking for the fastest node reads the whole sheet.
                began[lane] = (
                    count if settled_for > settling.time[1] or fastest(v, lane, lanes) < settling.at_rest else -1
                )
            if began[lane] == count and frames == 0:
                steps[lane] = count
                return
            if began[lane] == count:
                dt_now[lane] = dt[lane]
                begin(v, settles, keep, kick, step, dashpots, damping, lane, lanes, dt[lane], loss[lane])
                done[lane] = write_due(x, v, lane, lanes, start, 0, sampling, grips)
            elif 0 <= began[lane] == count - 1:
                for e in range(lane, entries, lanes):
                    kick[e] = dt[lane]
        for family in range(strides.shape[0]):
            if stages > 1:
                elastic_forces_and_axes(
                    x, strides[family], rest[family], stiffness[family], roots[family], g[family], axes[family], longest
                )
            elif damping.shape[0] > 0:
                spring_forces(
                    x, v, strides[family], rest[family], stiffness[family], dashpots[family], g[family], longest
                )
            else:
                elastic_forces(x, strides[family], rest[family], stiffness[family], g[family], longest)
            add_pairwise(f, g[family], longest, strides[family])
        heavier = False
        if n_effects > 0:
            t = start + max(0, count - began[0]) * dt[0] if began[0] >= 0 else start
            put_back(xd, x)
            put_back(vd, v)
            put_back(fd, f)
            show_grips(sheet, knots, curves[0], t, segment[0])
            if normals:
                sheet_normals(xd, strides[1] // lanes, sheet)
            heavier = apply_effects(
                effects, terms.stages, n_effects, t, dt_now[0], xd, vd, fd, extra, sheet,
                terms.parameters[0], terms.state[0],
            )  # fmt: skip
            if heavier:
                invert_inertia(mass, extra, inertia)
                bear_inverted(fd, inertia)
                mobilities(inverse_mass, extra, mobility)
            put_back(f, fd)
        free = mobility if heavier else inverse_mass
        if stages > 1:
            half_kick(v, f, inverse_mass, kick, room.half)
            relax(
                v, f, fd, strides, axes, inverse_mass, heavier, inertia, kick, stages, centre, slope, room.stages,
                longest,
            )  # fmt: skip
            half_kick_and_drift(x, v, f, room.half, weights, step)
        else:
            kick_and_drift(x, v, f, inverse_mass, weights, kick, step, keep)
        count += 1
        for lane in range(lanes):
            curve = curves[lane % curves.shape[0]]
            now = start + (count - began[lane]) * dt[lane] if began[lane] >= 0 else start
            if held:
                segment[lane] = advance_segment(knots, now, segment[lane])
                hold(x, v, pins, lane, lanes, knots, curve, now, segment[lane], dt_now[lane])
            if springs.strain_limit < np.inf:
                limit_strain(
                    x, v, springs.limited, strides, rest, stiffness, free, lane, lanes, springs.strain_limit,
                    dt_now[lane],
                )  # fmt: skip
            if layers.triangles.shape[0] > 0:
                keep_apart(x, v, dt_now[lane], free, layers)
            if obstacles.shape[0] > 0:
                carry(obstacles, knots, curve, start, now, dt_now[lane])
                keep_out(x, v, obstacles, inverse_mass, lane, lanes, extra, heavier)
            if steps[lane] > 0:
                continue
            if count % CHECK_EVERY == 0 and is_lost(x, lane, lanes, limit):
                status[lane] = DIVERGED
            elif began[lane] >= 0:
                done[lane] = write_due(x, v, lane, lanes, now, done[lane], sampling, grips)
            if status[lane] == DIVERGED or (began[lane] >= 0 and done[lane] == frames):
                steps[lane] = count
                running -= 1


@functools.cache
def run_block(precision):
    """The compiled loop in "double" or "single" precision; compiling takes seconds once, then it lies on disk."""
    return kernel(_run_block, signature=_signature(types.float64 if precision == "double" else types.float32))
