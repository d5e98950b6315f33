"""What compiled code of models and effects shares: the sheet an effect sees, and the kernel decorator."""

from __future__ import annotations

import warnings
from collections import namedtuple
from collections.abc import Callable

import numpy as np
from numba import njit, types
from numba.core.errors import NumbaExperimentalFeatureWarning

Sheet = namedtuple("Sheet", "uv mass area normal triangles gravity air_density")
Sheet.__doc__ = """The cloth as an effect sees it.

uv: (n, 2) m, rest coordinates; mass: (n,) kg and area: (n,) m² of each node; normal: (3, n), unit, at this step;
triangles: (F, 3), node numbers; gravity: (3,) m/s²; air_density: kg/m³.
"""

_vector = types.float64[::1]
_rows = types.float64[:, ::1]
SHEET = types.NamedTuple(
    (_rows, _vector, _vector, _rows, types.int64[:, ::1], _vector, types.float64),
    Sheet,
)
SIGNATURE = types.void(types.float64, types.float64, _rows, _rows, _rows, SHEET, _vector, _vector)
EFFECT = types.FunctionType(SIGNATURE)


def effect_kernel(function: Callable) -> Callable:
    """Compile an effect's `force` or `inertia` for the time loops of all models (see `clothbench.Effect`).

    `function(t, dt, x, v, f, sheet, p, state)` changes f (3, n) in place. Compiled on definition and cached on disk.
    """
    return compiled(SIGNATURE)(function)


def compiled(signature) -> Callable[[Callable], Callable]:
    """`njit` for a kernel with a stated signature, compiled where it is defined and cached on disk.

    Functions as values are marked experimental by numba (they let one time loop call any effect); that is
    no news to a user.
    """

    def decorate(function: Callable) -> Callable:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NumbaExperimentalFeatureWarning)
            return njit(signature, cache=True, error_model="numpy", nogil=True)(function)

    return decorate


@effect_kernel
def no_effect(t, dt, x, v, f, sheet, p, state):
    """Fills the slots of a time loop that has no effect there."""


@njit(cache=True, error_model="numpy", nogil=True)
def node_normals(x, triangles, normal):
    """Unit normals (3, n) at the nodes of the mesh x (3, n): area-weighted sum over the triangles (F, 3) around each.

    A node whose triangles have collapsed gets the zero vector: nothing can push on it along a normal.
    """
    normal[:] = 0.0
    for k in range(triangles.shape[0]):
        a, b, c = triangles[k, 0], triangles[k, 1], triangles[k, 2]
        px, py, pz = x[0, b] - x[0, a], x[1, b] - x[1, a], x[2, b] - x[2, a]
        qx, qy, qz = x[0, c] - x[0, a], x[1, c] - x[1, a], x[2, c] - x[2, a]
        nx, ny, nz = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
        for i in (a, b, c):
            normal[0, i] += nx
            normal[1, i] += ny
            normal[2, i] += nz
    for i in range(x.shape[1]):
        size = np.sqrt(normal[0, i] ** 2 + normal[1, i] ** 2 + normal[2, i] ** 2)
        if size > 0.0:
            for k in range(3):
                normal[k, i] /= size


def grid_triangles(shape: tuple[int, int]) -> np.ndarray:
    """Triangles (F, 3) of a regular grid (nu, nv), node number j·nu + i, diagonals alternating."""
    nu, nv = shape
    i, j = (a.ravel() for a in np.meshgrid(np.arange(nu - 1), np.arange(nv - 1)))
    a = j * nu + i
    b, c, d = a + 1, a + nu, a + nu + 1
    even = ((i + j) % 2 == 0)[:, None, None]
    falling = np.stack([np.stack([a, c, d], 1), np.stack([a, d, b], 1)], 1)
    rising = np.stack([np.stack([a, c, b], 1), np.stack([b, c, d], 1)], 1)
    return np.ascontiguousarray(np.where(even, falling, rising).reshape(-1, 3).astype(np.int64))
