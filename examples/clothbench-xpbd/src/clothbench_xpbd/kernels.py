"""The compiled time loop of `xpbd`: predict, pull the springs straight, put the grips where they are."""

from __future__ import annotations

import functools

import numpy as np
from clothbench.modelling import kernel
from clothbench.modelling.bound_effects import FORCE, INERTIA
from clothbench.modelling.kernels import EFFECT
from clothbench.modelling.sheet import SHEET, bear_inertia, grid_normals
from numba import types

SLOTS = 4  # places for dynamics effects
SETTLING = 40.0  # 1/s, damping while the sheet comes to rest; strong, so that it sinks into the nearest shape
AT_REST = 1e-5  # m/s; slower than this a settling sheet is taken to hang still
LOST = 1e3  # m


@kernel
def project(x, before, inverse_mass, pairs, rest, compliance, tau, dt):
    """One Gauss–Seidel sweep over the springs C = |d| − L, damped (Macklin et al. 2016, equation 26):

    Δλ = (−C − γ ∇C·(x − x₀)) / ((1 + γ) Σ 1/m + α/dt²), γ = τ/dt; Δx = ±Δλ n/m.  compliance α = 1/k (C,) m/N.
    """
    gamma = tau / dt
    for s in range(pairs.shape[0]):
        a, b = pairs[s, 0], pairs[s, 1]
        dx, dy, dz = x[0, b] - x[0, a], x[1, b] - x[1, a], x[2, b] - x[2, a]
        length = np.sqrt(dx * dx + dy * dy + dz * dz) + 1e-30
        nx, ny, nz = dx / length, dy / length, dz / length
        moved = nx * (dx - before[0, b] + before[0, a]) + ny * (dy - before[1, b] + before[1, a])
        moved += nz * (dz - before[2, b] + before[2, a])
        weight = (1.0 + gamma) * (inverse_mass[a] + inverse_mass[b]) + compliance[s] / dt**2
        push = (rest[s] - length - gamma * moved) / weight
        for c, n in enumerate((nx, ny, nz)):
            x[c, a] -= inverse_mass[a] * push * n
            x[c, b] += inverse_mass[b] * push * n


@kernel
def grip_at(knots, curve, t, g, c):
    """Coordinate c of grip g at time t: piecewise cubic (4, K−1, G, 3), held still beyond its ends."""
    t = min(max(t, knots[0]), knots[-1])
    k = min(max(np.searchsorted(knots, t, side="right") - 1, 0), knots.shape[0] - 2)
    s = t - knots[k]
    return ((curve[0, k, g, c] * s + curve[1, k, g, c]) * s + curve[2, k, g, c]) * s + curve[3, k, g, c]


@kernel
def hold(x, inverse_mass, held, share, knots, curve, t):
    """Move the nodes around each grip (G, 4) by the least, weighed by mass, that puts the gripped point on it."""
    for g in range(held.shape[0]):
        weight = 0.0
        for k in range(held.shape[1]):
            weight += share[g, k] ** 2 * inverse_mass[held[g, k]]
        for c in range(3):
            away = grip_at(knots, curve, t, g, c)
            for k in range(held.shape[1]):
                away -= share[g, k] * x[c, held[g, k]]
            for k in range(held.shape[1]):
                x[c, held[g, k]] += share[g, k] * inverse_mass[held[g, k]] / weight * away


@kernel
def look(x, before, part, index, weight, seen, shared, knots, curve, t, frame):
    """Fill frame (N, 3): the points between shape `before` (part 0) and `x` (part 1); grips where they are, exactly."""
    for n in range(index.shape[0]):
        for c in range(3):
            frame[n, c] = 0.0
            for k in range(index.shape[1]):
                e = index[n, k]
                frame[n, c] += weight[n, k] * ((1.0 - part) * before[c, e] + part * x[c, e])
    for n in range(seen.shape[0]):
        for c in range(3):
            frame[seen[n], c] = grip_at(knots, curve, t, shared[n], c)


@kernel
def push_all(stage, effects, stages, used, t, dt, x, v, f, sheet, parameters, state):
    """Let every effect that has something to do at this stage add to forces f (3, n) N, or to masses f (6, n) kg."""
    for k in range(used):
        if stages[k] == stage:
            effects[k](t, dt, x, v, f, sheet, parameters[k], state[k])


@kernel
def fastest(v):
    """Largest speed [m/s] of v (3, n), the same whichever way the axes point."""
    return np.sqrt((v[0] ** 2 + v[1] ** 2 + v[2] ** 2).max())


def _march(
    x, sheet, nu, pairs, rest, compliance, tau,
    effect_0, effect_1, effect_2, effect_3, stages, used, parameters, state,
    held, share, knots, curve, seen, shared, index, weight, times, start, settle, dt, out,
):  # fmt: skip
    """Settle shape x (3, n) m in the grips' first pose, then run; fills out (T, N, 3) m, returns the steps taken."""
    effects = (effect_0, effect_1, effect_2, effect_3)
    mass, normal, gravity = sheet.mass, sheet.normal, sheet.gravity
    inverse_mass, extra = 1.0 / mass, np.empty((6, mass.shape[0]))
    v, f, before, total = np.zeros(x.shape), np.empty(x.shape), np.empty(x.shape), np.empty(x.shape)
    settling = held.shape[0] > 0
    done, count, began = 0, 0, 0
    while done < times.shape[0]:
        t = start if settling else start + (count - began) * dt
        for c in range(3):
            f[c] = mass * gravity[c]
        if used > 0:
            grid_normals(x, nu, normal)
            for g in range(held.shape[0]):
                for c in range(3):
                    sheet.grip[c, g] = grip_at(knots, curve, t, g, c)
            push_all(FORCE, effects, stages, used, t, dt, x, v, f, sheet, parameters, state)
        keep = max(0.0, 1.0 - SETTLING * dt) if settling else 1.0
        for c in range(3):
            before[c] = x[c]
            x[c] += dt * (keep * v[c] + dt * f[c] * inverse_mass)
        project(x, before, inverse_mass, pairs, rest, compliance, tau, dt)
        if used > 0:  # what has moved the nodes says what the springs' force was; inertia needs the whole
            total[:] = mass * (x - before - dt * v) / dt**2
            f[:] = total
            extra[:] = 0.0
            push_all(INERTIA, effects, stages, used, t, dt, before, v, extra, sheet, parameters, state)
            bear_inertia(f, mass, extra)
            x += dt**2 * (f - total) * inverse_mass
        after = start if settling else t + dt
        hold(x, inverse_mass, held, share, knots, curve, after)
        v[:] = (x - before) / dt
        count += 1
        if settling:
            spent = count * dt
            if spent > settle[1] or (spent > settle[0] and fastest(v) < AT_REST):
                settling, began = False, count
                v[:] = 0.0
            continue
        if not np.abs(x).max() < LOST:
            out[done:] = np.nan
            return count
        while done < times.shape[0] and times[done] <= after:
            part = max(0.0, (times[done] - t) / dt)  # what is looked at before the start shows the start
            look(x, before, part, index, weight, seen, shared, knots, curve, times[done], out[done])
            done += 1
    return count


_d, _i = types.float64, types.int64
_SIGNATURE = _i(
    _d[:, ::1], SHEET, _i, _i[:, ::1], _d[::1], _d[::1], _d,
    *(EFFECT,) * SLOTS, _i[::1], _i, _d[:, ::1], _d[:, ::1],
    _i[:, ::1], _d[:, ::1], _d[::1], _d[:, :, :, ::1], _i[::1], _i[::1],
    _i[:, ::1], _d[:, ::1], _d[::1], _d, _d[::1], _d, _d[:, :, ::1],
)  # fmt: skip


@functools.cache
def march():
    """The compiled loop; compiling takes seconds when it is first used, then it lies on disk."""
    return kernel(_march, signature=_SIGNATURE)
