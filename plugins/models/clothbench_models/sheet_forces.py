"""Compiled forces of stretch, shear and bending on a grid cut into triangles.

Nodes a, b, c, d = e, e + 1, e + nu, e + nu + 1 make a cell; the triangles abd ("lower") and adc ("upper") have
w_u and w_v along the cell's own edges, so all of it is written as fluxes along edges: u-edges e → e + 1 and v-edges
e → e + nu. Flat rows without branches, with zero weights where an edge or cell would wrap around: that is what the
compiler turns into vector code. An array of edges has `nu + 1` zeros before and after, so that neighbours exist.
"""

from __future__ import annotations

import numpy as np

from clothbench.modelling import lean_kernel

TINY = 1e-30  # m²
TRIANGLES, CELLS = 13, 7  # rows that shear keeps: two triangles a cell, or whole cells


@lean_kernel
def edge_differences(x, nu, du, dv):
    """Differences along u-edges and v-edges into du, dv (3, pad + n + pad)."""
    n, pad = x.shape[1], nu + 1
    for c in range(3):
        xc = x[c]
        a, b, out = xc[: n - 1], xc[1:], du[c, pad : pad + n - 1]
        for e in range(n - 1):
            out[e] = b[e] - a[e]
        a, b, out = xc[: n - nu], xc[nu:], dv[c, pad : pad + n - nu]
        for e in range(n - nu):
            out[e] = b[e] - a[e]


@lean_kernel
def add_fluxes(fu, fv, nu, out, sign):
    """out_a += sign·flux, out_b −= sign·flux for every edge a → b."""
    n, pad = out.shape[1], nu + 1
    for c in range(3):
        oc = out[c]
        here, left = fu[c, pad : pad + n], fu[c, pad - 1 : pad - 1 + n]
        down, up = fv[c, pad : pad + n], fv[c, 1 : 1 + n]
        for e in range(n):
            oc[e] += sign * ((here[e] - left[e]) + (down[e] - up[e]))


@lean_kernel
def stretch_fluxes(d, rate, rest, stiffness, damping, flux, unit, along, across, k_scale, c_scale):
    """Stretch of one family of edges: E = ½ k (|d| − L)², and its dashpot (Baraff and Witkin 1998, eq. 10 and 11).

    d, rate: difference of positions m and velocities m/s, (3, P); rest L m, stiffness k N/m, damping c N·s/m (P,).
    Fills flux (3, P) N, and for `assemble` unit (3, P), along and across (P,): the weights k_scale·k + c_scale·c along
    the edge and k_scale·k (1 − L/|d|) across it, the latter only under tension so that the matrix stays positive.
    """
    dx, dy, dz = d[0], d[1], d[2]
    rx, ry, rz = rate[0], rate[1], rate[2]
    for e in range(rest.shape[0]):
        inverse = 1.0 / np.sqrt(dx[e] * dx[e] + dy[e] * dy[e] + dz[e] * dz[e] + TINY)
        ux, uy, uz = dx[e] * inverse, dy[e] * inverse, dz[e] * inverse
        slack = 1.0 - rest[e] * inverse
        closing = rx[e] * ux + ry[e] * uy + rz[e] * uz
        spring, dashpot = stiffness[e] * slack, damping[e] * closing
        flux[0, e] = spring * dx[e] + dashpot * ux
        flux[1, e] = spring * dy[e] + dashpot * uy
        flux[2, e] = spring * dz[e] + dashpot * uz
        unit[0, e], unit[1, e], unit[2, e] = ux, uy, uz
        tension = k_scale * stiffness[e] * max(slack, 0.0)
        across[e] = tension
        along[e] = k_scale * stiffness[e] + c_scale * damping[e] - tension


@lean_kernel
def shear_fluxes(nu, du, dv, ru, rv, over_u, over_v, stiffness, damping, fu, fv, pl, ql, pu, qu):
    """Shear C = w_u·w_v of both triangles of every cell, E = ½ k A C² and −c A Ċ ∂C (Baraff and Witkin 1998, 4.3).

    over_u, over_v (P,): 1/h of each cell; stiffness, damping (P,): k A N·m, c A N·m·s of one triangle.
    Adds to fu, fv; keeps ∂C by u- and v-edge in pl, ql (lower) and pu, qu (upper), (3, P).
    """
    m = over_u.shape[0] - 1 - nu  # the last pad has no neighbours of its own
    for e in range(m):
        b, c = e + 1, e + nu
        iu, iv = over_u[e], over_v[e]
        iuv = iu * iv
        # lower: u-edge e, v-edge e + 1; upper: u-edge e + nu, v-edge e
        cl = iuv * (du[0, e] * dv[0, b] + du[1, e] * dv[1, b] + du[2, e] * dv[2, b])
        cu = iuv * (du[0, c] * dv[0, e] + du[1, c] * dv[1, e] + du[2, c] * dv[2, e])
        rl = ru[0, e] * dv[0, b] + ru[1, e] * dv[1, b] + ru[2, e] * dv[2, b]
        rl += du[0, e] * rv[0, b] + du[1, e] * rv[1, b] + du[2, e] * rv[2, b]
        rr = ru[0, c] * dv[0, e] + ru[1, c] * dv[1, e] + ru[2, c] * dv[2, e]
        rr += du[0, c] * rv[0, e] + du[1, c] * rv[1, e] + du[2, c] * rv[2, e]
        tl = stiffness[e] * cl + damping[e] * iuv * rl
        tu = stiffness[e] * cu + damping[e] * iuv * rr
        for k in range(3):
            pl[k, e] = iuv * dv[k, b]
            ql[k, e] = iuv * du[k, e]
            pu[k, e] = iuv * dv[k, e]
            qu[k, e] = iuv * du[k, c]
            fu[k, e] += tl * pl[k, e]
            fv[k, b] += tl * ql[k, e]
            fu[k, c] += tu * pu[k, e]
            fv[k, e] += tu * qu[k, e]


@lean_kernel
def add_diagonals(offsets, values, x, scale, out):
    """out += scale · (K x) for the symmetric K given by its diagonals, row by row of x (3, n)."""
    n = x.shape[1]
    for s in range(offsets.shape[0]):
        k = offsets[s]
        w = values[s, : n - k]
        for c in range(3):
            first, second = x[c, : n - k], x[c, k:]
            low, high = out[c, : n - k], out[c, k:]
            for e in range(n - k):
                low[e] += scale * w[e] * second[e]
            if k > 0:
                for e in range(n - k):
                    high[e] += scale * w[e] * first[e]


@lean_kernel
def cell_shear_fluxes(nu, du, dv, ru, rv, over_u, over_v, stiffness, damping, fu, fv, p, q):
    """Shear of whole cells, C = w_u·w_v from the means of a cell's opposite edges, E = ½ k A C²: as `shear_fluxes`, for
    quadrilaterals. stiffness, damping (P,): k A and c A of a cell; keeps ∂C by either u-edge in p, either v-edge in q.
    """
    for e in range(over_u.shape[0] - 1 - nu):
        b, c = e + 1, e + nu
        scale = 0.25 * over_u[e] * over_v[e]
        shear, rate = 0.0, 0.0
        for k in range(3):
            u, v = du[k, e] + du[k, c], dv[k, e] + dv[k, b]
            p[k, e], q[k, e] = scale * v, scale * u
            shear += scale * u * v
            rate += scale * (u * (rv[k, e] + rv[k, b]) + (ru[k, e] + ru[k, c]) * v)
        t = stiffness[e] * shear + damping[e] * rate
        for k in range(3):
            fu[k, e] += t * p[k, e]
            fu[k, c] += t * p[k, e]
            fv[k, e] += t * q[k, e]
            fv[k, b] += t * q[k, e]
