"""The sheet's own layers kept apart, for the compiled time loops of all models.

After every step, pairs of features that have come closer than `thickness` are taken apart: each node against each
triangle and each edge against each edge, except where the two lie within 2·thickness of each other on the flat sheet
(so a thickness above half a cell merely leaves out more neighbours). The closest points and the direction between
them are taken from the *beginning* of the step, x − dt·v, where the layers still were on their right sides; along that
direction the end of the step must leave `thickness` between the same two points. Where it does not, the points are
pushed apart, shared among their nodes as an impulse would be (position-based dynamics, Müller et al. 2007, with
the weights of Bridson, Fedkiw and Anderson 2002), and their approaching velocity is taken away: an inelastic impact,
without friction between layers. Because the side is that of the step's beginning, a step may be longer than the
thickness is deep. Nodes go first, in the order of the lists; up to PASSES times, as long as layers get pushed by much.

What makes it affordable: pairs are listed while they are up to `skin` further apart than the thickness, and the lists
last until nodes may have moved by half of that; each pair sleeps until nodes have moved by half of what it lacks to
the thickness, TOLERANCE of it disregarded. The lists come from a hashed grid of triangles' and edges' centres.
"""

from __future__ import annotations

from collections import namedtuple

import numpy as np
from numba import types

from clothbench.core.kernels import bundle_type, lean_kernel
from clothbench.core.scene import Scene
from clothbench.modelling.sheet import Sheet

PASSES = 4
TOLERANCE = 0.02  # share of the thickness by which layers may approach before a pair is looked at again
PAIRS = 64  # length of both lists, in pairs a node; a longer one is worked off in pieces, at every step anew
PUSHED = -1.0  # wake of a pair that was pushed: it is looked at again in any case
TOUCHING = 1e-12  # m; below it there is no direction between two features

Layers = namedtuple("Layers", "uv triangles edges size pairs wake reference travel count centre half cell head order")
Layers.__doc__ = """What `keep_apart` needs and remembers of one sheet; `layers_of` makes it, one for each run.

uv: (3, n) m, rest coordinates with a row of zeros; triangles: (F, 3) and edges: (E, 2), node numbers;
size: (3,) m, thickness, skin, and the distance on the flat sheet up to which features are neighbours;
pairs: (2, P, 2), lists of (node, triangle) and (edge, edge); wake: (2, P) m, at which travel a pair is looked at again;
reference: (3, n) m, where nodes were when the lists were made; travel: (4,) m, how far any node may have gone since the
run began, the same when the lists were made, how far the lists reach beyond the thickness, largest push;
count: (4,), pairs in each list, 1 if the lists are incomplete, how often they were made;
centre: (3, E) m, half: (E,) m, cell: (3, E), head: (H + 1,), order: (E,): the hashed grid.
"""

_int1, _int2, _real1, _real2 = types.int64[::1], types.int64[:, ::1], types.float64[::1], types.float64[:, ::1]
LAYERS = bundle_type(Layers, _real2, _int2, _int2, _real1, types.int64[:, :, ::1], _real2, _real2, _real1, _int1,
        _real2, _real1, _int2, _int1, _int1)  # fmt: skip
NODE_TRIANGLE, EDGE_EDGE = 0, 1
TRAVEL, TRAVEL_AT_LISTS, REACH, PUSH = 0, 1, 2, 3
INCOMPLETE, LISTINGS = 2, 3


def layers_of(scene: Scene, sheet: Sheet) -> Layers:
    """The sheet's features for one run; of length 0 if the scene says that layers pass through each other."""
    thickness = scene.thickness
    triangles = sheet.triangles if thickness > 0 else sheet.triangles[:0]
    n = len(sheet.uv) if thickness > 0 else 0
    sides = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges = np.unique(sides, axis=0)
    uv = np.zeros((3, n))
    uv[:2] = sheet.uv[:n].T
    length = np.linalg.norm(sheet.uv[edges[:, 0]] - sheet.uv[edges[:, 1]], axis=1).min(initial=np.inf)
    # Reaching further than this, the lists would be full of neighbours on a flat sheet. Measured, 21² nodes draped:
    # 0.6 cells cost 300 µs a step, 1.0 cells 340 µs, 1.5 cells 850 µs, though the lists then last three times as long.
    skin = max(0.8 * thickness, 0.6 * length - thickness) if n else 0.0
    buckets = 1 << max(4, int(2 * len(edges)).bit_length())
    return Layers(
        uv, np.ascontiguousarray(triangles), np.ascontiguousarray(edges, dtype=np.int64),
        np.array([thickness, skin, 2 * thickness]), np.zeros((2, PAIRS * n, 2), np.int64), np.zeros((2, PAIRS * n)),
        np.zeros((3, n)), np.array([0.0, -np.inf, 0.0, 0.0]), np.zeros(4, np.int64),
        np.zeros((3, len(edges))), np.zeros(len(edges)), np.zeros((3, len(edges)), np.int64),
        np.zeros(buckets + 1, np.int64), np.zeros(len(edges), np.int64),
    )  # fmt: skip


@lean_kernel
def keep_apart(x, v, dt, free, layers):
    """Keep the layers of one sheet apart after a step of dt s; see the module for the scheme.

    x (3, n) m and v (3, n) m/s are changed in place; v is the velocity that brought x here in this step;
    free (n,): inverse mass 1/kg, 0 where a node is held.
    """
    travel, count = layers.travel, layers.count
    step = _largest(v) * dt
    if not step < np.inf:
        return  # blown up; the loop will notice
    before = travel[TRAVEL]
    travel[TRAVEL] = before + step
    travel[PUSH] = 0.0
    if count[INCOMPLETE] or 2 * (travel[TRAVEL] - travel[TRAVEL_AT_LISTS]) > travel[REACH]:
        gone = _farthest(x, layers.reference) if count[LISTINGS] else np.inf
        if count[INCOMPLETE] or 2 * gone > 0.9 * travel[REACH]:
            _make_lists(x, v, dt, free, layers, step, before)
            travel[TRAVEL_AT_LISTS] = before
        else:
            travel[TRAVEL_AT_LISTS] = travel[TRAVEL] - gone
    for again in range(PASSES):
        travel[PUSH] = 0.0
        _work_off(x, v, dt, free, layers, before, PUSHED if again else travel[TRAVEL])
        travel[TRAVEL] += travel[PUSH]
        if travel[PUSH] < 0.1 * layers.size[0]:
            break


@lean_kernel
def _work_off(x, v, dt, free, layers, before, awake):
    """Look at every listed pair that wakes up to `awake`; `before`: the travel when the step began [m]."""
    pairs, wake, size = layers.pairs[NODE_TRIANGLE], layers.wake[NODE_TRIANGLE], layers.size
    for k in range(layers.count[NODE_TRIANGLE]):
        if wake[k] <= awake:
            a, f = pairs[k, 0], pairs[k, 1]
            t = layers.triangles
            gap, push = _part_node(x, v, dt, free, a, t[f, 0], t[f, 1], t[f, 2], size[0])
            wake[k] = PUSHED if push > 0.0 else _wake(before, gap, size[0])
            layers.travel[PUSH] = max(layers.travel[PUSH], push)
    pairs, wake, edges = layers.pairs[EDGE_EDGE], layers.wake[EDGE_EDGE], layers.edges
    for k in range(layers.count[EDGE_EDGE]):
        if wake[k] <= awake:
            e, g = pairs[k, 0], pairs[k, 1]
            gap, push = _part_edges(x, v, dt, free, edges[e, 0], edges[e, 1], edges[g, 0], edges[g, 1], size[0])
            wake[k] = PUSHED if push > 0.0 else _wake(before, gap, size[0])
            layers.travel[PUSH] = max(layers.travel[PUSH], push)


@lean_kernel
def _wake(before, gap, thickness):
    """At which travel [m] a pair that was `gap` apart at travel `before` has to be looked at again."""
    return before + 0.5 * (gap - (1.0 - TOLERANCE) * thickness)


@lean_kernel
def _part_node(x, v, dt, free, p, a, b, c, thickness):
    """Node p against triangle abc; returns how far apart they were [m] and the largest push [m]."""
    s, t = _closest_on_triangle(_old(x, v, dt, p), _old(x, v, dt, a), _old(x, v, dt, b), _old(x, v, dt, c))
    return _part(x, v, dt, free, p, p, a, b, c, 0.0, 1.0 - s - t, s, t, thickness)


@lean_kernel
def _part_edges(x, v, dt, free, a, b, c, d, thickness):
    """Edge ab against edge cd; returns how far apart they were [m] and the largest push [m]."""
    s, t = _closest_on_segments(_old(x, v, dt, a), _old(x, v, dt, b), _old(x, v, dt, c), _old(x, v, dt, d))
    return _part(x, v, dt, free, a, b, c, d, d, s, 1.0 - t, t, 0.0, thickness)


@lean_kernel
def _part(x, v, dt, free, i, j, k, m, n, s, wk, wm, wn, thickness):
    """Take apart the points P = (1−s) i + s j and Q = wk k + wm m + wn n; a weight of 0 marks a node not in it.

    With n = (P − Q)/|P − Q| as the step began and g = n·(P − Q) now, each node moves by ∓w·(its 1/m)/Σw²/m times
    (thickness − g), and the velocities change likewise by what takes away n·(Ṗ − Q̇) < 0.
    """
    wi, wj = 1.0 - s, s
    ox, oy, oz = _apart(x, v, dt, i, j, k, m, n, wi, wj, wk, wm, wn)
    distance = np.sqrt(ox * ox + oy * oy + oz * oz)
    if distance < TOUCHING:
        return distance, 0.0
    dx, dy, dz = ox / distance, oy / distance, oz / distance
    ex, ey, ez = _apart(x, v, 0.0, i, j, k, m, n, wi, wj, wk, wm, wn)
    gap = ex * dx + ey * dy + ez * dz
    if gap >= thickness:
        return distance, 0.0
    softness = (
        wi * wi * free[i] + wj * wj * free[j] + wk * wk * free[k] + wm * wm * free[m] + wn * wn * free[n]
    )  # fmt: skip
    if softness == 0.0:
        return distance, 0.0
    closing = (distance - gap) / dt if dt > 0.0 else 0.0
    move, kick = (thickness - gap) / softness, max(0.0, closing) / softness
    largest = 0.0
    for node, weight in ((i, wi), (j, wj), (k, -wk), (m, -wm), (n, -wn)):
        share = weight * free[node]
        if share != 0.0:
            x[0, node] += move * share * dx
            x[1, node] += move * share * dy
            x[2, node] += move * share * dz
            v[0, node] += kick * share * dx
            v[1, node] += kick * share * dy
            v[2, node] += kick * share * dz
            largest = max(largest, move * abs(share))
    return distance, largest


@lean_kernel
def _apart(x, v, back, i, j, k, m, n, wi, wj, wk, wm, wn):
    """P − Q of `_part`, `back` s ago."""
    dx = _mixed(x, v, back, 0, i, j, k, m, n, wi, wj, wk, wm, wn)
    dy = _mixed(x, v, back, 1, i, j, k, m, n, wi, wj, wk, wm, wn)
    return dx, dy, _mixed(x, v, back, 2, i, j, k, m, n, wi, wj, wk, wm, wn)


@lean_kernel
def _mixed(x, v, back, c, i, j, k, m, n, wi, wj, wk, wm, wn):
    p = wi * (x[c, i] - back * v[c, i]) + wj * (x[c, j] - back * v[c, j])
    return p - (
        wk * (x[c, k] - back * v[c, k]) + wm * (x[c, m] - back * v[c, m]) + wn * (x[c, n] - back * v[c, n])
    )  # fmt: skip


@lean_kernel
def _old(x, v, dt, i):
    """Where node i was when the step began."""
    return x[0, i] - dt * v[0, i], x[1, i] - dt * v[1, i], x[2, i] - dt * v[2, i]


# --- lists ------------------------------------------------------------------------------------------------------------


@lean_kernel
def _make_lists(x, v, dt, free, layers, step, before):
    """List the pairs that were within thickness + reach when the step began; each may move by half the reach."""
    layers.travel[REACH] = max(layers.size[1], 2 * step)
    layers.count[INCOMPLETE] = 0
    layers.count[LISTINGS] += 1
    for i in range(x.shape[1]):
        layers.reference[0, i], layers.reference[1, i], layers.reference[2, i] = _old(x, v, dt, i)
    limit = layers.size[0] + layers.travel[REACH]
    _list_nodes(x, v, dt, free, layers, limit, before)
    _list_edges(x, v, dt, free, layers, limit, before)


@lean_kernel
def _list_nodes(x, v, dt, free, layers, limit, before):
    triangles, r, centre, half = layers.triangles, layers.reference, layers.centre, layers.half
    for f in range(triangles.shape[0]):
        a, b, c = triangles[f, 0], triangles[f, 1], triangles[f, 2]
        for k in range(3):
            centre[k, f] = (r[k, a] + r[k, b] + r[k, c]) / 3
        half[f] = np.sqrt(max(_square(centre, f, r, a), _square(centre, f, r, b), _square(centre, f, r, c)))
    cell = _largest_of(half, triangles.shape[0]) + limit
    _fill_grid(layers, triangles.shape[0], cell)
    layers.count[NODE_TRIANGLE] = 0
    for p in range(r.shape[1]):
        cx, cy, cz = _cell_of(r, p, cell)
        for near in range(27):
            ix, iy, iz = cx + near % 3 - 1, cy + near // 3 % 3 - 1, cz + near // 9 - 1
            bucket = _bucket(ix, iy, iz, layers.head.shape[0] - 1)
            for o in range(layers.head[bucket], layers.head[bucket + 1]):
                f = layers.order[o]
                if layers.cell[0, f] != ix or layers.cell[1, f] != iy or layers.cell[2, f] != iz:
                    continue  # another cell in the same bucket
                if _square(centre, f, r, p) < (half[f] + limit) ** 2 and not _has(triangles, f, p):
                    gap = _node_gap(r, triangles, p, f)
                    if gap < limit and _node_gap(layers.uv, triangles, p, f) >= layers.size[2]:
                        _append(x, v, dt, free, layers, before, NODE_TRIANGLE, p, f, gap)


@lean_kernel
def _list_edges(x, v, dt, free, layers, limit, before):
    edges, r, centre, half = layers.edges, layers.reference, layers.centre, layers.half
    for e in range(edges.shape[0]):
        for k in range(3):
            centre[k, e] = 0.5 * (r[k, edges[e, 0]] + r[k, edges[e, 1]])
        half[e] = np.sqrt(_square(centre, e, r, edges[e, 0]))
    cell = 2 * _largest_of(half, edges.shape[0]) + limit
    _fill_grid(layers, edges.shape[0], cell)
    layers.count[EDGE_EDGE] = 0
    for e in range(edges.shape[0]):
        for near in range(13, 27):  # the other half is found from the other edge
            ix = layers.cell[0, e] + near % 3 - 1
            iy = layers.cell[1, e] + near // 3 % 3 - 1
            iz = layers.cell[2, e] + near // 9 - 1
            bucket = _bucket(ix, iy, iz, layers.head.shape[0] - 1)
            for o in range(layers.head[bucket], layers.head[bucket + 1]):
                g = layers.order[o]
                if (near == 13 and g <= e) or layers.cell[0, g] != ix or layers.cell[1, g] != iy:
                    continue
                if layers.cell[2, g] != iz:
                    continue
                if _square(centre, e, centre, g) < (half[e] + half[g] + limit) ** 2 and not _meet(edges, e, g):
                    gap = _edge_gap(r, edges, e, g)
                    if gap < limit and _edge_gap(layers.uv, edges, e, g) >= layers.size[2]:
                        _append(x, v, dt, free, layers, before, EDGE_EDGE, e, g, gap)


@lean_kernel
def _has(features, k, node):
    """Whether a node belongs to a triangle."""
    return features[k, 0] == node or features[k, 1] == node or features[k, 2] == node


@lean_kernel
def _meet(edges, e, g):
    """Whether two edges have a node in common."""
    c, d = edges[g, 0], edges[g, 1]
    return edges[e, 0] in (c, d) or edges[e, 1] in (c, d)


@lean_kernel
def _append(x, v, dt, free, layers, before, kind, one, other, gap):
    """Add a pair to its list; a full list is worked off at once and begun anew, and made again at the next step."""
    if layers.count[kind] == layers.pairs.shape[1]:
        layers.count[INCOMPLETE] = 1
        _work_off(x, v, dt, free, layers, before, layers.travel[TRAVEL])
        layers.count[kind] = 0
    k = layers.count[kind]
    layers.pairs[kind, k, 0], layers.pairs[kind, k, 1] = one, other
    layers.wake[kind, k] = _wake(before, gap, layers.size[0])
    layers.count[kind] = k + 1


@lean_kernel
def _fill_grid(layers, items, size):
    """Sort the centres of `items` features into cells of `size` m and those into hashed buckets (a counting sort)."""
    head, order, cell = layers.head, layers.order, layers.cell
    buckets = head.shape[0] - 1
    head[:] = 0
    for k in range(items):
        cell[0, k], cell[1, k], cell[2, k] = _cell_of(layers.centre, k, size)
        head[_bucket(cell[0, k], cell[1, k], cell[2, k], buckets)] += 1
    total = 0
    for b in range(buckets + 1):
        total += head[b]
        head[b] = total
    for k in range(items - 1, -1, -1):
        b = _bucket(cell[0, k], cell[1, k], cell[2, k], buckets)
        head[b] -= 1
        order[head[b]] = k


@lean_kernel
def _cell_of(points, k, size):
    return (
        np.int64(np.floor(points[0, k] / size)),
        np.int64(np.floor(points[1, k] / size)),
        np.int64(np.floor(points[2, k] / size)),
    )


@lean_kernel
def _bucket(ix, iy, iz, buckets):
    """Hash of a cell (Teschner et al. 2003); `buckets` is a power of two."""
    return ((ix * 73856093) ^ (iy * 19349663) ^ (iz * 83492791)) & (buckets - 1)


# --- distances --------------------------------------------------------------------------------------------------------


@lean_kernel
def _largest(v):
    """Largest speed of a node; not a number if any is not."""
    top = 0.0
    for i in range(v.shape[1]):
        square = v[0, i] * v[0, i] + v[1, i] * v[1, i] + v[2, i] * v[2, i]
        if not square <= top:
            top = square
    return np.sqrt(top)


@lean_kernel
def _farthest(x, reference):
    """How far a node is at most from where it was."""
    top = 0.0
    for i in range(x.shape[1]):
        top = max(top, _square(x, i, reference, i))
    return np.sqrt(top)


@lean_kernel
def _square(a, i, b, j):
    return (a[0, i] - b[0, j]) ** 2 + (a[1, i] - b[1, j]) ** 2 + (a[2, i] - b[2, j]) ** 2


@lean_kernel
def _largest_of(values, count):
    top = 0.0
    for k in range(count):
        top = max(top, values[k])
    return top


@lean_kernel
def _node_gap(r, triangles, p, f):
    """Distance of node p from triangle f [m]."""
    a, b, c = triangles[f, 0], triangles[f, 1], triangles[f, 2]
    s, t = _closest_on_triangle(_at(r, p), _at(r, a), _at(r, b), _at(r, c))
    dx, dy, dz = _apart(r, r, 0.0, p, p, a, b, c, 1.0, 0.0, 1.0 - s - t, s, t)
    return np.sqrt(dx * dx + dy * dy + dz * dz)


@lean_kernel
def _edge_gap(r, edges, e, g):
    """Distance between two edges [m]."""
    a, b, c, d = edges[e, 0], edges[e, 1], edges[g, 0], edges[g, 1]
    s, t = _closest_on_segments(_at(r, a), _at(r, b), _at(r, c), _at(r, d))
    dx, dy, dz = _apart(r, r, 0.0, a, b, c, d, d, 1.0 - s, s, 1.0 - t, t, 0.0)
    return np.sqrt(dx * dx + dy * dy + dz * dz)


@lean_kernel
def _at(r, i):
    return r[0, i], r[1, i], r[2, i]


@lean_kernel
def _less(p, q):
    return p[0] - q[0], p[1] - q[1], p[2] - q[2]


@lean_kernel
def _dot(p, q):
    return p[0] * q[0] + p[1] * q[1] + p[2] * q[2]


@lean_kernel
def _closest_on_triangle(p, a, b, c):
    """Weights (s, t) of b and c of the point of triangle abc that is closest to p (Ericson 2005, section 5.1.5)."""
    ab, ac, ap = _less(b, a), _less(c, a), _less(p, a)
    d1, d2 = _dot(ab, ap), _dot(ac, ap)
    if d1 <= 0.0 and d2 <= 0.0:
        return 0.0, 0.0
    bp = _less(p, b)
    d3, d4 = _dot(ab, bp), _dot(ac, bp)
    if d3 >= 0.0 and d4 <= d3:
        return 1.0, 0.0
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        return d1 / (d1 - d3), 0.0
    cp = _less(p, c)
    d5, d6 = _dot(ab, cp), _dot(ac, cp)
    if d6 >= 0.0 and d5 <= d6:
        return 0.0, 1.0
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        return 0.0, d2 / (d2 - d6)
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 >= d3 and d5 >= d6:
        t = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return 1.0 - t, t
    total = 1.0 / (va + vb + vc)
    return vb * total, vc * total


@lean_kernel
def _closest_on_segments(a, b, c, d):
    """Where on ab (0…1) and on cd (0…1) the two segments are closest (Ericson 2005, section 5.1.9)."""
    ab, cd, ca = _less(b, a), _less(d, c), _less(a, c)
    aa, ee, f = _dot(ab, ab), _dot(cd, cd), _dot(cd, ca)
    if aa <= 0.0 or ee <= 0.0:
        return 0.0, 0.0
    g, h = _dot(ab, ca), _dot(ab, cd)
    across = aa * ee - h * h
    s = min(max((h * f - g * ee) / across, 0.0), 1.0) if across > 1e-12 * aa * ee else 0.5
    t = (h * s + f) / ee
    if t < 0.0:
        return min(max(-g / aa, 0.0), 1.0), 0.0
    if t > 1.0:
        return min(max((h - g) / aa, 0.0), 1.0), 1.0
    return s, t
