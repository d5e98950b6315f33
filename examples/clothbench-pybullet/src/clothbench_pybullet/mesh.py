"""The triangles that Bullet is given, and the springs that it makes of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix


def triangles(shape: tuple[int, int]) -> np.ndarray:
    """Two triangles a cell (F, 3), node number j·nu + i, diagonals that alternate from cell to cell.

    With all diagonals one way a sheet that is pulled would lean by as much as it stretches.
    """
    nu, nv = shape
    j, i = (a.ravel() for a in np.mgrid[: nv - 1, : nu - 1])
    a = j * nu + i
    b, c, d = a + 1, a + nu, a + nu + 1
    other = ((i + j) % 2 == 1)[:, None, None]
    along = np.stack([np.stack([a, b, d], 1), np.stack([a, d, c], 1)], 1)
    across = np.stack([np.stack([a, b, c], 1), np.stack([b, d, c], 1)], 1)
    return np.where(other, across, along).reshape(-1, 3)


def springs(faces: np.ndarray, nodes: int) -> tuple[csr_matrix, csr_matrix]:
    """Which nodes (n, n) an edge joins, and which are two edges apart: Bullet's elastic and its bending springs."""
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    joined = coo_matrix((np.ones(len(ends)), ends.T), (nodes, nodes)).tocsr()
    joined = ((joined + joined.T) > 0).astype(float)
    apart = ((joined @ joined) > 0).astype(float)
    apart.setdiag(0)
    return joined, ((apart - apart.multiply(joined)) > 0).astype(float)


def write_obj(path: Path, uv: np.ndarray, faces: np.ndarray) -> None:
    """The flat sheet, nodes uv (n, 2) m in the plane z = 0, as a file that Bullet reads."""
    lines = [f"v {u!r} {v!r} 0" for u, v in uv.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (faces + 1).tolist()]
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
