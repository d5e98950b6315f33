"""Meshes of triangles: those of a grid, and the weights by which derivatives are read off any of them."""

from __future__ import annotations

import numpy as np

AT_CLAMP = np.sqrt(2.0)  # times the curvature where cloth leaves a clamp, see `curvature_weights`


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


def triangle_slots(
    uv: np.ndarray,
    triangles: np.ndarray,
    face_area: np.ndarray,
    whole: bool = True,
    clamped: np.ndarray | None = None,
) -> tuple[int, np.ndarray, np.ndarray]:
    """How compiled loops go over all triangles at once: `columns`, `spacing` and `slots` of a sheet.

    columns: nodes in a row if the mesh is `grid_triangles` between straight lines, none of which is cut (`whole`), else
    0. Such a grid has a slot per kind of triangle for each node e = j·nu + i up to the last cell, first all (e, e+1,
    e+nu+1), then all (e, e+nu+1, e+nu): nodes and neighbours of all triangles of a kind lie at constant distances, and
    no loop needs their numbers.
    Any other mesh has a slot per triangle.
    spacing: (2, 3n) 1/m of a grid, 1/h_u and 1/h_v from each node to the next, 0 where there is none, three times over
    for loops that run through x, y and z; else (2, 0).
    slots: (4, S), area of cloth m², 0 where a row ends; and weights. Of a grid they are what makes ∂²/∂u², ∂²/∂v² and
    ∂²/∂u∂v as `curvature_weights` sees them of differences of first derivatives, 1/m, 0 where nothing holds the slope;
    else 1. clamped: (F,), see `clamped_triangles`.
    """
    columns = _grid_columns(uv, triangles) if whole else 0
    if columns == 0:
        return 0, np.zeros((2, 0)), np.vstack([face_area[None], np.ones((3, len(face_area)))])
    u, v = uv[:columns, 0], uv[::columns, 1]
    spacing, cells = np.zeros((2, len(v), columns)), np.zeros((4, 2, len(v) - 1, columns))
    spacing[0, :, :-1], spacing[1, :-1] = 1 / np.diff(u), 1 / np.diff(v)[:, None]
    cells[0, :, :, :-1] = np.moveaxis(face_area.reshape(len(v) - 1, columns - 1, 2), 2, 0)
    cells[1, 0, :, :-2], cells[1, 1, :, 1:] = spacing[0, 1:, :-2], spacing[0, 1:, 1:]
    cells[2, 0, 1:], cells[2, 1, :-1] = spacing[1, 1:-1], spacing[1, :-2]
    cells[3] = spacing[1, :-1]
    if clamped is not None and clamped.any():
        _stiffen_clamps(cells, clamped[::2].reshape(len(v) - 1, columns - 1))
    slots = cells.reshape(4, 2, -1)[:, :, :-1].reshape(4, -1)
    return columns, np.tile(spacing.reshape(2, -1), 3), np.ascontiguousarray(slots)


def _stiffen_clamps(cells: np.ndarray, clamped: np.ndarray) -> None:
    """What clamped cells (nv − 1, nu − 1) make of the weights of slots (4, 2, nv − 1, nu), as `curvature_weights`."""
    beyond = np.pad(clamped, 1, mode="edge")
    right, left, above, below = beyond[1:-1, 2:], beyond[1:-1, :-2], beyond[:-2, 1:-1], beyond[2:, 1:-1]
    for component, kind, neighbour in ((1, 0, right), (1, 1, left), (2, 0, above), (2, 1, below)):
        cells[component, kind, :, :-1] *= np.where(clamped != neighbour, AT_CLAMP, 1.0)


def clamped_triangles(triangles: np.ndarray, held: np.ndarray, cloth: np.ndarray) -> np.ndarray:
    """Which triangles (F,) lie between grips: all three corners are `held` (G,), and there is `cloth` (F,) m² in them;
    of a cell whose two triangles follow each other as in `grid_triangles`, cut or not, both or none.
    """
    clamped = np.isin(triangles, held).all(axis=1) & (cloth > 0)
    (a, b, d), (also_a, also_d, c) = triangles[:-1].T, triangles[1:].T
    cells = np.flatnonzero((also_a == a) & (also_d == d) & (b == a + 1) & (c == d - 1))
    clamped[cells] = clamped[cells + 1] = clamped[cells] & clamped[cells + 1]
    return clamped


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
    uv: np.ndarray,
    triangles: np.ndarray,
    gradient: np.ndarray,
    face_area: np.ndarray,
    clamped: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Patches (F, 6) and the second derivatives (F, 3, 6) 1/m² over each triangle, from its three neighbours.

    κ = Σ_k l_k/(2A) [n_k·(∇x_k − ∇x)] n_k ⊗ n_k over the edges k of a triangle, with length l_k, normal n_k and the
    neighbour's gradient ∇x_k: the mean over the triangle of the slope's derivative, slopes on an edge being the mean
    of both sides (the rotation-free triangle of Oñate and Zárate 2000, there called BST). Exact for quadratic shapes
    on a regular mesh. At a free edge nothing holds the slope: the bending across it is what costs least, which
    without cross contraction is none, n·κ·n = 0.

    clamped: (F,), triangles in a clamp, None for none. Where the cloth leaves a clamp its slope turns from the edge on,
    over half the way between the middles of two triangles: twice the curvature over half the area. The two triangles at
    that edge have √2 times the curvature across it, which costs as much; as between others, the cloth would begin to
    turn half a triangle inside the clamp. That is exact for energies quadratic in the curvature. Couples
    (`rest_curvature`, `crease`) and what yields or rubs (`plastic_bending`, `bending_hysteresis`) are of another law,
    and approach the edge with first order: the tip of a strip that curls and is clamped at two columns is 8, 4 and 2 %
    too far off with 5, 10 and 20 free cells (as between others 20, 10 and 5 %).
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
    if clamped is not None and clamped.any():
        at_edge = (beyond >= 0) & (clamped[beyond] != clamped[:, None])
        for f in np.flatnonzero(at_edge.any(axis=1)):
            weights[f] += (AT_CLAMP - 1) * _across(normals[f, at_edge[f]], weights[f])
    for f in np.flatnonzero((beyond < 0).any(axis=1)):
        weights[f] -= _across(normals[f, beyond[f] < 0], weights[f])
    weights[:, 2] /= np.sqrt(2.0)
    return np.ascontiguousarray(patch), np.ascontiguousarray(weights)


def _across(normals: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """The part of a curvature, as weights (3, 6), that lies across edges of these normals ⊗ themselves (K, 3)."""
    return np.asarray(normals.T @ np.linalg.lstsq(normals.T, weights, rcond=None)[0])


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
