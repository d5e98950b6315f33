"""One linear solve on a grid of triangles: (M + C + K) δ = r by conjugate gradients, preconditioned node by node.

The matrix lies in rows over the nodes (`assemble`), the couplings of each node with the next ones along u, v and the
diagonals, so that a product is one loop without branches that reads what it needs once: a third of the time that it
takes to go by way of edges and cells.

Why conjugate gradients and not a factorisation: on 41 × 41 nodes at 2 ms CHOLMOD, given the pattern, takes 6 times as
long, QDLDL and SuperLU 32 times; at 8 ms 1.8 and 9 times, at 1/60 s 1.4 and 7 times
(`tests/benchmarks/test_implicit_solvers.py`).
"""

from __future__ import annotations

import numpy as np

from clothbench.modelling import apart_kernel, fast_kernel, kernel, lean_kernel
from clothbench_models.resting_contact import SLIDES, STICKS
from clothbench_models.sheet_forces import CELLS

# Rows of a matrix: a node's own block (xx, yy, zz, yz, xz, xy); the blocks (xx, xy, … zz) that couple it with the nodes
# 1, nu and nu + 1 after it; the numbers that couple it with those 2, nu − 1 and 2 nu after it in each coordinate; and,
# of whole cells, the block that couples it with the one nu − 1 after it.
NEXT, ACROSS, DIAGONAL, SECOND_NEXT, BESIDE, SECOND_ACROSS, ANTIDIAGONAL = 6, 15, 24, 33, 34, 35, 36
OWN = (0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1)


@lean_kernel
def put(into, of):
    """into (C, n) = of, number by number: numba's assignment of a whole array takes seconds to compile, for what it has
    to say of shapes that do not fit.
    """
    for c in range(into.shape[0]):
        for e in range(into.shape[1]):
            into[c, e] = of[c, e]


@lean_kernel
def margin_of(nu):
    """How many places a matrix and what it is multiplied by have before the first node, and after the last."""
    return 2 * nu + 2


@kernel
def empty_matrix(nu, n, shear_rows):
    """Room for the matrix of n nodes, nu in a row: (rows, margin + n + margin)."""
    return np.empty((ANTIDIAGONAL + (9 if shear_rows == CELLS else 0), n + 2 * margin_of(nu)))


@lean_kernel
def row_of(offset, nu):
    """The first row that couples nodes so far apart; -1 if there is none."""
    if offset == 0:
        return 0
    if offset == 1:
        return NEXT
    if offset == nu:
        return ACROSS
    if offset == nu + 1:
        return DIAGONAL
    if offset == nu - 1:
        return BESIDE
    if offset == 2:
        return SECOND_NEXT
    return SECOND_ACROSS if offset == 2 * nu else -1


@lean_kernel
def hold_back(r, touch, normal):
    """Remove from r (3, n) what a node cannot follow: all of it where it sticks, the normal part where it slides."""
    for i in range(r.shape[1]):
        if touch[i] == STICKS:
            r[0, i] = r[1, i] = r[2, i] = 0.0
        elif touch[i] == SLIDES:
            s = r[0, i] * normal[0, i] + r[1, i] * normal[1, i] + r[2, i] * normal[2, i]
            for c in range(3):
                r[c, i] -= s * normal[c, i]


@fast_kernel(allocates=False)
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


@apart_kernel(allocates=False)
def _add_products(block, weight, a, b, scale, before, nu):
    """block (9, margin + n + margin) += scale · weight · a bᵀ, of the edge or cell so many places `before` the node.

    weight (P,), a and b (3, P), padded like the edges.
    """
    n = block.shape[1] - 2 * margin_of(nu)
    to, start = np.uint64(margin_of(nu)), np.uint64(nu + 1 - before)
    for i in range(3):
        for j in range(3):
            for k in range(n):
                e = np.uint64(k)
                block[3 * i + j, to + e] += scale * weight[start + e] * a[i, start + e] * b[j, start + e]


@apart_kernel(allocates=False)
def _add_scalars(rows, weight, scale, start, step, nu):
    """rows[0], rows[step], rows[2 step] += scale · weight (P,), from its place `start` on."""
    n = rows.shape[1] - 2 * margin_of(nu)
    to, first = np.uint64(margin_of(nu)), np.uint64(start)
    for i in range(3):
        for k in range(n):
            e = np.uint64(k)
            rows[step * i, to + e] += scale * weight[first + e]


@apart_kernel(allocates=False)
def _add_own(own, block, distance, nu):
    """Take a coupling's blocks (9, …) from the nodes' own (6, …) on either side: what holds nodes together resists no
    motion of all of them.
    """
    n = own.shape[1] - 2 * margin_of(nu)
    to, behind = np.uint64(margin_of(nu)), np.uint64(margin_of(nu) - distance)
    for row in range(6):
        i, j = OWN[row]
        for k in range(n):
            e = np.uint64(k)
            own[row, to + e] -= block[3 * i + j, to + e] + block[3 * j + i, behind + e]


@lean_kernel
def assemble(nu, mass, extra, heavier, edges, shear, offsets, bending, bend_scale, matrix, work):
    """Fill matrix (`empty_matrix`) with M + C + K, from what the force routines kept.

    edges: (10, P) rows unit (3), along, across of u-edges in edges[0:5] and of v-edges in edges[5:10];
    shear: rows ∂C (12, or 6 for whole cells) and the weight; work: (6, P), overwritten.
    """
    n, pad, margin = mass.shape[0], nu + 1, margin_of(nu)
    matrix[:] = 0.0
    own, along, across = matrix[0:NEXT], matrix[NEXT:ACROSS], matrix[ACROSS:DIAGONAL]
    diagonal, antidiagonal = matrix[DIAGONAL:SECOND_NEXT], matrix[ANTIDIAGONAL:]
    _add_products(along, edges[3], edges[0:3], edges[0:3], -1.0, 0, nu)
    _add_products(across, edges[8], edges[5:8], edges[5:8], -1.0, 0, nu)
    _add_scalars(along, edges[4], -1.0, pad, 4, nu)
    _add_scalars(across, edges[9], -1.0, pad, 4, nu)
    weight, one, other = shear[shear.shape[0] - 1], work[0:3], work[3:6]
    if shear.shape[0] == CELLS:  # ∂C is −p − q at corner a, p − q at b, q − p at c and p + q at d
        p, q = shear[0:3], shear[3:6]
        for c in range(3):
            for e in range(weight.shape[0]):
                one[c, e], other[c, e] = p[c, e] + q[c, e], p[c, e] - q[c, e]
        _add_products(along, weight, one, other, -1.0, 0, nu)
        _add_products(along, weight, other, one, -1.0, nu, nu)
        _add_products(across, weight, one, other, 1.0, 0, nu)
        _add_products(across, weight, other, one, 1.0, 1, nu)
        _add_products(diagonal, weight, one, one, -1.0, 0, nu)
        _add_products(antidiagonal, weight, other, other, -1.0, 1, nu)
    else:  # lower: −p at a, p − q at b, q at d; upper: −q at a, q − p at c, p at d
        pl, ql, pu, qu = shear[0:3], shear[3:6], shear[6:9], shear[9:12]
        for c in range(3):
            for e in range(weight.shape[0]):
                one[c, e], other[c, e] = pl[c, e] - ql[c, e], qu[c, e] - pu[c, e]
        _add_products(along, weight, pl, one, -1.0, 0, nu)
        _add_products(along, weight, other, pu, 1.0, nu, nu)
        _add_products(across, weight, qu, other, -1.0, 0, nu)
        _add_products(across, weight, one, ql, 1.0, 1, nu)
        _add_products(diagonal, weight, pl, ql, -1.0, 0, nu)
        _add_products(diagonal, weight, qu, pu, -1.0, 0, nu)
    _add_own(own, along, 1, nu)
    _add_own(own, across, nu, nu)
    _add_own(own, diagonal, nu + 1, nu)
    if shear.shape[0] == CELLS:
        _add_own(own, antidiagonal, nu - 1, nu)
    _add_scalars(own, mass, 1.0, 0, 1, nu)
    if heavier:
        for c in range(6):
            for i in range(n):
                own[c, margin + i] += extra[c, i]
    for s in range(offsets.shape[0]):
        row = row_of(offsets[s], nu)
        if row == 0:
            _add_scalars(own, bending[s], bend_scale, 0, 1, nu)
        elif row >= SECOND_NEXT:
            for i in range(n):
                matrix[row, margin + i] = bend_scale * bending[s, i]
        elif row > 0:
            _add_scalars(matrix[row : row + 9], bending[s], bend_scale, 0, 4, nu)


@apart_kernel(allocates=False)
def _inverses(own, nu, xx, yy, zz, yz, xz, xy):
    """The symmetric blocks (6, margin + n + margin), inverted, row by row (n,)."""
    start = np.uint64(margin_of(nu))
    for k in range(xx.shape[0]):
        e = start + np.uint64(k)
        a, b, c, d, f, g = own[0, e], own[1, e], own[2, e], own[3, e], own[4, e], own[5, e]
        bc, fd, gd = b * c - d * d, f * d - g * c, g * d - f * b
        scale = 1.0 / (a * bc + g * fd + f * gd)
        xx[k], yy[k], zz[k] = bc * scale, (a * c - f * f) * scale, (a * b - g * g) * scale
        yz[k], xz[k], xy[k] = (g * f - a * d) * scale, gd * scale, fd * scale


@lean_kernel
def invert_blocks(nu, matrix, touch, normal, inverse):
    """The nodes' own blocks inverted: inverse (6, n) as xx, yy, zz, yz, xz, xy, within what each node can follow; and
    whether any of them slides.
    """
    slides = False
    _inverses(matrix[0:NEXT], nu, inverse[0], inverse[1], inverse[2], inverse[3], inverse[4], inverse[5])
    for i in range(touch.shape[0]):
        if touch[i] == STICKS:
            inverse[:, i] = 0.0
        elif touch[i] == SLIDES:  # S B⁻¹ S, with S = 1 − n nᵀ
            slides = True
            xx, yy, zz = inverse[0, i], inverse[1, i], inverse[2, i]
            yz, xz, xy = inverse[3, i], inverse[4, i], inverse[5, i]
            x, y, z = normal[0, i], normal[1, i], normal[2, i]
            bx, by, bz = xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z
            b = bx * x + by * y + bz * z
            inverse[0, i] += x * (b * x - 2 * bx)
            inverse[1, i] += y * (b * y - 2 * by)
            inverse[2, i] += z * (b * z - 2 * bz)
            inverse[3, i] += b * y * z - by * z - bz * y
            inverse[4, i] += b * x * z - bx * z - bz * x
            inverse[5, i] += b * x * y - bx * y - by * x
    return slides


@fast_kernel(forceinline=True, allocates=False)
def _coupled(a, row, p, e, distance, x, y, z):
    """x, y, z and what the blocks from this row on couple place e with, so far after it and before it."""
    i = e + distance
    u, v, w = p[0, i], p[1, i], p[2, i]
    x += a[row, e] * u + a[row + 1, e] * v + a[row + 2, e] * w
    y += a[row + 3, e] * u + a[row + 4, e] * v + a[row + 5, e] * w
    z += a[row + 6, e] * u + a[row + 7, e] * v + a[row + 8, e] * w
    i = e - distance
    u, v, w = p[0, i], p[1, i], p[2, i]
    x += a[row, i] * u + a[row + 3, i] * v + a[row + 6, i] * w
    y += a[row + 1, i] * u + a[row + 4, i] * v + a[row + 7, i] * w
    z += a[row + 2, i] * u + a[row + 5, i] * v + a[row + 8, i] * w
    return x, y, z


@fast_kernel(forceinline=True, allocates=False)
def _alike(a, row, p, e, distance, x, y, z):
    """The same for numbers that couple each coordinate with itself."""
    i, j = e + distance, e - distance
    s, t = a[row, e], a[row, j]
    return x + s * p[0, i] + t * p[0, j], y + s * p[1, i] + t * p[1, j], z + s * p[2, i] + t * p[2, j]


@apart_kernel(allocates=False)
def _times(a, nu, p, qx, qy, qz):
    """q = A p for the rows of a matrix, p (3, margin + n + margin) with zeros around it; returns p·q."""
    start, one, across = np.uint64(margin_of(nu)), np.uint64(1), np.uint64(nu)
    total = 0.0
    for k in range(qx.shape[0]):
        e = start + np.uint64(k)
        u, v, w = p[0, e], p[1, e], p[2, e]
        x = a[0, e] * u + a[5, e] * v + a[4, e] * w
        y = a[5, e] * u + a[1, e] * v + a[3, e] * w
        z = a[4, e] * u + a[3, e] * v + a[2, e] * w
        x, y, z = _coupled(a, NEXT, p, e, one, x, y, z)
        x, y, z = _coupled(a, ACROSS, p, e, across, x, y, z)
        x, y, z = _coupled(a, DIAGONAL, p, e, across + one, x, y, z)
        x, y, z = _alike(a, SECOND_NEXT, p, e, one + one, x, y, z)
        x, y, z = _alike(a, BESIDE, p, e, across - one, x, y, z)
        x, y, z = _alike(a, SECOND_ACROSS, p, e, across + across, x, y, z)
        qx[k], qy[k], qz[k] = x, y, z
        total += x * u + y * v + z * w
    return total


@apart_kernel(allocates=False)
def _add_antidiagonal(a, nu, p, qx, qy, qz):
    """q += what the blocks of whole cells couple with the node nu − 1 after; returns what that adds to p·q."""
    start, distance = np.uint64(margin_of(nu)), np.uint64(nu - 1)
    total = 0.0
    for k in range(qx.shape[0]):
        e = start + np.uint64(k)
        x, y, z = _coupled(a, ANTIDIAGONAL, p, e, distance, 0.0, 0.0, 0.0)
        qx[k] += x
        qy[k] += y
        qz[k] += z
        total += x * p[0, e] + y * p[1, e] + z * p[2, e]
    return total


@lean_kernel
def multiply(matrix, nu, offsets, bending, bend_scale, p, q):
    """q (3, n) = (M + C + K) p, for p (3, margin + n + margin) with zeros around it; returns p·q."""
    total, margin, n = _times(matrix, nu, p, q[0], q[1], q[2]), margin_of(nu), q.shape[1]
    if matrix.shape[0] > ANTIDIAGONAL:
        total += _add_antidiagonal(matrix, nu, p, q[0], q[1], q[2])
    for s in range(offsets.shape[0]):
        k = offsets[s]
        if row_of(k, nu) < 0:  # cloth that ends within cells, and grids of unequal ones
            for c in range(3):
                here, ahead = p[c, margin : margin + n - k], p[c, margin + k : margin + n]
                low, high = q[c, : n - k], q[c, k:]
                for e in range(n - k):
                    w = bend_scale * bending[s, e]
                    low[e] += w * ahead[e]
                    high[e] += w * here[e]
                    total += 2.0 * w * here[e] * ahead[e]
    return total


@apart_kernel(allocates=False)
def _precondition(inverse, r, zx, zy, zz):
    """z = blocks · r; returns r·z."""
    total = 0.0
    for e in range(zx.shape[0]):
        x, y, w = r[0, e], r[1, e], r[2, e]
        u = inverse[0, e] * x + inverse[5, e] * y + inverse[4, e] * w
        v = inverse[5, e] * x + inverse[1, e] * y + inverse[3, e] * w
        t = inverse[4, e] * x + inverse[3, e] * y + inverse[2, e] * w
        zx[e], zy[e], zz[e] = u, v, t
        total += x * u + y * v + w * t
    return total


@apart_kernel(allocates=False)
def _advance(delta, r, p, q, alpha, nu):
    """δ += α p, r −= α q."""
    start = np.uint64(margin_of(nu))
    for c in range(3):
        for k in range(delta.shape[1]):
            e = np.uint64(k)
            delta[c, e] += alpha * p[c, start + e]
        for k in range(delta.shape[1]):
            r[c, k] -= alpha * q[c, k]


@apart_kernel(allocates=False)
def _turn(p, z, beta, nu):
    """p ← z + β p."""
    start = np.uint64(margin_of(nu))
    for c in range(3):
        for k in range(z.shape[1]):
            e = np.uint64(k)
            p[c, start + e] = z[c, e] + beta * p[c, start + e]


@lean_kernel
def solve(delta, r, nu, matrix, offsets, bending, bend_scale, touch, normal, tolerance, most, inverse, z, p, q):
    """Conjugate gradients for (M + C + K) δ = r within what the nodes can follow; r becomes what is left of it, and
    forces of what holds them.

    Begins at δ = 0 and ends when rᵀP⁻¹r has fallen by `tolerance`², or after `most` rounds, whose number it returns.
    The filter of Baraff and Witkin 1998, section 5.3, is in the preconditioner. p: (3, margin + n + margin).
    """
    delta[:] = 0.0
    p[:] = 0.0
    slides = invert_blocks(nu, matrix, touch, normal, inverse)
    if slides:  # what the obstacle takes is large, and its rounding would be taken for a residual
        hold_back(r, touch, normal)
    rz = _precondition(inverse, r, z[0], z[1], z[2])
    goal = tolerance * tolerance * rz
    _turn(p, z, 0.0, nu)
    rounds = 0
    while rz > goal and rounds < most:
        pq = multiply(matrix, nu, offsets, bending, bend_scale, p, q)
        if not pq > 0.0:
            break
        if slides:
            hold_back(q, touch, normal)
        _advance(delta, r, p, q, rz / pq, nu)
        before = rz
        rz = _precondition(inverse, r, z[0], z[1], z[2])
        _turn(p, z, rz / before, nu)
        rounds += 1
    return rounds
