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


_fast = njit(cache=True, error_model="numpy", nogil=True)


@_fast
def grid_normals(x, nu, normal):
    """Unit normals (3, n) of a regular grid x (3, n) m, nu nodes a row: cross product of the central differences.

    A node where the sheet has collapsed gets the zero vector: nothing can push on it along a normal.
    """
    n = x.shape[1]
    inner = n - 2 * nu
    # All inner rows at once first, as if rows did not end: without branches the compiler can use the vector unit.
    lx, ly, lz = x[0, nu - 1 : nu - 1 + inner], x[1, nu - 1 : nu - 1 + inner], x[2, nu - 1 : nu - 1 + inner]
    rx, ry, rz = x[0, nu + 1 : nu + 1 + inner], x[1, nu + 1 : nu + 1 + inner], x[2, nu + 1 : nu + 1 + inner]
    tx, ty, tz = x[0, :inner], x[1, :inner], x[2, :inner]
    bx, by, bz = x[0, 2 * nu : 2 * nu + inner], x[1, 2 * nu : 2 * nu + inner], x[2, 2 * nu : 2 * nu + inner]
    ox, oy, oz = normal[0, nu : nu + inner], normal[1, nu : nu + inner], normal[2, nu : nu + inner]
    for e in range(inner):
        px, py, pz = bx[e] - tx[e], by[e] - ty[e], bz[e] - tz[e]
        qx, qy, qz = rx[e] - lx[e], ry[e] - ly[e], rz[e] - lz[e]
        ox[e], oy[e], oz[e] = _unit_cross(px, py, pz, qx, qy, qz)
    for i in range(nu):
        _border_normal(x, nu, i, normal)
        _border_normal(x, nu, n - nu + i, normal)
    for j in range(1, n // nu - 1):
        _border_normal(x, nu, j * nu, normal)
        _border_normal(x, nu, j * nu + nu - 1, normal)


@_fast
def _unit_cross(px, py, pz, qx, qy, qz):
    """p × q, normalised; the zero vector where they are parallel."""
    nx, ny, nz = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
    size = 1.0 / np.sqrt(nx * nx + ny * ny + nz * nz + 1e-60)
    return nx * size, ny * size, nz * size


@_fast
def _border_normal(x, nu, e, normal):
    """The same at one node of the border, with one-sided differences."""
    i, n = e % nu, x.shape[1]
    left, right = e - (1 if i > 0 else 0), e + (1 if i < nu - 1 else 0)
    top, bottom = e - (nu if e >= nu else 0), e + (nu if e < n - nu else 0)
    px, py, pz = x[0, bottom] - x[0, top], x[1, bottom] - x[1, top], x[2, bottom] - x[2, top]
    qx, qy, qz = x[0, right] - x[0, left], x[1, right] - x[1, left], x[2, right] - x[2, left]
    normal[0, e], normal[1, e], normal[2, e] = _unit_cross(px, py, pz, qx, qy, qz)


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
