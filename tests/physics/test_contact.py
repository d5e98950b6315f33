"""Contact with obstacles against mechanics: they keep cloth out and rub as Coulomb says, also when they are carried."""

import dataclasses
from functools import partial

import numpy as np
import pytest
from clothbench_models.baraff_witkin import BaraffWitkin
from clothbench_models.inextensible import Inextensible
from clothbench_models.mass_spring import MassSpring
from clothbench_models.mass_spring_verlet import MassSpringVerlet
from contact_scenes import DISC, IMPLICIT, QUADS, SOFT, SPHERE, TRIANGLES, G, drape, lattice, loose

from clothbench import Scene
from clothbench.core.scene import Obstacle
from clothbench.modelling import keep_out, obstacle_table
from clothbench.plugins.discovery import catalogue
from clothbench.testing import scenes

THREE = (
    Obstacle("plane"),
    Obstacle("disc", (1.0, 0.0, 0.5), radius=0.1),
    Obstacle("sphere", (2.0, 0, 0.5), radius=0.1),
)


# --- one node -------------------------------------------------------------------------------------------------------


def put_out(place, velocity=(0.0, 0.0, 0.0), obstacles=THREE, held=False):
    scene = loose(np.zeros((9, 3)), lattice((3, 3), 1, 1), np.array([0.0]), obstacles=obstacles, shape=(3, 3))
    x, v = np.array([place], dtype=float).T.copy(), np.array([velocity], dtype=float).T.copy()
    keep_out(x, v, obstacle_table(scene), np.array([0.0 if held else 1.0]), 0, 1)
    return x[:, 0], v[:, 0]


@pytest.mark.parametrize(
    ("inside", "expected"),
    [
        ((0.2, 0.3, -0.01), (0.2, 0.3, 0.0)),
        ((1.02, 0.0, 0.49), (1.02, 0.0, 0.5)),  # through the pedestal's top
        ((1.09, 0.0, 0.3), (1.1, 0.0, 0.3)),  # through its side
        ((2.0, 0.05, 0.5), (2.0, 0.1, 0.5)),
        ((1.11, 0.0, 0.3), (1.11, 0.0, 0.3)),  # outside of all
        ((2.0, 0.08, 0.58), (2.0, 0.08, 0.58)),
    ],
)
def test_the_nearest_way_out(inside, expected):
    np.testing.assert_allclose(put_out(inside)[0], expected, atol=1e-12)


def test_a_held_node_stays():
    np.testing.assert_array_equal(put_out((0.0, 0.0, -0.1), held=True)[0], [0.0, 0.0, -0.1])


def test_friction_takes_at_most_its_share_of_the_impact():
    rough = (Obstacle("plane", friction=0.5),)
    np.testing.assert_allclose(put_out((0, 0, -1e-3), (3.0, 0.0, -2.0), rough)[1], [2.0, 0.0, 0.0])
    np.testing.assert_allclose(put_out((0, 0, -1e-3), (0.3, 0.4, -2.0), rough)[1], 0.0, atol=1e-15)
    np.testing.assert_allclose(put_out((0, 0, -1e-3), (3.0, 0.0, 2.0), rough)[1], [3.0, 0.0, 2.0])


# --- a sheet among obstacles ----------------------------------------------------------------------------------------


def slide(angle, friction, model=MassSpring, theta=SOFT, batch=1, effects=()):
    """Mean path [m] down a slope of a sheet that lies on it, at 0, 0.1, … 0.5 s."""
    shape, times = (7, 7), np.linspace(0.0, 0.5, 6)
    uv = lattice(shape, 0.12, 0.12)
    gravity = (G * np.sin(angle), 0.0, -G * np.cos(angle))
    scene = loose(np.column_stack([uv, np.zeros(49)]), uv, times, obstacles=(Obstacle("plane", friction=friction),),
                  gravity=gravity, shape=shape)  # fmt: skip
    x = model().prepare(scene, effects).run(np.repeat(theta, batch, axis=0)).position
    assert (x[..., 2] > -1e-9).all()
    return times, (x - x[:, :1])[..., 0].mean(axis=2)


VERLET = MassSpringVerlet.parameters.defaults[None] * np.array([1.0] * 12 + [0.0])


@pytest.mark.parametrize(("model", "theta"), [(MassSpring, SOFT), (MassSpringVerlet, VERLET)])
@pytest.mark.parametrize("batch", [1, 3])
def test_a_sheet_on_a_slope_slides_as_coulomb_says(model, theta, batch):
    """Sticks below atan μ, and above accelerates with g (sin α − μ cos α)."""
    times, path = slide(np.arctan(0.5) - 0.03, 0.5, model, theta, batch)
    assert np.abs(path).max() < 1e-6
    angle = np.arctan(0.5) + 0.1
    times, path = slide(angle, 0.5, model, theta, batch)
    expected = 0.5 * G * (np.sin(angle) - 0.5 * np.cos(angle)) * times**2
    np.testing.assert_allclose(path[:, 1:], np.broadcast_to(expected, path.shape)[:, 1:], rtol=0.01)


RUNGE_KUTTA = partial(BaraffWitkin, integrator="rk45")
HEAVIER = {"added_mass": [0.3], "total_mass": [1.4], "point_mass": [0.01, 0.5, 0.5]}


@pytest.mark.parametrize("effect", HEAVIER)
@pytest.mark.parametrize(("model", "theta"), [(MassSpring, SOFT), (MassSpringVerlet, VERLET), (RUNGE_KUTTA, TRIANGLES)])
def test_what_effects_add_to_its_mass_changes_nothing_about_how_a_sheet_slides(model, theta, effect):
    """What weighs slides as the sheet does; and air, which is pressed on by it, weighs nothing (added mass)."""
    heavier = [catalogue().make("effects", effect)]
    with_amount = [[*theta[0], *HEAVIER[effect]]]
    times, path = slide(np.arctan(0.5) - 0.03, 0.5, model, with_amount, effects=heavier)
    assert np.abs(path).max() < 1e-5
    angle = np.arctan(0.5) + 0.1
    times, path = slide(angle, 0.5, model, with_amount, effects=heavier)
    expected = 0.5 * G * (np.sin(angle) - 0.5 * np.cos(angle)) * times**2
    np.testing.assert_allclose(path[0, 1:], expected[1:], rtol=0.01)


def test_a_dropped_sheet_comes_to_rest_on_the_plane():
    shape, uv = (9, 9), lattice((9, 9), 0.16, 0.16)
    start = np.column_stack([uv, 0.05 + 0.02 * uv[:, 0]])
    scene = loose(start, uv, np.array([0.0, 1.0, 1.5]), obstacles=(Obstacle("plane", friction=0.3),), shape=shape)
    x = MassSpring().prepare(scene).run(SOFT).position[0]
    np.testing.assert_allclose(x[1:, :, 2], 0.0, atol=1e-4)
    np.testing.assert_allclose(x[1], x[2], atol=1e-4)


SCHEMES = {
    "baraff_witkin bdf2": (BaraffWitkin, TRIANGLES, 2e-3),
    "baraff_witkin implicit_euler": (partial(BaraffWitkin, integrator="implicit_euler"), TRIANGLES, 1e-3),
    "inextensible bdf2": (Inextensible, QUADS, 2e-3),
    "inextensible implicit_euler": (partial(Inextensible, integrator="implicit_euler"), QUADS, 1e-3),
}


@pytest.mark.parametrize(("model", "theta", "dt"), SCHEMES.values(), ids=SCHEMES)
def test_what_is_lifted_comes_off_the_plane(model, theta, dt):
    """It rests there first; lifted by its corners all of it leaves, as in explicit steps, which put nodes out only."""
    shape, uv = (5, 5), lattice((5, 5), 0.16, 0.16)
    corners = uv[[0, 4, 20, 24]]
    flat, lifted = (np.column_stack([corners, np.full(4, z)]) for z in (0.0, 0.08))
    scene = Scene(0.16, 0.16, 0.2, np.array([0.0, 0.1, 0.4]), corners, np.stack([flat, flat, lifted]),
                  np.array([0.0, 0.1, 0.4]), uv, resolution=shape, start=np.column_stack([uv, 0 * uv[:, 0]]),
                  obstacles=(Obstacle("plane", friction=0.3),))  # fmt: skip
    height = model(dt=dt).prepare(scene).run(theta).position[0, :, :, 2]
    np.testing.assert_allclose(height[1], 0.0, atol=1e-6)
    assert height[2].min() > 0.02
    explicit = MassSpring().prepare(scene).run(SOFT).position[0, 2, :, 2]
    assert abs(height[2].mean() - explicit.mean()) < 0.015


@pytest.mark.parametrize(("model", "theta", "dt"), SCHEMES.values(), ids=SCHEMES)
@pytest.mark.parametrize("friction", [0.1, 0.5])
def test_in_implicit_steps_a_sheet_slides_as_coulomb_says_from_its_first_step_on(model, theta, dt, friction):
    """Sticks below atan μ; above, it accelerates with g (sin α − μ cos α)."""
    times, path = slide(np.arctan(friction) - 0.003, friction, model, theta)
    assert np.abs(path).max() < 1e-12
    angle = np.arctan(friction) + 0.1
    times, path = slide(angle, friction, model, theta)
    pull = G * (np.sin(angle) - friction * np.cos(angle))
    np.testing.assert_allclose(np.diff(path[0], 2) / 0.1**2, pull, rtol=2e-3)
    late = times[1:] - np.sqrt(2 * path[0, 1:] / pull)
    assert (np.abs(late) < 0.6 * dt).all()  # implicit Euler is half a step ahead


@pytest.mark.parametrize(("model", "theta", "dt"), SCHEMES.values(), ids=SCHEMES)
def test_in_implicit_steps_a_sheet_slides_on_slopes_little_steeper_than_it_would_stick_on(model, theta, dt):
    """Where nodes that touch anew were stopped dead, none ever got under way."""
    angle = np.arctan(0.5) + 0.015
    times, path = slide(angle, 0.5, model, theta)
    expected = 0.5 * G * (np.sin(angle) - 0.5 * np.cos(angle)) * times**2
    np.testing.assert_allclose(path[0, -1], expected[-1], rtol=0.03)


def set_going(model, theta, height, friction, speed, times):
    """A flat loose sheet that begins `height` m over a plane, at `speed` m/s along it → (T, n, 3) m."""
    shape, uv = (5, 5), lattice((5, 5), 0.12, 0.12)
    start, floor = np.column_stack([uv, np.full(25, height)]), Obstacle("plane", friction=friction)
    scene = loose(start, uv, times, obstacles=(floor,), shape=shape, velocity=(speed, 0.0, 0.0))
    rollout = model().prepare(scene).run(theta)
    assert rollout.status == ("ok",)
    return rollout.position[0]


@pytest.mark.parametrize(("model", "theta", "dt"), SCHEMES.values(), ids=SCHEMES)
@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_what_falls_flat_on_the_floor_does_not_bounce(model, theta, dt, friction):
    """The impacts of `contact` are inelastic, whatever a scheme remembers of the steps before."""
    for height in (0.01, 0.05, 0.06):
        landed = np.sqrt(2 * height / G) + 2 * dt
        times = np.append(0.0, np.linspace(landed, landed + 0.1, 51))
        z = set_going(model, theta, height, friction, 0.0, times)[1:, :, 2]
        assert np.abs(z).max() < 1e-5


@pytest.mark.parametrize(("model", "theta", "dt"), SCHEMES.values(), ids=SCHEMES)
def test_what_lands_in_motion_slides_on_as_coulomb_says(model, theta, dt):
    """The impact takes μ times the speed of the fall from that along the floor, and then there are μ g."""
    height, friction, times = 0.005, 0.1, np.array([0.0, 0.1, 0.2])
    path = set_going(model, theta, height, friction, 1.0, times)[..., 0].mean(axis=1)
    fall = np.sqrt(2 * height / G)
    after = times[1:] - fall
    expected = fall + (1.0 - friction * G * fall) * after - 0.5 * friction * G * after**2
    np.testing.assert_allclose(path[1:] - path[0], expected, rtol=5e-3)


@pytest.mark.parametrize(("model", "theta", "dt"), SCHEMES.values(), ids=SCHEMES)
def test_what_lies_there_in_motion_stops_as_coulomb_says(model, theta, dt):
    """After v²/(2 μ g)."""
    path = set_going(model, theta, 0.0, 0.4, 1.0, np.array([0.0, 0.3, 0.4]))[..., 0].mean(axis=1)
    assert np.abs(path[1:] - path[0] - 1.0 / (2 * 0.4 * G)).max() < 0.6 * dt * 1.0


def test_in_runge_kutta_steps_a_sheet_slides_as_coulomb_says():
    model = partial(BaraffWitkin, integrator="rk45")
    times, path = slide(np.arctan(0.5) - 0.03, 0.5, model, TRIANGLES)
    assert np.abs(path).max() < 1e-5
    angle = np.arctan(0.5) + 0.1
    times, path = slide(angle, 0.5, model, TRIANGLES)
    expected = 0.5 * G * (np.sin(angle) - 0.5 * np.cos(angle)) * times**2
    np.testing.assert_allclose(path[0, 1:], expected[1:], rtol=1e-3)


@pytest.mark.parametrize("effect", ["air_memory", "viscoelasticity"])
def test_a_floor_far_below_halts_no_memory(effect):
    """In Runge-Kutta steps the forces are taken anew after each step in which something might have been touched."""
    memory = catalogue().make("effects", effect)
    values = [2.0, 0.0, 0.15] if effect == "air_memory" else [1e-4, 0.0, 0.2]
    free = scenes.with_times(scenes.swinging(), np.linspace(0.0, 0.2, 5))
    above = dataclasses.replace(free, obstacles=(Obstacle("plane", (0.0, 0.0, -5.0)),))
    theta = np.array([[*BaraffWitkin.parameters.defaults, *values]])
    one, other = (BaraffWitkin(integrator="rk45").prepare(scene, (memory,)).run(theta) for scene in (free, above))
    np.testing.assert_allclose(other.position, one.position, atol=1e-5)


def accelerated(model, theta, friction, pull):
    """Mean path [m] of a loose sheet on a plane that goes off with `pull` m/s², at 0, 0.1, … 0.5 s, beside Coulomb's.

    What carries the plane is a grip on a corner that has been cut off the sheet.
    """
    uv, times = lattice((7, 7), 0.12, 0.12), np.linspace(0.0, 0.5, 6)
    path = np.zeros((6, 1, 3))
    path[:, 0, 0] = 0.5 * pull * times**2
    scene = Scene(0.12, 0.12, 0.2, times, uv[:1], path, times, uv[7:], resolution=(7, 7),
                  start=np.column_stack([uv[7:], np.zeros(42)]), velocity=np.zeros((42, 3)),
                  outline=np.array([[0.0, 0.02], [0.12, 0.02], [0.12, 0.12], [0.0, 0.12]]),
                  obstacles=(Obstacle("plane", friction=friction, carried=True),))  # fmt: skip
    x = model().prepare(scene).run(theta).position[0]
    return (x - x[0])[..., 0].mean(axis=1), 0.5 * min(pull, friction * G) * times**2


CARRIED = {
    "mass_spring": (MassSpring, SOFT),
    "mass_spring_verlet": (MassSpringVerlet, VERLET),
    **{name: (model, theta) for name, (model, theta, _) in SCHEMES.items()},
    "baraff_witkin rk45": (partial(BaraffWitkin, integrator="rk45"), TRIANGLES),
}


@pytest.mark.parametrize(("model", "theta"), CARRIED.values(), ids=CARRIED)
def test_a_plane_that_is_carried_off_takes_the_sheet_along_as_coulomb_says(model, theta):
    """With the plane where friction suffices, with μ g where it does not; a few steps late, as above."""
    for friction in (0.05, 0.2):
        path, expected = accelerated(model, theta, friction, 1.0)
        np.testing.assert_allclose(path, expected, atol=1e-3)
        np.testing.assert_allclose(path[-1], expected[-1], rtol=0.02)


@pytest.mark.parametrize(("model", "theta"), CARRIED.values(), ids=CARRIED)
def test_a_sphere_that_is_carried_into_a_hanging_sheet_pushes_it_aside(model, theta):
    """The grips take it along sideways; no node is inside at any frame, and the sheet follows on its far side only."""
    uv, times = lattice((9, 9), 0.3, 0.3), np.linspace(0.0, 0.6, 7)
    moved = 0.15 * np.clip(times / 0.4, 0.0, 1.0)[:, None, None] * np.array([0.0, 1.0, 0.0])
    start = np.column_stack([uv[:, 0], np.zeros(81), 1.0 - uv[:, 1]])
    ball = Obstacle("sphere", (0.15, -0.061, 0.8), radius=0.06, friction=0.2, carried=True)
    scene = Scene(0.3, 0.3, 0.2, times, uv[[0, 8]], start[[0, 8]] + moved, times, uv, resolution=(9, 9), start=start,
                  obstacles=(ball,))  # fmt: skip
    rollout = model().prepare(scene).run(theta)
    assert rollout.status == ("ok",)
    centre = np.array(ball.centre) + moved[:, 0]
    away = np.linalg.norm(rollout.position[0] - centre[:, None], axis=2)
    assert away.min() > 0.06 - 1e-5
    ahead = rollout.position[0, 4, 40, 1] - moved[4, 0, 1]  # of the middle, where cloth without a ball would trail
    alone = model().prepare(dataclasses.replace(scene, obstacles=())).run(theta).position[0, 4, 40, 1] - moved[4, 0, 1]
    assert ahead > -0.01 > alone


def test_no_node_enters_a_sphere():
    x = drape(SPHERE, np.linspace(0.0, 0.8, 9))
    assert np.linalg.norm(x - SPHERE.centre, axis=-1).min() > 0.05 - 1e-9
    assert x[-1, :, 2].min() < -0.1


@pytest.mark.parametrize(("model", "theta"), IMPLICIT.values(), ids=IMPLICIT)
def test_in_models_that_do_not_stretch_much_no_node_enters_a_sphere_or_a_disc(model, theta):
    """But by 1 µm, in a frame between two of the Runge–Kutta steps."""
    times, inside = np.linspace(0.0, 0.8, 41), 1e-6
    x = drape(SPHERE, times, nodes=13, model=model, theta=theta)
    assert np.linalg.norm(x - SPHERE.centre, axis=-1).min() > 0.05 - inside
    assert x[-1, :, 2].min() < -0.1
    x = drape(DISC, times, nodes=13, model=model, theta=theta)
    assert ((x[..., 2] > -inside) | (np.hypot(x[..., 0], x[..., 1]) > 0.06 - inside)).all()
    assert x[-1, :, 2].min() < -0.1


@pytest.mark.parametrize(("model", "theta"), [(MassSpring, SOFT), (MassSpringVerlet, VERLET)])
def test_cloth_drapes_over_the_rim_of_a_disc(model, theta):
    x = drape(DISC, np.linspace(0.0, 0.8, 9), model=model, theta=theta)
    away, height = np.hypot(x[..., 0], x[..., 1]), x[..., 2]
    assert ((height > -1e-9) | (away > 0.06 - 1e-9)).all()
    assert height[-1].min() < -0.05
    assert (np.abs(height[-1][away[-1] < 0.05]) < 0.01).all()  # it may still tremble
