"""What compiled code of models and effects shares: the sheet an effect sees, and the kernel decorator."""

from __future__ import annotations

import textwrap
import warnings
from collections import namedtuple
from collections.abc import Callable

import numpy as np
from numba import njit, types
from numba.core.errors import NumbaError, NumbaExperimentalFeatureWarning

from clothbench.core.errors import ClothbenchError

Sheet = namedtuple(
    "Sheet",
    "uv mass area normal triangles gradient face_area patch curvature gravity air_density held grip columns "
    "spacing slots",
)
Sheet.__doc__ = """The cloth as an effect sees it; `sheet_of` makes one from any mesh of triangles.

uv: (n, 2) m, rest coordinates; mass: (n,) kg and area: (n,) m² of each node; normal: (3, n), unit, at this step;
triangles: (F, 3), node numbers; face_area: (F,) m², at rest;
gradient: (F, 2, 3) 1/m, ∂/∂u and ∂/∂v over a triangle as weights of its corners;
patch: (F, 6), the corners, then the node beyond the edge opposite to each corner (a corner again at the border);
curvature: (F, 3, 6) 1/m², ∂²/∂u², ∂²/∂v² and ∂²/∂u∂v as weights of the patch (see `curvature_weights`);
gravity: (3,) m/s²; air_density: kg/m³; held: (G,), the node on each grip; grip: (3, G) m, where the grips are;
columns, spacing, slots: for loops over all triangles at once, see `triangle_slots`.
"""

_vector = types.float64[::1]
_rows = types.float64[:, ::1]
_blocks = types.float64[:, :, ::1]
_nodes = types.int64[:, ::1]
SHEET = types.NamedTuple(
    (
        _rows,
        _vector,
        _vector,
        _rows,
        _nodes,
        _blocks,
        _vector,
        _nodes,
        _blocks,
        _vector,
        types.float64,
        types.int64[::1],
        _rows,
        types.int64,
        _rows,
        _rows,
    ),
    Sheet,
)
SIGNATURE = types.void(types.float64, types.float64, _rows, _rows, _rows, SHEET, _vector, _vector)
EFFECT = types.FunctionType(SIGNATURE)

_fast = njit(cache=True, error_model="numpy", nogil=True)


def effect_kernel(function: Callable) -> Callable:
    """Compile an effect's `force` or `inertia` for the time loops of all models (see `clothbench.Effect`).

    `function(t, dt, x, v, f, sheet, p, state)` adds to f in place: forces (3, n), or for `inertia` masses (6, n).
    Compiled when a model first takes it (`ready`), so that nobody waits for effects that he does not use, and cached
    on disk.
    """
    return _fast(function)


def ready(kernel: Callable, name: str) -> Callable:
    """An effect's kernel compiled for the time loops; `name` tells an author which one cannot be."""
    try:
        kernel.compile(SIGNATURE)  # type: ignore[attr-defined]
    except NumbaError as error:
        reason = textwrap.shorten(str(error).partition("\n")[2] or str(error), 300)
        raise ClothbenchError(f"{name} cannot be compiled by numba: {reason}") from error
    return kernel


def compiled(signature) -> Callable[[Callable], Callable]:
    """`njit` for a kernel with a stated signature, compiled where it is defined and cached on disk.

    Functions as values are marked experimental by numba (they let one time loop call any effect); that is
    no news to a user.
    """

    def decorate(function: Callable) -> Callable:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NumbaExperimentalFeatureWarning)
            return njit(signature, cache=True, error_model="numpy", nogil=True)(function)

    return decorate


@effect_kernel
def no_effect(t, dt, x, v, f, sheet, p, state):
    """Fills the slots of a time loop that has no effect there."""


@_fast
def grid_normals(x, nu, normal):
    """Unit normals (3, n) of a regular grid x (3, n) m, nu nodes a row: cross product of the central differences.

    A node where the sheet has collapsed gets the zero vector: nothing can push on it along a normal.
    """
    n = x.shape[1]
    inner = n - 2 * nu
    # All inner rows at once first, as if rows did not end: without branches the compiler can use the vector unit.
    lx, ly, lz = x[0, nu - 1 : nu - 1 + inner], x[1, nu - 1 : nu - 1 + inner], x[2, nu - 1 : nu - 1 + inner]
    rx, ry, rz = x[0, nu + 1 : nu + 1 + inner], x[1, nu + 1 : nu + 1 + inner], x[2, nu + 1 : nu + 1 + inner]
    tx, ty, tz = x[0, :inner], x[1, :inner], x[2, :inner]
    bx, by, bz = x[0, 2 * nu : 2 * nu + inner], x[1, 2 * nu : 2 * nu + inner], x[2, 2 * nu : 2 * nu + inner]
    ox, oy, oz = normal[0, nu : nu + inner], normal[1, nu : nu + inner], normal[2, nu : nu + inner]
    for e in range(inner):
        px, py, pz = bx[e] - tx[e], by[e] - ty[e], bz[e] - tz[e]
        qx, qy, qz = rx[e] - lx[e], ry[e] - ly[e], rz[e] - lz[e]
        ox[e], oy[e], oz[e] = _unit_cross(px, py, pz, qx, qy, qz)
    for i in range(nu):
        _border_normal(x, nu, i, normal)
        _border_normal(x, nu, n - nu + i, normal)
    for j in range(1, n // nu - 1):
        _border_normal(x, nu, j * nu, normal)
        _border_normal(x, nu, j * nu + nu - 1, normal)


@_fast
def wants_normals(sheet):
    """Whether a loop has to fill `sheet.normal` (see `own_sheet`)."""
    return sheet.normal[0, 0] == sheet.normal[0, 0]  # NaN is not


@_fast
def _unit_cross(px, py, pz, qx, qy, qz):
    """p × q, normalised; the zero vector where they are parallel."""
    nx, ny, nz = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
    size = 1.0 / np.sqrt(nx * nx + ny * ny + nz * nz + 1e-60)
    return nx * size, ny * size, nz * size


@_fast
def _border_normal(x, nu, e, normal):
    """The same at one node of the border, with one-sided differences."""
    i, n = e % nu, x.shape[1]
    left, right = e - (1 if i > 0 else 0), e + (1 if i < nu - 1 else 0)
    top, bottom = e - (nu if e >= nu else 0), e + (nu if e < n - nu else 0)
    px, py, pz = x[0, bottom] - x[0, top], x[1, bottom] - x[1, top], x[2, bottom] - x[2, top]
    qx, qy, qz = x[0, right] - x[0, left], x[1, right] - x[1, left], x[2, right] - x[2, left]
    normal[0, e], normal[1, e], normal[2, e] = _unit_cross(px, py, pz, qx, qy, qz)


@_fast
def bear_inertia(f, mass, extra):
    """Turn the total force f (3, n) N into what the bare masses (n,) kg must feel: f ← m (m I + ΔM)⁻¹ f.

    extra (6, n) kg: ΔM of each node as xx, yy, zz, yz, xz, xy. A node without any is not touched, to the bit.
    """
    for i in range(f.shape[1]):
        if (
            extra[0, i] == 0.0 and extra[1, i] == 0.0 and extra[2, i] == 0.0
            and extra[3, i] == 0.0 and extra[4, i] == 0.0 and extra[5, i] == 0.0
        ):  # fmt: skip
            continue
        m = mass[i]
        xx, yy, zz = 1.0 + extra[0, i] / m, 1.0 + extra[1, i] / m, 1.0 + extra[2, i] / m
        yz, xz, xy = extra[3, i] / m, extra[4, i] / m, extra[5, i] / m
        # Cofactors of the symmetric 3 × 3 matrix.
        axx, axy, axz = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
        ayy, ayz, azz = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
        scale = 1.0 / (xx * axx + xy * axy + xz * axz)
        fx, fy, fz = f[0, i] * scale, f[1, i] * scale, f[2, i] * scale
        f[0, i] = axx * fx + axy * fy + axz * fz
        f[1, i] = axy * fx + ayy * fy + ayz * fz
        f[2, i] = axz * fx + ayz * fy + azz * fz


# --- meshes -----------------------------------------------------------------------------------------------------------


def grid_triangles(shape: tuple[int, int]) -> np.ndarray:
    """Triangles (F, 3) of a regular grid (nu, nv), node number j·nu + i; two a cell, all diagonals i, j → i+1, j+1.

    With one direction of diagonals every node sees the same neighbours, and the mean of two triangles that share an
    edge is exact for quadratic shapes; with alternating ones it is not, and bending comes out wrong on every mesh.
    """
    nu, nv = shape
    i, j = (a.ravel() for a in np.meshgrid(np.arange(nu - 1), np.arange(nv - 1)))
    a = j * nu + i
    b, c, d = a + 1, a + nu, a + nu + 1
    cells = np.stack([np.stack([a, b, d], 1), np.stack([a, d, c], 1)], 1)
    return np.ascontiguousarray(cells.reshape(-1, 3).astype(np.int64))


def sheet_of(
    uv: np.ndarray, mass: np.ndarray, area: np.ndarray, triangles: np.ndarray, gravity, air_density: float, held=()
) -> Sheet:
    """The `Sheet` of a mesh of triangles, for compiled loops; normals are zero until a loop fills them.

    uv: (n, 2) m; mass: (n,) kg; area: (n,) m²; triangles: (F, 3); held: (G,) nodes. A loop on another
    thread needs a copy with arrays of its own where it writes: `own_sheet(sheet)`.
    """
    gradient, face_area = gradient_weights(uv, triangles)
    patch, curvature = curvature_weights(uv, triangles, gradient, face_area)
    columns, spacing, slots = triangle_slots(uv, triangles, face_area)
    return Sheet(
        np.ascontiguousarray(uv, dtype=float), np.array(mass, dtype=float), np.array(area, dtype=float),
        np.zeros((3, len(uv))), np.ascontiguousarray(triangles, dtype=np.int64), gradient, face_area, patch, curvature,
        np.array(gravity, dtype=float), float(air_density), np.array(held, dtype=np.int64), np.zeros((3, len(held))),
        columns, spacing, slots,
    )  # fmt: skip


def own_sheet(sheet: Sheet, normals: bool = True) -> Sheet:
    """A copy for one thread: normals and grips, which a loop fills at every step, of its own.

    normals: whether anything reads them; else they are NaN, and stay so in a loop that asks `wants_normals`.
    """
    return sheet._replace(normal=np.full_like(sheet.normal, 0.0 if normals else np.nan), grip=np.zeros_like(sheet.grip))


def triangle_slots(uv: np.ndarray, triangles: np.ndarray, face_area: np.ndarray) -> tuple[int, np.ndarray, np.ndarray]:
    """How compiled loops go over all triangles at once: `columns`, `spacing` and `slots` of a sheet.

    columns: nodes in a row if the mesh is `grid_triangles` between straight lines, else 0. Such a grid has a slot per
    kind of triangle for each node e = j·nu + i up to the last cell, first all (e, e+1, e+nu+1), then all (e, e+nu+1,
    e+nu): nodes and neighbours of all triangles of a kind lie at constant distances, and no loop needs their numbers.
    Any other mesh has a slot per triangle.
    spacing: (2, 3n) 1/m of a grid, 1/h_u and 1/h_v from each node to the next, 0 where there is none, three times over
    for loops that run through x, y and z; else (2, 0).
    slots: (4, S), area m², 0 where a row ends; and weights. Of a grid they are what makes ∂²/∂u², ∂²/∂v² and ∂²/∂u∂v
    as `curvature_weights` sees them of differences of first derivatives, 1/m, 0 where nothing holds the slope; else 1.
    """
    columns = _grid_columns(uv, triangles)
    if columns == 0:
        return 0, np.zeros((2, 0)), np.vstack([face_area[None], np.ones((3, len(face_area)))])
    u, v = uv[:columns, 0], uv[::columns, 1]
    spacing, cells = np.zeros((2, len(v), columns)), np.zeros((4, 2, len(v) - 1, columns))
    spacing[0, :, :-1], spacing[1, :-1] = 1 / np.diff(u), 1 / np.diff(v)[:, None]
    cells[0, :, :, :-1] = 0.5 * np.outer(np.diff(v), np.diff(u))
    cells[1, 0, :, :-2], cells[1, 1, :, 1:] = spacing[0, 1:, :-2], spacing[0, 1:, 1:]
    cells[2, 0, 1:], cells[2, 1, :-1] = spacing[1, 1:-1], spacing[1, :-2]
    cells[3] = spacing[1, :-1]
    slots = cells.reshape(4, 2, -1)[:, :, :-1].reshape(4, -1)
    return columns, np.tile(spacing.reshape(2, -1), 3), np.ascontiguousarray(slots)


def _grid_columns(uv: np.ndarray, triangles: np.ndarray) -> int:
    """nu of a grid of straight lines u, v that ascend, node number j·nu + i, with the triangles of `grid_triangles`."""
    columns = int(triangles[0, 2]) - 1 if len(triangles) else 0
    if columns < 2 or len(uv) % columns or len(uv) < 2 * columns:
        return 0
    shape = (columns, len(uv) // columns)
    lines = uv.reshape(shape[1], columns, 2)
    straight = (lines[:, :, 0] == lines[0, :, 0]).all() and (lines[:, :, 1] == lines[:, :1, 1]).all()
    ascending = (np.diff(lines[0, :, 0]) > 0).all() and (np.diff(lines[:, 0, 1]) > 0).all()
    return columns if straight and ascending and np.array_equal(triangles, grid_triangles(shape)) else 0


def gradient_weights(uv: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """∂/∂u and ∂/∂v of a field that is linear over each triangle, (F, 2, 3) 1/m; and the areas (F,) m²."""
    corner = uv[triangles]
    side = np.roll(corner, -2, axis=1) - np.roll(corner, -1, axis=1)  # opposite to each corner
    double = side[:, 0, 0] * side[:, 1, 1] - side[:, 0, 1] * side[:, 1, 0]
    weights = np.stack([-side[:, :, 1], side[:, :, 0]], axis=1) / double[:, None, None]
    return np.ascontiguousarray(weights), np.abs(double) / 2


def curvature_weights(
    uv: np.ndarray, triangles: np.ndarray, gradient: np.ndarray, face_area: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Patches (F, 6) and the second derivatives (F, 3, 6) 1/m² over each triangle, from its three neighbours.

    κ = Σ_k l_k/(2A) [n_k·(∇x_k − ∇x)] n_k ⊗ n_k over the edges k of a triangle, with length l_k, normal n_k and the
    neighbour's gradient ∇x_k: the mean over the triangle of the slope's derivative, slopes on an edge being the mean
    of both sides (the rotation-free triangle of Oñate and Zárate 2000, there called BST). Exact for quadratic shapes
    on a regular mesh. At a free edge nothing holds the slope: the bending across it is what costs least, which
    without cross contraction is none, n·κ·n = 0.
    """
    beyond, far = _neighbours(triangles)
    rows = np.arange(len(triangles))
    patch = np.hstack([triangles, np.where(far < 0, triangles, far)])
    # In the orthonormal components uu, vv, √2 uv.
    weights, normals = np.zeros((len(triangles), 3, 6)), np.zeros((len(triangles), 3, 3))
    for k in range(3):
        one, two = (k + 1) % 3, (k + 2) % 3
        a, b, c = (uv[triangles[:, m]] for m in (one, two, k))
        edge = b - a
        length = np.linalg.norm(edge, axis=1, keepdims=True)
        n = np.stack([edge[:, 1], -edge[:, 0]], axis=1) / length
        n *= -np.sign(((c - a) * n).sum(axis=1, keepdims=True))  # outwards
        normals[:, k] = np.stack([n[:, 0] ** 2, n[:, 1] ** 2, np.sqrt(2.0) * n[:, 0] * n[:, 1]], axis=1)
        jump = np.zeros((len(triangles), 6))
        jump[:, :3] = -np.einsum("fi,fim->fm", n, gradient)
        other = triangles[beyond[:, k]]  # nonsense at the border, where it is left out below
        slope = np.einsum("fi,fim->fm", n, gradient[beyond[:, k]])
        for m in range(3):
            place = np.select([other[:, m] == triangles[:, one], other[:, m] == triangles[:, two]], [one, two], 3 + k)
            jump[rows, place] += slope[:, m]
        share = np.where(beyond[:, k : k + 1] < 0, 0.0, length / (2 * face_area[:, None]))
        weights += normals[:, k, :, None] * (share * jump)[:, None]
    for f in np.flatnonzero((beyond < 0).any(axis=1)):
        span = normals[f, beyond[f] < 0].T
        weights[f] -= span @ np.linalg.lstsq(span, weights[f], rcond=None)[0]
    weights[:, 2] /= np.sqrt(2.0)
    return np.ascontiguousarray(patch), np.ascontiguousarray(weights)


def _neighbours(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The triangle, and its far corner, beyond the edge opposite to each corner: (F, 3), (F, 3); −1 at the border."""
    seen: dict[tuple[int, int], tuple[int, int]] = {}
    beyond, far = np.full(triangles.shape, -1), np.full(triangles.shape, -1)
    for f, own in enumerate(triangles.tolist()):
        for k in range(3):
            one, two = own[(k + 1) % 3], own[(k + 2) % 3]
            edge = (one, two) if one < two else (two, one)
            if edge in seen:
                g, m = seen[edge]
                beyond[f, k], beyond[g, m] = g, f
                far[f, k], far[g, m] = triangles[g, m], own[k]
            else:
                seen[edge] = (f, k)
    return beyond, far
