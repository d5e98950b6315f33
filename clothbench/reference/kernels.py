"""Kernels of the reference simulation: one physical term each, on plain arrays, SI units.

They share no code with the models that clothbench fits, so that a stand-in recording is never the fitted
model's own output. Node positions and velocities are (N, 3); every force kernel *adds* to `force` (N, 3) [N].
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from clothbench.core.kernels import kernel

DEEP = 1e-3  # m; what lies deeper in a sphere, as a start may, is not pushed out any faster


class Sheet(NamedTuple):
    """A discretised cloth. T triangles, H hinges, N nodes."""

    triangle: np.ndarray  # (T, 3) nodes
    slope: np.ndarray  # (T, 2, 2) d(shape function of node 1, 2)/d(u, v) [1/m]; node 0 is minus their sum
    area: np.ndarray  # (T,) rest area [m²]
    hinge: np.ndarray  # (H, 4) edge start, edge end, the two nodes opposite
    hinge_stiffness: np.ndarray  # (H,) [N m]
    hinge_rest: np.ndarray  # (H,) angle that costs nothing [rad]
    mass: np.ndarray  # (N,) [kg]
    stiffness: np.ndarray  # (4,) c11, c22, c12, shear [N/m]
    damping: np.ndarray  # (4,) stretch [s], shear [s], bending [s], mass-proportional [1/s]
    drag: np.ndarray  # (4,) ½ρ_air C_N, ½ρ_air C_T [kg/m³], linear tangential [kg/(m² s)], decline k_f [s²/m²]
    gravity: np.ndarray  # (3,) [m/s²]
    wind: np.ndarray  # (3,) velocity of the air [m/s]


@kernel
def _minus(x, i, j):
    return x[i, 0] - x[j, 0], x[i, 1] - x[j, 1], x[i, 2] - x[j, 2]


@kernel
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def _cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel
def _mix(p, a, q, b):
    return p * a[0] + q * b[0], p * a[1] + q * b[1], p * a[2] + q * b[2]


@kernel
def _add(force, i, a):
    force[i, 0] += a[0]
    force[i, 1] += a[1]
    force[i, 2] += a[2]


@kernel
def _tangents(sheet, t, x):
    """∂x/∂u and ∂x/∂v in triangle t (of positions), or their rates (of velocities)."""
    i, j, k = sheet.triangle[t]
    first, second, s = _minus(x, j, i), _minus(x, k, i), sheet.slope[t]
    return _mix(s[0, 0], first, s[1, 0], second), _mix(s[0, 1], first, s[1, 1], second)


@kernel
def membrane_energy(sheet, x):
    """∫ ½(c11 E11² + c22 E22²) + c12 E11 E22 + ½ G (2 E12)² [J], E = ½(FᵀF − 1) (St. Venant–Kirchhoff)."""
    c11, c22, c12, shear = sheet.stiffness
    total = 0.0
    for t in range(len(sheet.area)):
        fu, fv = _tangents(sheet, t, x)
        e1, e2, g = 0.5 * (_dot(fu, fu) - 1.0), 0.5 * (_dot(fv, fv) - 1.0), _dot(fu, fv)
        total += sheet.area[t] * (0.5 * (c11 * e1 * e1 + c22 * e2 * e2 + shear * g * g) + c12 * e1 * e2)
    return total


@kernel
def membrane_force(sheet, x, v, force, elastic=1.0, viscous=1.0):
    """f_a = −A F S ∇N_a, S = C : (E + β Ė), Ė = sym(Fᵀ Ḟ), shear with a β of its own (Kelvin–Voigt).

    elastic, viscous: what share of E and of β Ė is taken; the viscous part alone is linear in v.
    """
    c11, c22, c12, shear = sheet.stiffness
    beta, shear_beta = viscous * sheet.damping[0], viscous * sheet.damping[1]
    for t in range(len(sheet.area)):
        fu, fv = _tangents(sheet, t, x)
        ru, rv = _tangents(sheet, t, v)
        e1 = 0.5 * elastic * (_dot(fu, fu) - 1.0) + beta * _dot(fu, ru)
        e2 = 0.5 * elastic * (_dot(fv, fv) - 1.0) + beta * _dot(fv, rv)
        s12 = shear * (elastic * _dot(fu, fv) + shear_beta * (_dot(fu, rv) + _dot(ru, fv)))
        s11, s22, weight = c11 * e1 + c12 * e2, c12 * e1 + c22 * e2, -sheet.area[t]
        along_u, along_v = _mix(weight * s11, fu, weight * s12, fv), _mix(weight * s12, fu, weight * s22, fv)
        s = sheet.slope[t]
        first = _mix(s[0, 0], along_u, s[0, 1], along_v)
        second = _mix(s[1, 0], along_u, s[1, 1], along_v)
        _add(force, sheet.triangle[t, 1], first)
        _add(force, sheet.triangle[t, 2], second)
        _add(force, sheet.triangle[t, 0], _mix(-1.0, first, -1.0, second))


@kernel
def _hinge(sheet, h, x):
    """Angle between the normals of a hinge's two triangles [rad], its gradient for the four nodes [rad/m].

    Gradient after Bridson, Marino, Fedkiw, "Simulation of clothing with folds and wrinkles", SCA 2003.
    """
    p, q, a, b = sheet.hinge[h]
    edge, pa, qa = _minus(x, q, p), _minus(x, a, p), _minus(x, a, q)
    pb, qb = _minus(x, b, p), _minus(x, b, q)
    na, nb = _cross(edge, pa), _cross(pb, edge)
    length = math.sqrt(_dot(edge, edge))
    angle = math.atan2(_dot(_cross(na, nb), edge) / length, _dot(na, nb))
    wa, wb = 1.0 / _dot(na, na), 1.0 / _dot(nb, nb)
    ga, gb = _mix(-length * wa, na, 0.0, na), _mix(-length * wb, nb, 0.0, nb)
    gp = _mix(-_dot(qa, edge) / length * wa, na, -_dot(qb, edge) / length * wb, nb)
    gq = _mix(_dot(pa, edge) / length * wa, na, _dot(pb, edge) / length * wb, nb)
    return angle, gp, gq, ga, gb


@kernel
def bending_energy(sheet, x):
    """Σ ½ k (θ − θ₀)² over the hinges [J]; k = D l²/(A₁+A₂) is set by the mesh (see `mesh.hinges`)."""
    total = 0.0
    for h in range(len(sheet.hinge)):
        total += 0.5 * sheet.hinge_stiffness[h] * (_hinge(sheet, h, x)[0] - sheet.hinge_rest[h]) ** 2
    return total


@kernel
def bending_force(sheet, x, v, force):
    """f = −k (θ − θ₀ + β θ̇) ∇θ: discrete-shell hinges (Grinspun et al., SCA 2003) with Kelvin–Voigt damping."""
    beta = sheet.damping[2]
    for h in range(len(sheet.hinge)):
        angle, gp, gq, ga, gb = _hinge(sheet, h, x)
        p, q, a, b = sheet.hinge[h]
        rate = _dot(gp, v[p]) + _dot(gq, v[q]) + _dot(ga, v[a]) + _dot(gb, v[b])
        moment = -sheet.hinge_stiffness[h] * (angle - sheet.hinge_rest[h] + beta * rate)
        _add(force, p, _mix(moment, gp, 0.0, gp))
        _add(force, q, _mix(moment, gq, 0.0, gq))
        _add(force, a, _mix(moment, ga, 0.0, ga))
        _add(force, b, _mix(moment, gb, 0.0, gb))


@kernel
def drag_force(sheet, x, v, force):
    """f = −A (½ρ_air (C_N |v_n| v_n/(1 + k_f |v_n|²) + C_T |v_t| v_t) + k_T v_t), v against the air: quadratic, with
    the decline and the linear part of Bhat et al. 2003, section 3."""
    normal_drag, tangential_drag, linear_drag, decline = sheet.drag
    for t in range(len(sheet.area)):
        i, j, k = sheet.triangle[t]
        twice = _cross(_minus(x, j, i), _minus(x, k, i))
        size = math.sqrt(_dot(twice, twice))
        mean = _mix(1.0, _mix(1.0 / 3.0, _mix(1.0, v[i], 1.0, v[j]), 1.0 / 3.0, v[k]), -1.0, sheet.wind)
        along = _mix(_dot(mean, twice) / (size * size), twice, 0.0, twice)
        across = _mix(1.0, mean, -1.0, along)
        third = size / 6.0
        square = _dot(along, along)
        strength_n = -third * normal_drag * math.sqrt(square) / (1.0 + decline * square)
        strength_t = -third * (tangential_drag * math.sqrt(_dot(across, across)) + linear_drag)
        share = _mix(strength_n, along, strength_t, across)
        _add(force, i, share)
        _add(force, j, share)
        _add(force, k, share)


@kernel
def weight_force(sheet, v, force):
    """f = m (g − α v): gravity and mass-proportional damping."""
    for i in range(len(sheet.mass)):
        for d in range(3):
            force[i, d] += sheet.mass[i] * (sheet.gravity[d] - sheet.damping[3] * v[i, d])


@kernel
def contact_force(spheres, grips, before, step, sheet, x, v, force):
    """A penalty on nodes within spheres that move with the mean of the grips, and Coulomb's friction.

    f_n = m (ω² d − 2 ω v_n) but not below 0, d the depth up to DEEP, ω = 0.2/Δt, which explicit steps bear; friction
    takes μ f_n, or the half of what would stop the node within the step. spheres (K, 5): centre against the mean of the
    grips and radius [m], μ; grips and before (G, 3) m: now, and a step of `step` [s] before; v against the sphere.
    """
    omega, carried, centre = 0.2 / step, np.zeros(3), np.zeros(3)
    for g in range(len(grips)):
        for d in range(3):
            centre[d] += grips[g, d] / len(grips)
            carried[d] += (grips[g, d] - before[g, d]) / step / len(grips)
    for k in range(len(spheres)):
        for i in range(len(x)):
            out = _mix(1.0, _mix(1.0, x[i], -1.0, centre), -1.0, spheres[k, :3])
            away = math.sqrt(_dot(out, out))
            depth = spheres[k, 3] - away
            if depth <= 0.0 or away == 0.0:
                continue
            normal, moves = _mix(1.0 / away, out, 0.0, out), _mix(1.0, v[i], -1.0, carried)
            speed = _dot(moves, normal)
            press = sheet.mass[i] * max(0.0, omega * omega * min(depth, DEEP) - 2.0 * omega * speed)
            along = _mix(1.0, moves, -speed, normal)
            slides = math.sqrt(_dot(along, along))
            rub = min(spheres[k, 4] * press, 0.5 * sheet.mass[i] * slides / step) / max(slides, 1e-300)
            _add(force, i, _mix(press, normal, -rub, along))


@kernel
def total_force(sheet, x, v, force, viscous=1.0):
    """All forces on all nodes [N], with that share of the membrane's damping; overwrites `force`."""
    force[:] = 0.0
    weight_force(sheet, v, force)
    membrane_force(sheet, x, v, force, 1.0, viscous)
    bending_force(sheet, x, v, force)
    drag_force(sheet, x, v, force)


@kernel
def advance(sheet, x, v, force, held, path, step, spheres):
    """Velocity Verlet; the nodes `held` follow `path` (steps + 1, G, 3) [m], one row per `step` [s].

    Forces that depend on velocity see v + Δt a (second order), the kick itself is the usual two halves.
    `x`, `v`, `force` are brought up to date in place; `force` must be that of `x`, `v` on entry.
    """
    half = np.empty_like(v)
    for s in range(len(path) - 1):
        for i in range(len(x)):
            for d in range(3):
                kick = 0.5 * step * force[i, d] / sheet.mass[i]
                half[i, d] = v[i, d] + kick
                v[i, d] = half[i, d] + kick
                x[i, d] += step * half[i, d]
        for g in range(len(held)):
            for d in range(3):
                x[held[g], d] = path[s + 1, g, d]
                v[held[g], d] = (path[s + 1, g, d] - path[s, g, d]) / step
        total_force(sheet, x, v, force)
        contact_force(spheres, path[s + 1], path[s], step, sheet, x, v, force)
        for i in range(len(x)):
            for d in range(3):
                v[i, d] = half[i, d] + 0.5 * step * force[i, d] / sheet.mass[i]
        for g in range(len(held)):
            for d in range(3):
                v[held[g], d] = (path[s + 1, g, d] - path[s, g, d]) / step
                force[held[g], d] = 0.0


@kernel
def _damped(sheet, x, v, step, held, out):
    """out = (M + Δt D(x)) v, D the membrane's damping; zero at held nodes."""
    out[:] = 0.0
    membrane_force(sheet, x, v, out, 0.0, 1.0)
    for i in range(len(x)):
        for d in range(3):
            out[i, d] = sheet.mass[i] * v[i, d] - step * out[i, d]
    out[held] = 0.0


@kernel
def _weighed(sheet, a, b):
    """Σ a·b/m over nodes and directions."""
    total = 0.0
    for i in range(len(a)):
        total += (a[i, 0] * b[i, 0] + a[i, 1] * b[i, 1] + a[i, 2] * b[i, 2]) / sheet.mass[i]
    return total


@kernel
def relax(sheet, x, v, step, held, correction, tolerance=5e-3, most=400):
    """Backward Euler for the membrane's damping alone: (M + Δt D(x)) v⁺ = M v, by conjugate gradients, v in place.

    `correction` (N, 3), v⁺ − v of the step before, is where the search begins, and is brought up to date. Velocities of
    held nodes stay. The residual ends below `tolerance` of what the damping does within the step.
    """
    residual, product, direction = np.zeros_like(v), np.empty_like(v), np.empty_like(v)
    membrane_force(sheet, x, v, residual, 0.0, 1.0)
    residual *= step
    residual[held] = 0.0
    enough = tolerance**2 * _weighed(sheet, residual, residual)
    _damped(sheet, x, correction, step, held, product)
    residual -= product
    rho, before, count = _weighed(sheet, residual, residual), 1.0, 0
    direction[:] = 0.0
    while rho > enough and count < most:
        for i in range(len(x)):
            for d in range(3):
                direction[i, d] = residual[i, d] / sheet.mass[i] + (rho / before if count else 0.0) * direction[i, d]
        _damped(sheet, x, direction, step, held, product)
        alpha = rho / (direction * product).sum()
        for i in range(len(x)):
            for d in range(3):
                correction[i, d] += alpha * direction[i, d]
                residual[i, d] -= alpha * product[i, d]
        rho, before, count = _weighed(sheet, residual, residual), rho, count + 1
    v += correction
    return count


@kernel
def advance_damped(sheet, x, v, force, held, path, step, spheres):
    """As `advance`, for damping too stiff for explicit steps: it acts by itself after each step, implicitly."""
    total_force(sheet, x, v, force, 0.0)
    contact_force(spheres, path[0], path[0], step, sheet, x, v, force)
    correction = np.zeros_like(v)
    for s in range(len(path) - 1):
        for i in range(len(x)):
            for d in range(3):
                v[i, d] += step * force[i, d] / sheet.mass[i]
        for g in range(len(held)):
            for d in range(3):
                v[held[g], d] = (path[s + 1, g, d] - path[s, g, d]) / step
        relax(sheet, x, v, step, held, correction)
        for i in range(len(x)):
            for d in range(3):
                x[i, d] += step * v[i, d]
        for g in range(len(held)):
            for d in range(3):
                x[held[g], d] = path[s + 1, g, d]
        total_force(sheet, x, v, force, 0.0)
        contact_force(spheres, path[s + 1], path[s], step, sheet, x, v, force)
