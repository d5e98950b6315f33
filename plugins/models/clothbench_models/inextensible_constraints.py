"""The constraints of `inextensible`, and the fast projection onto them (Goldenthal et al. 2007); compiled.

Constraints are kept by edge and cell of the grid like the fluxes of `sheet_forces`: rows 0 (u-edges) and 1 (v-edges)
with C = (|d|²/L − L)/2, row 2 (cells) with C = d_u·d_v/√(h_u h_v), d the mean of a cell's two opposite edges, which
says that both diagonals are equal. Multipliers λ are tensions [N] in the same (3, P) layout.
"""

from __future__ import annotations

from collections import namedtuple

import numpy as np
from numba import types

from clothbench.modelling import apart_kernel, bear_inverted, bundle_type, fast_kernel, kernel, lean_kernel
from clothbench_models.implicit_grid import hold_back, put
from clothbench_models.sheet_forces import add_fluxes, edge_differences

Constraints = namedtuple("Constraints", "lengths share give")
Constraints.__doc__ = """What may not change: lengths (2, P) m of u- and v-edges at rest; share (3, P), 1/L, 1/L and
1/√(h_u h_v), 0 where there is no constraint; give (3, P) m/N, how little each gives way.
"""
CONSTRAINTS = bundle_type(Constraints, *[types.float64[:, ::1]] * 3)
PROJECTIONS = 12  # rounds of the fast projection in one step, at most
CRUMPLED = 0.1  # strain that is left when projecting has failed
SOLVED = 0.01  # of the residual is left by each round's solver; the next round deals with it


@apart_kernel(allocates=False)
def violations(nu, du, dv, lengths, share, c):
    """C (3, P) m from the edge differences du, dv (3, P) m; share (3, P): 1/L, 1/L and 1/√(h_u h_v), 0 outside."""
    one, across = np.uint64(1), np.uint64(nu)
    for k in range(share.shape[1]):
        e = np.uint64(k)
        square = du[0, e] * du[0, e] + du[1, e] * du[1, e] + du[2, e] * du[2, e]
        c[0, e] = 0.5 * (square * share[0, e] - lengths[0, e])
        square = dv[0, e] * dv[0, e] + dv[1, e] * dv[1, e] + dv[2, e] * dv[2, e]
        c[1, e] = 0.5 * (square * share[1, e] - lengths[1, e])
    for k in range(share.shape[1] - 1 - nu):
        e = np.uint64(k)
        i, j = e + across, e + one
        total = (du[0, e] + du[0, i]) * (dv[0, e] + dv[0, j])
        total += (du[1, e] + du[1, i]) * (dv[1, e] + dv[1, j])
        total += (du[2, e] + du[2, i]) * (dv[2, e] + dv[2, j])
        c[2, e] = 0.25 * share[2, e] * total


@lean_kernel
def pull(nu, du, dv, share, tension, fu, fv):
    """Fluxes (3, P) N of the constraint forces −∂Cᵀλ, tension λ (3, P) N; zero where there are no edges, as before."""
    _pull_along(nu, du, dv, share[0], share[2], tension[0], tension[2], 1, nu, fu)
    _pull_along(nu, dv, du, share[1], share[2], tension[1], tension[2], nu, 1, fv)


@apart_kernel(allocates=False)
def _pull_along(nu, d, cross, share, cells, tension, shear, along, aside, flux):
    """The same of one family of edges d (3, P) m: `along` places from one to the next, and `aside` to those beside."""
    step, before = np.uint64(along), np.uint64(aside)
    for c in range(3):
        for k in range(share.shape[0] - 2 * nu):
            e = np.uint64(nu) + np.uint64(k)
            i = e - before
            here, there = shear[e] * cells[e], shear[i] * cells[i]
            slide = here * (cross[c, e] + cross[c, e + step]) + there * (cross[c, i] + cross[c, i + step])
            flux[c, e] = tension[e] * share[e] * d[c, e] + 0.25 * slide


@apart_kernel(allocates=False)
def rates(nu, du, dv, share, pu, pv, out):
    """∂C·p (3, P) for the edge differences pu, pv of p."""
    one, across = np.uint64(1), np.uint64(nu)
    for k in range(share.shape[1]):
        e = np.uint64(k)
        out[0, e] = share[0, e] * (du[0, e] * pu[0, e] + du[1, e] * pu[1, e] + du[2, e] * pu[2, e])
        out[1, e] = share[1, e] * (dv[0, e] * pv[0, e] + dv[1, e] * pv[1, e] + dv[2, e] * pv[2, e])
    for k in range(share.shape[1] - 1 - nu):
        e = np.uint64(k)
        i, j = e + across, e + one
        total = (pu[0, e] + pu[0, i]) * (dv[0, e] + dv[0, j]) + (du[0, e] + du[0, i]) * (pv[0, e] + pv[0, j])
        total += (pu[1, e] + pu[1, i]) * (dv[1, e] + dv[1, j]) + (du[1, e] + du[1, i]) * (pv[1, e] + pv[1, j])
        total += (pu[2, e] + pu[2, i]) * (dv[2, e] + dv[2, j]) + (du[2, e] + du[2, i]) * (pv[2, e] + pv[2, j])
        out[2, e] = 0.25 * share[2, e] * total


@lean_kernel
def yield_to(f, mass, inertia, heavier, touch, normal):
    """f (3, n) N becomes accelerations of what can move, in place; inertia: from `invert_inertia`, if heavier."""
    hold_back(f, touch, normal)
    if heavier:
        bear_inverted(f, inertia)
    for c in range(3):
        for e in range(mass.shape[0]):
            f[c, e] /= mass[e]
    hold_back(f, touch, normal)


@apart_kernel(allocates=False)
def schur_diagonal(nu, du, dv, share, weight, give, square, out):
    """The diagonal (3, P) of c/γ² + ∂C W ∂Cᵀ for inverse masses `weight` (P,) padded like the edges, 0 where held."""
    for e in range(share.shape[1] - 1 - nu):
        uu = du[0, e] ** 2 + du[1, e] ** 2 + du[2, e] ** 2
        vv = dv[0, e] ** 2 + dv[1, e] ** 2 + dv[2, e] ** 2
        out[0, e] = give[0, e] / square + share[0, e] ** 2 * uu * (weight[e] + weight[e + 1])
        out[1, e] = give[1, e] / square + share[1, e] ** 2 * vv * (weight[e] + weight[e + nu])
        plus, minus = 0.0, 0.0
        for k in range(3):
            a = 0.25 * share[2, e] * (dv[k, e] + dv[k, e + 1])
            b = 0.25 * share[2, e] * (du[k, e] + du[k, e + nu])
            plus += (a + b) ** 2
            minus += (a - b) ** 2
        out[2, e] = (
            give[2, e] / square + plus * (weight[e] + weight[e + nu + 1]) + minus * (weight[e + 1] + weight[e + nu])
        )
    for e in range(max(0, share.shape[1] - 1 - nu), share.shape[1]):
        out[0, e] = out[1, e] = out[2, e] = 1.0
    for k in range(3):
        for e in range(share.shape[1]):
            if out[k, e] <= 0.0:
                out[k, e] = 1.0


@apart_kernel(allocates=False)
def factor_lines(nu, du, dv, share, weight, diagonal, off):
    """Turn the diagonal (3, P) into the pivots D of L D Lᵀ for all mesh lines' own blocks; off (2, P): their L.

    The lengths along one line form a chain whose condition grows with the square of its nodes; between lines that are
    orthogonal there is next to no coupling. So a chain is solved exactly, in its own direction, and what is left for
    the conjugate gradients is shear.
    """
    for e in range(1, share.shape[1] - 1 - nu):
        dots = du[0, e - 1] * du[0, e] + du[1, e - 1] * du[1, e] + du[2, e - 1] * du[2, e]
        off[0, e] = -share[0, e - 1] * share[0, e] * weight[e] * dots / diagonal[0, e - 1]
        diagonal[0, e] -= off[0, e] * off[0, e] * diagonal[0, e - 1]
    for e in range(nu, share.shape[1] - 1 - nu):
        f = e - nu
        dots = dv[0, f] * dv[0, e] + dv[1, f] * dv[1, e] + dv[2, f] * dv[2, e]
        off[1, e] = -share[1, f] * share[1, e] * weight[e] * dots / diagonal[1, f]
        diagonal[1, e] -= off[1, e] * off[1, e] * diagonal[1, f]


@apart_kernel(allocates=False)
def times(a, b, out):
    """out = a b for small matrices (l, m), (m, n), four rows of b at once."""
    inner = a.shape[1]
    for i in range(a.shape[0]):
        for j in range(b.shape[1]):
            out[i, j] = 0.0
        for k in range(0, inner - 3, 4):
            u, v, w, x = a[i, k], a[i, k + 1], a[i, k + 2], a[i, k + 3]
            for j in range(b.shape[1]):
                out[i, j] += u * b[k, j] + v * b[k + 1, j] + w * b[k + 2, j] + x * b[k + 3, j]
        for k in range(inner - inner % 4, inner):
            w = a[i, k]
            for j in range(b.shape[1]):
                out[i, j] += w * b[k, j]


@apart_kernel(allocates=False)
def solve_lines(nu, diagonal, off, waves_u, waves_v, damped, plane, r, z):
    """The preconditioner: z = (L D Lᵀ)⁻¹ r for the mesh lines, and the flat sheet's inverse for the cells.

    Of a flat sheet of square cells the cells' block is (1/m) (2 λ − ½ Σ λ of the four diagonal neighbours), whose
    eigenvectors are sines along u and v: waves_u (nu − 1, nu − 1), waves_v (nv − 1, nv − 1), orthogonal and symmetric,
    with the inverse eigenvalues damped (nv − 1, nu − 1). plane: (2, nv − 1, nu − 1), overwritten.
    """
    size = r.shape[1]
    z[0, 0], end = r[0, 0], size - 1 - nu
    for e in range(1, end):
        z[0, e] = r[0, e] - off[0, e] * z[0, e - 1]
    for e in range(end):
        z[0, e] /= diagonal[0, e]
    for e in range(end - 2, -1, -1):
        z[0, e] -= off[0, e + 1] * z[0, e + 1]
    for e in range(nu):
        z[1, e] = r[1, e]
    for e in range(nu, end):
        z[1, e] = r[1, e] - off[1, e] * z[1, e - nu]
    for e in range(end):
        z[1, e] /= diagonal[1, e]
    for e in range(end - 1 - nu, -1, -1):
        z[1, e] -= off[1, e + nu] * z[1, e + nu]
    one, two, pad = plane[0], plane[1], nu + 1
    for j in range(one.shape[0]):
        for i in range(nu - 1):
            one[j, i] = r[2, pad + j * nu + i]
    times(waves_v, one, two)
    times(two, waves_u, one)
    for j in range(one.shape[0]):
        for i in range(nu - 1):
            one[j, i] *= damped[j, i]
    times(waves_v, one, two)
    times(two, waves_u, one)
    for e in range(size):
        z[2, e] = 0.0
    for j in range(one.shape[0]):
        for i in range(nu - 1):
            z[2, pad + j * nu + i] = one[j, i]


@kernel
def damp_waves(mass, give, square, nu, damped):
    """Inverse eigenvalues (nv − 1, nu − 1) of the flat sheet's cells, for a typical inner mass and compliance.

    They are the middle's; where an outline leaves that out, it weighs nothing and would let no cell resist shear: then
    the heaviest node's and the softest cell's.
    """
    nv = damped.shape[0] + 1
    pad, middle = nu + 1, (nv // 2) * nu + nu // 2
    heaviest = mass.max()
    if mass[middle] > 0.1 * heaviest:
        typical, softness = 1.0 / mass[middle], give[2, pad + middle - nu - 1] / square
    else:
        typical, softness = 1.0 / heaviest, give[2].max() / square
    for j in range(nv - 1):
        for i in range(nu - 1):
            wave = np.cos(np.pi * (i + 1) / nu) * np.cos(np.pi * (j + 1) / nv)
            damped[j, i] = 1.0 / (softness + typical * (2.0 - 2.0 * wave))


@kernel
def sines(count):
    """The orthogonal, symmetric matrix (count, count) of the discrete sine transform."""
    out = np.empty((count, count))
    for i in range(count):
        for k in range(count):
            out[i, k] = np.sqrt(2.0 / (count + 1)) * np.sin(np.pi * (i + 1) * (k + 1) / (count + 1))
    return out


@fast_kernel(allocates=False)
def _sum(a, b):
    total = 0.0
    for k in range(3):
        ak, bk = a[k], b[k]
        for e in range(ak.shape[0]):
            total += ak[e] * bk[e]
    return total


@lean_kernel
def schur_times(nu, du, dv, share, give, square, p, mass, inertia, heavier, touch, normal, f, out, work):
    """out = (c/γ² + ∂C W ∂Cᵀ) p for multipliers p (3, P); work[6:12] and work[12:18] are overwritten."""
    fu, fv, pu, pv = work[6:9], work[9:12], work[12:15], work[15:18]
    pull(nu, du, dv, share, p, fu, fv)
    f[:] = 0.0
    add_fluxes(fu, fv, nu, f, 1.0)
    yield_to(f, mass, inertia, heavier, touch, normal)
    edge_differences(f, nu, pu, pv)
    rates(nu, du, dv, share, pu, pv, out)
    for k in range(3):
        for e in range(p.shape[1]):
            out[k, e] = give[k, e] / square * p[k, e] - out[k, e]


@kernel
def tighten(
    x, gamma, tension, nu, lengths, share, give, mass, inertia, heavier, touch, normal, weight, tolerance, rows, work,
    f, waves_u, waves_v, damped, plane,
):  # fmt: skip
    """Fast projection (Goldenthal et al. 2007, section 4.1) of x (3, n) m onto C(x) = cλ, in the metric of the masses.

    Rounds of (γ² ∂C W ∂Cᵀ + c) δλ = C − cλ, x ← x − γ² W ∂Cᵀ δλ, each solved by conjugate gradients, until no
    constraint errs by more than `tolerance` of its length. tension (3, P) N: λ, as guessed from the step before, and
    as found. give (3, P): c, how little the cloth stretches after all
    [m/N], which keeps grips that pull it too far apart from asking the impossible. Returns the rounds of the solver,
    or -1 if the sheet cannot be pulled straight.
    """
    du, dv, fu, fv = work[0:3], work[3:6], work[6:9], work[9:12]
    c, r, z, p, q, step, diagonal = rows[0], rows[1], rows[2], rows[3], rows[4], rows[5], rows[6]
    square, total = gamma * gamma, 0
    off, worst = rows[7], 0.0
    damp_waves(mass, give, square, nu, damped)
    for _ in range(PROJECTIONS):
        edge_differences(x, nu, du, dv)
        violations(nu, du, dv, lengths, share, c)
        worst = 0.0
        step[:] = 0.0
        for k in range(3):
            for e in range(c.shape[1]):
                r[k, e] = (c[k, e] - give[k, e] * tension[k, e]) / square if share[k, e] > 0.0 else 0.0
                worst = max(worst, abs(r[k, e]) * square * share[k, e])
        if worst < tolerance or not worst < 1e6:
            break
        schur_diagonal(nu, du, dv, share, weight, give, square, diagonal)
        factor_lines(nu, du, dv, share, weight, diagonal, off)
        solve_lines(nu, diagonal, off, waves_u, waves_v, damped, plane, r, z)
        share_left = max(SOLVED, 0.3 * tolerance / worst)
        goal = share_left * share_left * _sum(r, z)
        rz = _sum(r, z)
        put(p, z)
        for _ in range(500):
            if rz <= goal:
                break
            schur_times(nu, du, dv, share, give, square, p, mass, inertia, heavier, touch, normal, f, q, work)
            pq = _sum(p, q)
            if not pq > 0.0:
                break
            alpha, before = rz / pq, rz
            for k in range(3):
                for e in range(c.shape[1]):
                    step[k, e] += alpha * p[k, e]
                    r[k, e] -= alpha * q[k, e]
            solve_lines(nu, diagonal, off, waves_u, waves_v, damped, plane, r, z)
            rz = _sum(r, z)
            beta = rz / before
            for k in range(3):
                for e in range(c.shape[1]):
                    p[k, e] = z[k, e] + beta * p[k, e]
            total += 1
        pull(nu, du, dv, share, step, fu, fv)
        f[:] = 0.0
        add_fluxes(fu, fv, nu, f, 1.0)
        yield_to(f, mass, inertia, heavier, touch, normal)
        for k in range(3):
            for e in range(x.shape[1]):
                x[k, e] += square * f[k, e]
            for e in range(c.shape[1]):
                tension[k, e] += step[k, e]
    return total if worst < CRUMPLED else -1
