"""What several effects share, compiled: drag of a node, fibres and curvatures of a triangle, parts of a triangle."""

from __future__ import annotations

import numpy as np
from numba import njit

helper = njit(cache=True, error_model="numpy", nogil=True, forceinline=True)

COLLAPSED = 1e-9  # area over rest area below which a triangle has no normal that could be trusted


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


@helper
def fibre(x, sheet, face, c):
    """∂x/∂u (c = 0, warp) or ∂x/∂v (c = 1, weft) over a triangle: (3 numbers); its length is 1 at rest."""
    a, b, d = sheet.triangles[face, 0], sheet.triangles[face, 1], sheet.triangles[face, 2]
    g = sheet.gradient[face, c]
    return (
        g[0] * x[0, a] + g[1] * x[0, b] + g[2] * x[0, d],
        g[0] * x[1, a] + g[1] * x[1, b] + g[2] * x[1, d],
        g[0] * x[2, a] + g[1] * x[2, b] + g[2] * x[2, d],
    )


@helper
def stretch(x, sheet, face, c):
    """Strain ε = |w| − 1 of a triangle's warp or weft fibre w."""
    wx, wy, wz = fibre(x, sheet, face, c)
    return np.sqrt(wx * wx + wy * wy + wz * wz) - 1.0


@helper
def add_tension(f, x, sheet, face, c, tension):
    """f −= A T ∂ε/∂x: a tension T N/m along a triangle's warp (c = 0) or weft (c = 1)."""
    wx, wy, wz = fibre(x, sheet, face, c)
    length = np.sqrt(wx * wx + wy * wy + wz * wz)
    if length == 0.0:
        return
    pull = sheet.face_area[face] * tension / length
    for k in range(3):
        e, share = sheet.triangles[face, k], pull * sheet.gradient[face, c, k]
        f[0, e] -= share * wx
        f[1, e] -= share * wy
        f[2, e] -= share * wz


@helper
def normal_of(x, sheet, face):
    """Unit normal of a triangle, along warp × weft, and its area over that at rest; zero where it has collapsed."""
    ux, uy, uz = fibre(x, sheet, face, 0)
    vx, vy, vz = fibre(x, sheet, face, 1)
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    size = np.sqrt(nx * nx + ny * ny + nz * nz)
    if size < COLLAPSED:
        return 0.0, 0.0, 0.0, 0.0
    over = 1.0 / size
    return nx * over, ny * over, nz * over, size


@helper
def curvatures(x, sheet, face, normal):
    """κ_uu, κ_vv, κ_uv 1/m of a triangle: second derivatives along its normal; above 0 it curls towards warp × weft.

    normal: from `normal_of`, here and in `add_couples`.
    """
    nx, ny, nz, _ = normal
    uu, vv, uv = 0.0, 0.0, 0.0
    for k in range(6):
        e = sheet.patch[face, k]
        height = x[0, e] * nx + x[1, e] * ny + x[2, e] * nz
        uu += sheet.curvature[face, 0, k] * height
        vv += sheet.curvature[face, 1, k] * height
        uv += sheet.curvature[face, 2, k] * height
    return uu, vv, uv


@helper
def add_couples(f, x, sheet, face, normal, uu, vv, uv):
    """f −= A (M_uu ∂κ_uu + M_vv ∂κ_vv + 2 M_uv ∂κ_uv)/∂x: couples per width M N, which do work on the curvatures.

    κ = c·n, so ∂κ = ∂c·n + c·∂n: the second term vanishes on a sheet that only bends; with it the forces carry no
    net torque on any sheet.
    """
    nx, ny, nz, size = normal
    if size == 0.0:
        return
    area, uv = sheet.face_area[face], 2.0 * uv
    cx, cy, cz = 0.0, 0.0, 0.0  # c = Σ_k W_k x_k with W = M_uu ∂²/∂u² + M_vv ∂²/∂v² + 2 M_uv ∂²/∂u∂v as weights
    for k in range(6):
        e = sheet.patch[face, k]
        w = uu * sheet.curvature[face, 0, k] + vv * sheet.curvature[face, 1, k] + uv * sheet.curvature[face, 2, k]
        cx += w * x[0, e]
        cy += w * x[1, e]
        cz += w * x[2, e]
        f[0, e] -= area * w * nx
        f[1, e] -= area * w * ny
        f[2, e] -= area * w * nz
    along = cx * nx + cy * ny + cz * nz
    over = area / size
    qx, qy, qz = over * (cx - along * nx), over * (cy - along * ny), over * (cz - along * nz)
    ux, uy, uz = fibre(x, sheet, face, 0)
    vx, vy, vz = fibre(x, sheet, face, 1)
    for k in range(3):
        e = sheet.triangles[face, k]
        g, h = sheet.gradient[face, 0, k], sheet.gradient[face, 1, k]
        f[0, e] -= g * (vy * qz - vz * qy) + h * (qy * uz - qz * uy)
        f[1, e] -= g * (vz * qx - vx * qz) + h * (qz * ux - qx * uz)
        f[2, e] -= g * (vx * qy - vy * qx) + h * (qx * uy - qy * ux)


@helper
def cut(polygon, count, axis, side, limit, out):
    """Keep the part of a convex polygon (count, 2) in which side·(coordinate − limit) ≥ 0; returns its corner count.

    Sutherland and Hodgman 1974, one edge of their window.
    """
    kept = 0
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        here, there = side * (polygon[i, axis] - limit), side * (polygon[j, axis] - limit)
        if here >= 0.0:
            out[kept] = polygon[i]
            kept += 1
        if (here > 0.0 and there < 0.0) or (here < 0.0 and there > 0.0):
            out[kept] = polygon[i] + (polygon[j] - polygon[i]) * (here / (here - there))
            kept += 1
    return kept


@helper
def add_overlap(sheet, face, low, high, share):
    """share_k += ∫ N_k over the part of a triangle between low (2,) and high (2,) m, N_k linear, 1 at corner k.

    share: (n,) m². Sums and first moments over the sheet are those of the rectangle, whatever the mesh.
    """
    one, two = np.zeros((8, 2)), np.zeros((8, 2))
    for k in range(3):
        one[k] = sheet.uv[sheet.triangles[face, k]]
    count = cut(one, 3, 0, 1.0, low[0], two)
    count = cut(two, count, 0, -1.0, high[0], one)
    count = cut(one, count, 1, 1.0, low[1], two)
    count = cut(two, count, 1, -1.0, high[1], one)
    origin = sheet.uv[sheet.triangles[face, 0]]
    for m in range(1, count - 1):
        a, b = one[m] - one[0], one[m + 1] - one[0]
        area = 0.5 * abs(a[0] * b[1] - a[1] * b[0])
        middle = (one[0] + one[m] + one[m + 1]) / 3.0 - origin
        for k in range(3):
            weight = sheet.gradient[face, 0, k] * middle[0] + sheet.gradient[face, 1, k] * middle[1]
            share[sheet.triangles[face, k]] += area * (weight + (1.0 if k == 0 else 0.0))
