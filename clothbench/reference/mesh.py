"""Meshes of the reference simulation: rows of nearly equilateral triangles, every second row shifted by half; and the
same lattice cut to a ring.

Why this lattice: all inner nodes are alike (a Bravais lattice), so a sheet of uniform curvature is in balance
node by node and none can relax into a checkerboard, which spoils hinge bending where diagonals alternate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

EVENED = 12  # times that a ring's nodes near its rims are moved to the middle of their neighbours


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


def ring(inner: float, outer: float, edge: float) -> tuple[Mesh, np.ndarray]:
    """What of a disc hangs over a plate: a ring of the lattice about (0, 0), from `inner` to `outer` m, and the numbers
    of its nodes on and within the plate's rim, which the plate holds. edge: m, of the triangles.

    Nodes stand on both rims, and on one more circle within the inner, so that the plate holds the slope too. Between
    them the lattice, evened out where it meets them. It has no rows: row_start says all nodes are one.
    """
    from scipy.spatial import Delaunay

    height = edge * np.sqrt(3) / 2
    j, i = (np.arange(-k, k + 1) for k in (int(outer / height) + 1, int(outer / edge) + 2))
    lattice = np.stack(np.meshgrid(i * edge, j * height), axis=-1)
    lattice[1::2, :, 0] += edge / 2
    points = lattice.reshape(-1, 2)
    away = np.linalg.norm(points, axis=1)
    points = points[(away > inner + 0.6 * edge) & (away < outer - 0.6 * edge)]
    rims = [_circle(radius, edge) for radius in (inner - height, inner, outer)]
    fixed = np.concatenate(rims)
    for _ in range(EVENED):
        material = np.concatenate([fixed, points])
        triangle = _between(Delaunay(material).simplices, material, inner - height, outer)
        moved = material.copy()
        near = abs(np.linalg.norm(material, axis=1) - (inner + outer) / 2) > (outer - inner) / 2 - 2.5 * edge
        near[: len(fixed)] = False
        total, count = np.zeros_like(material), np.zeros(len(material))
        for a, b in ((0, 1), (1, 2), (2, 0)):
            for p, q in ((triangle[:, a], triangle[:, b]), (triangle[:, b], triangle[:, a])):
                np.add.at(total, p, material[q])
                np.add.at(count, p, 1.0)
        moved[near] = total[near] / count[near, None]
        points = moved[len(fixed) :]
    material = np.concatenate([fixed, points])
    triangle = _between(Delaunay(material).simplices, material, inner - height, outer)
    return Mesh(material, triangle, np.array([0, len(material)])), np.arange(len(rims[0]) + len(rims[1]))


def _circle(radius: float, edge: float) -> np.ndarray:
    """Points (K, 2) m evenly on a circle, about an edge apart."""
    turn = 2 * np.pi * np.arange(round(2 * np.pi * radius / edge)) / round(2 * np.pi * radius / edge)
    return radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)


def _between(triangle: np.ndarray, material: np.ndarray, inner: float, outer: float) -> np.ndarray:
    """The triangles (T, 3) whose middle lies in a ring, turned so that their area in (u, v) is positive."""
    middle = np.linalg.norm(material[triangle].mean(axis=1), axis=1)
    triangle = triangle[(middle > inner) & (middle < outer)]
    a, b = _edges(Mesh(material, triangle, np.zeros(1)))
    left = a[:, 0] * b[:, 1] > a[:, 1] * b[:, 0]
    return np.where(left[:, None], triangle, triangle[:, ::-1])


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
