"""The cloth as compiled code sees it: the sheet, its normals, and what inertia does to forces."""

from __future__ import annotations

from collections import namedtuple

import numpy as np
from numba import types

from clothbench.core.kernels import bundle_type, lean_kernel
from clothbench.modelling.mesh import clamped_triangles, curvature_weights, gradient_weights, triangle_slots

Sheet = namedtuple(
    "Sheet",
    "uv mass area normal triangles gradient face_area patch curvature gravity air_density held gripped grip columns "
    "spacing slots outline",
)
Sheet.__doc__ = """The cloth as an effect sees it; `sheet_of` makes one from any mesh of triangles.

uv: (n, 2) m, rest coordinates; mass: (n,) kg and area: (n,) m² of each node, 0 where there is no cloth; normal:
(3, n), unit, at this step; triangles: (F, 3), node numbers; face_area: (F,) m², of cloth in each at rest;
gradient: (F, 2, 3) 1/m, ∂/∂u and ∂/∂v over a triangle as weights of its corners;
patch: (F, 6), the corners, then the node beyond the edge opposite to each corner (a corner again at the border);
curvature: (F, 3, 6) 1/m², ∂²/∂u², ∂²/∂v² and ∂²/∂u∂v as weights of the patch (see `curvature_weights`);
gravity: (3,) m/s²; air_density: kg/m³; held: (G + S,), the node on each grip, then those that never move, off the cloth
or clamped; gripped: G; grip: (3, G + S) m, where they are;
columns, spacing, slots: for loops over all triangles at once, see `triangle_slots`;
outline: (M, 2) m, corners of the cloth, counter-clockwise, where it is not what lies between the outermost lines of a
grid (nodes j·nu + i on straight lines): it is cut, or its hems lie beside them; (0, 2) of any other.
"""

WHOLE = 1e-9  # share of a triangle that may be missing from one that is all cloth: rounding
WIDE = 8  # nodes at a time: doubles in one vector register of AVX-512
VECTOR = types.float64[::1]
ROWS = types.float64[:, ::1]
BLOCKS = types.float64[:, :, ::1]
NODES = types.int64[:, ::1]
SHEET = bundle_type(
    Sheet,
    ROWS,
    VECTOR,
    VECTOR,
    ROWS,
    NODES,
    BLOCKS,
    VECTOR,
    NODES,
    BLOCKS,
    VECTOR,
    types.float64,
    types.int64[::1],
    types.int64,
    ROWS,
    types.int64,
    ROWS,
    ROWS,
    ROWS,
)


def sheet_of(
    uv: np.ndarray, mass: np.ndarray, area: np.ndarray, triangles: np.ndarray, gravity, air_density: float, held=(),
    still=(), share: np.ndarray | None = None, outline: np.ndarray | None = None, whole: bool | None = None,
) -> Sheet:  # fmt: skip
    """The `Sheet` of a mesh of triangles, for compiled loops; normals are zero until a loop fills them.

    uv: (n, 2) m; mass: (n,) kg; area: (n,) m²; triangles: (F, 3); held: (G,) nodes on the grips; still: (S,) nodes that
    never move; share: (F,), how much cloth each triangle stands for, of what fits into it, None for all; outline:
    (M, 2) m, along which the grid was cut or has its hems, None if these are its outermost lines; whole: whether no
    cell is cut, None for whether no share is below 1. A loop on another thread needs a copy with arrays of its own
    where it writes: `own_sheet(sheet)`.
    """
    gradient, face_area = gradient_weights(uv, triangles)
    cloth = face_area if share is None else face_area * share
    if whole is None:  # loops over a grid take normals as if none of its cells were cut
        whole = share is None or bool((share > 1 - WHOLE).all())
    never = np.concatenate([np.array(held, dtype=np.int64), np.array(still, dtype=np.int64)])
    # Of grips only: the rim of a disc that clamps is no line of the mesh, and how far it holds allows for that.
    clamped = clamped_triangles(triangles, never[: len(held)], cloth)
    patch, curvature = curvature_weights(uv, triangles, gradient, face_area, clamped)
    columns, spacing, slots = triangle_slots(uv, triangles, cloth, whole, clamped)
    return Sheet(
        np.ascontiguousarray(uv, dtype=float), np.array(mass, dtype=float), np.array(area, dtype=float),
        np.zeros((3, len(uv))), np.ascontiguousarray(triangles, dtype=np.int64), gradient, cloth, patch, curvature,
        np.array(gravity, dtype=float), float(air_density), never, len(held), np.zeros((3, len(never))),
        columns, spacing, slots, np.array(np.zeros((0, 2)) if outline is None else outline, dtype=float, order="C"),
    )  # fmt: skip


def own_sheet(sheet: Sheet, normals: bool = True) -> Sheet:
    """A copy for one thread: normals and grips, which a loop fills at every step, of its own.

    normals: whether anything reads them; else they are NaN, and stay so in a loop that asks `wants_normals`.
    """
    return sheet._replace(normal=np.full_like(sheet.normal, 0.0 if normals else np.nan), grip=np.zeros_like(sheet.grip))


@lean_kernel
def grid_normals(x, nu, normal):
    """Unit normals (3, n) of a regular grid x (3, n) m, nu nodes a row: cross product of the central differences.

    A node where the sheet has collapsed gets the zero vector: nothing can push on it along a normal.
    """
    n = x.shape[1]
    # All inner rows at once first, as if rows did not end: without branches the compiler can use the vector unit. What
    # does not fill a register goes with the last ones that do: one by one it would take as long as the rest.
    inner = n - 2 * nu
    over = inner % WIDE if inner >= WIDE else 0
    _row_normals(x, nu, 0, inner - over, normal)
    if over:
        _row_normals(x, nu, inner - WIDE, WIDE, normal)
    for i in range(nu):
        _border_normal(x, nu, i, i, normal)
        _border_normal(x, nu, n - nu + i, i, normal)
    for j in range(1, n // nu - 1):
        _border_normal(x, nu, j * nu, 0, normal)
        _border_normal(x, nu, j * nu + nu - 1, nu - 1, normal)


@lean_kernel
def _row_normals(x, nu, first, count, normal):
    """Normals of `count` nodes from place `first` of the second row on, central differences all along."""
    e, left, right, above, below = first + nu, first + nu - 1, first + nu + 1, first, first + 2 * nu
    lx, ly, lz = x[0, left : left + count], x[1, left : left + count], x[2, left : left + count]
    rx, ry, rz = x[0, right : right + count], x[1, right : right + count], x[2, right : right + count]
    tx, ty, tz = x[0, above : above + count], x[1, above : above + count], x[2, above : above + count]
    bx, by, bz = x[0, below : below + count], x[1, below : below + count], x[2, below : below + count]
    ox, oy, oz = normal[0, e : e + count], normal[1, e : e + count], normal[2, e : e + count]
    for k in range(count):
        px, py, pz = bx[k] - tx[k], by[k] - ty[k], bz[k] - tz[k]
        qx, qy, qz = rx[k] - lx[k], ry[k] - ly[k], rz[k] - lz[k]
        ox[k], oy[k], oz[k] = _unit_cross(px, py, pz, qx, qy, qz)


@lean_kernel
def sheet_normals(x, nu, sheet):
    """Fill `sheet.normal` for the shape x (3, n) m of a grid with nu nodes a row: `grid_normals` of a whole one; of one
    cut along an outline the mean over the triangles around a node, weighed by their area.
    """
    if sheet.columns > 0:
        grid_normals(x, nu, sheet.normal)
        return
    normal, triangles = sheet.normal, sheet.triangles
    normal[:] = 0.0
    for f in range(triangles.shape[0]):
        a, b, c = triangles[f, 0], triangles[f, 1], triangles[f, 2]
        px, py, pz = x[0, c] - x[0, a], x[1, c] - x[1, a], x[2, c] - x[2, a]
        qx, qy, qz = x[0, b] - x[0, a], x[1, b] - x[1, a], x[2, b] - x[2, a]
        nx, ny, nz = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
        for k in range(3):
            normal[0, triangles[f, k]] += nx
            normal[1, triangles[f, k]] += ny
            normal[2, triangles[f, k]] += nz
    for i in range(x.shape[1]):
        size = 1.0 / np.sqrt(normal[0, i] ** 2 + normal[1, i] ** 2 + normal[2, i] ** 2 + 1e-60)
        for c in range(3):
            normal[c, i] *= size


@lean_kernel
def wants_normals(sheet):
    """Whether a loop has to fill `sheet.normal` (see `own_sheet`)."""
    return sheet.normal[0, 0] == sheet.normal[0, 0]  # NaN is not


@lean_kernel
def _unit_cross(px, py, pz, qx, qy, qz):
    """p × q, normalised; the zero vector where they are parallel."""
    nx, ny, nz = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
    size = 1.0 / np.sqrt(nx * nx + ny * ny + nz * nz + 1e-60)
    return nx * size, ny * size, nz * size


@lean_kernel
def _border_normal(x, nu, e, i, normal):
    """The same at one node e of the border, the i-th of its row, with one-sided differences."""
    n = x.shape[1]
    left, right = e - (1 if i > 0 else 0), e + (1 if i < nu - 1 else 0)
    top, bottom = e - (nu if e >= nu else 0), e + (nu if e < n - nu else 0)
    px, py, pz = x[0, bottom] - x[0, top], x[1, bottom] - x[1, top], x[2, bottom] - x[2, top]
    qx, qy, qz = x[0, right] - x[0, left], x[1, right] - x[1, left], x[2, right] - x[2, left]
    normal[0, e], normal[1, e], normal[2, e] = _unit_cross(px, py, pz, qx, qy, qz)


@lean_kernel
def bear_inertia(f, mass, extra):
    """Turn the total force f (3, n) N into what the bare masses (n,) kg must feel: f ← m (m I + ΔM)⁻¹ f.

    extra (6, n) kg: ΔM of each node as xx, yy, zz, yz, xz, xy. A node without any is not touched, to the bit.
    """
    for i in range(f.shape[1]):
        if _any(extra, i):
            scale, xx, yy, zz, yz, xz, xy = _inverse_inertia(mass, extra, i)
            fx, fy, fz = f[0, i] * scale, f[1, i] * scale, f[2, i] * scale
            f[0, i] = xx * fx + xy * fy + xz * fz
            f[1, i] = xy * fx + yy * fy + yz * fz
            f[2, i] = xz * fx + yz * fy + zz * fz


@lean_kernel
def invert_inertia(mass, extra, inverse):
    """What `bear_inertia` multiplies forces by, for loops that need it several times in a step, into inverse (8, n):
    whether there is any ΔM, and of nodes that have some one over the determinant of I + ΔM/m, and its cofactors as xx,
    yy, zz, yz, xz, xy.
    """
    some = inverse[0]
    for i in range(some.shape[0]):
        some[i] = 1.0 if _any(extra, i) else 0.0
    for i in range(some.shape[0]):
        if some[i] != 0.0:
            (
                inverse[1, i], inverse[2, i], inverse[3, i], inverse[4, i], inverse[5, i], inverse[6, i], inverse[7, i]
            ) = _inverse_inertia(mass, extra, i)  # fmt: skip


@lean_kernel
def mobilities(free, extra, out):
    """Inverse masses (n,) 1/kg with what effects added, into out: 1/(m + tr ΔM/3), that of masses, and of air carried
    along the mean over all directions. free (n,): 1/m, 0 of a node that is held; extra: as of `bear_inertia`.
    """
    for i in range(free.shape[0]):
        out[i] = free[i] / (1.0 + free[i] * (extra[0, i] + extra[1, i] + extra[2, i]) / 3.0)


@lean_kernel
def bear_inverted(f, inverse):
    """`bear_inertia` with what `invert_inertia` made, to the bit."""
    x, y, z, some, scale = f[0], f[1], f[2], inverse[0], inverse[1]
    xx, yy, zz, yz, xz, xy = inverse[2], inverse[3], inverse[4], inverse[5], inverse[6], inverse[7]
    for i in range(x.shape[0]):
        fx, fy, fz = x[i] * scale[i], y[i] * scale[i], z[i] * scale[i]
        gx = xx[i] * fx + xy[i] * fy + xz[i] * fz
        gy = xy[i] * fx + yy[i] * fy + yz[i] * fz
        gz = xz[i] * fx + yz[i] * fy + zz[i] * fz
        x[i] = gx if some[i] != 0.0 else x[i]
        y[i] = gy if some[i] != 0.0 else y[i]
        z[i] = gz if some[i] != 0.0 else z[i]


@lean_kernel
def _any(extra, i):
    """Whether node i has any ΔM; without branches, so that loops over it use the vector unit."""
    upper = (extra[0, i] != 0.0) | (extra[1, i] != 0.0) | (extra[2, i] != 0.0)
    return upper | (extra[3, i] != 0.0) | (extra[4, i] != 0.0) | (extra[5, i] != 0.0)


@lean_kernel
def _inverse_inertia(mass, extra, i):
    """Of node i: 1/det of I + ΔM/m, and its cofactors xx, yy, zz, yz, xz, xy."""
    m = mass[i]
    xx, yy, zz = 1.0 + extra[0, i] / m, 1.0 + extra[1, i] / m, 1.0 + extra[2, i] / m
    yz, xz, xy = extra[3, i] / m, extra[4, i] / m, extra[5, i] / m
    axx, axy, axz = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    ayy, ayz, azz = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    return 1.0 / (xx * axx + xy * axy + xz * axz), axx, ayy, azz, ayz, axz, axy
