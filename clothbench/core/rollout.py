"""The rollout: what a simulation gives back, at the observation's times and material points."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from clothbench.core.brief import brief

STATUSES = ("ok", "diverged", "timeout")


@dataclass(frozen=True, eq=False)
class Rollout:
    """Positions of the wanted material points for a batch of B parameter sets.

    position: (B, T, N, 3) m, NaN from the frame on at which a member was stopped; status: B of `STATUSES`;
    steps: (B,) time steps taken; nodes: how many the simulated mesh had (the unit of work is a node-step).
    """

    time: np.ndarray
    position: np.ndarray
    status: tuple[str, ...]
    steps: np.ndarray
    nodes: int
    reasons: tuple[str, ...] = field(default=())

    __repr__ = brief

    def __len__(self) -> int:
        return len(self.position)


@dataclass(frozen=True, eq=False)
class Interpolator:
    """Material points as weighted sums of mesh nodes: index (N, k) of nodes, weight (N, k), rows sum to 1."""

    index: np.ndarray
    weight: np.ndarray

    __repr__ = brief

    def __call__(self, position: np.ndarray) -> np.ndarray:
        """Node positions (..., nodes, 3) m → (..., N, 3) m."""
        return np.einsum("...nkc,nk->...nc", position[..., self.index, :], self.weight)

    @classmethod
    def on_lines(
        cls, points: np.ndarray, u: np.ndarray, v: np.ndarray, nodes: np.ndarray | None = None
    ) -> Interpolator:
        """Bilinear between grid lines at u (nu,) and v (nv,) m, node number j·nu + i.

        Points (N, 2) m beyond the outer lines (markers over the hem) are extrapolated from the border cells; nodes
        (nv, nu): which are of the cloth, None for all: no other is made use of.
        """
        i, p = _cell(points[:, 0], u)
        j, q = _cell(points[:, 1], v)
        if nodes is not None:
            return _on_cut_grid(points, (u, v), nodes, (i, j), (p, q))
        corner = j * len(u) + i
        index = np.stack([corner, corner + 1, corner + len(u), corner + len(u) + 1], axis=1)
        weight = np.stack([(1 - p) * (1 - q), p * (1 - q), (1 - p) * q, p * q], axis=1)
        return cls(index.astype(np.int64), weight)


def _on_cut_grid(
    points: np.ndarray,
    lines: tuple[np.ndarray, np.ndarray],
    nodes: np.ndarray,
    cell: tuple[np.ndarray, np.ndarray],
    at: tuple[np.ndarray, np.ndarray],
) -> Interpolator:
    """As `on_lines`: in a cell with one corner off the cloth, the plane through the other three; in one with more, on
    from the nearest whole cell.
    """
    (u, v), (i, j), (p, q) = lines, cell, at
    whole = nodes[:-1, :-1] & nodes[:-1, 1:] & nodes[1:, :-1] & nodes[1:, 1:]
    middle = np.stack(np.meshgrid((u[1:] + u[:-1]) / 2, (v[1:] + v[:-1]) / 2), axis=-1)
    corners = np.stack([nodes[j, i], nodes[j, i + 1], nodes[j + 1, i], nodes[j + 1, i + 1]], axis=1)
    far = np.flatnonzero(corners.sum(axis=1) < 3)
    if len(far):
        choice = np.argwhere(whole)
        away = ((middle[whole][None] - points[far, None]) ** 2).sum(axis=2)
        jj, ii = choice[away.argmin(axis=1)].T
        i, j, p, q = (a.copy() for a in (i, j, p, q))
        i[far], j[far] = ii, jj
        p[far] = (points[far, 0] - u[ii]) / (u[ii + 1] - u[ii])
        q[far] = (points[far, 1] - v[jj]) / (v[jj + 1] - v[jj])
        corners[far] = True
    weight = np.stack([(1 - p) * (1 - q), p * (1 - q), (1 - p) * q, p * q], axis=1)
    # On the plane through three corners x_a − x_b − x_c + x_d is nothing: as much of it takes away the fourth's weight.
    twist = np.array([1.0, -1.0, -1.0, 1.0])
    missing = np.flatnonzero(~corners.all(axis=1))
    lacking = corners[missing].argmin(axis=1)
    weight[missing] -= (weight[missing, lacking] / twist[lacking])[:, None] * twist
    corner = j * len(u) + i
    index = np.stack([corner, corner + 1, corner + len(u), corner + len(u) + 1], axis=1)
    return Interpolator(index.astype(np.int64), weight)


def _cell(x: np.ndarray, lines: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Number of the cell in which each x lies, and how far along it; on a line the fraction is 0 or 1 exactly."""
    cell = np.clip(np.searchsorted(lines, x + 1e-9, side="right") - 1, 0, len(lines) - 2)
    fraction = (x - lines[cell]) / (lines[cell + 1] - lines[cell])
    return cell, np.where(np.abs(fraction) < 1e-6, 0.0, np.where(np.abs(fraction - 1) < 1e-6, 1.0, fraction))
