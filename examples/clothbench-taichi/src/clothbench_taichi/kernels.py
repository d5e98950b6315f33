"""The compiled time loop of `taichi_springs`. Importing this starts Taichi on the CPU, in double precision.

Taichi reads annotations as they stand, so this file cannot postpone them (`from __future__ import annotations`).
"""

import contextlib
import sys

import numpy as np

with contextlib.redirect_stdout(sys.stderr):  # on which Taichi says hello: standard output belongs to the command
    import taichi as ti

    ti.init(arch=ti.cpu, default_fp=ti.f64, default_ip=ti.i32, log_level=ti.ERROR)

_D, _I = ti.types.ndarray(dtype=ti.f64), ti.types.ndarray(dtype=ti.i32)


@ti.func
def add_forces(
    x: ti.template(), v: ti.template(), f: ti.template(), b, pairs: ti.template(), strength: ti.template(),
    rest: ti.template(), share: ti.template(), k, c,
):  # fmt: skip
    """f += Y (|d|/L − 1) d/|d| + c (ḋ·d) d/|d|² for every spring, Y = k · strength, and less at its other end."""
    for s in range(rest.shape[0]):
        one, other = pairs[s, 0], pairs[s, 1]
        d = ti.Vector([x[b, other, i] - x[b, one, i] for i in ti.static(range(3))])
        closing = ti.Vector([v[b, other, i] - v[b, one, i] for i in ti.static(range(3))])
        length = d.norm() + 1e-30
        pull = k * strength[s] * (length / rest[s] - 1.0) / length + c * share[s] * closing.dot(d) / length**2
        for i in ti.static(range(3)):
            f[b, one, i] += pull * d[i]
            f[b, other, i] -= pull * d[i]


@ti.func
def grip_place(knots: ti.template(), curve: ti.template(), segment, t, g, i: ti.template()):
    """Coordinate i of grip g at time t: its piecewise cubic, [m]."""
    s = ti.min(ti.max(t, knots[0]), knots[knots.shape[0] - 1]) - knots[segment]
    return ((curve[0, segment, g, i] * s + curve[1, segment, g, i]) * s + curve[2, segment, g, i]) * s + curve[
        3, segment, g, i
    ]


@ti.kernel
def forces(x: _D, v: _D, f: _D, pairs: _I, strength: _D, rest: _D, share: _D, k: ti.f64, c: ti.f64):
    """Springs' forces on one sheet, x, v, f (1, n, 3): what the loop adds up, for whoever wants to look at it."""
    for b in range(1):
        add_forces(x, v, f, b, pairs, strength, rest, share, k, c)


@ti.kernel
def _march(
    x: _D, v: _D, f: _D, mass: _D, gravity: _D, pairs: _I, strength: _D, rest: _D, share: _D, theta: _D, dt: _D,
    held: _I, knots: _D, curve: _D, start: ti.f64, least: ti.f64, most: ti.f64, calm: ti.f64, at_rest: ti.f64,
    limit: ti.f64, stops: _I, seen: _D, steps: _I,
):  # fmt: skip
    for b in range(dt.shape[0]):  # one thread each, and all that follows in order
        h, count, now, stop, segment, settling, lost = dt[b], 0, 0, 0, 0, most > 0.0, False
        nodes, frames = mass.shape[0], stops.shape[1]
        while stop < frames and not lost:
            while not settling and stop < frames and stops[b, stop] == now:
                for n in range(nodes):
                    for i in ti.static(range(3)):
                        seen[b, stop, n, i] = x[b, n, i]
                stop += 1
            if stop < frames:
                for n in range(nodes):
                    for i in ti.static(range(3)):
                        f[b, n, i] = mass[n] * gravity[i]
                add_forces(x, v, f, b, pairs, strength, rest, share, theta[b, 0], theta[b, 1])
                decay = ti.exp(-(calm if settling else theta[b, 2]) * h)
                fastest, farthest = 0.0, 0.0
                after = start if settling else start + (now + 1) * h
                while segment < curve.shape[1] - 1 and after > knots[segment + 1]:
                    segment += 1
                for n in range(nodes):
                    for i in ti.static(range(3)):
                        v[b, n, i] = decay * (v[b, n, i] + h * f[b, n, i] / mass[n])
                for g in range(held.shape[0]):
                    for i in ti.static(range(3)):
                        v[b, held[g], i] = (grip_place(knots, curve, segment, after, g, i) - x[b, held[g], i]) / h
                for n in range(nodes):
                    for i in ti.static(range(3)):
                        x[b, n, i] += h * v[b, n, i]
                        fastest = ti.max(fastest, ti.abs(v[b, n, i]))
                        farthest = ti.max(farthest, ti.abs(x[b, n, i]))
                lost = not farthest < limit
                count += 1
                if settling:
                    spent = count * h
                    if spent > most or (spent > least and fastest < at_rest):
                        settling = False
                        for n in range(nodes):
                            for i in ti.static(range(3)):
                                v[b, n, i] = 0.0
                else:
                    now += 1
        steps[b] = count


def march(
    shape, mass, gravity, pairs, strength, rest, share, theta, dt, held, knots, curve, start, settle, calm, at_rest,
    limit, stops, seen,
):  # fmt: skip
    """Settle all B members from shape (n, 3) m, then run them; fills seen (B, S, n, 3) m at steps `stops` (B, S).

    A member that is lost leaves the rest of its stops NaN. Returns the steps taken (B,).
    """
    x = np.repeat(np.asarray(shape, dtype=float)[None], len(dt), axis=0)
    steps = np.zeros(len(dt), np.int32)
    _march(
        x, np.zeros_like(x), np.zeros_like(x), mass.copy(), gravity, pairs.astype(np.int32), strength, rest, share,
        np.ascontiguousarray(theta), np.ascontiguousarray(dt), held.astype(np.int32), knots, curve, start, *settle,
        calm, at_rest, limit, stops.astype(np.int32), seen, steps,
    )  # fmt: skip
    return steps
