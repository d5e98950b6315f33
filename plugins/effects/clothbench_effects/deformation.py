"""How all triangles of a sheet are stretched and bent, and loads on that as forces on nodes; compiled.

Everything stands in rows and is done in short loops over few of them, without branches and gathers, which is what lets
the compiler use the vector unit. On a regular grid neighbours share what they are made of: each fibre (∂x/∂u or ∂x/∂v)
belongs to an edge, each second derivative is a difference of two fibres, and all triangles of a kind find theirs at
constant distances in the rows (`_part`). On any other mesh each triangle has its own. Only the functions that go from
nodes to these rows and back know what mesh it is.

What is public makes room and leaves the work to a function that makes none.
"""

from __future__ import annotations

import functools
from collections import namedtuple

import numpy as np

from clothbench.modelling import lean_kernel

_fast = functools.partial(lean_kernel, forceinline=True)
_views = functools.partial(lean_kernel, inline="always")  # becomes a part of who calls it, as it must not return arrays

COLLAPSED = 1e-9  # area over rest area below which a triangle has no normal that could be trusted

Bent = namedtuple("Bent", "fibre second normal curvature")
Bent.__doc__ = """What `bent` finds out about a sheet, S slots of triangles (see `clothbench.Sheet`).

fibre: (2, 3R), from `fibres`; second: (3, 3R), from `_find_second_derivatives`; normal: (4, S), from `_find_normals`;
curvature: (3, S) 1/m, κ_uu, κ_vv and κ_uv: second derivatives along the normal; above 0 it curls towards warp × weft.
"""


# --- bending ----------------------------------------------------------------------------------------------------------


@_fast(allocates=True)
def bent(x, sheet):
    """Fibres, normals and curvatures of a sheet at x (3, n) m: a `Bent`."""
    width, slots = _width(x, sheet), sheet.slots.shape[1]
    shape = Bent(np.empty((2, width)), np.empty((3, width)), np.empty((4, slots)), np.empty((3, slots)))
    _bend(x, sheet, shape)
    return shape


@_fast
def _bend(x, sheet, shape):
    slots, columns = sheet.slots, sheet.columns
    fibre, second, normal, curvature = shape.fibre, shape.second, shape.normal, shape.curvature
    _find_fibres(x, sheet, fibre)
    _find_second_derivatives(x, sheet, fibre, second)
    for kind in range(_kinds(columns)):
        first, count, places = _part(columns, kind, slots.shape[1])
        _find_normals(fibre, places, normal, first, count)
        _find_curvatures(second[0], places[2], slots[1], normal, curvature[0], first, count)
        _find_curvatures(second[1], places[3], slots[2], normal, curvature[1], first, count)
        _find_curvatures(second[2], places[4], slots[3], normal, curvature[2], first, count)


@_fast
def _find_normals(fibre, places, normal, first, count):
    """Unit normals along warp × weft, rows 0 to 2, and rest area over area, row 3; 0 where a triangle has collapsed."""
    ux, uy, uz = _axes(fibre[0], places[0], count)
    vx, vy, vz = _axes(fibre[1], places[1], count)
    nx, ny, nz = _at(normal, first, count)
    over = normal[3, first : first + count]
    for e in range(count):
        x, y, z = uy[e] * vz[e] - uz[e] * vy[e], uz[e] * vx[e] - ux[e] * vz[e], ux[e] * vy[e] - uy[e] * vx[e]
        size = np.sqrt(x * x + y * y + z * z)
        inverse = 1.0 / size if size >= COLLAPSED else 0.0
        nx[e] = x * inverse
        ny[e] = y * inverse
        nz[e] = z * inverse
        over[e] = inverse


@_fast
def _find_curvatures(second, place, weight, normal, curvature, first, count):
    """One of κ_uu, κ_vv and κ_uv of the triangles of a kind."""
    cx, cy, cz = _axes(second, place, count)
    nx, ny, nz = _at(normal, first, count)
    share, out = weight[first : first + count], curvature[first : first + count]
    for e in range(count):
        out[e] = share[e] * (cx[e] * nx[e] + cy[e] * ny[e] + cz[e] * nz[e])


@_fast(allocates=True)
def add_couples(f, sheet, shape, couples):
    """f −= A (M_uu ∂κ_uu + M_vv ∂κ_vv + 2 M_uv ∂κ_uv)/∂x: couples per width (3, S) N, which do work on the curvatures.

    shape: from `bent`. κ = c·n, so ∂κ = ∂c·n + c·∂n: the second term vanishes on a sheet that only bends; with it the
    forces carry no net torque on any sheet.
    """
    on_fibre, on_second = np.empty(shape.fibre.shape), np.empty(shape.second.shape)
    _load(f, sheet, shape, couples, np.empty(couples.shape), np.empty(couples.shape), on_fibre, on_second)


@_fast
def _load(f, sheet, shape, couples, work, across, on_fibre, on_second):
    slots, columns = sheet.slots, sheet.columns
    on_fibre[:], on_second[:] = 0.0, 0.0
    _weigh(couples[0], slots[0], slots[1], 1.0, work[0])
    _weigh(couples[1], slots[0], slots[2], 1.0, work[1])
    _weigh(couples[2], slots[0], slots[3], 2.0, work[2])
    for kind in range(_kinds(columns)):
        first, count, places = _part(columns, kind, slots.shape[1])
        _load_along(work[0], shape.normal, on_second[0], places[2], first, count)
        _load_along(work[1], shape.normal, on_second[1], places[3], first, count)
        _load_along(work[2], shape.normal, on_second[2], places[4], first, count)
        _find_across(shape.second, places, work, shape.normal, across, first, count)
        _turn(shape.fibre, places, across, on_fibre, first, count)
    _add_loads(f, sheet, on_fibre, on_second)


@_fast
def _weigh(couple, area, weight, factor, out):
    for e in range(out.shape[0]):
        out[e] = factor * couple[e] * area[e] * weight[e]


@_fast
def _load_along(work, normal, load, place, first, count):
    """Loads along the normals on second derivatives: what does work on curvatures."""
    lx, ly, lz = _axes(load, place, count)
    nx, ny, nz = _at(normal, first, count)
    m = work[first : first + count]
    for e in range(count):
        lx[e] += m[e] * nx[e]
        ly[e] += m[e] * ny[e]
        lz[e] += m[e] * nz[e]


@_fast
def _find_across(second, places, work, normal, across, first, count):
    """What of c = A (M_uu ∂²x/∂u² + M_vv ∂²x/∂v² + 2 M_uv ∂²x/∂u∂v) lies in the plane, over |warp × weft|."""
    ux, uy, uz = _axes(second[0], places[2], count)
    vx, vy, vz = _axes(second[1], places[3], count)
    wx, wy, wz = _axes(second[2], places[4], count)
    uu, vv, uv = _at(work, first, count)
    nx, ny, nz = _at(normal, first, count)
    over, (qx, qy, qz) = normal[3, first : first + count], _at(across, first, count)
    for e in range(count):
        x = uu[e] * ux[e] + vv[e] * vx[e] + uv[e] * wx[e]
        y = uu[e] * uy[e] + vv[e] * vy[e] + uv[e] * wy[e]
        z = uu[e] * uz[e] + vv[e] * vz[e] + uv[e] * wz[e]
        along = x * nx[e] + y * ny[e] + z * nz[e]
        qx[e] = over[e] * (x - along * nx[e])
        qy[e] = over[e] * (y - along * ny[e])
        qz[e] = over[e] * (z - along * nz[e])


@_fast
def _turn(fibre, places, across, on_fibre, first, count):
    """Loads on fibres that turn the normals: weft × q on the warp, q × warp on the weft."""
    q = _at(across, first, count)
    _add_cross(_axes(fibre[1], places[1], count), q, _axes(on_fibre[0], places[0], count))
    _add_cross(q, _axes(fibre[0], places[0], count), _axes(on_fibre[1], places[1], count))


# --- stretch ----------------------------------------------------------------------------------------------------------


@_fast(allocates=True)
def strains(fibre, sheet):
    """Strains ε = |w| − 1 of the warp and weft fibres w of all triangles, (2, S); fibre: from `fibres`."""
    out = np.empty((2, sheet.slots.shape[1]))
    _find_strains(fibre, sheet, np.empty(fibre.shape[1] // 3), out)
    return out


@_fast
def _find_strains(fibre, sheet, strain, out):
    rows, slots = strain.shape[0], out.shape[1]
    for c in range(2):
        wx, wy, wz = _axes(fibre[c], 0, rows)
        for e in range(rows):
            strain[e] = np.sqrt(wx[e] * wx[e] + wy[e] * wy[e] + wz[e] * wz[e]) - 1.0
        for kind in range(_kinds(sheet.columns)):
            first, count, places = _part(sheet.columns, kind, slots)
            here, own = out[c, first:], strain[places[c] :]
            for e in range(count):
                here[e] = own[e]


@_fast(allocates=True)
def add_tensions(f, sheet, fibre, tension):
    """f −= A T ∂ε/∂x: tensions T (2, S) N/m along warp and weft of all triangles."""
    _pull(f, sheet, fibre, tension, np.empty(fibre.shape[1] // 3), np.empty(fibre.shape))


@_fast
def _pull(f, sheet, fibre, tension, pull, load):
    rows, area = pull.shape[0], sheet.slots[0]
    for c in range(2):
        pull[:] = 0.0
        for kind in range(_kinds(sheet.columns)):
            first, count, places = _part(sheet.columns, kind, area.shape[0])
            share, own, of = pull[places[c] : places[c] + count], tension[c, first : first + count], area[first:]
            for e in range(count):
                share[e] += of[e] * own[e]
        wx, wy, wz = _axes(fibre[c], 0, rows)
        lx, ly, lz = _axes(load[c], 0, rows)
        for e in range(rows):
            length = np.sqrt(wx[e] * wx[e] + wy[e] * wy[e] + wz[e] * wz[e])
            t = pull[e] / length if length > 0.0 else 0.0
            lx[e] = t * wx[e]
            ly[e] = t * wy[e]
            lz[e] = t * wz[e]
    _add_fibre_loads(f, sheet, load)


# --- linear bending ---------------------------------------------------------------------------------------------------


@_fast(allocates=True)
def add_linear_bending(f, x, sheet, warp, weft):
    """f −= A (D_u W_uu c_uu + D_v W_vv c_vv): of the energy ½ (D_u |∂²x/∂u²|² + D_v |∂²x/∂v²|²) per area, D in N·m."""
    width = _width(x, sheet)
    _bend_linearly(f, x, sheet, warp, weft, np.empty((2, width)), np.empty((3, width)), np.empty(width // 3))


@_fast
def _bend_linearly(f, x, sheet, warp, weft, fibre, second, rigidity):
    slots, rows = sheet.slots, rigidity.shape[0]
    _find_fibres(x, sheet, fibre)
    _find_second_derivatives(x, sheet, fibre, second)
    fibre[:], second[2] = 0.0, 0.0
    for c in range(2):
        rigidity[:] = 0.0
        for kind in range(_kinds(sheet.columns)):
            first, count, places = _part(sheet.columns, kind, slots.shape[1])
            out, d = rigidity[places[2 + c] : places[2 + c] + count], weft if c else warp
            area, weight = slots[0, first : first + count], slots[1 + c, first : first + count]
            for e in range(count):
                out[e] += d * area[e] * weight[e] * weight[e]
        for k in range(3):
            load = second[c, k * rows : (k + 1) * rows]
            for e in range(rows):
                load[e] *= rigidity[e]
    _add_loads(f, sheet, fibre, second)


# --- where a triangle finds its own -----------------------------------------------------------------------------------


@_fast
def _kinds(columns):
    return 2 if columns > 0 else 1


@_fast
def _part(columns, kind, slots):
    """First slot and number of the triangles of a kind; and at which places of the rows the first of them finds its
    warp and weft fibre, ∂²x/∂u², ∂²x/∂v² and ∂²x/∂u∂v.

    On a grid the edges to the next node of the row and of the column stand at a node's own place, and so do the
    differences of the edges that meet there and of those across a cell.
    """
    if columns == 0:
        return 0, slots, (0, 0, 0, 0, 0)
    if kind == 0:
        return 0, slots // 2, (0, 1, columns + 1, 0, 0)
    return slots // 2, slots // 2, (columns, 0, 0, columns + 1, 0)


@_views
def _axes(plane, start, count):
    """x, y and z of `count` vectors of a plane (3R,), from place `start` on."""
    rows = plane.shape[0] // 3
    x, y, z = plane[start:], plane[rows + start :], plane[2 * rows + start :]
    return x[:count], y[:count], z[:count]


@_views
def _at(rows, first, count):
    """The first three rows of some slots."""
    return rows[0, first : first + count], rows[1, first : first + count], rows[2, first : first + count]


@_fast
def _add_cross(a, b, out):
    """out += a × b, each three rows."""
    (ax, ay, az), (bx, by, bz), (ox, oy, oz) = a, b, out
    for e in range(ox.shape[0]):
        ox[e] += ay[e] * bz[e] - az[e] * by[e]
        oy[e] += az[e] * bx[e] - ax[e] * bz[e]
        oz[e] += ax[e] * by[e] - ay[e] * bx[e]


# --- from nodes to rows and back --------------------------------------------------------------------------------------


@_fast
def _width(x, sheet):
    """3R, of rows that hold x, y and z of what the triangles are made of."""
    return x.size if sheet.columns > 0 else 3 * sheet.triangles.shape[0]


@_fast(allocates=True)
def fibres(x, sheet):
    """∂x/∂u (warp) and ∂x/∂v (weft), (2, 3R): x, y, z one after the other; their length is 1 at rest."""
    out = np.empty((2, _width(x, sheet)))
    _find_fibres(x, sheet, out)
    return out


@_fast
def _find_fibres(x, sheet, out):
    if sheet.columns == 0:
        faces = sheet.triangles.shape[0]
        for face in range(faces):
            a, b, d = sheet.triangles[face, 0], sheet.triangles[face, 1], sheet.triangles[face, 2]
            for c in range(2):
                g = sheet.gradient[face, c]
                for k in range(3):
                    out[c, k * faces + face] = g[0] * x[k, a] + g[1] * x[k, b] + g[2] * x[k, d]
        return
    nu, flat = sheet.columns, x.reshape(x.size)
    n = flat.shape[0]
    warp, weft = out[0], out[1]
    _difference(flat[1:], flat, sheet.spacing[0], warp[: n - 1])
    _difference(flat[nu:], flat, sheet.spacing[1], weft[: n - nu])
    warp[n - 1] = 0.0
    weft[n - nu :] = 0.0


@_fast
def _find_second_derivatives(x, sheet, fibre, out):
    """∂²x/∂u², ∂²x/∂v² and ∂²x/∂u∂v, (3, 3R), which the weights of the slots make those of `curvature_weights`.

    On a grid they are differences of fibres, over all axes at once: where a row ends the weights are 0.
    """
    if sheet.columns == 0:
        out[:] = 0.0
        faces = sheet.triangles.shape[0]
        for face in range(faces):
            for m in range(6):
                e = sheet.patch[face, m]
                for c in range(3):
                    weight = sheet.curvature[face, c, m]
                    out[c, face] += weight * x[0, e]
                    out[c, faces + face] += weight * x[1, e]
                    out[c, 2 * faces + face] += weight * x[2, e]
        return
    nu, n = sheet.columns, fibre.shape[1]
    warp, weft, uu, vv, uv = fibre[0], fibre[1], out[0], out[1], out[2]
    uu[0] = 0.0
    for e in range(nu):
        vv[e] = 0.0
        uv[n - nu + e] = 0.0
    _subtract(warp[1:], warp, uu[1:])
    _subtract(weft[nu:], weft, vv[nu:])
    _subtract(warp[nu:], warp, uv[: n - nu])


@_fast
def _add_loads(f, sheet, on_fibre, on_second):
    """f −= ∂/∂x of what the loads (2, 3R) and (3, 3R) on fibres and second derivatives work on; changes on_fibre."""
    if sheet.columns == 0:
        faces = sheet.triangles.shape[0]
        for face in range(faces):
            for m in range(6):
                e = sheet.patch[face, m]
                uu, vv, uv = sheet.curvature[face, 0, m], sheet.curvature[face, 1, m], sheet.curvature[face, 2, m]
                for k in range(3):
                    i = k * faces + face
                    f[k, e] -= uu * on_second[0, i] + vv * on_second[1, i] + uv * on_second[2, i]
    else:
        nu = sheet.columns
        warp, weft, uu, vv, uv = on_fibre[0], on_fibre[1], on_second[0], on_second[1], on_second[2]
        ahead = uu[1:]
        for e in range(ahead.shape[0]):
            warp[e] += uu[e] - ahead[e] - uv[e]
        ahead, other = vv[nu:], warp[nu:]
        for e in range(ahead.shape[0]):
            weft[e] += vv[e] - ahead[e]
            other[e] += uv[e]
    _add_fibre_loads(f, sheet, on_fibre)


@_fast
def _add_fibre_loads(f, sheet, load):
    """f −= ∂/∂x of what loads (2, 3R) on fibres work on; changes them."""
    if sheet.columns == 0:
        faces = sheet.triangles.shape[0]
        for face in range(faces):
            for m in range(3):
                e = sheet.triangles[face, m]
                g, h = sheet.gradient[face, 0, m], sheet.gradient[face, 1, m]
                for k in range(3):
                    f[k, e] -= g * load[0, k * faces + face] + h * load[1, k * faces + face]
        return
    nu, flat, warp, weft = sheet.columns, f.reshape(f.size), load[0], load[1]
    over_u, over_v = sheet.spacing[0], sheet.spacing[1]
    for e in range(flat.shape[0]):
        warp[e] *= over_u[e]
        weft[e] *= over_v[e]
    for e in range(nu):
        flat[e] += warp[e] + weft[e] - (warp[e - 1] if e > 0 else 0.0)
    out, here, beside, below, above = flat[nu:], warp[nu:], warp[nu - 1 :], weft[nu:], weft
    for e in range(out.shape[0]):
        out[e] += (here[e] - beside[e]) + (below[e] - above[e])


@_fast
def _difference(ahead, behind, weight, out):
    for e in range(out.shape[0]):
        out[e] = (ahead[e] - behind[e]) * weight[e]


@_fast
def _subtract(a, b, out):
    for e in range(out.shape[0]):
        out[e] = a[e] - b[e]
