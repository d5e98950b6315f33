"""Lasting contact inside an implicit step: which nodes rest on an obstacle, slide or stick there, and what rubs them.

`contact.keep_out` deals with impact after any step. A linear solve that did not know of the obstacle would press
resting nodes in at every step and have them put back; so there they are held back along the normal (Baraff and Witkin
1998, section 5.2), and the reaction that this took decides what they do in the next step: a node that would have had
to be pulled is let go; one whose tangential reaction leaves Coulomb's cone slides, rubbed by μ times the normal
reaction; one that comes to a stop sticks again. A node that was let go is not caught where it lies: cloth would never
come off a table.
"""

from __future__ import annotations

import numpy as np

from clothbench.modelling import DISC, OBSTACLE, SPHERE, inside, keep_apart, lean_kernel, vector_of

FREE, SLIDES, STICKS = 0, 1, 2  # what a node may do where it touches an obstacle; held nodes stick
LEAVES = 3  # it was let go and lies on the surface still: it is free for one step, in which it leaves or falls back
FAR = 2.0  # times what a node weighs, or friction and that: what is not left to the next step
SKIN = 2e-9  # m; as near as this is touching
STILL = 1e-9  # m/s; as slow as this friction has stopped what has just touched


@lean_kernel
def touching(x, v, dt, obstacles, free, touch, normal, friction, on):
    """Find the nodes of x (3, n) m that lay on an obstacle before it moved on for dt [s] to where it is: their outward
    normal (3, n), the friction (n,) there, and on (n,), the number of the obstacle, −1 of nodes that touch none.

    touch (n,) keeps what a node did before, as far as it still touches. A new contact slides, unless `keep_out` has
    taken all of its velocity v (3, n) m/s against the obstacle: what friction could not stop by then, the next step
    must not stop with an impulse that Coulomb does not allow.
    """
    for i in range(x.shape[1]):
        if free[i] == 0.0:
            continue
        found = False
        on[i] = -1
        for k in range(obstacles.shape[0]):
            kind = obstacles[k, OBSTACLE.kind]
            ax, ay, az = vector_of(obstacles, k, OBSTACLE.normal)
            cx, cy, cz = vector_of(obstacles, k, OBSTACLE.centre)
            vx, vy, vz = vector_of(obstacles, k, OBSTACLE.velocity)
            px, py, pz = x[0, i] + dt * vx, x[1, i] + dt * vy, x[2, i] + dt * vz
            dx, dy, dz = px - cx, py - cy, pz - cz
            if kind == SPHERE:
                away = np.sqrt(dx * dx + dy * dy + dz * dz) + 1e-300
                sx, sy, sz = dx / away, dy / away, dz / away
            else:
                sx, sy, sz = ax, ay, az
                if kind == DISC:
                    height = dx * ax + dy * ay + dz * az
                    rx, ry, rz = dx - height * ax, dy - height * ay, dz - height * az
                    away = np.sqrt(rx * rx + ry * ry + rz * rz) + 1e-300
                    sx, sy, sz = sx + rx / away, sy + ry / away, sz + rz / away
            depth, nx, ny, nz = inside(kind, obstacles, k, px - SKIN * sx, py - SKIN * sy, pz - SKIN * sz)
            if depth > 0.0:
                found = True
                normal[0, i], normal[1, i], normal[2, i] = nx, ny, nz
                friction[i] = obstacles[k, OBSTACLE.friction]
                on[i] = k
                break
        if not found or touch[i] == LEAVES:
            touch[i] = FREE
        elif touch[i] == FREE:
            touch[i] = STICKS if friction[i] > 0.0 and _still(v, obstacles, on[i], i) else SLIDES


@lean_kernel
def _still(v, obstacles, k, i):
    """Whether node i goes along with obstacle k, as that moved in the step in which they touched."""
    wx, wy, wz = vector_of(obstacles, k, OBSTACLE.velocity_before)
    return (v[0, i] - wx) ** 2 + (v[1, i] - wy) ** 2 + (v[2, i] - wz) ** 2 <= STILL * STILL


@lean_kernel
def judge(reaction, moved, free, touch, normal, friction, rub):
    """What touching nodes do next, from the obstacle's reaction (3, n) N and how they moved (3, n), in any unit.

    moved: against the obstacle; rub (3, n) N: friction on sliding nodes, to be added to the forces of the next step. A
    node let go LEAVES.
    """
    for i in range(reaction.shape[1]):
        rub[0, i] = rub[1, i] = rub[2, i] = 0.0
        if free[i] == 0.0 or touch[i] == FREE:
            continue
        nx, ny, nz = normal[0, i], normal[1, i], normal[2, i]
        push = reaction[0, i] * nx + reaction[1, i] * ny + reaction[2, i] * nz
        if push <= 0.0:
            touch[i] = LEAVES
            continue
        if friction[i] == 0.0:
            touch[i] = SLIDES
            continue
        most = friction[i] * push
        if touch[i] == STICKS:
            tx, ty, tz = reaction[0, i] - push * nx, reaction[1, i] - push * ny, reaction[2, i] - push * nz
            size = np.sqrt(tx * tx + ty * ty + tz * tz)
            if size <= most:
                continue
            touch[i] = SLIDES
        else:  # friction points against the motion
            tx, ty, tz = -moved[0, i], -moved[1, i], -moved[2, i]
            along = tx * nx + ty * ny + tz * nz
            tx, ty, tz = tx - along * nx, ty - along * ny, tz - along * nz
            size = np.sqrt(tx * tx + ty * ty + tz * tz)
            if size == 0.0:
                touch[i] = STICKS
                continue
        rub[0, i], rub[1, i], rub[2, i] = most * tx / size, most * ty / size, most * tz / size


@lean_kernel
def drop_rub(touch, normal, rub):
    """Friction acts along the surface, and where a node slides on it: what it was in the step before may be neither
    where a node has left since, or come around an edge.
    """
    for i in range(rub.shape[1]):
        along = rub[0, i] * normal[0, i] + rub[1, i] * normal[1, i] + rub[2, i] * normal[2, i]
        for c in range(3):
            rub[c, i] = rub[c, i] - along * normal[c, i] if touch[i] == SLIDES else 0.0


@lean_kernel
def overcome(reaction, slid, mass, gravity, free, touch, normal, friction, rub, more):
    """Whether friction did in a step what it cannot have done, so that the step has to be made again: nodes stuck that
    only a reaction (3, n) N far beyond Coulomb's cone can have held, which slide instead; or slid (3, n) m/s to where
    friction of the step before has thrown them, which then is half as large. more (3, n) N: what `rub` changes by.

    Near the cone a step late is soon enough (`judge`, `stop_reversed`). But cloth that does not stretch pulls as hard
    as it takes where nodes beside each other stick; that pull is friction in the next step, and the sheet is thrown
    off what it lies on, harder from step to step.
    """
    found = False
    weight = np.sqrt(gravity[0] ** 2 + gravity[1] ** 2 + gravity[2] ** 2)
    for i in range(reaction.shape[1]):
        more[0, i] = more[1, i] = more[2, i] = 0.0
        if touch[i] == FREE or free[i] == 0.0:
            continue
        little = weight * mass[i]
        if touch[i] == SLIDES:
            turned = rub[0, i] * slid[0, i] + rub[1, i] * slid[1, i] + rub[2, i] * slid[2, i]
            size = np.sqrt(rub[0, i] ** 2 + rub[1, i] ** 2 + rub[2, i] ** 2)
            if turned > 0.0 and size > FAR * little:
                found = True
                for c in range(3):
                    more[c, i] = -0.5 * rub[c, i]
        else:
            nx, ny, nz = normal[0, i], normal[1, i], normal[2, i]
            push = reaction[0, i] * nx + reaction[1, i] * ny + reaction[2, i] * nz
            tx, ty, tz = reaction[0, i] - push * nx, reaction[1, i] - push * ny, reaction[2, i] - push * nz
            size, most = np.sqrt(tx * tx + ty * ty + tz * tz), friction[i] * max(push, 0.0)
            if size > FAR * (most + little):
                found = True
                touch[i] = SLIDES
                more[0, i], more[1, i], more[2, i] = most * tx / size, most * ty / size, most * tz / size
        for c in range(3):
            rub[c, i] += more[c, i]
    return found


@lean_kernel
def stop_reversed(moved, touch, rub):
    """A sliding node that friction has turned round has come to a stop: it sticks in the next step."""
    for i in range(moved.shape[1]):
        if touch[i] == SLIDES and rub[0, i] * moved[0, i] + rub[1, i] * moved[1, i] + rub[2, i] * moved[2, i] > 0.0:
            touch[i] = STICKS


@lean_kernel
def part_layers(x, v, before, dt, free, layers, path, kept):
    """`keep_apart` after a step of any scheme from `before` to x: its way in a straight line, v changed by as much."""
    for c in range(3):
        for e in range(x.shape[1]):
            path[c, e] = kept[c, e] = (x[c, e] - before[c, e]) / dt
    keep_apart(x, path, dt, free, layers)
    for c in range(3):
        for e in range(x.shape[1]):
            v[c, e] += path[c, e] - kept[c, e]
