"""The compiled time loop of `xpbd`: predict, pull the springs straight, put the grips where they are."""

from __future__ import annotations

import functools
from collections import namedtuple

import numpy as np
from clothbench.modelling import (
    CLOCK,
    DIVERGED,
    EFFECT,
    GRIPS,
    OK,
    SAMPLING,
    SHEET,
    SLOTS,
    TERMS,
    add_effects,
    advance_segment,
    bear_inertia,
    bundle_type,
    fastest,
    hold_grips,
    is_lost,
    kernel,
    write_frames,
)
from numba import types

SETTLING = 20.0  # 1/s, damping while the sheet comes to rest
SETTLE = (1.5, 20.0)  # s, least and most that the sheet is given to come to rest
AT_REST = 1e-6  # m/s; slower than this a settling sheet is taken to hang still

Springs = namedtuple("Springs", "pairs rest compliance tau")
Springs.__doc__ = "pairs: (C, 2), node numbers; rest: (C,) m; compliance: (C,) m/N, 1/k; tau: s, relaxation time."
_D, _I = types.float64, types.int64
SPRINGS = bundle_type(Springs, _I[:, ::1], _D[::1], _D[::1], _D)


@kernel
def project(x, before, inverse_mass, springs, dt):
    """One Gauss–Seidel sweep over the springs C = |d| − L, damped (Macklin et al. 2016, equation 26):

    Δλ = (−C − γ ∇C·(x − x₀)) / ((1 + γ) Σ 1/m + α/dt²), γ = τ/dt; Δx = ±Δλ n/m, α the compliance.
    """
    pairs, gamma = springs.pairs, springs.tau / dt
    for s in range(pairs.shape[0]):
        a, b = pairs[s, 0], pairs[s, 1]
        dx, dy, dz = x[0, b] - x[0, a], x[1, b] - x[1, a], x[2, b] - x[2, a]
        length = np.sqrt(dx * dx + dy * dy + dz * dz) + 1e-30
        nx, ny, nz = dx / length, dy / length, dz / length
        moved = nx * (dx - before[0, b] + before[0, a]) + ny * (dy - before[1, b] + before[1, a])
        moved += nz * (dz - before[2, b] + before[2, a])
        weight = (1.0 + gamma) * (inverse_mass[a] + inverse_mass[b]) + springs.compliance[s] / dt**2
        push = (springs.rest[s] - length - gamma * moved) / weight
        for c, n in enumerate((nx, ny, nz)):
            x[c, a] -= inverse_mass[a] * push * n
            x[c, b] += inverse_mass[b] * push * n


def _march(
    x, sheet, nu, springs, effect_0, effect_1, effect_2, effect_3, effect_4, effect_5, effect_6, effect_7,
    terms, grips, clock, sampling,
):  # fmt: skip
    """Settle shape x (3, n) m in the grips' first pose, then run to the last frame; returns status and steps.

    A sheet that has blown up leaves the rest of its frames NaN.
    """
    effects = (effect_0, effect_1, effect_2, effect_3, effect_4, effect_5, effect_6, effect_7)
    mass, pins, dt = sheet.mass, sheet.held, clock.dt
    inverse_mass, extra, v = 1.0 / mass, np.empty((6, mass.shape[0])), np.zeros(x.shape)
    inverse_mass[pins] = 0.0  # nothing moves the held nodes but their grips
    f, before, slower, total = np.empty(x.shape), np.empty(x.shape), np.empty(x.shape), np.empty(x.shape)
    settling, done, count, began, segment = pins.shape[0] > 0, 0, 0, 0, 0
    while done < sampling.times.shape[0]:
        t = clock.start if settling else clock.start + (count - began) * dt
        for c in range(3):
            f[c] = mass * sheet.gravity[c]
        heavier = add_effects(t, dt, x, v, f, nu, sheet, effects, terms, grips, segment, extra)
        keep = max(0.0, 1.0 - SETTLING * dt) if settling else 1.0
        for c in range(3):
            before[c], slower[c] = x[c], v[c]
            x[c] += dt * (keep * v[c] + dt * f[c] * inverse_mass)
        project(x, before, inverse_mass, springs, dt)
        if heavier:  # what has moved the nodes says what the springs' force was; inertia needs the whole
            total[:] = mass * (x - before - dt * v) / dt**2
            f[:] = total
            bear_inertia(f, mass, extra)
            x += dt**2 * (f - total) * inverse_mass
        after = clock.start if settling else t + dt
        segment = advance_segment(grips.knots, after, segment)
        hold_grips(x, pins, grips, after, segment)
        v[:] = (x - before) / dt
        count += 1
        if settling:
            spent = count * dt
            if spent > SETTLE[1] or (spent > SETTLE[0] and fastest(v, 0, 1) < AT_REST):
                settling, began = False, count
                v[:] = 0.0
            continue
        if is_lost(x, 0, 1, clock.limit):
            return DIVERGED, count
        done = write_frames(before, slower, x, v, t, after, done, sampling, grips)
    return OK, count


_SIGNATURE = types.UniTuple(_I, 2)(_D[:, ::1], SHEET, _I, SPRINGS, *(EFFECT,) * SLOTS, TERMS, GRIPS, CLOCK, SAMPLING)


@functools.cache
def march():
    """The compiled loop; compiling takes seconds when it is first used, then it lies on disk."""
    return kernel(_march, signature=_SIGNATURE)
