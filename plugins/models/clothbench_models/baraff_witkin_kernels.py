"""Compiled time loops of `baraff_witkin`: linearly implicit steps (Euler, BDF2) and adaptive Runge–Kutta."""

from __future__ import annotations

import functools
from collections import namedtuple

import numpy as np
from numba import types

from clothbench.modelling import (
    CLOCK,
    DIVERGED,
    EFFECT,
    GRIPS,
    LAYERS,
    OK,
    RESTLESS,
    RESTS,
    SAMPLING,
    SETTLES,
    SHEET,
    SLOTS,
    START,
    TERMS,
    advance_segment,
    apply_effects,
    bear_inertia,
    bundle_type,
    carry,
    grip_speed,
    hold_grips,
    is_lost,
    keep_out,
    kernel,
    lean_kernel,
    mobilities,
    sheet_normals,
    show_grips,
    wants_normals,
    write_frames,
)
from clothbench_models.implicit_grid import assemble, empty_matrix, margin_of, mass_times, multiply, put, solve
from clothbench_models.implicit_step import (
    BDF2,
    EULER,
    end_step,
    extrapolate,
    follow_grips,
    is_loose,
    moved_on,
    rest_on,
    see_ahead,
    set_off,
    slip,
    step_before,
)
from clothbench_models.resting_contact import STICKS, drop_rub, judge, part_layers, stop_reversed, touching
from clothbench_models.sheet_forces import (
    CELLS,
    add_diagonals,
    add_fluxes,
    cell_shear_fluxes,
    edge_differences,
    shear_fluxes,
    stretch_fluxes,
)

__all__ = ["BDF2", "EULER", "PLATE", "RK45", "Membrane", "Plate", "add_outer", "march"]

RK45 = 2  # beside EULER and BDF2

Membrane = namedtuple("Membrane", "lengths over stiffness dampings")
Membrane.__doc__ = """A grid's springs in the plane, padded (`baraff_witkin.triangle_edges`).

lengths: (2, P) m, at rest, of u- and v-edges; over: (2, P) 1/m, 1/h of the cells; stiffness, dampings: (3, P), of
u-edges N/m, v-edges N/m and shear N·m (·s).
"""
Plate = namedtuple("Plate", "offsets values rigidity damping stiffer")
Plate.__doc__ = """Bending: offsets (D,) and values (D, n) of its matrix's diagonals for a rigidity of 1; rigidity: N·m;
damping: N·m·s; stiffer: (2,), what effects add at most: to the stretch stiffness, as a share of it, and to the
rigidity [N·m].
"""
MEMBRANE = bundle_type(Membrane, *[types.float64[:, ::1]] * 4)
PLATE = bundle_type(Plate, types.int64[::1], types.float64[:, ::1], types.float64, types.float64, types.float64[::1])
SETTLE_ROUNDS = 2000
ROUGH = 1e-2  # what settling leaves of a step's residual: the next step mends it, so that finer solves only cost time
FINE = 1e-3  # what it leaves near the end: a rough solve does not see that all of a stiff sheet still has to move
NEARLY = 2e-6  # m that a node still moves in a rough step, from which on they are fine
NEAR = 1e-3  # of the sheet's size, that a node still moves in a full step, from which on the valley is certain
STRAIGHT = 0.9  # cosine between two steps, above which the next may be longer
AT_REST = 2e-8  # m that a node still moves in a settling step as long as a second
VISIBLE = 1e-4  # m of it, above which what the last round left is no rest


@lean_kernel
def elastic(x, v, f, nu, membrane, plate, stiffer, k_scale, c_scale, edges, shear, work):
    """Add all inner forces to f (3, n) N and keep the matrix k_scale·K + c_scale·C for `assemble`.

    stiffer: what effects add to the stretch stiffness, as a share of it (their forces are taken as they are; the matrix
    knows them by this bound, so that they need no shorter step).
    """
    lengths, over, stiffness, dampings = membrane.lengths, membrane.over, membrane.stiffness, membrane.dampings
    du, dv, fu, fv, ru, rv = work[0:3], work[3:6], work[6:9], work[9:12], work[14:17], work[17:20]
    edge_differences(x, nu, du, dv)
    edge_differences(v, nu, ru, rv)
    stretch_fluxes(du, ru, lengths[0], stiffness[0], dampings[0], fu, edges[0:3], edges[3], edges[4], k_scale, c_scale)
    stretch_fluxes(dv, rv, lengths[1], stiffness[1], dampings[1], fv, edges[5:8], edges[8], edges[9], k_scale, c_scale)
    last = shear.shape[0] - 1
    if last + 1 == CELLS:
        cell_shear_fluxes(
            nu, du, dv, ru, rv, over[0], over[1], stiffness[2], dampings[2], fu, fv, shear[0:3], shear[3:6]
        )
    else:
        shear_fluxes(
            nu, du, dv, ru, rv, over[0], over[1], stiffness[2], dampings[2], fu, fv,
            shear[0:3], shear[3:6], shear[6:9], shear[9:12],
        )  # fmt: skip
    for e in range(shear.shape[1]):
        shear[last, e] = k_scale * stiffness[2, e] + c_scale * dampings[2, e]
    if stiffer > 0.0:
        for e in range(shear.shape[1]):
            edges[3, e] += k_scale * stiffer * stiffness[0, e]
            edges[8, e] += k_scale * stiffer * stiffness[1, e]
    add_fluxes(fu, fv, nu, f, 1.0)
    add_diagonals(plate.offsets, plate.values, x, -plate.rigidity, f)
    if plate.damping != 0.0:
        add_diagonals(plate.offsets, plate.values, v, -plate.damping, f)


@lean_kernel
def add_air(v, f, normal, area, quadratic, tangential, falloff):
    """f −= a (k_N |v_N|²/(1 + k_f |v_N|²) v_N/|v_N| + k_T v_T) (Bhat et al. 2003, section 3), of nodes."""
    for i in range(v.shape[1]):
        nx, ny, nz = normal[0, i], normal[1, i], normal[2, i]
        along = v[0, i] * nx + v[1, i] * ny + v[2, i] * nz
        push = area[i] * quadratic * abs(along) * along / (1.0 + falloff * along * along)
        rub = area[i] * tangential
        f[0, i] -= push * nx + rub * (v[0, i] - along * nx)
        f[1, i] -= push * ny + rub * (v[1, i] - along * ny)
        f[2, i] -= push * nz + rub * (v[2, i] - along * nz)


@lean_kernel
def add_outer(t, dt, x, v, f, nu, air, sheet, effects, terms, state, extra, grips, segment):
    """Weight, air and effects, whose memory is `state`; returns whether effects have added mass to `extra`."""
    for c in range(3):
        g = sheet.gravity[c]
        for e in range(f.shape[1]):
            f[c, e] += sheet.mass[e] * g
    windy = air[0] != 0.0 or air[1] != 0.0
    if windy or (terms.count > 0 and wants_normals(sheet)):
        sheet_normals(x, nu, sheet)
    if windy:
        add_air(v, f, sheet.normal, sheet.area, air[0], air[1], air[2])
    if terms.count == 0:
        return False
    show_grips(sheet, grips.knots, grips.curve, t, segment)
    return apply_effects(effects, terms.stages, terms.count, t, dt, x, v, f, extra, sheet, terms.parameters, state)


@lean_kernel
def largest(delta):
    """Largest length of a column of delta (3, n)."""
    top = 0.0
    for e in range(delta.shape[1]):
        top = max(top, delta[0, e] ** 2 + delta[1, e] ** 2 + delta[2, e] ** 2)
    return np.sqrt(top)


@lean_kernel
def direction(a, b):
    """The cosine between two steps of all nodes, a and b (3, n); 1 where either is none."""
    onwards, one, other = 0.0, 0.0, 0.0
    for c in range(3):
        for e in range(a.shape[1]):
            onwards += a[c, e] * b[c, e]
            one += a[c, e] ** 2
            other += b[c, e] ** 2
    return onwards / np.sqrt(one * other) if one > 0.0 and other > 0.0 else 1.0


def _march_implicit(
    scheme, shear_rows, begins, nu, sheet, membrane, plate, air,
    effect_0, effect_1, effect_2, effect_3, effect_4, effect_5, effect_6, effect_7,
    terms, grips, obstacles, layers, clock, size, sampling, result,
):  # fmt: skip
    """Run the sheet step by step from where it begins, settled first if it is to; fills `sampling.out` (T, N, 3) m.

    The steps are those of `implicit_step`. Settling is the same step with v̄ = 0 and steps growing to a second, which is
    Newton's method for rest; a sheet that does not come to it in time is RESTLESS. clock.tolerance: what the linear
    solver leaves of a step's residual; size: m, of the cloth; shear_rows: TRIANGLES or CELLS; result: (3,) status, time
    steps, rounds of the linear solver.
    """
    effects = (effect_0, effect_1, effect_2, effect_3, effect_4, effect_5, effect_6, effect_7)
    pins, mass, bend, stiffer = sheet.held, sheet.mass, plate.rigidity, plate.stiffer
    start, dt, tolerance, limit = clock.start, clock.dt, clock.tolerance, clock.limit
    n, padded, frames = mass.shape[0], mass.shape[0] + 2 * (nu + 1), sampling.times.shape[0]
    edges, shear, work = np.zeros((10, padded)), np.zeros((shear_rows, padded)), np.zeros((20, padded))
    margin, matrix = margin_of(nu), empty_matrix(nu, n, shear_rows)
    f, r, delta, inverse = np.empty((3, n)), np.empty((3, n)), np.empty((3, n)), np.ones((6, n))
    z, p, q = np.empty((3, n)), np.zeros((3, n + 2 * margin)), np.empty((3, n))
    extra, normal, free = np.zeros((6, n)), np.zeros((3, n)), 1.0 / mass
    x, v, guess, x_bar, v_bar = begins.x, begins.v, np.zeros((3, n)), np.empty((3, n)), np.zeros((3, n))
    x_old, v_old, x_before, v_before = np.empty((3, n)), np.zeros((3, n)), np.empty((3, n)), np.zeros((3, n))
    touch, friction, rub, on = np.zeros(n, np.int64), np.zeros(n), np.zeros((3, n)), np.full(n, -1)
    solid, loose = obstacles.shape[0] > 0, is_loose(mass, pins)
    wanted, mobility = np.empty((3, n if solid else 0)), np.empty(n)
    for g in range(pins.shape[0]):
        touch[pins[g]] = STICKS
        free[pins[g]] = 0.0
    settling, count, done, segment = pins.shape[0] > 0 and begins.settles == SETTLES, 0, 0, 0
    rounds, h, t, relax, moved_before, fine = 0, 0.01, start, 1.0, np.inf, False
    if not settling:
        if begins.settles == RESTS:
            put(x_old, x)
        else:
            touching(x, v, 0.0, obstacles, free, touch, normal, friction, on)
            f[:] = 0.0
            heavier = add_outer(start, dt, x, v, f, nu, air, sheet, effects, terms, terms.state, extra, grips, segment)
            if solid and loose:
                set_off(f, v, obstacles, on, free, touch, normal, friction, rub, z, q)
            if heavier:
                bear_inertia(f, mass, extra)
            step_before(x, v, dt, f, mass, loose, x_old, v_old)
        done = write_frames(x, v, x, v, start, start, done, sampling, grips)
    while settling or done < frames:
        if settling:
            gamma = h
            put(x_bar, x)
            guess[:] = 0.0
        else:
            t = start + (count + 1) * dt
            gamma = extrapolate(scheme, dt, x, v, x_old, v_old, stiffer, x_bar, v_bar, guess)
        segment = advance_segment(grips.knots, t, segment)
        follow_grips(guess, x_bar, gamma, pins, grips, t, segment)
        if solid:
            carry(obstacles, grips.knots, grips.curve, start, t, dt)
            rest_on(guess, x, v, x_bar, gamma, dt, obstacles, free, touch, normal, friction, on, z, q)
        moved_on(x_bar, gamma, guess, q)
        see_ahead(EULER if settling else scheme, guess, v, v_old, touch, z)
        f[:] = 0.0
        step = dt if not settling else min(h, dt)
        heavier = add_outer(t, step, q, z, f, nu, air, sheet, effects, terms, terms.state, extra, grips, segment)
        elastic(q, guess, f, nu, membrane, plate, stiffer[0], gamma * gamma, gamma, edges, shear, work)
        for c in range(3):
            for e in range(n):
                z[c, e] = guess[c, e] - v_bar[c, e]
        mass_times(mass, extra, heavier, z, r)
        for c in range(3):
            for e in range(n):
                r[c, e] = gamma * f[c, e] - r[c, e]
        if solid:
            drop_rub(touch, normal, rub)
            for c in range(3):
                for e in range(n):
                    r[c, e] += gamma * rub[c, e]
            put(wanted, r)
        bend_scale = gamma * gamma * (bend + stiffer[1]) + gamma * plate.damping
        assemble(
            nu, mass, extra, heavier, edges, shear, plate.offsets, plate.values, bend_scale, matrix, work[14:20]
        )  # fmt: skip
        rounds += solve(
            delta, r, nu, matrix, plate.offsets, plate.values, bend_scale, touch, normal,
            (FINE if fine else ROUGH) if settling else tolerance, 2000, inverse, z, p, q,
        )  # fmt: skip
        if solid:
            put(p[:, margin : margin + n], delta)
            multiply(matrix, nu, plate.offsets, plate.values, bend_scale, p, z)
            for c in range(3):
                for e in range(n):
                    z[c, e] = (z[c, e] - wanted[c, e]) / gamma
                    r[c, e] = guess[c, e] + delta[c, e]
            slip(scheme, r, obstacles, on, q)
            stop_reversed(q, touch, rub)
            judge(z, q, free, touch, normal, friction, rub)
        if settling:
            moved = gamma * largest(delta)
            rests, fine = fine and h >= 1.0 and moved < AT_REST, fine or (h >= 1.0 and moved < NEARLY)
            shrink = min(1.0, 0.1 * size / max(moved, 1e-300))
            # Where the matrix leaves out what compression softens, full steps may go to and fro for ever, or leap into
            # another valley of wrinkles. So steps stay short until it is clear in which one the sheet ends; there they
            # grow as long as the way is straight.
            far = moved > NEAR * size
            shorten = moved > 0.8 * moved_before if far else direction(delta, v_old) < STRAIGHT
            relax = max(0.1, 0.7 * relax) if shorten else min(1.0, 1.2 * relax)
            moved_before = moved
            put(v_old, delta)  # nothing moves yet: there is room for the step before
            for c in range(3):
                for e in range(n):
                    x[c, e] = x_bar[c, e] + gamma * (guess[c, e] + relax * shrink * delta[c, e])
            if solid:
                keep_out(x, v, obstacles, free, 0, 1)
            v[:] = 0.0
            count += 1
            if layers.size[0] > 0.0:
                part_layers(x, v, x_bar, h, free, layers, z, q)
                v[:] = 0.0
            if is_lost(x, 0, 1, limit):
                result[0], result[1], result[2] = DIVERGED, count, rounds
                return
            if rests or count == SETTLE_ROUNDS:
                result[0] = RESTLESS if moved > VISIBLE else OK
                settling, count = False, 0
                put(x_old, x)
                v_old[:] = 0.0
                v_bar[:] = 0.0
                done = write_frames(x, v, x, v, start, start, 0, sampling, grips)
            h = min(1.0, h * (1.3 if shrink == 1.0 else 0.7))
            continue
        for c in range(3):
            for e in range(n):
                x_before[c, e], v_before[c, e] = x[c, e], v[c, e]
                w = guess[c, e] + delta[c, e]
                v[c, e] = w
                x[c, e] = x_bar[c, e] + gamma * w
        hold_grips(x, pins, grips, t, segment)
        end_step(
            x, v, x_before, v_before, x_old, v_old, dt, obstacles, free, extra, heavier, layers, x_bar, v_bar, z, q,
            mobility,
        )  # fmt: skip
        count += 1
        if is_lost(x, 0, 1, limit):
            result[0], result[1], result[2] = DIVERGED, count, rounds
            return
        done = write_frames(x_before, v_before, x, v, t - dt, t, done, sampling, grips)
    result[1], result[2] = count, rounds


# Dormand and Prince 1980: nodes, weights, and fifth minus fourth order.
_C = np.array([0.0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0, 1.0])
_A = np.array(
    [
        [0, 0, 0, 0, 0, 0],
        [1 / 5, 0, 0, 0, 0, 0],
        [3 / 40, 9 / 40, 0, 0, 0, 0],
        [44 / 45, -56 / 15, 32 / 9, 0, 0, 0],
        [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729, 0, 0],
        [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656, 0],
        [35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84],
    ]
)
_E = np.array([71 / 57600, 0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40])
SLOWEST = 1e-9  # s; a step that has to be shorter than this will never end
RHYTHM = 100.0  # 1/s, weighs errors of velocity against errors of position: those of a motion of some 15 Hz


def _march_adaptive(
    scheme, shear_rows, begins, nu, sheet, membrane, plate, air,
    effect_0, effect_1, effect_2, effect_3, effect_4, effect_5, effect_6, effect_7,
    terms, grips, obstacles, layers, clock, size, sampling, result,
):  # fmt: skip
    """Run the sheet, which has settled, with Dormand and Prince's embedded pair; arguments as `_march_implicit`.

    clock.tolerance: m, the largest error of a node in one step; clock.dt: s, the longest step. Effects with a memory
    see a copy of it in trial stages and go on for good once per accepted step. The first stage after a contact, at the
    time of the last, sees what they remembered before that: asked twice at one time, a memory takes it for settling.
    """
    effects = (effect_0, effect_1, effect_2, effect_3, effect_4, effect_5, effect_6, effect_7)
    pins, mass = sheet.held, sheet.mass
    start, dt, tolerance, limit = clock.start, clock.dt, clock.tolerance, clock.limit
    n, padded, frames = mass.shape[0], mass.shape[0] + 2 * (nu + 1), sampling.times.shape[0]
    edges, shear, work = np.zeros((10, padded)), np.zeros((shear_rows, padded)), np.zeros((20, padded))
    speed, push = np.zeros((7, 3, n)), np.zeros((7, 3, n))  # dx/dt and dv/dt of the stages
    f, extra, free = np.empty((3, n)), np.zeros((6, n)), 1.0 / mass
    x, v, xs, vs = begins.x, begins.v, np.empty((3, n)), np.empty((3, n))
    memory, remembered = terms.state.copy(), terms.state.copy()
    before, speed_before, mobility = np.empty((3, n)), np.empty((3, n)), np.empty(n)
    for g in range(pins.shape[0]):
        free[pins[g]] = 0.0
    t, h, count, tries, segment, fresh = start, min(dt, 1e-5), 0, 0, 0, True
    done = write_frames(x, v, x, v, start, start, 0, sampling, grips)
    while done < frames:
        for stage in range(0 if fresh else 1, 7):
            at = t + _C[stage] * h
            for c in range(3):
                for e in range(n):
                    a, b = 0.0, 0.0
                    for k in range(stage):
                        a += _A[stage, k] * speed[k, c, e]
                        b += _A[stage, k] * push[k, c, e]
                    xs[c, e], vs[c, e] = x[c, e] + h * a, v[c, e] + h * b
            segment = advance_segment(grips.knots, at, 0)
            hold_grips(xs, pins, grips, at, segment)
            for g in range(pins.shape[0]):
                for c in range(3):
                    vs[c, pins[g]] = grip_speed(grips.knots, grips.curve, at, segment, g, c)
            f[:] = 0.0
            for k in range(memory.shape[0]):
                memory[k] = remembered[k] if stage == 0 else terms.state[k]
            heavier = add_outer(at, h, xs, vs, f, nu, air, sheet, effects, terms, memory, extra, grips, segment)
            elastic(xs, vs, f, nu, membrane, plate, 0.0, 0.0, 0.0, edges, shear, work)
            if heavier:
                bear_inertia(f, mass, extra)
            for c in range(3):
                for e in range(n):
                    speed[stage, c, e] = vs[c, e]
                    push[stage, c, e] = free[e] * f[c, e]
        fresh = False
        worst = 0.0
        for c in range(3):
            for e in range(n):
                a, b = 0.0, 0.0
                for k in range(7):
                    a += _E[k] * speed[k, c, e]
                    b += _E[k] * push[k, c, e]
                if free[e] > 0.0:
                    worst = max(worst, abs(h * a), abs(h * b) / RHYTHM)
        tries += 1
        worst /= tolerance
        if worst <= 1.0:  # the last stage is the new state, and the first stage of the next step
            put(before, x)
            put(speed_before, v)
            put(x, xs)
            put(v, vs)
            count += 1
            put(speed[0], speed[6])
            put(push[0], push[6])
            if obstacles.shape[0] > 0:
                carry(obstacles, grips.knots, grips.curve, start, t + h, h)
                keep_out(x, v, obstacles, free, 0, 1, extra, heavier)
                fresh = True
            if layers.size[0] > 0.0:
                if heavier:
                    mobilities(free, extra, mobility)
                part_layers(x, v, before, h, mobility if heavier else free, layers, f, vs)
                fresh = True
            if terms.count > 0:
                f[:] = 0.0
                for k in range(memory.shape[0]):
                    remembered[k] = terms.state[k]
                add_outer(t + h, h, x, v, f, nu, air, sheet, effects, terms, terms.state, extra, grips, segment)
            done = write_frames(before, speed_before, x, v, t, t + h, done, sampling, grips)
            t += h
        h = min(dt, h * min(4.0, max(0.2, 0.9 * max(worst, 1e-8) ** -0.2)))
        if is_lost(x, 0, 1, limit) or not h > SLOWEST or tries > 20_000_000:
            result[0], result[1] = DIVERGED, tries
            return
    result[1] = tries


_d2, _i1, _real, _whole = types.float64[:, ::1], types.int64[::1], types.float64, types.int64
_SIGNATURE = types.void(
    _whole, _whole, START, _whole, SHEET, MEMBRANE, PLATE, types.float64[::1],
    *(EFFECT,) * SLOTS, TERMS, GRIPS, _d2, LAYERS, CLOCK, _real, SAMPLING, _i1,
)  # fmt: skip


@functools.cache
def march(scheme):
    """The compiled loop of a scheme; compiling takes seconds once, then it lies on disk."""
    return kernel(_march_adaptive if scheme == RK45 else _march_implicit, signature=_SIGNATURE)
