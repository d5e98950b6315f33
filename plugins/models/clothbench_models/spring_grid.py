"""The grid of the mass-spring models: where its lines lie, and what each spring and node of it stands for.

Where the papers behind the models give every node the same mass, nodes here carry the mass, and border springs
the stiffness, of the area they stand for: only then do period and sag converge as the mesh is refined.

Flexion springs join every second node along rows and columns, as Provot (1995) has them. "Cloth mechanical parameter
estimation …", section 5.2, has [i, j] with [i, j+2] and with [i+2, j+2], by which nothing would resist bending along i.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix, vstack

from clothbench.modelling import Cover, spaces, to_hems, tributary

Families = tuple[tuple[int, int, int], ...]  # (Δi, Δj, which of the model's stiffnesses) of each family of springs
# Provot's: structural, shear, flexion
FAMILIES: Families = ((1, 0, 0), (0, 1, 0), (1, 1, 0), (-1, 1, 0), (2, 0, 1), (0, 2, 1))


@dataclass(frozen=True, eq=False)
class SpringGrid:
    """The springs of one grid, per unit stiffness. n nodes, S families.

    families: (S,), those that fit on the grid; stiffnesses: how many the model has; uv: (n, 2) m; mass: (n,) kg;
    area: (n,) m²; strides: (S,); rest: (S, n) m; share: (S, n), stiffness of each spring in units of its parameter
    (0 where a spring would wrap around the edge); node_mass: kg, of an inner node.
    """

    families: Families
    stiffnesses: int
    uv: np.ndarray
    mass: np.ndarray
    area: np.ndarray
    strides: np.ndarray
    rest: np.ndarray
    share: np.ndarray
    node_mass: float

    @classmethod
    def of(
        cls,
        lines: tuple[np.ndarray, np.ndarray],
        size: tuple[float, float],
        areal_density: float,
        families: Families = FAMILIES,
        cover: Cover | None = None,
    ) -> SpringGrid:
        """The springs between lines u (nu,) and v (nv,) m of a sheet of that size [m], or of what of it is cloth."""
        u, v = lines
        v_of, u_of = (a.ravel() for a in np.meshgrid(v, u, indexing="ij"))
        wide, high = tributary(u, size[0]), tributary(v, size[1])
        area = np.outer(high, wide).ravel()
        if cover is not None:
            wide, high, area = spaces(u), spaces(v), cover.area.ravel()
        stiffnesses = 1 + max(which for _, _, which in families)
        families = tuple(f for f in families if abs(f[0]) < len(u) and f[1] < len(v))
        hems = to_hems(u, size[0]), to_hems(v, size[1])
        springs = [_family(u, v, wide, high, hems, di, dj, cover) for di, dj, _ in families]
        return cls(
            families=families,
            stiffnesses=stiffnesses,
            uv=np.ascontiguousarray(np.stack([u_of, v_of], axis=1)),
            mass=areal_density * area,
            area=area,
            strides=np.array([dj * len(u) + di for di, dj, _ in families], dtype=np.int64),
            rest=np.stack([f[0] for f in springs]),
            share=np.stack([f[1] for f in springs]),
            node_mass=areal_density * size[0] * size[1] / ((len(u) - 1) * (len(v) - 1)),
        )

    @cached_property
    def eigenvalue_rows(self) -> np.ndarray:
        """Gershgorin's circles of M⁻¹K of the flat sheet, their largest values for each stiffness being 1 N/m alone:
        (K, 2 n) 1/kg. The largest row of any mix bounds the eigenvalues.

        Each spring with direction d adds share·|d_c|(|d_u| + |d_v|) to the diagonal and as much again off it.
        """
        bounds = np.zeros((self.stiffnesses, 2, len(self.mass)))
        for family, (_, _, which) in enumerate(self.families):
            self._add_rows(bounds[which], family)
        carrying = np.broadcast_to(self.mass > 0, bounds.shape)
        return np.divide(2 * bounds, self.mass, out=np.zeros_like(bounds), where=carrying).reshape(self.stiffnesses, -1)

    @cached_property
    def largest_eigenvalues(self) -> tuple[float, ...]:
        """The largest eigenvalue [1/kg] of M⁻¹K of the flat sheet, for each stiffness being 1 N/m alone: a fifth to a
        quarter below Gershgorin's circles. To a thousandth, rounded up, so that no last bit of a sum shows in a step.
        """
        from scipy.sparse.linalg import eigsh

        start = np.cos(np.arange(len(self.mass) * 2.0) ** 2)  # any vector will do, but always the same
        exact = (
            eigsh(self._stiffness_matrix(which), k=1, tol=1e-4, v0=start, return_eigenvectors=False)[0]
            for which in range(self.stiffnesses)
        )
        return tuple(float(f"{1.0006 * value:.3e}") for value in exact)

    def _stiffness_matrix(self, which: int) -> csr_matrix:
        """M^-½ K M^-½ in the plane of the nodes that carry mass, one of the stiffnesses being 1 N/m."""
        n = len(self.mass)
        over = np.zeros(n)
        over[self.mass > 0] = self.mass[self.mass > 0] ** -0.5
        rows = []  # of ∂d/∂x of all springs, √share times as long
        for family in (k for k, (_, _, of) in enumerate(self.families) if of == which):
            first = np.flatnonzero(self.share[family] > 0)
            second = first + self.strides[family]
            d = self.uv[second] - self.uv[first]
            d *= (np.sqrt(self.share[family, first]) / np.linalg.norm(d, axis=1))[:, None]
            springs = np.arange(len(first))
            ends = [
                coo_matrix((sign * d[:, c] * over[end], (springs, 2 * end + c)), (len(first), 2 * n))
                for sign, end in ((-1.0, first), (1.0, second))
                for c in range(2)
            ]
            rows.append(sum(ends[1:], ends[0]))
        stretch = csr_matrix(vstack(rows))
        return csr_matrix(stretch.T @ stretch)

    def _add_rows(self, rows: np.ndarray, family: int) -> None:
        stride = self.strides[family]
        first = np.flatnonzero(self.share[family])
        d = np.abs(self.uv[first + stride] - self.uv[first])
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        weight = (self.share[family, first][:, None] * d * d.sum(axis=1, keepdims=True)).T
        for row, more in zip(rows, weight, strict=True):
            np.add.at(row, first, more)
            np.add.at(row, first + stride, more)


def _family(u, v, wide, high, hems, di: int, dj: int, cover: Cover | None) -> tuple[np.ndarray, np.ndarray]:
    """Rest length (n,) m and stiffness share (n,) of one family, at each spring's first node.

    On square cells the share is 1 inside and ½ along a border. Elsewhere it is what keeps the sheet's stiffness per
    width: (width stood for) / (length per cell) for straight springs, 2ab/(a² + b²) for diagonals that span a × b. Of
    the diagonals of cells that are not square that holds for C11 + 2 C12 + C22 only, 4 as on squares for a stiffness of
    1: they have C11 = 4a⁴/(a² + b²)², C22 = 4b⁴/(a² + b²)² and C12 = C66 = 4a²b²/(a² + b²)². Along a hem, which lies
    beside its line where a grip has moved that, all stand for the cloth up to it.
    Where the cloth is cut to an outline, it is the share of that which is cloth.
    """
    nu, nv = len(u), len(v)
    j, i = (a.ravel() for a in np.meshgrid(np.arange(nv), np.arange(nu), indexing="ij"))
    inside = (i + di >= 0) & (i + di < nu) & (j + dj < nv)
    i2, j2 = np.where(inside, i + di, i), np.where(inside, j + dj, j)
    a, b = np.abs(u[i2] - u[i]), np.abs(v[j2] - v[j])
    rest = np.hypot(a, b)
    with np.errstate(invalid="ignore", divide="ignore"):
        straight = (high[j] if di else wide[i]) / (rest / max(di, dj))
        share = 2 * a * b / (a**2 + b**2) if di and dj else straight
    if cover is not None:
        share = np.where(inside, share, 0.0) * cover.springs(di, dj).ravel()
    elif di and dj:
        with np.errstate(invalid="ignore", divide="ignore"):
            share = share * np.abs(hems[0][i2] - hems[0][i]) / a * np.abs(hems[1][j2] - hems[1][j]) / b
    return np.where(inside, rest, 1.0), np.where(inside, share, 0.0)
