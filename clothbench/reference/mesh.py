"""Mesh of the reference simulation: rows of nearly equilateral triangles, every second row shifted by half.

Why this mesh: all inner nodes are alike (a Bravais lattice), so a sheet of uniform curvature is in balance
node by node and none can relax into a checkerboard, which spoils hinge bending where diagonals alternate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Mesh:
    """material: (N, 2) rest (u, v) [m]; triangle: (T, 3) nodes; row_start: (R + 2,) first node per row."""

    material: np.ndarray
    triangle: np.ndarray
    row_start: np.ndarray

    @property
    def area(self) -> np.ndarray:
        """Rest areas [m²], (T,); all positive."""
        a, b = _edges(self)
        return 0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def build(width: float, height: float, columns: int, rows: int) -> Mesh:
    """`columns` edges along u, `rows` rows of triangles along v; equilateral at rows/columns = 1.155 H/W."""
    whole = np.arange(columns + 1) * width / columns
    shifted = np.concatenate([[0.0], whole[:-1] + 0.5 * width / columns, [width]])
    levels = [shifted if j % 2 else whole for j in range(rows + 1)]
    start = np.concatenate([[0], np.cumsum([len(level) for level in levels])])
    v = np.repeat(np.arange(rows + 1) * height / rows, np.diff(start))
    strips = [_strip(start[j], start[j + 1], columns, j % 2 == 1) for j in range(rows)]
    return Mesh(np.column_stack([np.concatenate(levels), v]), np.concatenate(strips), start)


def _strip(upper: int, lower: int, columns: int, upper_is_shifted: bool) -> np.ndarray:
    """Triangles between two rows, turned so that their area in (u, v) is positive."""
    whole, shifted = (lower, upper) if upper_is_shifted else (upper, lower)
    i, k = np.arange(columns + 1), np.arange(columns)
    on_shifted = np.column_stack([whole + i, shifted + i + 1, shifted + i])
    on_whole = np.column_stack([whole + k, whole + k + 1, shifted + k + 1])
    triangle = np.concatenate([on_shifted, on_whole])
    return triangle[:, ::-1] if upper_is_shifted else triangle


def _edges(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    corner = mesh.material[mesh.triangle]
    return corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]


def slopes(mesh: Mesh) -> np.ndarray:
    """Gradients of the shape functions of each triangle's nodes 1 and 2 [1/m], (T, 2, 2): [node, (u, v)]."""
    a, b = _edges(mesh)
    return np.linalg.inv(np.stack([a, b], axis=2))


def lumped_mass(mesh: Mesh, areal_density: float) -> np.ndarray:
    """A third of each triangle's mass on each of its nodes [kg], (N,)."""
    mass = np.zeros(len(mesh.material))
    np.add.at(mass, mesh.triangle.ravel(), np.repeat(areal_density * mesh.area / 3.0, 3))
    return mass


def hinges(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Inner edges as (H, 4) (edge start, end, the two opposite nodes), and l²/(A₁+A₂) of each.

    Calibration. On equilateral triangles of height h, a surface of curvature tensor κ turns the hinge with
    edge direction t and normal n by θ = h(κ_nn − κ_tt/3). Summing ½ k θ² over the three directions gives, per
    area, ½ (√3/2) k κ² for a cylinder along *any* direction, so k = (2/√3) D = D l²/(A₁+A₂). (Sphere and
    saddle come out as of a plate with Poisson ratio −1/3.) The half triangles at the sides keep the formula.
    """
    opposite: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for t, (i, j, k) in enumerate(mesh.triangle.tolist()):
        for start, end, apex in ((i, j, k), (j, k, i), (k, i, j)):
            opposite.setdefault((min(start, end), max(start, end)), []).append((apex, t))
    inner = {edge: sides for edge, sides in opposite.items() if len(sides) == 2}
    nodes = np.array([(*edge, sides[0][0], sides[1][0]) for edge, sides in inner.items()])
    size = mesh.area
    area = np.array([size[sides[0][1]] + size[sides[1][1]] for sides in inner.values()])
    length = np.linalg.norm(mesh.material[nodes[:, 1]] - mesh.material[nodes[:, 0]], axis=1)
    return nodes, length**2 / area


def tracking_weights(mesh: Mesh, points: np.ndarray) -> np.ndarray:
    """Weights (M, N) that read material `points` (M, 2) [m] by cubic interpolation along the row they lie on.

    Cubic, because a chord of the mesh cuts a fold's curve by κ l²/8, about half a marker's noise.
    """
    weights = np.zeros((len(points), len(mesh.material)))
    row_v = mesh.material[mesh.row_start[:-1], 1]
    for m, (u, v) in enumerate(points):
        row = int(np.argmin(abs(row_v - v)))
        if row % 2 or abs(row_v[row] - v) > 1e-9:
            raise ValueError(f"v = {v:g} m is no unshifted row of the mesh; choose another number of rows")
        first, last = mesh.row_start[row], mesh.row_start[row + 1]
        level = mesh.material[first:last, 0]
        near = int(np.clip(np.searchsorted(level, u - 1e-9) - 2, 0, len(level) - 4))
        weights[m, first + near : first + near + 4] = _lagrange(level[near : near + 4], u)
    return weights


def _lagrange(nodes: np.ndarray, at: float) -> np.ndarray:
    gap = nodes[:, None] - nodes[None, :]
    np.fill_diagonal(gap, 1.0)
    factor = np.where(np.eye(len(nodes), dtype=bool), 1.0, (at - nodes[None, :]) / gap)
    return factor.prod(axis=1)
