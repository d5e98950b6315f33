"""Contact with a scene's obstacles, for the compiled time loops of all models.

The scheme, once after every step of a model, in this order: obstacle by obstacle as the scene lists them, and in each
node by node. A node that the step has brought inside is put on the surface, along the surface's normal; the part of
its velocity that points inwards is taken away (a perfectly inelastic impact); and Coulomb's friction takes from the
tangential velocity at most μ times the normal velocity that was taken away, since friction's impulse in a step is at
most μ times the normal one. So a resting node feels μ times the force with which it is pressed on, whatever that
force is made of, and sticks as long as friction suffices. The part of the path that the node went tangentially since
it touched is taken back in the same proportion; without that a sticking node would creep by g sin(α) dt² a step. All
velocities are those against the obstacle, which may itself be carried along by the grips.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clothbench.core.kernels import lean_kernel
from clothbench.core.scene import SHAPES, Scene
from clothbench.modelling.time_loop import grip_point

PLANE, DISC, SPHERE = (float(SHAPES.index(shape)) for shape in ("plane", "disc", "sphere"))


class ObstacleColumns(NamedTuple):
    """The columns of `obstacle_table`; of a vector the first of three."""

    kind: int = 0  # PLANE, DISC or SPHERE
    centre: int = 1  # m
    normal: int = 4  # outward, of length 1
    radius: int = 7  # m
    friction: int = 8
    velocity: int = 9  # m/s
    carriers: int = 12  # how many grips carry it
    first_centre: int = 13  # m, when the run begins
    velocity_before: int = 16  # m/s, a step before
    end: int = 19


OBSTACLE = ObstacleColumns()


def obstacle_table(scene: Scene) -> np.ndarray:
    """The obstacles for `keep_out`, a row each, with the columns of `OBSTACLE`.

    `carry` changes centres and velocities, so that loops that run side by side need a table each.
    """
    grips, still = len(scene.grip_material), (0.0, 0.0, 0.0)
    rows = [
        (
            *(SHAPES.index(o.shape), *o.centre, *o.normal, o.radius, o.friction),
            *(*still, grips * o.carried, *o.centre, *still),
        )
        for o in scene.obstacles
    ]
    return np.array(rows, dtype=float).reshape(-1, OBSTACLE.end)


@lean_kernel
def vector_of(obstacles, k, column):
    """The vector (3,) of obstacle k that begins in a column."""
    return obstacles[k, column], obstacles[k, column + 1], obstacles[k, column + 2]


@lean_kernel
def carry(obstacles, knots, curve, start, t, dt):
    """Bring the obstacles that the grips carry to where they are at time t, in a run that began at `start` [s].

    Their velocity becomes the mean one over the last dt [s], and that before the one over the dt before. knots (K,) s
    and curve (4, K−1, G, 3): the grips of one member, as in `Grips`; obstacles: `obstacle_table`, changed in place.
    """
    for k in range(obstacles.shape[0]):
        grips = int(obstacles[k, OBSTACLE.carriers])  # the first of the curve; nodes off the cloth come after, at rest
        if grips > 0:
            for c in range(3):
                first = _mean_grip(knots, curve, grips, start, c)
                now = _mean_grip(knots, curve, grips, t, c)
                before = _mean_grip(knots, curve, grips, max(start, t - dt), c)
                earlier = _mean_grip(knots, curve, grips, max(start, t - 2 * dt), c)
                obstacles[k, OBSTACLE.centre + c] = obstacles[k, OBSTACLE.first_centre + c] + now - first
                obstacles[k, OBSTACLE.velocity + c] = (now - before) / dt
                obstacles[k, OBSTACLE.velocity_before + c] = (before - earlier) / dt


@lean_kernel
def _mean_grip(knots, curve, grips, t, c):
    """Coordinate c of the mean of the first `grips` curves at time t [m]."""
    segment, total = min(max(np.searchsorted(knots, t, side="right") - 1, 0), knots.shape[0] - 2), 0.0
    for g in range(grips):
        total += grip_point(knots, curve, t, segment, g, c)
    return total / grips


@lean_kernel
def keep_out(x, v, obstacles, free, lane, lanes, extra=None, heavier=False):
    """Put the nodes of one lane that are inside an obstacle on its surface; see the module for the scheme.

    x (3, n·lanes) m and v m/s are changed in place, after a step; node i of a lane is entry i·lanes + lane.
    obstacles: `obstacle_table`, where they are after the step (`carry`); free (n·lanes,): inverse mass, 0 for a node
    that is held and stays where it is; extra (6, n) kg: what effects added to the masses of one lane, if they made it
    `heavier` (`apply_effects`). Air that is pressed on with a node presses, and is not dragged along.
    """
    for k in range(obstacles.shape[0]):
        kind, friction = obstacles[k, OBSTACLE.kind], obstacles[k, OBSTACLE.friction]
        drift = vector_of(obstacles, k, OBSTACLE.velocity)
        for e in range(lane, x.shape[1], lanes):
            if free[e] == 0.0:
                continue
            depth, nx, ny, nz = inside(kind, obstacles, k, x[0, e], x[1, e], x[2, e])
            if depth > 0.0:
                rub = friction
                if extra is not None and heavier:
                    rub *= _pressed_over_dragged(v, e, nx, ny, nz, drift, free[e], extra)
                _put_on(x, v, e, depth, nx, ny, nz, rub, drift)


@lean_kernel
def inside(kind, obstacles, k, px, py, pz):
    """How deep the point is in obstacle k [m], ≤ 0 outside, and the way out: a unit normal."""
    cx, cy, cz = vector_of(obstacles, k, OBSTACLE.centre)
    dx, dy, dz = px - cx, py - cy, pz - cz
    nx, ny, nz = vector_of(obstacles, k, OBSTACLE.normal)
    radius = obstacles[k, OBSTACLE.radius]
    if kind == SPHERE:
        square = dx * dx + dy * dy + dz * dz
        if square >= radius * radius or square == 0.0:
            return 0.0, nx, ny, nz
        distance = np.sqrt(square)
        return radius - distance, dx / distance, dy / distance, dz / distance
    height = dx * nx + dy * ny + dz * nz
    if kind == PLANE or height >= 0.0:
        return -height, nx, ny, nz
    # A disc is a pedestal: out through its top or its side, whichever is nearer.
    dx, dy, dz = dx - height * nx, dy - height * ny, dz - height * nz
    away = np.sqrt(dx * dx + dy * dy + dz * dz)
    if away >= radius:
        return 0.0, nx, ny, nz
    if -height <= radius - away or away == 0.0:
        return -height, nx, ny, nz
    return radius - away, dx / away, dy / away, dz / away


@lean_kernel
def _pressed_over_dragged(v, e, nx, ny, nz, drift, free, extra):
    """nᵀMn / tᵀMt of a node's mass M = 1/free + ΔM, t the way it slides: by how much more velocity friction takes than
    of a node that is as heavy in all directions.
    """
    vx, vy, vz = v[0, e] - drift[0], v[1, e] - drift[1], v[2, e] - drift[2]
    speed = vx * nx + vy * ny + vz * nz
    tx, ty, tz = vx - speed * nx, vy - speed * ny, vz - speed * nz
    square = tx * tx + ty * ty + tz * tz
    if square == 0.0:
        return 1.0
    pressed, dragged = _quadratic(extra, e, nx, ny, nz), _quadratic(extra, e, tx, ty, tz) / square
    return (1.0 + free * pressed) / (1.0 + free * dragged)


@lean_kernel
def _quadratic(extra, e, x, y, z):
    """(x, y, z) ΔM (x, y, z)ᵀ of node e."""
    own = extra[0, e] * x * x + extra[1, e] * y * y + extra[2, e] * z * z
    return own + 2.0 * (extra[3, e] * y * z + extra[4, e] * x * z + extra[5, e] * x * y)


@lean_kernel
def _put_on(x, v, e, depth, nx, ny, nz, friction, drift):
    """Move node e out by `depth` m along the normal, and take what impact and friction take from its velocity against
    the obstacle, which itself moves at `drift` (3,) m/s.
    """
    vx, vy, vz = v[0, e] - drift[0], v[1, e] - drift[1], v[2, e] - drift[2]
    speed = vx * nx + vy * ny + vz * nz
    x[0, e] += depth * nx
    x[1, e] += depth * ny
    x[2, e] += depth * nz
    if speed >= 0.0:
        return
    tx, ty, tz = vx - speed * nx, vy - speed * ny, vz - speed * nz
    sliding = np.sqrt(tx * tx + ty * ty + tz * tz)
    lost = min(1.0, -friction * speed / sliding) if sliding > 0.0 else 0.0  # share of the tangential velocity
    # Since it touched it has gone depth/|speed| long; it cannot have gone further sideways than friction held it.
    back = min(lost * sliding * depth / -speed, friction * depth) / sliding if sliding > 0.0 else 0.0
    x[0, e] -= back * tx
    x[1, e] -= back * ty
    x[2, e] -= back * tz
    v[0, e] = drift[0] + (1.0 - lost) * tx
    v[1, e] = drift[1] + (1.0 - lost) * ty
    v[2, e] = drift[2] + (1.0 - lost) * tz
