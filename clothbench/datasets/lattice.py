"""Unroll measured lattices of a square cloth flat, and read its surface at fixed material points.

A depth-camera mesher lays an n × n lattice over the outline it sees. The surface is good, its labels are
not: a corner is often found some centimetres along the hem, which drags every label near it along. Cloth
hardly stretches, so the measured sheet can be unrolled flat; where a node then lies *is* its material point.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

# A hem is found to about a node's noise and a contour's rounding; further outside than this no cloth was
# seen.
HEM_TOLERANCE = 0.010
# Half a cell's diagonal is 0.707 spacings: every point of a fully seen cell has a seen node at least this
# near.
NEAREST_SEEN = 0.75


def nominal(n: int, side: float) -> np.ndarray:
    """Material coordinates (n·n, 2) in m of the regular lattice that spans the cloth from hem to hem, row by
    row.
    """
    s = np.linspace(0.0, side, n)
    u, v = np.meshgrid(s, s)
    return np.stack([u.ravel(), v.ravel()], axis=-1)


def filled(frames: np.ndarray) -> np.ndarray:
    """Lattices (T, n, n, 3) with unseen nodes bridged from their seen neighbours; for unrolling only."""
    out = frames.copy()
    for _ in range(2 * frames.shape[1]):
        holes = ~np.isfinite(out).all(axis=-1)
        if not holes.any():
            break
        padded = np.pad(out, ((0, 0), (1, 1), (1, 1), (0, 0)), constant_values=np.nan)
        sides = (padded[:, :-2, 1:-1], padded[:, 2:, 1:-1], padded[:, 1:-1, :-2], padded[:, 1:-1, 2:])
        around = np.stack(sides)
        seen = np.isfinite(around).all(axis=-1, keepdims=True)
        mean = np.where(seen, around, 0.0).sum(axis=0) / np.maximum(seen.sum(axis=0), 1)
        out = np.where(holes[..., None] & seen.any(axis=0), mean, out)
    return out


def _springs(n: int) -> np.ndarray:
    """Node pairs (E, 2) one and two steps apart, along rows, columns and diagonals of an n × n lattice."""
    index = np.arange(n * n).reshape(n, n)
    pairs = []
    for k in (1, 2):
        pairs += [
            (index[:, :-k], index[:, k:]),
            (index[:-k], index[k:]),
            (index[:-k, :-k], index[k:, k:]),
            (index[:-k, k:], index[k:, :-k]),
        ]
    return np.concatenate([np.stack([a.ravel(), b.ravel()], axis=-1) for a, b in pairs])


@lru_cache(maxsize=8)
def _majoriser(n: int) -> np.ndarray:
    """The Guttman transform's constant matrix (n·n, E): pseudo-inverse of the springs' Laplacian times
    incidence.
    """
    pairs = _springs(n)
    incidence = np.zeros((len(pairs), n * n))
    rows = np.arange(len(pairs))
    incidence[rows, pairs[:, 0]], incidence[rows, pairs[:, 1]] = 1.0, -1.0
    return np.linalg.pinv(incidence.T @ incidence) @ incidence.T


def unroll(frames: np.ndarray, side: float, steps: int = 60) -> tuple[np.ndarray, np.ndarray]:
    """Flatten lattices (T, n, n, 3) → plane coordinates (T, n·n, 2) in m, and what would not flatten (T,) in
    m.

    Minimises Σ (|m_i − m_j| − |x_i − x_j|)² over near pairs by majorisation (de Leeuw 1977, the Guttman
    transform), from the nominal lattice. The second result is the root mean square of what is left: cloth
    unrolls, noise does not.
    """
    count, n = frames.shape[:2]
    first, second = _springs(n).T
    x = np.moveaxis(frames.reshape(count, n * n, 3), 0, -1)  # frames last: one product serves them all
    length = np.linalg.norm(x[first] - x[second], axis=1)
    solve = _majoriser(n)
    flat = np.repeat((nominal(n, side) - side / 2)[..., None], count, axis=-1)
    for _ in range(steps):
        apart = flat[first] - flat[second]
        distance = np.maximum(np.sqrt(apart[:, 0] ** 2 + apart[:, 1] ** 2), 1e-9)
        flat = (solve @ (apart * (length / distance)[:, None]).reshape(len(first), -1)).reshape(n * n, 2, count)
    return np.moveaxis(flat, -1, 0).copy(), np.sqrt(np.mean((distance - length) ** 2, axis=0))


def place(flat: np.ndarray, side: float, hem: float = 0.006) -> np.ndarray:
    """Move unrolled lattices (T, n·n, 2) rigidly so that their outline lies on the cloth's hem, a square of
    `side` m.

    Only the distance of an outline node to its hem line counts, not where along it the node sits, so a
    corner that slipped along the hem does no harm; Cauchy weights of width `hem` m take out nodes that cut a
    corner.
    """
    count, size = flat.shape[:2]
    n = round(size**0.5)
    grid = flat.reshape(count, n, n, 2)
    outline = np.concatenate([grid[:, :, 0], grid[:, :, -1], grid[:, 0], grid[:, -1]], axis=1)
    axis = np.repeat([0, 0, 1, 1], n)
    line = np.repeat([-side / 2, side / 2, -side / 2, side / 2], n)
    turn, shift = np.zeros(count), np.zeros((count, 2))
    for _ in range(20):
        moved = _turned(outline, turn) + shift[:, None]
        miss = np.take_along_axis(moved, np.broadcast_to(axis[:, None], (count, 4 * n, 1)), axis=-1)[..., 0] - line
        weight = 1.0 / (1.0 + (miss / hem) ** 2)
        slope = np.where(axis == 0, -moved[..., 1], moved[..., 0])
        jacobian = np.stack(
            [slope, np.broadcast_to(axis == 0, slope.shape), np.broadcast_to(axis == 1, slope.shape)], -1
        )
        normal = np.einsum("tki,tk,tkj->tij", jacobian, weight, jacobian) + 1e-9 * np.eye(3)
        step = -np.linalg.solve(normal, np.einsum("tki,tk,tk->ti", jacobian, weight, miss)[..., None])[..., 0]
        shift = _turned(shift[:, None], step[:, 0])[:, 0] + step[:, 1:]
        turn = turn + step[:, 0]
    return _turned(flat, turn) + shift[:, None] + side / 2


def _turned(points: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Plane points (T, K, 2) turned by angles (T,) in rad."""
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    return np.stack([c * points[..., 0] - s * points[..., 1], s * points[..., 0] + c * points[..., 1]], axis=-1)


def resample(frames: np.ndarray, flat: np.ndarray, side: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The measured surfaces (T, n, n, 3) at the nominal material points: positions (T, n·n, 3), unseen,
    outside.

    `flat` (T, n·n, 2) says which material point each node really is. Around every nominal point the surface
    is taken as a plane through the seen nodes near it (moving least squares, Gaussian of half a spacing), so
    a node that did not slip keeps its place. `unseen` and `outside` (T, n·n) mark points without a seen node
    near, and points further outside the seen outline than a hem's tolerance; both come back as NaN, nothing
    is invented.
    """
    count, n = frames.shape[:2]
    spacing = side / (n - 1)
    target = nominal(n, side)
    x = frames.reshape(count, n * n, 3)
    seen = np.isfinite(x).all(axis=-1)
    offset = flat[:, None] - target[None, :, None]
    square = np.where(seen[:, None], (offset**2).sum(axis=-1), np.inf)
    weight = np.exp(-square / (2 * (spacing / 2) ** 2))
    basis = np.concatenate([np.ones((*offset.shape[:-1], 1)), offset / spacing], axis=-1)
    weighted = (basis * weight[..., None]).swapaxes(-1, -2)
    right = weighted @ np.where(seen[..., None], x, 0.0)[:, None]
    position = np.linalg.solve(weighted @ basis + 1e-6 * np.eye(3), right)[:, :, 0]
    unseen = np.sqrt(square.min(axis=-1)) > NEAREST_SEEN * spacing
    outside = _outside(flat.reshape(count, n, n, 2), target) & ~unseen
    position[unseen | outside] = np.nan
    return position, unseen, outside


def _outside(grid: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Which points (Q, 2) lie more than the hem's tolerance outside the outlines of the lattices (T, n, n,
    2).
    """
    ring = np.concatenate([grid[:, 0, :-1], grid[:, :-1, -1], grid[:, -1, :0:-1], grid[:, :0:-1, 0]], axis=1)
    start, along = ring[:, None], (np.roll(ring, -1, axis=1) - ring)[:, None]
    to = target[None, :, None] - start
    part = np.clip((to * along).sum(-1) / np.maximum((along**2).sum(-1), 1e-12), 0.0, 1.0)
    far = np.linalg.norm(to - part[..., None] * along, axis=-1).min(axis=-1) > HEM_TOLERANCE
    end = start + along
    crosses = (start[..., 1] > target[None, :, None, 1]) != (end[..., 1] > target[None, :, None, 1])
    rise = np.where(crosses, along[..., 1], 1.0)
    at = start[..., 0] + along[..., 0] * (target[None, :, None, 1] - start[..., 1]) / rise
    inside = (crosses & (target[None, :, None, 0] < at)).sum(axis=-1) % 2 == 1
    return far & ~inside
