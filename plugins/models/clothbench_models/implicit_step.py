"""What every implicit step here shares: where it is extrapolated from, what grips and obstacles say about the guess.

One Newton round a step from an extrapolated guess (Baraff and Witkin 1998, eq. 6; Choi and Ko 2002 for BDF2):
v' = v̄ + γ M⁻¹ f(x̄ + γ v', v'), with γ = dt, x̄ = x, v̄ = v for Euler and γ = 2dt/3, x̄ = (4x − x₋)/3 for BDF2.
"""

from __future__ import annotations

from clothbench.modelling import OBSTACLE, grip_point, keep_out, kernel, lean_kernel, mobilities
from clothbench_models.implicit_grid import hold_back, put
from clothbench_models.resting_contact import FREE, LEAVES, SLIDES, judge, part_layers, touching

EULER, BDF2 = 0, 1


@lean_kernel
def extrapolate(scheme, dt, x, v, x_old, v_old, stiffer, x_bar, v_bar, guess):
    """Fill x̄, v̄ and the guess of v' (3, n); returns γ [s]. stiffer (2,): what effects add to the stiffness, which the
    matrix only bounds; then nothing is extrapolated, but for air and effects (`see_ahead`).
    """
    if scheme == EULER:
        put(x_bar, x)
        put(v_bar, v)
        put(guess, v)
        return dt
    for c in range(3):
        for e in range(x.shape[1]):
            x_bar[c, e] = (4.0 * x[c, e] - x_old[c, e]) / 3.0
            v_bar[c, e] = (4.0 * v[c, e] - v_old[c, e]) / 3.0
            guess[c, e] = 2.0 * v[c, e] - v_old[c, e]
    if stiffer[0] > 0.0 or stiffer[1] > 0.0:
        put(guess, v)
    return 2.0 * dt / 3.0


@lean_kernel
def see_ahead(scheme, guess, v, v_old, touch, out):
    """out (3, n) = the velocity at which air and effects are taken: the guess, and of BDF2 what `extrapolate` may have
    left out of it. No matrix knows of these forces, so that at a velocity of the step before they would be of first
    order; what stiffens does not see velocities.
    """
    put(out, guess)
    if scheme == BDF2:
        for e in range(v.shape[1]):
            if touch[e] == FREE:
                for c in range(3):
                    out[c, e] = 2.0 * v[c, e] - v_old[c, e]


@lean_kernel
def follow_grips(guess, x_bar, gamma, pins, grips, t, segment):
    """The velocity that brings each held node from x̄ to where its grip is at time t."""
    for g in range(pins.shape[0]):
        for c in range(3):
            place = grip_point(grips.knots, grips.curve, t, segment, g, c)
            guess[c, pins[g]] = (place - x_bar[c, pins[g]]) / gamma


@kernel
def rest_on(guess, x, v, x_bar, gamma, dt, obstacles, free, touch, normal, friction, on, z, q):
    """Find who touches an obstacle, and take from the guess what such a node cannot follow; z, q are overwritten.

    The obstacles are where they will be after the step of dt [s]; on (n,): as `touching` leaves it.
    """
    touching(x, v, dt, obstacles, free, touch, normal, friction, on)
    for e in range(x.shape[1]):
        if free[e] > 0.0 and touch[e] != FREE:  # x̄ lies off the surface by what x did before
            for c in range(3):
                drift = obstacles[on[e], OBSTACLE.velocity + c]
                z[c, e] = guess[c, e] - (x[c, e] + dt * drift - x_bar[c, e]) / gamma
        else:
            z[0, e] = z[1, e] = z[2, e] = 0.0
    put(q, z)
    hold_back(q, touch, normal)
    for c in range(3):
        for e in range(x.shape[1]):
            guess[c, e] += q[c, e] - z[c, e]


@lean_kernel
def slip(scheme, v, obstacles, on, out):
    """out (3, n) = the velocity v of nodes against the obstacle that they touch, whose own is that of the scheme: over
    the step of Euler; of BDF2, whose velocities are those at the end of the step, (3 V − V₋)/2.
    """
    ahead = 0.5 if scheme == BDF2 else 0.0
    for e in range(v.shape[1]):
        for c in range(3):
            out[c, e] = v[c, e]
            if on[e] >= 0:
                now = obstacles[on[e], OBSTACLE.velocity + c]
                before = obstacles[on[e], OBSTACLE.velocity_before + c]
                out[c, e] -= now + ahead * (now - before)


@lean_kernel
def moved_on(x_bar, gamma, guess, q):
    """q = x̄ + γ v', where the forces of a step are taken."""
    for c in range(3):
        for e in range(q.shape[1]):
            q[c, e] = x_bar[c, e] + gamma * guess[c, e]


@lean_kernel
def is_loose(mass, pins):
    """Whether nothing holds the cloth: what is off it holds nothing."""
    held = 0.0
    for g in range(pins.shape[0]):
        held = max(held, mass[pins[g]])
    return held == 0.0


@kernel
def set_off(f, v, obstacles, on, free, touch, normal, friction, rub, z, q):
    """What the nodes of a loose sheet do that lie on an obstacle as a run begins, as if it had no inner forces: `rub`
    becomes the friction of those that slide, and f (3, n) N what moves nodes; z, q are overwritten.
    """
    slip(EULER, v, obstacles, on, q)
    for c in range(3):
        for e in range(v.shape[1]):
            z[c, e] = -f[c, e]
    judge(z, q, free, touch, normal, friction, rub)
    for e in range(v.shape[1]):
        if touch[e] == LEAVES:  # only a step lets go
            touch[e] = SLIDES
        for c in range(3):
            f[c, e] += rub[c, e]
    hold_back(f, touch, normal)


@lean_kernel
def step_before(x, v, dt, f, mass, loose, x_old, v_old):
    """The step before the first of a sheet that does not begin at rest in its grips: held, it moved as it does now;
    loose, on the parabola of its fall or slide. f (3, n): N, weight, air and effects, as the bare masses feel them.
    """
    for c in range(3):
        for e in range(x.shape[1]):
            a = f[c, e] / mass[e] if loose and mass[e] > 0.0 else 0.0
            v_old[c, e] = v[c, e] - dt * a
            x_old[c, e] = x[c, e] - dt * v[c, e] + 0.5 * dt * dt * a


@kernel
def end_step(
    x, v, x_before, v_before, x_old, v_old, dt, obstacles, free, extra, heavier, layers, x_came, v_came, z, q, mobility,
):  # fmt: skip
    """What was now is before; then nodes are put out of obstacles, and layers apart. extra (6, n) kg: what effects
    added to the masses, if they did. Overwritten: x_came and v_came, by where the step came to, z, q and mobility.

    What an impact changed counts as if it had always been so: BDF2 would take the difference to the step before for an
    acceleration, and carry it on until an impulse had become one and a half, so that what hit the floor bounced.
    """
    put(x_old, x_before)
    put(v_old, v_before)
    if obstacles.shape[0] == 0 and layers.size[0] == 0.0:
        return
    put(x_came, x)
    put(v_came, v)
    if obstacles.shape[0] > 0:
        keep_out(x, v, obstacles, free, 0, 1, extra, heavier)
    if layers.size[0] > 0.0:
        if heavier:
            mobilities(free, extra, mobility)
        part_layers(x, v, x_before, dt, mobility if heavier else free, layers, z, q)
    for c in range(3):
        for e in range(x.shape[1]):
            impulse = v[c, e] - v_came[c, e]
            v_old[c, e] += impulse
            x_old[c, e] += x[c, e] - x_came[c, e] - dt * impulse
