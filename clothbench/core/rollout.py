"""The rollout: what a simulation gives back, at the observation's times and material points."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

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

    def __len__(self) -> int:
        return len(self.position)


@dataclass(frozen=True, eq=False)
class Interpolator:
    """Material points as weighted sums of mesh nodes: index (N, k) of nodes, weight (N, k), rows sum to 1."""

    index: np.ndarray
    weight: np.ndarray

    def __call__(self, position: np.ndarray) -> np.ndarray:
        """Node positions (..., nodes, 3) m → (..., N, 3) m."""
        return np.einsum("...nkc,nk->...nc", position[..., self.index, :], self.weight)

    @classmethod
    def on_lines(cls, points: np.ndarray, u: np.ndarray, v: np.ndarray) -> Interpolator:
        """Bilinear between grid lines at u (nu,) and v (nv,) m, node number j·nu + i.

        Points (N, 2) m beyond the outer lines (markers over the hem) are extrapolated from the border cells.
        """
        i, p = _cell(points[:, 0], u)
        j, q = _cell(points[:, 1], v)
        corner = j * len(u) + i
        index = np.stack([corner, corner + 1, corner + len(u), corner + len(u) + 1], axis=1)
        weight = np.stack([(1 - p) * (1 - q), p * (1 - q), (1 - p) * q, p * q], axis=1)
        return cls(index.astype(np.int64), weight)


def _cell(x: np.ndarray, lines: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Number of the cell in which each x lies, and how far along it; on a line the fraction is 0 or 1 exactly."""
    cell = np.clip(np.searchsorted(lines, x + 1e-9, side="right") - 1, 0, len(lines) - 2)
    fraction = (x - lines[cell]) / (lines[cell + 1] - lines[cell])
    return cell, np.where(np.abs(fraction) < 1e-6, 0.0, np.where(np.abs(fraction - 1) < 1e-6, 1.0, fraction))
