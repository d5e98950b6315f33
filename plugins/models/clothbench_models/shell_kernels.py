"""Equilibrium of a rectangular Kirchhoff–Love shell on tensor-product cubic splines, in three dimensions.

Per areal density ρ the energy is Π/ρ = ∫ ε·C ε/2η_m + κ·C κ/2η_b + g·x dA with ε_αβ = (x,_α·x,_β − δ_αβ)/2 and
κ_αβ = x,_αβ·n, n the unit normal (Kiendl, Bletzinger, Linhard, Wüchner 2009, the flat sheet at rest), and C of plane
stress with Poisson's ratio ν. Along two threads of unlike stiffness C is orthotropic, [√r ν 0; ν 1/√r 0; 0 0 (1 − ν)/2]
with r the ratio and ν² = ν_12 ν_21 (Huber's plate: Timoshenko and Woinowsky-Krieger 1959, Theory of plates and shells,
section 86); roots (2,) are √r of membrane and bending. Strains as (11, 22, 2·12). Stresses are unknowns of their own
during the iteration, as in `strip_kernels`. At each quadrature point everything is a function of five vectors: x,_1
x,_2 x,_11 x,_22 x,_12.
"""

from __future__ import annotations

import numpy as np

from clothbench.modelling import kernel, lean_kernel
from clothbench_models.banded import times
from clothbench_models.strip_kernels import CONVERGED, ENDLESS, LOST, advance, farthest, touches

SUPPORT = 16  # functions that do not vanish on an element
VECTORS = 5


@lean_kernel
def cross(a, b, out):
    out[0], out[1], out[2] = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@lean_kernel
def turned(g, vector, which, out):
    """out (3,) = Pᵀ vector, with P the derivative of x,_1 × x,_2 by x,_1 (which = 0) or x,_2 (1)."""
    if which == 0:
        cross(g[1], vector, out)
    else:
        cross(vector, g[0], out)


@lean_kernel
def vectors(c, nodes, shape, g):
    """The five vectors g (5, 3) at a quadrature point from its functions' derivatives shape (5, 16)."""
    for p in range(VECTORS):
        for i in range(3):
            s = 0.0
            for k in range(SUPPORT):
                s += shape[p, k] * c[nodes[k], i]
            g[p, i] = s


@kernel
def strains(g, normal, strain, gradient):
    """Normal (3,), the six strains (ε11, ε22, 2ε12, κ11, κ22, 2κ12) and their derivatives by g, (6, 5, 3).

    Returns |x,_1 × x,_2|.
    """
    cross(g[0], g[1], normal)
    area = np.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
    along = np.empty(3)
    gradient[:] = 0.0
    strain[:] = 0.0
    for i in range(3):
        normal[i] /= area
        strain[0] += 0.5 * g[0, i] * g[0, i]
        strain[1] += 0.5 * g[1, i] * g[1, i]
        strain[2] += g[0, i] * g[1, i]
        gradient[0, 0, i], gradient[1, 1, i] = g[0, i], g[1, i]
        gradient[2, 0, i], gradient[2, 1, i] = g[1, i], g[0, i]
    strain[0] -= 0.5
    strain[1] -= 0.5
    for s in range(3):
        twice = 2.0 if s == 2 else 1.0
        bent = g[2 + s, 0] * normal[0] + g[2 + s, 1] * normal[1] + g[2 + s, 2] * normal[2]
        strain[3 + s] = twice * bent
        for i in range(3):
            along[i] = twice * (g[2 + s, i] - bent * normal[i]) / area
            gradient[3 + s, 2 + s, i] = twice * normal[i]
        turned(g, along, 0, gradient[3 + s, 0])
        turned(g, along, 1, gradient[3 + s, 1])
    return area


@kernel
def geometric(g, normal, area, stress, out):
    """Σ stress · second derivatives of the strains by g, into out (5, 3, 5, 3).

    With b = Σ M_αβ x,_αβ and t = x,_1 × x,_2 the bending part is b·t/|t|, with gradient (b − (b·n) n)/|t| by t
    and whose second derivatives are (3 (b·n) n nᵀ − b nᵀ − n bᵀ − (b·n) I)/|t|².
    """
    out[:] = 0.0
    pulled, first, half, row = np.zeros(3), np.empty(3), np.empty(3), np.empty(3)
    for i in range(3):
        out[0, i, 0, i], out[1, i, 1, i] = stress[0], stress[1]
        out[0, i, 1, i] = out[1, i, 0, i] = stress[2]
        pulled[i] = stress[3] * g[2, i] + stress[4] * g[3, i] + 2.0 * stress[5] * g[4, i]
    bent = pulled[0] * normal[0] + pulled[1] * normal[1] + pulled[2] * normal[2]
    for i in range(3):
        first[i] = (pulled[i] - bent * normal[i]) / area
    second, between = np.empty((3, 3)), np.empty((2, 3, 3))
    for i in range(3):
        for j in range(3):
            same = 1.0 if i == j else 0.0
            second[i, j] = 3.0 * bent * normal[i] * normal[j] - pulled[i] * normal[j] - normal[i] * pulled[j]
            second[i, j] = (second[i, j] - bent * same) / area**2
            half[j] = (same - normal[i] * normal[j]) / area
        for a in range(2):
            turned(g, half, a, row)  # ∂n_i/∂x,_a
            for s in range(3):
                share = (2.0 if s == 2 else 1.0) * stress[3 + s]
                for j in range(3):
                    out[2 + s, i, a, j] += share * row[j]
                    out[a, j, 2 + s, i] += share * row[j]
    for a in range(2):
        for i in range(3):
            turned(g, second[i], a, row)
            for j in range(3):
                between[a, j, i] = row[j]  # (Pᵀ second)_ji, second being symmetric
    for a in range(2):
        for b in range(2):
            for i in range(3):
                turned(g, between[a, i], b, row)
                for j in range(3):
                    out[a, i, b, j] += row[j]
    # δt = δx,_1 × δx,_2 once more: first · (δx,_1 × δx,_2)
    out[0, 0, 1, 1] += first[2]
    out[0, 1, 1, 0] -= first[2]
    out[0, 1, 1, 2] += first[0]
    out[0, 2, 1, 1] -= first[0]
    out[0, 2, 1, 0] += first[1]
    out[0, 0, 1, 2] -= first[1]
    for i in range(3):
        for j in range(3):
            if i != j:
                out[1, j, 0, i] = out[0, i, 1, j]


@lean_kernel
def stresses(strain, soft, bend, poisson, roots, out):
    """C ε/η_m and C κ/η_b, (6,)."""
    for half, ratio, root in ((0, soft, roots[0]), (3, bend, roots[1])):
        out[half] = (root * strain[half] + poisson * strain[half + 1]) / ratio
        out[half + 1] = (strain[half + 1] / root + poisson * strain[half]) / ratio
        out[half + 2] = 0.5 * (1.0 - poisson) * strain[half + 2] / ratio


@kernel
def moments(c, nodes, shape, bend, poisson, roots, stress):
    """Set the moments in stress (Q, 6) to those of the shape; of a first guess, in which no tension is meant."""
    g, normal, strain, gradient = np.empty((VECTORS, 3)), np.empty(3), np.empty(6), np.empty((6, VECTORS, 3))
    for q in range(nodes.shape[0]):
        vectors(c, nodes[q], shape[q], g)
        strains(g, normal, strain, gradient)
        stresses(strain, 1.0, bend, poisson, roots, stress[q])
        stress[q, :3] = 0.0


@kernel
def energy(c, nodes, shape, weight, pull, soft, bend, poisson, roots):
    """Π/ρ [m⁴/s²]; pull (n, 3): gravity times the area of each control point."""
    g, normal, strain, gradient = np.empty((VECTORS, 3)), np.empty(3), np.empty(6), np.empty((6, VECTORS, 3))
    stress, total = np.empty(6), 0.0
    for q in range(weight.shape[0]):
        vectors(c, nodes[q], shape[q], g)
        strains(g, normal, strain, gradient)
        stresses(strain, soft, bend, poisson, roots, stress)
        for s in range(6):
            total += 0.5 * weight[q] * strain[s] * stress[s]
    for n in range(c.shape[0]):
        for i in range(3):
            total -= c[n, i] * pull[n, i]
    return total


@kernel
def assemble(c, nodes, shape, weight, pull, soft, bend, poisson, roots, stress, force, band):
    """force (3n,) and the stiffness' lower band (3n, w), its geometric part from the stresses (Q, 6) as known."""
    g, normal, strain, gradient = np.empty((VECTORS, 3)), np.empty(3), np.empty(6), np.empty((6, VECTORS, 3))
    told, local, seen = np.empty(6), np.empty((VECTORS, 3, VECTORS, 3)), np.empty((6, VECTORS, 3))
    part, row = np.empty((VECTORS, 3)), np.empty((SUPPORT, VECTORS, 3, 3))
    band[:] = 0.0
    for n in range(c.shape[0]):
        for i in range(3):
            force[3 * n + i] = pull[n, i]
    for q in range(weight.shape[0]):
        vectors(c, nodes[q], shape[q], g)
        area = strains(g, normal, strain, gradient)
        stresses(strain, soft, bend, poisson, roots, told)
        geometric(g, normal, area, stress[q], local)
        part[:] = 0.0
        for s in range(6):
            half = 0 if s < 3 else 3
            ratio = soft if s < 3 else bend
            other = s if s == half + 2 else 2 * half + 1 - s
            root = roots[0] if s < 3 else roots[1]
            own, beside = root if s == half else 1.0 / root, poisson
            if s == half + 2:
                own, beside = 0.5 * (1.0 - poisson), 0.0
            for p in range(VECTORS):
                for i in range(3):
                    part[p, i] += told[s] * gradient[s, p, i]
                    seen[s, p, i] = (own * gradient[s, p, i] + beside * gradient[other, p, i]) / ratio
        for p in range(VECTORS):
            for i in range(3):
                for r in range(VECTORS):
                    for j in range(3):
                        total = local[p, i, r, j]
                        for s in range(6):
                            total += gradient[s, p, i] * seen[s, r, j]
                        local[p, i, r, j] = weight[q] * total
        for k in range(SUPPORT):
            for p in range(VECTORS):
                for i in range(3):
                    force[3 * nodes[q, k] + i] -= weight[q] * shape[q, p, k] * part[p, i]
                    for j in range(3):
                        total = 0.0
                        for r in range(VECTORS):
                            total += shape[q, r, k] * local[p, i, r, j]
                        row[k, p, i, j] = total
        for k in range(SUPPORT):
            column = 3 * nodes[q, k]
            for m in range(SUPPORT):
                down = 3 * nodes[q, m] - column
                if down < 0:
                    continue
                for i in range(3):
                    for j in range(3):
                        if down + i < j:
                            continue
                        total = 0.0
                        for p in range(VECTORS):
                            total += shape[q, p, m] * row[k, p, i, j]
                        band[column + j, down + i - j] += total


@kernel
def update(c, step, share, nodes, shape, soft, bend, poisson, roots, stress):
    """Move the control points by share · step, and the stresses by what the linearised strains say."""
    g, normal, strain, gradient = np.empty((VECTORS, 3)), np.empty(3), np.empty(6), np.empty((6, VECTORS, 3))
    moved, told = np.empty((VECTORS, 3)), np.empty(6)
    for q in range(nodes.shape[0]):
        vectors(c, nodes[q], shape[q], g)
        strains(g, normal, strain, gradient)
        vectors(step, nodes[q], shape[q], moved)
        for s in range(6):
            for p in range(VECTORS):
                for i in range(3):
                    strain[s] += gradient[s, p, i] * moved[p, i]
        stresses(strain, soft, bend, poisson, roots, told)
        for s in range(6):
            stress[q, s] += share * (told[s] - stress[q, s])
    c += share * step


@kernel
def equilibrium(
    c, stress, lines, grips, goal, holding, stiff, floor, springs, nodes, shape, weight, pull, soft, bend, poisson,
    roots, reach, tolerance, most, wide,
):  # fmt: skip
    """Newton with an active set, in place, from control points c (n, 3) m, stresses (Q, 6), grip forces holding (H, 3).

    lines (H, 16): control points that a held material point is made of, by weights grips (H, 16), to lie at goal
    (H, 3) m; stiff: 1/s² · m², what its force is at first guessed by (augmented Lagrangian: the converged state has
    the point where it should be); floor, springs (n,): as in `strip_kernels`; wide: width of the band. Returns the
    status and the number of iterations.
    """
    count, most_away = c.shape[0], 0.0
    force, product, flat_step = np.empty(3 * count), np.empty(3 * count), np.empty(3 * count)
    band, step = np.empty((3 * count, wide)), np.empty((count, 3))
    fixed, touching = np.zeros(3 * count, np.bool_), np.empty(count, np.bool_)
    nowhere, reaction = np.zeros(count, np.bool_), np.empty(count)
    for i in range(count):
        touching[i] = c[i, 2] <= floor[i] + tolerance
    shift = 0.0
    for iteration in range(1, most + 1):
        assemble(c, nodes, shape, weight, pull, soft, bend, poisson, roots, stress, force, band)
        hold(c, lines, grips, goal, holding, stiff, force, band)
        for i in range(count):
            j = 3 * i + 2
            fixed[j] = touching[i] and springs[i] == 0.0
            flat_step[j] = floor[i] - c[i, 2] if touching[i] else 0.0
            if touching[i]:
                band[j, 0] += springs[i]
                force[j] += springs[i] * flat_step[j]
        shift = advance(band, force, fixed, flat_step, product, shift)
        longest = farthest(flat_step, 3)
        if shift < 0.0 or not np.isfinite(longest):
            return LOST, iteration
        share = min(1.0, reach / max(longest, 1e-300))
        times(band, flat_step, product)
        for i in range(count):
            reaction[i] = product[3 * i + 2] - force[3 * i + 2]
            for k in range(3):
                step[i, k] = flat_step[3 * i + k]
        changed = touches(c[:, 2], share * step[:, 2], reaction, floor, springs, nowhere, touching)
        update(c, step, share, nodes, shape, soft, bend, poisson, roots, stress)
        most_away = pulled(c, lines, grips, goal, holding, stiff)
        if share == 1.0 and shift == 0.0 and changed == 0 and longest < tolerance and most_away < 0.1 * tolerance:
            return CONVERGED, iteration
        shift *= 0.25
    return ENDLESS, most


@lean_kernel
def hold(c, lines, grips, goal, holding, stiff, force, band):
    """Add the grips' forces and stiffness."""
    for h in range(lines.shape[0]):
        for i in range(3):
            away = -goal[h, i]
            for k in range(SUPPORT):
                away += grips[h, k] * c[lines[h, k], i]
            for k in range(SUPPORT):
                force[3 * lines[h, k] + i] -= grips[h, k] * (holding[h, i] + stiff * away)
        for k in range(SUPPORT):
            for m in range(SUPPORT):
                down = 3 * (lines[h, m] - lines[h, k])
                if down >= 0:
                    for i in range(3):
                        band[3 * lines[h, k] + i, down] += stiff * grips[h, k] * grips[h, m]


@lean_kernel
def pulled(c, lines, grips, goal, holding, stiff):
    """Renew the grips' forces; returns how far a held point is from its place [m]."""
    most = 0.0
    for h in range(lines.shape[0]):
        for i in range(3):
            away = -goal[h, i]
            for k in range(SUPPORT):
                away += grips[h, k] * c[lines[h, k], i]
            holding[h, i] += stiff * away
            most = max(most, abs(away))
    return most
