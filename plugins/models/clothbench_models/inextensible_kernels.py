"""Compiled loop of `inextensible`: implicit steps of the free sheet, then fast projection onto the constraints."""

from __future__ import annotations

import functools

import numpy as np
from numba import types

from clothbench.modelling import (
    CLOCK,
    DIVERGED,
    EFFECT,
    GOES_ON,
    GRIPS,
    LAYERS,
    SAMPLING,
    SHEET,
    SLOTS,
    START,
    TERMS,
    advance_segment,
    bear_inertia,
    carry,
    hold_grips,
    invert_inertia,
    is_lost,
    kernel,
    write_frames,
)
from clothbench_models.baraff_witkin_kernels import PLATE, add_outer
from clothbench_models.implicit_grid import assemble, empty_matrix, margin_of, mass_times, put, solve
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
from clothbench_models.inextensible_constraints import CONSTRAINTS, pull, sines, tighten, violations
from clothbench_models.resting_contact import STICKS, drop_rub, judge, overcome, stop_reversed, touching
from clothbench_models.sheet_forces import TRIANGLES, add_diagonals, add_fluxes, edge_differences

__all__ = ["BDF2", "EULER", "march"]


def _march(
    scheme, begins, nu, sheet, constraints, plate, alpha,
    effect_0, effect_1, effect_2, effect_3, effect_4, effect_5, effect_6, effect_7,
    terms, grips, obstacles, layers, clock, sampling, result,
):  # fmt: skip
    """Run the sheet step by step from where it begins, settled if it was to; fills `sampling.out` (T, N, 3) m.

    M (v' − v̄)/γ = F − θ K x' − (α A + β K) v' − ∂Cᵀλ, x' = x̄ + γ v', C(x') = 0, with γ, x̄ and v̄ as in
    `implicit_step` (Euler, or BDF2); θ and β are the plate's rigidity and damping. First a linear solve without the
    constraints, then `tighten`, which weighs nodes by their masses alone (Goldenthal et al. 2007): an error of the
    order of the step squared, like the others. clock.tolerance: strain that `tighten` leaves.
    """
    effects = (effect_0, effect_1, effect_2, effect_3, effect_4, effect_5, effect_6, effect_7)
    pins, mass, area = sheet.held, sheet.mass, sheet.area
    lengths, share, give = constraints.lengths, constraints.share, constraints.give
    offsets, bending, bend, beta, stiffer = plate.offsets, plate.values, plate.rigidity, plate.damping, plate.stiffer
    start, dt, tolerance, limit = clock.start, clock.dt, clock.tolerance, clock.limit
    n, padded, frames, pad = mass.shape[0], mass.shape[0] + 2 * (nu + 1), sampling.times.shape[0], nu + 1
    edges, shear, work = np.zeros((10, padded)), np.zeros((TRIANGLES, padded)), np.zeros((20, padded))
    waves_u, waves_v = sines(nu - 1), sines(n // nu - 1)
    damped, plane = np.empty((n // nu - 1, nu - 1)), np.empty((2, n // nu - 1, nu - 1))
    rows, tension = np.zeros((8, 3, padded)), np.zeros((3, padded))
    f, r, delta, inverse = np.empty((3, n)), np.empty((3, n)), np.empty((3, n)), np.ones((6, n))
    z, p, q = np.empty((3, n)), np.empty((3, n)), np.empty((3, n))
    matrix, swept = empty_matrix(nu, n, TRIANGLES), np.empty((3, n + 2 * margin_of(nu)))
    extra, inertia, normal, free = np.zeros((6, n)), np.zeros((8, n)), np.zeros((3, n)), 1.0 / mass
    x, v, guess, x_bar, v_bar = begins.x, begins.v, np.zeros((3, n)), np.empty((3, n)), np.zeros((3, n))
    wanted, outer, slack = np.empty((3, n)), np.empty((3, n)), np.empty((3, padded))
    x_old, v_old, x_before, v_before = np.empty((3, n)), np.zeros((3, n)), np.empty((3, n)), np.zeros((3, n))
    touch, friction, rub, on = np.zeros(n, np.int64), np.zeros(n), np.zeros((3, n)), np.full(n, -1)
    stiff_mass, lightness, mobility = np.empty(n), np.zeros(padded), np.empty(n)
    solid, loose = obstacles.shape[0] > 0, is_loose(mass, pins)
    for e in range(n):
        lightness[pad + e] = 1.0 / mass[e]
    for g in range(pins.shape[0]):
        touch[pins[g]] = STICKS
        free[pins[g]] = 0.0
        lightness[pad + pins[g]] = 0.0
    count, done, segment, rounds, t = 0, 0, 0, 0, start
    if pins.shape[0] > 0 and begins.settles != GOES_ON:
        # Settled by forces that stretched it a little: that is what the constraints pull with.
        edge_differences(x, nu, work[0:3], work[3:6])
        violations(nu, work[0:3], work[3:6], lengths, share, rows[0])
        for k in range(3):
            for e in range(padded):
                tension[k, e] = rows[0, k, e] / give[k, e] if share[k, e] > 0.0 else 0.0
        put(x_old, x)
    else:  # a start that fits, and the step before it
        used = tighten(
            x, 1.0, tension, nu, lengths, share, give, mass, inertia, False, touch, normal, lightness, tolerance,
            rows, work, r, waves_u, waves_v, damped, plane,
        )  # fmt: skip
        if used < 0:
            result[0] = DIVERGED
            return
        rounds += used
        tension[:] = 0.0
        touching(x, v, 0.0, obstacles, free, touch, normal, friction, on)
        f[:] = 0.0
        heavier = add_outer(start, dt, x, v, f, nu, NO_AIR, sheet, effects, terms, terms.state, extra, grips, segment)
        if solid and loose:
            set_off(f, v, obstacles, on, free, touch, normal, friction, rub, z, q)
        if heavier:
            bear_inertia(f, mass, extra)
        step_before(x, v, dt, f, mass, loose, x_old, v_old)
    done = write_frames(x, v, x, v, start, start, done, sampling, grips)
    while done < frames:
        t = start + (count + 1) * dt
        gamma = extrapolate(scheme, dt, x, v, x_old, v_old, stiffer, x_bar, v_bar, guess)
        segment = advance_segment(grips.knots, t, segment)
        follow_grips(guess, x_bar, gamma, pins, grips, t, segment)
        if solid:
            carry(obstacles, grips.knots, grips.curve, start, t, dt)
            rest_on(guess, x, v, x_bar, gamma, dt, obstacles, free, touch, normal, friction, on, z, q)
        moved_on(x_bar, gamma, guess, q)
        see_ahead(scheme, guess, v, v_old, touch, z)
        f[:] = 0.0
        heavier = add_outer(t, dt, q, z, f, nu, NO_AIR, sheet, effects, terms, terms.state, extra, grips, segment)
        add_diagonals(offsets, bending, q, -bend, f)
        if beta != 0.0:
            add_diagonals(offsets, bending, guess, -beta, f)
        for c in range(3):
            for e in range(n):
                f[c, e] -= alpha * area[e] * guess[c, e]
        if solid:
            drop_rub(touch, normal, rub)
            f += rub
        edge_differences(q, nu, work[0:3], work[3:6])
        pull(nu, work[0:3], work[3:6], share, tension, work[6:9], work[9:12])
        put(p, f)
        add_fluxes(work[6:9], work[9:12], nu, p, 1.0)
        for e in range(padded):
            edges[4, e] = gamma * gamma * max(tension[0, e], 0.0) * share[0, e]
            edges[9, e] = gamma * gamma * max(tension[1, e], 0.0) * share[1, e]
        for c in range(3):
            for e in range(n):
                z[c, e] = guess[c, e] - v_bar[c, e]
        if heavier:
            invert_inertia(mass, extra, inertia)
        mass_times(mass, extra, heavier, z, r)
        for c in range(3):
            for e in range(n):
                r[c, e] = gamma * p[c, e] - r[c, e]
        for e in range(n):
            stiff_mass[e] = mass[e] + gamma * alpha * area[e]
        bend_scale = gamma * gamma * (bend + stiffer[1]) + gamma * beta
        assemble(nu, stiff_mass, extra, heavier, edges, shear, offsets, bending, bend_scale, matrix, work[14:20])
        put(x_before, x)
        put(v_before, v)
        if solid:
            put(wanted, r)
            put(outer, f)
            for k in range(3):
                for e in range(padded):
                    slack[k, e] = tension[k, e]
        for again in range(AGAIN, -1, -1):
            rounds += solve(
                delta, r, nu, matrix, offsets, bending, bend_scale, touch, normal, 1e-4, 2000, inverse, z, swept, q
            )  # fmt: skip
            for c in range(3):
                for e in range(n):
                    x[c, e] = x_bar[c, e] + gamma * (guess[c, e] + delta[c, e])
            hold_grips(x, pins, grips, t, segment)
            used = tighten(
                x, gamma, tension, nu, lengths, share, give, mass, inertia, heavier, touch, normal, lightness,
                tolerance, rows, work, r, waves_u, waves_v, damped, plane,
            )  # fmt: skip
            if used < 0:
                result[0], result[1], result[2] = DIVERGED, count, rounds
                return
            rounds += used
            for c in range(3):
                for e in range(n):
                    v[c, e] = (x[c, e] - x_bar[c, e]) / gamma
            if not solid:
                break
            # What the obstacles did: the momentum that nothing else accounts for.
            for c in range(3):
                for e in range(n):
                    z[c, e] = v[c, e] - v_bar[c, e]
            mass_times(mass, extra, heavier, z, q)
            edge_differences(x, nu, work[0:3], work[3:6])
            pull(nu, work[0:3], work[3:6], share, tension, work[6:9], work[9:12])
            put(f, outer)
            add_fluxes(work[6:9], work[9:12], nu, f, 1.0)
            for c in range(3):
                for e in range(n):
                    q[c, e] = q[c, e] / gamma - f[c, e]
                    z[c, e] = gamma * (v[c, e] - guess[c, e])
            add_diagonals(offsets, bending, z, bend, q)
            slip(scheme, v, obstacles, on, p)
            if again == 0 or not overcome(q, p, mass, sheet.gravity, free, touch, normal, friction, rub, z):
                break
            for c in range(3):
                for e in range(n):
                    outer[c, e] += z[c, e]
                    wanted[c, e] += gamma * z[c, e]
            put(r, wanted)
            for k in range(3):
                for e in range(padded):
                    tension[k, e] = slack[k, e]
        if solid:
            stop_reversed(p, touch, rub)
            judge(q, p, free, touch, normal, friction, rub)
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


NO_AIR = np.zeros(3)
AGAIN = 8  # times a step is made again, at most, where friction did too much (`overcome`)
_SIGNATURE = types.void(
    types.int64, START, types.int64, SHEET, CONSTRAINTS, PLATE, types.float64,
    *(EFFECT,) * SLOTS, TERMS, GRIPS, types.float64[:, ::1], LAYERS, CLOCK, SAMPLING, types.int64[::1],
)  # fmt: skip


@functools.cache
def march():
    """The compiled loop; compiling takes seconds once, then it lies on disk."""
    return kernel(_march, signature=_SIGNATURE)
