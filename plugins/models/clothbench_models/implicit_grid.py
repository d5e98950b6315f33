"""One linear solve on a grid of triangles: (M + C + K) δ = r by conjugate gradients, preconditioned node by node.

Why conjugate gradients and not a factorisation: on 41 × 41 nodes at 2 ms CHOLMOD, given the pattern, takes 2.4 times
as long, QDLDL and SuperLU 14 times (`tests/benchmarks/test_implicit_solvers.py`). Only CHOLMOD gets ahead from 8 ms on,
and only of solves to 1e-4: those to 1e-2 stay quicker up to 1/60 s.
"""

from __future__ import annotations

from clothbench.modelling import fast_kernel, kernel
from clothbench_models.resting_contact import SLIDES, STICKS
from clothbench_models.sheet_forces import (
    CELLS,
    _cell_shear_times,
    _shear_times,
    _stretch_times,
    add_diagonals,
    add_fluxes,
    edge_differences,
)


@kernel
def hold_back(r, touch, normal):
    """Remove from r (3, n) what a node cannot follow: all of it where it sticks, the normal part where it slides."""
    for i in range(r.shape[1]):
        if touch[i] == STICKS:
            r[0, i] = r[1, i] = r[2, i] = 0.0
        elif touch[i] == SLIDES:
            s = r[0, i] * normal[0, i] + r[1, i] * normal[1, i] + r[2, i] * normal[2, i]
            for c in range(3):
                r[c, i] -= s * normal[c, i]


@fast_kernel
def mass_times(mass, extra, heavier, p, out):
    """out = M p with scalar masses (n,) kg, plus the tensors `extra` (6, n) if there are any."""
    for c in range(3):
        pc, oc = p[c], out[c]
        for e in range(mass.shape[0]):
            oc[e] = mass[e] * pc[e]
    if heavier:
        for e in range(mass.shape[0]):
            out[0, e] += extra[0, e] * p[0, e] + extra[5, e] * p[1, e] + extra[4, e] * p[2, e]
            out[1, e] += extra[5, e] * p[0, e] + extra[1, e] * p[1, e] + extra[3, e] * p[2, e]
            out[2, e] += extra[4, e] * p[0, e] + extra[3, e] * p[1, e] + extra[2, e] * p[2, e]


@kernel
def multiply(p, nu, mass, extra, heavier, edges, shear, offsets, bending, bend_scale, out, work):
    """out = (M + C + K) p, from what the force routines kept.

    edges: (8, …) rows unit (3), along, across of u-edges in edges[0:5] and of v-edges in edges[5:10];
    shear: rows ∂C (12, or 6 for whole cells) and the weight; work: rows for differences and fluxes.
    """
    du, dv, fu, fv = work[0:3], work[3:6], work[6:9], work[9:12]
    edge_differences(p, nu, du, dv)
    _stretch_times(du, edges[0:3], edges[3], edges[4], fu)
    _stretch_times(dv, edges[5:8], edges[8], edges[9], fv)
    if shear.shape[0] == CELLS:
        _cell_shear_times(nu, shear[6], du, dv, shear[0:3], shear[3:6], work[12], fu, fv)
    else:
        _shear_times(nu, shear[12], du, dv, shear[0:3], shear[3:6], shear[6:9], shear[9:12], work[12], work[13], fu, fv)
    mass_times(mass, extra, heavier, p, out)
    add_fluxes(fu, fv, nu, out, -1.0)
    add_diagonals(offsets, bending, p, bend_scale, out)


@kernel
def invert_blocks(nu, mass, extra, heavier, edges, shear, bending, bend_scale, touch, inverse):
    """The 3 × 3 blocks of M + C + K on the diagonal, inverted: inverse (6, n) as xx, yy, zz, yz, xz, xy."""
    n, pad = mass.shape[0], nu + 1
    for i in range(n):
        if touch[i] == STICKS:
            continue
        e = pad + i
        base = mass[i] + bend_scale * bending[0, i]
        xx, yy, zz, yz, xz, xy = base, base, base, 0.0, 0.0, 0.0
        if heavier:
            xx, yy, zz = xx + extra[0, i], yy + extra[1, i], zz + extra[2, i]
            yz, xz, xy = yz + extra[3, i], xz + extra[4, i], xy + extra[5, i]
        for k in range(4):
            o = 0 if k < 2 else 5
            j = e - (1 if k == 1 else 0) - (nu if k == 3 else 0)
            a, b = edges[o + 3, j], edges[o + 4, j]
            x, y, z = edges[o, j], edges[o + 1, j], edges[o + 2, j]
            xx, yy, zz = xx + a * x * x + b, yy + a * y * y + b, zz + a * z * z + b
            yz, xz, xy = yz + a * y * z, xz + a * x * z, xy + a * x * y
        # Triangles around the node: its own cell as corner a (both), as b, c and d of the cells before it.
        for k in range(4 if shear.shape[0] == CELLS else 6):
            if shear.shape[0] == CELLS:  # as corner a: −p − q, b: p − q, c: q − p, d: p + q
                o = 0
                j = e - (1 if k in (1, 3) else 0) - (nu if k in (2, 3) else 0)
                s, t = (1.0 if k in (1, 3) else -1.0), (1.0 if k in (2, 3) else -1.0)
            elif k == 0:  # lower, corner a: −p
                j, o, s, t = e, 0, -1.0, 0.0
            elif k == 1:  # upper, corner a: −q
                j, o, s, t = e, 6, 0.0, -1.0
            elif k == 2:  # lower, corner b: p − q
                j, o, s, t = e - 1, 0, 1.0, -1.0
            elif k == 3:  # upper, corner c: q − p
                j, o, s, t = e - nu, 6, -1.0, 1.0
            elif k == 4:  # lower, corner d: q
                j, o, s, t = e - nu - 1, 0, 0.0, 1.0
            else:  # upper, corner d: p
                j, o, s, t = e - nu - 1, 6, 1.0, 0.0
            w = shear[shear.shape[0] - 1, j]
            x = s * shear[o, j] + t * shear[o + 3, j]
            y = s * shear[o + 1, j] + t * shear[o + 4, j]
            z = s * shear[o + 2, j] + t * shear[o + 5, j]
            xx, yy, zz = xx + w * x * x, yy + w * y * y, zz + w * z * z
            yz, xz, xy = yz + w * y * z, xz + w * x * z, xy + w * x * y
        axx, axy, axz = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
        ayy, ayz, azz = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
        scale = 1.0 / (xx * axx + xy * axy + xz * axz)
        inverse[0, i], inverse[1, i], inverse[2, i] = axx * scale, ayy * scale, azz * scale
        inverse[3, i], inverse[4, i], inverse[5, i] = ayz * scale, axz * scale, axy * scale


@fast_kernel
def precondition(inverse, r, z):
    """z = blocks · r; returns r·z."""
    total = 0.0
    for e in range(r.shape[1]):
        x, y, w = r[0, e], r[1, e], r[2, e]
        zx = inverse[0, e] * x + inverse[5, e] * y + inverse[4, e] * w
        zy = inverse[5, e] * x + inverse[1, e] * y + inverse[3, e] * w
        zz = inverse[4, e] * x + inverse[3, e] * y + inverse[2, e] * w
        z[0, e], z[1, e], z[2, e] = zx, zy, zz
        total += x * zx + y * zy + w * zz
    return total


@fast_kernel
def dot(a, b):
    total = 0.0
    for c in range(3):
        ac, bc = a[c], b[c]
        for e in range(ac.shape[0]):
            total += ac[e] * bc[e]
    return total


@fast_kernel
def advance(delta, r, p, q, alpha):
    """δ += α p, r −= α q."""
    for c in range(3):
        dc, rc, pc, qc = delta[c], r[c], p[c], q[c]
        for e in range(dc.shape[0]):
            dc[e] += alpha * pc[e]
            rc[e] -= alpha * qc[e]


@fast_kernel
def turn(p, z, beta):
    """p ← z + β p."""
    for c in range(3):
        pc, zc = p[c], z[c]
        for e in range(pc.shape[0]):
            pc[e] = zc[e] + beta * pc[e]


@kernel
def solve(
    delta, r, nu, mass, extra, heavier, edges, shear, offsets, bending, bend_scale, touch, normal, tolerance, most,
    inverse, z, p, q, work,
):  # fmt: skip
    """Conjugate gradients for (M + C + K) δ = r within what the nodes can follow; r becomes what is left of it.

    Begins at δ = 0 and ends when rᵀP⁻¹r has fallen by `tolerance`², or after `most` rounds, whose number it returns.
    The filter of Baraff and Witkin 1998, section 5.3.
    """
    delta[:] = 0.0
    hold_back(r, touch, normal)
    invert_blocks(nu, mass, extra, heavier, edges, shear, bending, bend_scale, touch, inverse)
    rz = precondition(inverse, r, z)
    hold_back(z, touch, normal)
    rz = dot(r, z)
    goal = tolerance * tolerance * rz
    p[:] = z
    rounds = 0
    while rz > goal and rounds < most:
        multiply(p, nu, mass, extra, heavier, edges, shear, offsets, bending, bend_scale, q, work)
        hold_back(q, touch, normal)
        pq = dot(p, q)
        if not pq > 0.0:
            break
        advance(delta, r, p, q, rz / pq)
        before = rz
        rz = precondition(inverse, r, z)
        hold_back(z, touch, normal)
        rz = dot(r, z)
        turn(p, z, rz / before)
        rounds += 1
    return rounds
