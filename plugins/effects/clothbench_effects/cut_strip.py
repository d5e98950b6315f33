"""The lowest strip of a sheet that is cut along an outline, shared out among the nodes of its grid."""

import numpy as np

from clothbench_effects.sheet_kernels import cut, helper

ROOM = 8  # times the corners of an outline: each of five cuts adds half as many as there are at most


@helper(allocates=True)
def add_strip(sheet, above, share):
    """share_k += what node k carries of the cloth at v > `above` m, (n,) m²; together they are the strip's area.

    The outline is cut at the lines of the grid (nodes j·nu + i) and half-way between them, exactly, as `Cover` does.
    Where all corners of a cell are of the cloth, they take what lies in a quarter of it by their bilinear weights at
    its centre, which keeps the first moment; else the node in the quarter takes it, or the next that is of the cloth.
    """
    columns = row_length(sheet.uv)
    u, v = halved(sheet.uv[:columns, 0]), halved(sheet.uv[::columns, 1])
    room = ROOM * sheet.outline.shape[0]
    strip, band, piece, spare = np.empty((room, 2)), np.empty((room, 2)), np.empty((room, 2)), np.empty((room, 2))
    corners = cut(sheet.outline, sheet.outline.shape[0], 1, 1.0, above, strip)
    for j in range(v.shape[0] - 1):
        high = between(strip, corners, 1, j, v, spare, band)
        for i in range(u.shape[0] - 1):
            size, at_u, at_v = centre(piece, between(band, high, 0, i, u, spare, piece))
            if size > 0.0:
                left, top = i - i % 2, j - j % 2
                s = (at_u - u[left]) / (u[left + 2] - u[left])
                t = (at_v - v[top]) / (v[top + 2] - v[top])
                corner = top // 2 * columns + left // 2
                if not share_out(sheet.area, corner, columns, size, s, t, share):
                    share[nearest(sheet, corner + i % 2 + j % 2 * columns)] += size


@helper
def row_length(uv):
    """Nodes in a row of a grid, whose first row all lies at the same v."""
    columns = 1
    while columns < uv.shape[0] and uv[columns, 1] == uv[0, 1]:
        columns += 1
    return columns


@helper(allocates=True)
def halved(lines):
    """The lines (K,) m with another half-way between each two, (2 K − 1,)."""
    out = np.empty(2 * lines.shape[0] - 1)
    for k in range(lines.shape[0]):
        out[2 * k] = lines[k]
        if k > 0:
            out[2 * k - 1] = (lines[k - 1] + lines[k]) / 2.0
    return out


@helper(allocates=True)
def between(polygon, count, axis, k, lines, spare, out):
    """The part of a polygon between lines k and k + 1, beyond the outer ones as far as it reaches, into `out`; returns
    its corner count. Parts of one that is not convex hang together by edges that run there and back.
    """
    low = lines[k] if k > 0 else -np.inf
    high = lines[k + 1] if k + 2 < lines.shape[0] else np.inf
    return cut(spare, cut(polygon, count, axis, 1.0, low, spare), axis, -1.0, high, out)


@helper
def centre(polygon, count):
    """Area of a counter-clockwise polygon (count, 2) m² and its centre (u, v) m."""
    size, at_u, at_v = 0.0, 0.0, 0.0
    for m in range(1, count - 1):
        a, b = polygon[m], polygon[m + 1]
        part = 0.5 * ((a[0] - polygon[0, 0]) * (b[1] - polygon[0, 1]) - (a[1] - polygon[0, 1]) * (b[0] - polygon[0, 0]))
        size += part
        at_u += part * (polygon[0, 0] + a[0] + b[0]) / 3.0
        at_v += part * (polygon[0, 1] + a[1] + b[1]) / 3.0
    return size, at_u / size, at_v / size


@helper
def share_out(area, corner, columns, size, s, t, share):
    """Give `size` m² to the four corners of a cell, the first of them node `corner`, by their weights at (s, t).
    Whether all of them are of the cloth: else nobody gets anything.
    """
    right, below, last = corner + 1, corner + columns, corner + columns + 1
    if area[corner] <= 0.0 or area[right] <= 0.0 or area[below] <= 0.0 or area[last] <= 0.0:
        return False
    s, t = min(max(s, 0.0), 1.0), min(max(t, 0.0), 1.0)  # cloth reaches beyond the outer lines beside grips
    share[corner] += size * (1.0 - s) * (1.0 - t)
    share[right] += size * s * (1.0 - t)
    share[below] += size * (1.0 - s) * t
    share[last] += size * s * t
    return True


@helper
def nearest(sheet, node):
    """The node of the cloth that is next to this one."""
    found, best = node, np.inf
    for k in range(sheet.uv.shape[0]):
        away = (sheet.uv[k, 0] - sheet.uv[node, 0]) ** 2 + (sheet.uv[k, 1] - sheet.uv[node, 1]) ** 2
        if sheet.area[k] > 0.0 and away < best:
            found, best = k, away
    return found
