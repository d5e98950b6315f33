"""The grid of `mass_spring`: where its lines lie, and what each spring and node of it stands for.

Where the paper behind `mass_spring` gives every node the same mass, nodes here carry the mass, and border springs
the stiffness, of the area they stand for: only then do period and sag converge as the mesh is refined.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from clothbench import ClothbenchError

# (Δi, Δj, is flexion) of the six spring families
FAMILIES = ((1, 0, False), (0, 1, False), (1, 1, False), (-1, 1, False), (2, 0, True), (0, 2, True))


def even_count(asked: int, length: float, held: np.ndarray) -> int:
    """How many evenly spaced lines over [0, length] m to use: the number nearest to `asked` (within 5) for which
    every held coordinate lies on a line, so that no line has to be moved; `asked` if there is none."""
    for count in sorted(range(max(3, asked - 5), asked + 6), key=lambda n: (abs(n - asked), n)):
        at = held / length * (count - 1)
        if np.abs(at - np.round(at)).max(initial=0.0) < 1e-6:
            return count
    return asked


def grid_lines(length: float, count: int, held: np.ndarray) -> np.ndarray:
    """`count` lines over [0, length] m, even except that the nearest line to each held coordinate lies on it."""
    even = np.linspace(0.0, length, count)
    held = np.unique(np.round(held, 9))
    nearest = np.abs(even[:, None] - held[None]).argmin(axis=0)
    if len(set(nearest)) < len(nearest):
        raise ClothbenchError(
            f"grips {length / (count - 1):.3g} m or less apart on a grid of {count} nodes over {length:g} m; "
            "raise the resolution"
        )
    anchors = dict(zip(nearest.tolist(), held.tolist(), strict=True))
    anchors = {0: 0.0, count - 1: length} | anchors
    at = sorted(anchors)
    return np.interp(np.arange(count), at, [anchors[i] for i in at])


@dataclass(frozen=True, eq=False)
class SpringGrid:
    """The springs of one grid, per unit k1 or k2. n nodes, six families.

    uv: (n, 2) m; mass: (n,) kg; area: (n,) m²; strides: (6,); rest: (6, n) m; share: (6, n), stiffness of each
    spring in units of k1 or k2 (0 where a spring would wrap around the edge); node_mass: kg, of an inner node.
    """

    uv: np.ndarray
    mass: np.ndarray
    area: np.ndarray
    strides: np.ndarray
    rest: np.ndarray
    share: np.ndarray
    node_mass: float

    @classmethod
    def of(cls, lines: tuple[np.ndarray, np.ndarray], size: tuple[float, float], areal_density: float) -> SpringGrid:
        u, v = lines
        v_of, u_of = (a.ravel() for a in np.meshgrid(v, u, indexing="ij"))
        wide, high = tributary(u, size[0]), tributary(v, size[1])
        area = np.outer(high, wide).ravel()
        families = [_family(u, v, wide, high, *family) for family in FAMILIES]
        return cls(
            uv=np.ascontiguousarray(np.stack([u_of, v_of], axis=1)),
            mass=areal_density * area,
            area=area,
            strides=np.array([dj * len(u) + di for di, dj, _ in FAMILIES], dtype=np.int64),
            rest=np.stack([f[0] for f in families]),
            share=np.stack([f[1] for f in families]),
            node_mass=areal_density * size[0] * size[1] / ((len(u) - 1) * (len(v) - 1)),
        )

    @cached_property
    def largest_eigenvalues(self) -> tuple[float, float]:
        """Bounds on the largest eigenvalue [1/kg] of M⁻¹K of the flat sheet, for k1 = 1 and for k2 = 1 N/m.

        Gershgorin's circles: each spring with direction d adds share·|d_c|(|d_u| + |d_v|) to the diagonal and as
        much again off it.
        """
        bounds = []
        for flexion in (False, True):
            rows = np.zeros((2, len(self.mass)))
            for family, (_, _, is_flexion) in enumerate(FAMILIES):
                if is_flexion == flexion:
                    self._add_rows(rows, family)
            bounds.append(float((2 * rows / self.mass).max()))
        return bounds[0], bounds[1]

    def _add_rows(self, rows: np.ndarray, family: int) -> None:
        stride = self.strides[family]
        first = np.flatnonzero(self.share[family])
        d = np.abs(self.uv[first + stride] - self.uv[first])
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        weight = (self.share[family, first][:, None] * d * d.sum(axis=1, keepdims=True)).T
        for row, more in zip(rows, weight, strict=True):
            np.add.at(row, first, more)
            np.add.at(row, first + stride, more)


def tributary(lines: np.ndarray, length: float) -> np.ndarray:
    """The length of cloth that each grid line stands for [m]."""
    edges = np.concatenate([[0.0], (lines[1:] + lines[:-1]) / 2, [length]])
    return np.diff(edges)


def _family(u, v, wide, high, di: int, dj: int, flexion: bool) -> tuple[np.ndarray, np.ndarray]:
    """Rest length (n,) m and stiffness share (n,) of one family, at each spring's first node.

    On square cells the share is 1 inside and ½ along a border. Elsewhere it is what keeps the sheet's stiffness per
    width: (width stood for) / (length per cell) for straight springs, 2ab/(a² + b²) for the diagonals of a cell a × b.
    """
    nu, nv = len(u), len(v)
    j, i = (a.ravel() for a in np.meshgrid(np.arange(nv), np.arange(nu), indexing="ij"))
    inside = (i + di >= 0) & (i + di < nu) & (j + dj < nv)
    i2, j2 = np.where(inside, i + di, i), np.where(inside, j + dj, j)
    a, b = np.abs(u[i2] - u[i]), np.abs(v[j2] - v[j])
    rest = np.hypot(a, b)
    with np.errstate(invalid="ignore", divide="ignore"):
        if di and dj:
            share = 2 * a * b / (a**2 + b**2)
        else:
            share = (high[j] if di else wide[i]) / (rest / (2 if flexion else 1))
    return np.where(inside, rest, 1.0), np.where(inside, share, 0.0)
