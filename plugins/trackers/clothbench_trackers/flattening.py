"""A patch of triangles in space laid flat, so that every point of it gets its material coordinates by arclength.

`isometric` is the local/global method of Liu et al. 2008 (A Local/Global Approach to Mesh Parameterization): woven
cloth hardly stretches, so that the map that keeps all lengths is the one looked for, and it needs no border.
`harmonic` fixes the border, which has to be seen all round, on the rectangle by arclength, and the inside by the
discrete Laplacian, as the quadrilateral remeshing of Hormann and Greiner (2000) begins.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

NEIGHBOURS = 16  # vertices that say how the sheet goes on beyond its patch
ROUNDS = 12  # of local and global steps
HOLD = 1e-3  # weight of the gauge, of a vertex's own, that keeps the map from drifting
EDGE_WEIGHT = 0.3  # of a border vertex that is known to lie on a hem


@dataclass(frozen=True, eq=False)
class Flat:
    """The triangles (F, 3) of a patch, each laid flat: corner (F, 3, 2) m, and cot (F, 3) of the angle opposite side k,
    from corner k + 1 to corner k + 2.
    """

    triangle: np.ndarray
    corner: np.ndarray
    cot: np.ndarray
    count: int

    @classmethod
    def of(cls, point: np.ndarray, triangle: np.ndarray) -> Flat:
        """Triangles (F, 3) of points (M, 3) m."""
        p, q, r = (point[triangle[:, k]] for k in range(3))
        along = np.linalg.norm(q - p, axis=1)
        across = r - p
        x = (across * (q - p)).sum(axis=1) / along
        y = np.sqrt(np.maximum((across**2).sum(axis=1) - x**2, 1e-18))
        zero = np.zeros_like(x)
        corner = np.stack([np.stack([zero, zero], 1), np.stack([along, zero], 1), np.stack([x, y], 1)], axis=1)
        cot = np.empty((len(triangle), 3))
        for k in range(3):
            a, b = corner[:, (k + 1) % 3] - corner[:, k], corner[:, (k + 2) % 3] - corner[:, k]
            cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
            cot[:, k] = np.clip((a * b).sum(axis=1) / np.maximum(np.abs(cross), 1e-12), 0.05, 20.0)
        return cls(triangle, corner, cot, len(point))

    def laplacian(self) -> Any:
        """The cotangent Laplacian (M, M), sparse, positive."""
        from scipy.sparse import coo_matrix

        i = np.concatenate([self.triangle[:, (k + 1) % 3] for k in range(3)])
        j = np.concatenate([self.triangle[:, (k + 2) % 3] for k in range(3)])
        w = 0.5 * np.concatenate([self.cot[:, k] for k in range(3)])
        rows, columns = np.concatenate([i, j, i, j]), np.concatenate([j, i, i, j])
        return coo_matrix((np.concatenate([-w, -w, w, w]), (rows, columns)), shape=(self.count, self.count)).tocsc()

    def turned(self, uv: np.ndarray) -> np.ndarray:
        """Right sides (M, 2) of the global step: every triangle as it is, turned as the map uv (M, 2) m turns it."""
        mapped, out = uv[self.triangle], np.zeros((self.count, 2))
        sums = np.zeros((len(self.triangle), 2, 2))
        sides = []
        for k in range(3):
            a, b = (k + 1) % 3, (k + 2) % 3
            own, there = self.corner[:, a] - self.corner[:, b], mapped[:, a] - mapped[:, b]
            sums += self.cot[:, k, None, None] * there[:, :, None] * own[:, None, :]
            sides.append((a, b, own))
        # The rotation nearest to a 2 × 2 matrix, in closed form; there are no reflections among them.
        cos, sin = sums[:, 0, 0] + sums[:, 1, 1], sums[:, 1, 0] - sums[:, 0, 1]
        size = np.maximum(np.hypot(cos, sin), 1e-30)
        cos, sin = cos / size, sin / size
        for k, (a, b, own) in enumerate(sides):
            side = np.stack([cos * own[:, 0] - sin * own[:, 1], sin * own[:, 0] + cos * own[:, 1]], axis=1)
            pull = 0.5 * self.cot[:, k, None] * side
            for corner, sign in ((a, 1.0), (b, -1.0)):
                for c in range(2):
                    out[:, c] += np.bincount(self.triangle[:, corner], sign * pull[:, c], minlength=self.count)
        return out


def isometric(flat: Flat, uv: np.ndarray, wanted: np.ndarray | None = None, rounds: int = ROUNDS) -> np.ndarray:
    """Material coordinates (M, 2) m that keep the triangles' shapes best, from a first guess (M, 2) m.

    wanted: (M, 2) m, coordinates that some vertices are known to have, NaN where they are not.
    """
    from scipy.sparse import diags
    from scipy.sparse.linalg import splu

    laplacian = flat.laplacian()
    scale = laplacian.diagonal()
    uv = uv.copy()
    known = np.zeros_like(uv, bool) if wanted is None else np.isfinite(wanted)
    goal = np.where(known, np.nan_to_num(wanted) if wanted is not None else 0.0, 0.0)
    weight = HOLD * scale[:, None] + np.where(known, EDGE_WEIGHT * scale[:, None], 0.0)
    solve = [splu((laplacian + diags(weight[:, c])).tocsc()).solve for c in range(2)]
    for _ in range(rounds):
        right = flat.turned(uv)
        held = HOLD * scale[:, None] * uv + np.where(known, EDGE_WEIGHT * scale[:, None] * goal, 0.0)
        uv = np.stack([solve[c](right[:, c] + held[:, c]) for c in range(2)], axis=1)
    return uv


def harmonic(flat: Flat, point: np.ndarray, uv: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Material coordinates (M, 2) m with the border on the rectangle of `size` (2,) m by arclength from corner to
    corner, which are where the first guess uv (M, 2) m comes nearest to them; the inside is harmonic.
    """
    from scipy.sparse.linalg import spsolve

    loop = border(flat.triangle)
    corners = np.array([[0.0, 0.0], [size[0], 0.0], size, [0.0, size[1]]])
    at = [int(np.argmin(((uv[loop] - corner) ** 2).sum(axis=1))) for corner in corners]
    if len(set(at)) < 4:
        return uv
    loop = np.roll(loop, -at[0])
    at = [(k - at[0]) % len(loop) for k in at]
    if at[1] > at[3]:  # the loop runs the other way round
        loop = np.concatenate([loop[:1], loop[:0:-1]])
        at = [(-k) % len(loop) for k in at]
    if not at[0] < at[1] < at[2] < at[3]:
        return uv
    out = uv.copy()
    closed = np.append(loop, loop[0])
    for k in range(4):
        chain = closed[at[k] : (at[k + 1] if k < 3 else len(loop)) + 1]
        steps = np.linalg.norm(np.diff(point[chain], axis=0), axis=1)
        share = np.concatenate([[0.0], np.cumsum(steps)]) / steps.sum()
        out[chain] = corners[k] + share[:, None] * (corners[(k + 1) % 4] - corners[k])
    inside = np.setdiff1d(np.arange(flat.count), loop)
    laplacian = flat.laplacian().tocsr()
    right = -laplacian[inside][:, loop] @ out[loop]
    out[inside] = spsolve(laplacian[inside][:, inside].tocsc(), right)
    return out


def upright(triangle: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Triangles (F, 3) with their corners in the order in which the map uv (M, 2) has them turn the usual way."""
    a, b, c = (uv[triangle[:, k]] for k in range(3))
    twice = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    return triangle if np.median(np.sign(twice)) >= 0 else triangle[:, [0, 2, 1]]


def border(triangle: np.ndarray) -> np.ndarray:
    """The vertices of the longest border loop of triangles (F, 3), one after the other."""
    side = np.concatenate([triangle[:, [0, 1]], triangle[:, [1, 2]], triangle[:, [2, 0]]])
    key = np.sort(side, axis=1)
    _, first, count = np.unique(key, axis=0, return_index=True, return_counts=True)
    following: dict[int, list[int]] = {}
    for a, b in side[first[count == 1]].tolist():
        following.setdefault(a, []).append(b)
    best: list[int] = []
    while following:
        start = next(iter(following))
        loop, here = [], start
        while following.get(here):
            loop.append(here)
            here_next = following[here].pop()
            if not following[here]:
                del following[here]
            here = here_next
            if here == start:
                break
        best = max(best, loop, key=len)
        following = {a: b for a, b in following.items() if b}
    return np.array(best, dtype=int)


def placed(uv: np.ndarray, here: np.ndarray, there: np.ndarray) -> np.ndarray:
    """The map uv (M, 2) m turned and shifted, not scaled: its points `here` (K, 2) m come nearest to `there`."""
    a, b = here - here.mean(axis=0), there - there.mean(axis=0)
    angle = np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum())
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return (uv - here.mean(axis=0)) @ turn.T + there.mean(axis=0)


def turned_to(uv: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """The map uv (M, 2) m turned by a small angle and shifted to where single coordinates are `wanted` (M, 2) m, NaN
    where they are not.
    """
    middle = uv.mean(axis=0)
    u, v = (uv - middle).T
    one, zero = np.ones_like(u), np.zeros_like(u)
    rows = np.concatenate([np.stack([one, zero, -v], axis=1), np.stack([zero, one, u], axis=1)])
    miss = (wanted - uv).T.ravel()
    known = np.isfinite(miss)
    if known.sum() < len(rows[0]):
        return uv
    du, dv, angle = np.linalg.lstsq(rows[known], miss[known], rcond=None)[0]
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return (uv - middle) @ turn.T + middle + [du, dv]


def looked_up(flat: Flat, uv: np.ndarray, point: np.ndarray, wanted: np.ndarray, beyond: float) -> np.ndarray:
    """Where material points (N, 2) m are (N, 3) m: in the triangle that covers them, or up to `beyond` m outside one;
    NaN where there is none.
    """
    from scipy.spatial import cKDTree

    corner = uv[flat.triangle]
    tree = cKDTree(corner.mean(axis=1))
    _, near = tree.query(wanted, k=min(24, len(corner)))
    near = np.atleast_2d(near)
    a, b, c = (corner[near][..., k, :] for k in range(3))
    ab, ac, ap = b - a, c - a, wanted[:, None] - a
    area = ab[..., 0] * ac[..., 1] - ab[..., 1] * ac[..., 0]
    area = np.where(np.abs(area) < 1e-12, np.nan, area)
    s = (ap[..., 0] * ac[..., 1] - ap[..., 1] * ac[..., 0]) / area
    t = (ab[..., 0] * ap[..., 1] - ab[..., 1] * ap[..., 0]) / area
    weight = np.stack([1 - s - t, s, t], axis=-1)
    outside = np.nan_to_num(-weight.min(axis=-1), nan=np.inf)
    best = outside.argmin(axis=1)
    row = np.arange(len(wanted))
    place = (weight[row, best][..., None] * point[flat.triangle[near[row, best]]]).sum(axis=1)
    out = outside[row, best] > 0
    if out.any():
        place[out] = _extended(uv, point, wanted[out], beyond)
    return place


def _extended(uv: np.ndarray, point: np.ndarray, wanted: np.ndarray, beyond: float) -> np.ndarray:
    """Where material points (K, 2) m outside the patch are (K, 3) m, on the plane through the vertices nearest to each;
    NaN where the nearest is farther than `beyond` m.
    """
    from scipy.spatial import cKDTree

    away, near = cKDTree(uv).query(wanted, k=min(NEIGHBOURS, len(uv)))
    middle, centre = uv[near].mean(axis=1), point[near].mean(axis=1)
    across, lift = uv[near] - middle[:, None], point[near] - centre[:, None]
    slope = np.linalg.pinv(across) @ lift  # (K, 2, 3)
    place = centre + ((wanted - middle)[:, None] @ slope)[:, 0]
    place[away[:, 0] > beyond] = np.nan
    return place
