"""What several effects share, compiled: drag of a node, parts of a triangle."""

from __future__ import annotations

import functools

import numpy as np

from clothbench.modelling import lean_kernel

helper = functools.partial(lean_kernel, forceinline=True)


@helper
def add_drag(f, i, sheet, vx, vy, vz, normal, tangential):
    """f −= ½ ρ_air A (C_N |v_n| v_n + C_T |v_t| v_t) at node i; v_n and v_t: v along and across the normal."""
    nx, ny, nz = sheet.normal[0, i], sheet.normal[1, i], sheet.normal[2, i]
    along = vx * nx + vy * ny + vz * nz
    tx, ty, tz = vx - along * nx, vy - along * ny, vz - along * nz
    pressure = 0.5 * sheet.air_density * sheet.area[i]
    across = pressure * normal * abs(along) * along
    friction = pressure * tangential * np.sqrt(tx * tx + ty * ty + tz * tz)
    f[0, i] -= across * nx + friction * tx
    f[1, i] -= across * ny + friction * ty
    f[2, i] -= across * nz + friction * tz


@helper(allocates=True)
def nodal_cloth(sheet):
    """∫ N dA of the cloth in the triangles around each node, (n,) m²."""
    whole = np.zeros(sheet.area.shape[0])
    for face in range(sheet.triangles.shape[0]):
        for k in range(3):
            whole[sheet.triangles[face, k]] += sheet.face_area[face] / 3.0
    return whole


@helper(allocates=True)
def cut(polygon, count, axis, side, limit, out):
    """Keep the part of a polygon (count, 2) in which side·(coordinate − limit) ≥ 0; returns its corner count, at most
    half as many more.

    Sutherland and Hodgman 1974, one edge of their window.
    """
    kept = 0
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        here, there = side * (polygon[i, axis] - limit), side * (polygon[j, axis] - limit)
        if here >= 0.0:
            out[kept, 0], out[kept, 1] = polygon[i, 0], polygon[i, 1]
            kept += 1
        if (here > 0.0 and there < 0.0) or (here < 0.0 and there > 0.0):
            for k in range(2):
                out[kept, k] = polygon[i, k] + (polygon[j, k] - polygon[i, k]) * (here / (here - there))
            kept += 1
    return kept


@helper(allocates=True)
def add_overlap(sheet, face, low, high, share):
    """share_k += ∫ N_k over the part of a triangle between low (2,) and high (2,) m, N_k linear, 1 at corner k; where
    an outline cuts a triangle, as if its cloth were spread evenly over it.

    share: (n,) m². Sums and first moments over a whole sheet are those of the rectangle, whatever the mesh.
    """
    one, two = np.zeros((8, 2)), np.zeros((8, 2))
    for k in range(3):
        corner = sheet.triangles[face, k]
        one[k, 0], one[k, 1] = sheet.uv[corner, 0], sheet.uv[corner, 1]
    count = cut(one, 3, 0, 1.0, low[0], two)
    count = cut(two, count, 0, -1.0, high[0], one)
    count = cut(one, count, 1, 1.0, low[1], two)
    count = cut(two, count, 1, -1.0, high[1], one)
    origin = sheet.uv[sheet.triangles[face, 0]]
    cloth = 1.0
    if sheet.columns == 0:
        p, q = sheet.uv[sheet.triangles[face, 1]] - origin, sheet.uv[sheet.triangles[face, 2]] - origin
        cloth = sheet.face_area[face] / (0.5 * abs(p[0] * q[1] - p[1] * q[0]))
    for m in range(1, count - 1):
        a, b = one[m] - one[0], one[m + 1] - one[0]
        area = 0.5 * abs(a[0] * b[1] - a[1] * b[0]) * cloth
        middle = (one[0] + one[m] + one[m + 1]) / 3.0 - origin
        for k in range(3):
            weight = sheet.gradient[face, 0, k] * middle[0] + sheet.gradient[face, 1, k] * middle[1]
            share[sheet.triangles[face, k]] += area * (weight + (1.0 if k == 0 else 0.0))
