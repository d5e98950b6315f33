"""Equilibrium of a strip in a vertical plane: a Kirchhoff–Love shell bent to a cylinder, on cubic splines.

Per width and areal density ρ the energy is Π/ρ = ∫ ε²/2η_m + κ²/2η_b + g z du with ε = (|x′|² − 1)/2 and
κ = (x′ × x″)/|x′| (Kiendl, Bletzinger, Linhard, Wüchner 2009, the flat sheet at rest), so that nothing but two
ratios of the fabric take part. Tension n = ε/η_m and moment m = κ/η_b are unknowns of their own at the quadrature
points during the iteration: the converged state is the same, and Newton's steps can be long although cloth hardly
stretches (Magisano, Leonetti, Garcea 2017, mixed integration points).
"""

from __future__ import annotations

import numpy as np

from clothbench.modelling import kernel, lean_kernel
from clothbench_models.banded import factor, keep_out, substitute, times

SUPPORT = 4
BAND = 2 * SUPPORT  # of the stiffness, lower half with the diagonal
CONVERGED, LOST, ENDLESS = 0, 1, 2


@lean_kernel
def strains(c, first, d1, d2, a, b):
    """x′ and x″ at one quadrature point into a, b (2,); returns ε and κ [1, 1/m]."""
    a[0] = a[1] = b[0] = b[1] = 0.0
    for k in range(SUPPORT):
        for i in range(2):
            a[i] += d1[k] * c[first + k, i]
            b[i] += d2[k] * c[first + k, i]
    square = a[0] * a[0] + a[1] * a[1]
    return 0.5 * (square - 1.0), (a[0] * b[1] - a[1] * b[0]) / np.sqrt(square)


@lean_kernel
def slopes(a, b, gradient, curvature):
    """Derivatives of κ by (x′, x″): gradient (4,) and Hessian (4, 4)."""
    square = a[0] * a[0] + a[1] * a[1]
    length = np.sqrt(square)
    cross = a[0] * b[1] - a[1] * b[0]
    fa0, fa1, fb0, fb1 = b[1], -b[0], -a[1], a[0]
    cube = length * square
    gradient[0] = fa0 / length - cross * a[0] / cube
    gradient[1] = fa1 / length - cross * a[1] / cube
    gradient[2], gradient[3] = fb0 / length, fb1 / length
    curvature[:] = 0.0
    fa = (fa0, fa1)
    fb = (fb0, fb1)
    for i in range(2):
        for j in range(2):
            curvature[i, j] = -(fa[i] * a[j] + a[i] * fa[j]) / cube + 3.0 * cross * a[i] * a[j] / (cube * square)
            curvature[i, 2 + j] = -a[i] * fb[j] / cube
        curvature[i, i] -= cross / cube
    curvature[0, 3] += 1.0 / length
    curvature[1, 2] -= 1.0 / length
    for i in range(2):
        for j in range(2):
            curvature[2 + j, i] = curvature[i, 2 + j]


@kernel
def energy(c, d1, d2, weight, pull, soft, bend):
    """Π/ρ [m³/s²] per width; soft = η_m, bend (E, G) = η_b, pull (n, 2) = −g ∫N du."""
    a, b = np.empty(2), np.empty(2)
    total = 0.0
    for e in range(d1.shape[0]):
        for q in range(d1.shape[1]):
            strain, kappa = strains(c, e, d1[e, q], d2[e, q], a, b)
            total += 0.5 * weight[e, q] * (strain * strain / soft + kappa * kappa / bend)
    for i in range(c.shape[0]):
        total -= c[i, 0] * pull[i, 0] + c[i, 1] * pull[i, 1]
    return total


@kernel
def assemble(c, d1, d2, weight, pull, soft, bend, tension, moment, force, band):
    """What Newton's step needs: force (2n,) = pull − ∫ (∂ε ε/η_m + ∂κ κ/η_b) and the stiffness' lower band (2n, 8).

    The geometric part of the stiffness takes the stresses as they are known at the quadrature points.
    """
    a, b, gradient, curvature = np.empty(2), np.empty(2), np.empty(4), np.empty((4, 4))
    local, part = np.empty((4, 4)), np.empty(4)
    block = np.empty((BAND, 4))
    band[:] = 0.0
    for i in range(c.shape[0]):
        force[2 * i], force[2 * i + 1] = pull[i, 0], pull[i, 1]
    for e in range(d1.shape[0]):
        for q in range(d1.shape[1]):
            strain, kappa = strains(c, e, d1[e, q], d2[e, q], a, b)
            slopes(a, b, gradient, curvature)
            w, n, m = weight[e, q], tension[e, q], moment[e, q]
            for i in range(4):
                part[i] = w * gradient[i] * kappa / bend
                for j in range(4):
                    local[i, j] = w * (gradient[i] * gradient[j] / bend + m * curvature[i, j])
            for i in range(2):
                part[i] += w * a[i] * strain / soft
                local[i, i] += w * n
                for j in range(2):
                    local[i, j] += w * a[i] * a[j] / soft
            for k in range(SUPPORT):
                p, r = d1[e, q, k], d2[e, q, k]
                for i in range(2):
                    row = 2 * k + i
                    force[2 * e + row] -= p * part[i] + r * part[2 + i]
                    for j in range(4):
                        block[row, j] = p * local[i, j] + r * local[2 + i, j]
            for column in range(BAND):
                p, r, j = d1[e, q, column // 2], d2[e, q, column // 2], column % 2
                for row in range(column, BAND):
                    band[2 * e + column, row - column] += block[row, j] * p + block[row, 2 + j] * r


@kernel
def update(c, step, share, d1, d2, soft, bend, tension, moment):
    """Move the control points by share · step, and the stresses by what the linearised strains say."""
    a, b, gradient, curvature = np.empty(2), np.empty(2), np.empty(4), np.empty((4, 4))
    for e in range(d1.shape[0]):
        for q in range(d1.shape[1]):
            strain, kappa = strains(c, e, d1[e, q], d2[e, q], a, b)
            slopes(a, b, gradient, curvature)
            stretch, bent = strain, kappa
            for k in range(SUPPORT):
                for i in range(2):
                    s, p = step[2 * (e + k) + i], d1[e, q, k]
                    stretch += a[i] * p * s
                    bent += (gradient[i] * p + gradient[2 + i] * d2[e, q, k]) * s
            tension[e, q] += share * (stretch / soft - tension[e, q])
            moment[e, q] += share * (bent / bend - moment[e, q])
    for i in range(c.shape[0]):
        c[i, 0] += share * step[2 * i]
        c[i, 1] += share * step[2 * i + 1]


@kernel
def advance(band, force, fixed, step, product, shift):
    """Solve (K + shift) step = force where nothing is fixed; what is fixed moves by what `step` says beforehand.

    Where that is not positive definite the shift grows until it is. Returns the shift, negative if none will do.
    """
    count = band.shape[0]
    scale = 0.0
    for j in range(count):
        scale += band[j, 0] / count  # the mean of the trace, which does not depend on the axes
        if not fixed[j]:
            step[j] = 0.0
    times(band, step, product)
    for j in range(count):
        step[j] = step[j] if fixed[j] else force[j] - product[j]
    shift = shift if shift > 1e-12 * scale else 0.0
    kept = np.empty_like(band)
    while True:
        for j in range(count):
            for k in range(band.shape[1]):
                kept[j, k] = band[j, k]
            kept[j, 0] += shift
        keep_out(kept, fixed)
        if factor(kept):
            break
        shift = max(4.0 * shift, 1e-8 * scale)
        if not shift < scale:
            return -1.0
    substitute(kept, step)
    return shift


@lean_kernel
def farthest(step, dimensions):
    """How far a control point goes, at most [m]; steps (n · dimensions,)."""
    most = 0.0
    for i in range(0, step.shape[0], dimensions):
        square = 0.0
        for k in range(dimensions):
            square += step[i + k] ** 2
        if square != square:
            return square
        most = max(most, square)
    return np.sqrt(most)


@lean_kernel
def touches(height, step, reaction, floor, springs, held, touching):
    """Renew which points touch, all (n,); returns how many changed.

    Pressed to a rigid floor, a point touches as long as that takes an upward force (Hintermüller, Ito, Kunisch 2002,
    primal–dual active set); on springs, and before it touches, it does where it would lie below the floor.
    """
    changed = 0
    for i in range(height.shape[0]):
        if held[i] or floor[i] == -np.inf:
            continue
        now = reaction[i] > 0.0 if touching[i] and springs[i] == 0.0 else height[i] + step[i] < floor[i]
        if now != touching[i]:
            touching[i] = now
            changed += 1
    return changed


@kernel
def equilibrium(
    c, tension, moment, target, held, floor, springs, d1, d2, weight, pull, soft, bend, reach, tolerance, most, reaction
):  # fmt: skip
    """Newton with an active set, in place, from control points c (n, 2) m and stresses (E, G).

    held (n, 2): coordinates that go to `target` (n, 2) m; floor (n,): least height of each control point [m], −inf
    where there is none (points above it keep the whole strip above it); springs (n,): m/s², what the floor resists
    each point by a metre, 0 where it is rigid; reach: m, the longest step of a control point; tolerance: m. reaction
    (n, 2) becomes the forces per width and ρ [m²/s²] that hold what is held or touches. Returns the status and the
    number of iterations.
    """
    count = c.shape[0]
    force, product, step = np.empty(2 * count), np.empty(2 * count), np.empty(2 * count)
    band = np.empty((2 * count, BAND))
    fixed, touching = np.empty(2 * count, np.bool_), np.empty(count, np.bool_)
    for i in range(count):
        touching[i] = not held[i, 1] and c[i, 1] <= floor[i] + tolerance
    shift = 0.0
    for iteration in range(1, most + 1):
        assemble(c, d1, d2, weight, pull, soft, bend, tension, moment, force, band)
        for i in range(count):
            for k in range(2):
                j = 2 * i + k
                fixed[j] = held[i, k]
                step[j] = target[i, k] - c[i, k]
            if touching[i]:
                step[j] = floor[i] - c[i, 1]
                fixed[j] = fixed[j] or springs[i] == 0.0
                band[j, 0] += springs[i]
                force[j] += springs[i] * step[j]
        shift = advance(band, force, fixed, step, product, shift)
        longest = farthest(step, 2)
        if shift < 0.0 or not np.isfinite(longest):
            return LOST, iteration
        share = min(1.0, reach / max(longest, 1e-300))
        times(band, step, product)
        for i in range(count):
            reaction[i, 0], reaction[i, 1] = product[2 * i] - force[2 * i], product[2 * i + 1] - force[2 * i + 1]
        changed = touches(c[:, 1], share * step[1::2], reaction[:, 1], floor, springs, held[:, 1], touching)
        update(c, step, share, d1, d2, soft, bend, tension, moment)
        if share == 1.0 and shift == 0.0 and changed == 0 and longest < tolerance:
            return CONVERGED, iteration
        shift *= 0.25
    return ENDLESS, most
