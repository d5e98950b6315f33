"""A drawn surface: triangles over the material points, with finer points between those of a lattice."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clothbench.core.errors import ClothbenchError

HEM = 1e-6  # m, by which the outermost points of a cloth may miss its hem
SLIVER = 0.05  # altitude over longest side below which a triangle only joins points along the hem


@dataclass(frozen=True, eq=False)
class Surface:
    """material: (M, 2) m, the drawn points; triangle: (F, 3) of them; weight: (M, N), each point as a sum of the N
    nodes, or None where they are the nodes themselves (then a node that was not seen takes only its triangles along).
    """

    material: np.ndarray
    triangle: np.ndarray
    weight: np.ndarray | None = None

    def __call__(self, position: np.ndarray) -> np.ndarray:
        """Nodes (..., N, 3) m → drawn points (..., M, 3) m."""
        return position if self.weight is None else np.matmul(self.weight, position)


def surface_of(material: np.ndarray, refine: int = 1, size: tuple[float, float] | None = None) -> Surface:
    """The surface over material points (N, 2) m; the same for any order of them.

    On a whole lattice, every cell is cut into refine × refine, whose corners a cubic through the four nearest lines
    each way finds: a model's mesh is no facetted thing, and stripes would show its facets. Scattered points are joined
    by Delaunay triangles as they are. size: (width, height) m of the cloth, to whose hems a lattice that is refined
    goes straight on from its two outermost lines, by as much as these are apart at most.
    """
    u, v = (np.unique(material[:, i].round(9)) for i in (0, 1))
    order = np.lexsort(material.round(9).T)  # row by row, whatever order the nodes came in
    if len(u) * len(v) != len(material) or min(len(u), len(v)) < 2:
        return Surface(material, order[delaunay(material[order])])
    if refine == 1:
        return Surface(material, order[_cells(len(u), len(v))])
    whole = (u, v) if size is None else (_to_hem(u, size[0]), _to_hem(v, size[1]))
    return _refined(u, v, order, [_finer(lines, refine) for lines in whole])


def _to_hem(lines: np.ndarray, size: float) -> np.ndarray:
    """The lines (L,) m of a lattice with those at 0 and `size` m, where these lie farther out."""
    first, last = max(0.0, 2 * lines[0] - lines[1]), min(size, 2 * lines[-1] - lines[-2])
    before, after = lines[0] - first > HEM, last - lines[-1] > HEM
    return np.concatenate([[first] if before else [], lines, [last] if after else []])


def _refined(u: np.ndarray, v: np.ndarray, order: np.ndarray, fine: list[np.ndarray]) -> Surface:
    fine_u, fine_v = fine
    weight = np.empty((len(fine_u) * len(fine_v), len(order)))
    weight[:, order] = np.kron(cubic_weights(v, fine_v), cubic_weights(u, fine_u))
    grid = np.stack(np.meshgrid(fine_u, fine_v), axis=-1).reshape(-1, 2)
    return Surface(grid, _cells(len(fine_u), len(fine_v)), weight)


def _finer(lines: np.ndarray, refine: int) -> np.ndarray:
    steps = np.arange(refine) / refine
    return np.append((lines[:-1, None] + np.diff(lines)[:, None] * steps).ravel(), lines[-1])


def _cells(across: int, down: int) -> np.ndarray:
    """Two triangles for each cell of a grid with `across` points in a row, (2 (across-1) (down-1), 3)."""
    corner = (np.arange(down - 1)[:, None] * across + np.arange(across - 1)).ravel()
    a, b, c, d = corner, corner + 1, corner + across, corner + across + 1
    return np.concatenate([np.stack([a, c, b], axis=1), np.stack([b, c, d], axis=1)]).astype(np.int64)


def cubic_weights(lines: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Weights (M, L) by which the cubic through the four nearest of L lines reads `at` (M,); the straight line through
    the outermost two beyond them, where a cubic would soon go anywhere.
    """
    count = min(4, len(lines))
    first = np.clip(np.searchsorted(lines, at, side="right") - 2, 0, len(lines) - count)
    out = np.zeros((len(at), len(lines)))
    for row, (x, begin) in enumerate(zip(at, first, strict=True)):
        if not lines[0] <= x <= lines[-1]:
            outer, inner = (0, 1) if x < lines[0] else (-1, -2)
            beyond = (x - lines[outer]) / (lines[outer] - lines[inner])
            out[row, outer], out[row, inner] = 1 + beyond, -beyond
            continue
        near = lines[begin : begin + count]
        gap = near[:, None] - near
        np.fill_diagonal(gap, 1.0)
        factor = np.where(np.eye(count, dtype=bool), 1.0, (x - near) / gap)
        out[row, begin : begin + count] = factor.prod(axis=1)
    return out


def delaunay(material: np.ndarray) -> np.ndarray:
    """Delaunay triangles (F, 3) of material points (N, 2) m without slivers; points on one line are refused."""
    from scipy.spatial import Delaunay, QhullError

    try:
        triangle = Delaunay(material).simplices
    except (QhullError, ValueError):
        raise ClothbenchError("the material points lie on one line: there is no surface to draw") from None
    corner = material[triangle]
    side = np.roll(corner, -1, axis=1) - corner
    area = np.abs(side[:, 0, 0] * side[:, 1, 1] - side[:, 0, 1] * side[:, 1, 0])
    return triangle[area > SLIVER * (side**2).sum(axis=-1).max(axis=1)].astype(np.int64)
