"""Self-contact against geometry: a sheet's own layers do not cross, and pass on all momentum when they meet."""

import dataclasses
from functools import partial

import numpy as np
import pytest
from clothbench_models.baraff_witkin import BaraffWitkin
from clothbench_models.inextensible import Inextensible
from clothbench_models.mass_spring import MassSpring
from contact_scenes import IMPLICIT, QUADS, SOFT, SPHERE, TRIANGLES, drape, lattice, loose

from clothbench import Scene
from clothbench.core.scene import Obstacle
from clothbench.modelling import keep_apart, layers_of
from clothbench.modelling.mesh import grid_triangles
from clothbench.modelling.sheet import sheet_of
from clothbench.plugins.discovery import catalogue


def crossings(x, triangles):
    """How many edges pierce a triangle with which they share no node; x (n, 3) m."""
    edges = np.unique(np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    a, b, c = (x[triangles[:, k]] for k in range(3))
    normal, total = np.cross(b - a, c - a), 0
    for i, j in edges:
        first, second = ((x[i] - a) * normal).sum(axis=1), ((x[j] - a) * normal).sum(axis=1)
        hit = (first * second < 0) & ~((triangles == i) | (triangles == j)).any(axis=1)
        at = x[i] + (first[hit] / (first[hit] - second[hit]))[:, None] * (x[j] - x[i])
        inside = np.ones(hit.sum(), dtype=bool)
        for p, q in ((a, b), (b, c), (c, a)):
            inside &= (np.cross(q[hit] - p[hit], at - p[hit]) * normal[hit]).sum(axis=1) > 0
        total += int(inside.sum())
    return total


def test_the_counter_counts():
    x = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2, 0.2, -1], [0.2, 0.2, 1], [5, 5, 1]], dtype=float)
    assert crossings(x, np.array([[0, 1, 2], [3, 4, 5]])) == 2  # one edge of each
    x[3:, :2] += 1.0
    assert crossings(x, np.array([[0, 1, 2], [3, 4, 5]])) == 0


UNDAMPED = {
    "mass_spring": (MassSpring, SOFT),
    "baraff_witkin bdf2": (BaraffWitkin, TRIANGLES),
    "baraff_witkin rk45": (partial(BaraffWitkin, integrator="rk45"), TRIANGLES),
    "inextensible bdf2": (Inextensible, QUADS),
}


def pile(thickness, times, nodes=17, model=MassSpring, theta=SOFT):
    """A sheet dropped upright on the floor, where it folds up → (T, n, 3) m."""
    shape = (nodes // 2 + 1, nodes)
    uv = lattice(shape, 0.15, 0.3)
    wave = 2e-3 * np.sin(25 * uv[:, 1]) + 1e-3 * np.sin(20 * uv[:, 0])
    start = np.column_stack([uv[:, 0], wave, 0.31 - uv[:, 1]])
    floor = Obstacle("plane", friction=0.3)
    scene = loose(start, uv, times, obstacles=(floor,), thickness=thickness, shape=shape)
    rollout = model().prepare(scene).run(theta)
    assert rollout.status == ("ok",)  # what diverged crosses nothing
    return rollout.position[0]


def folded(thickness, times, nodes, model, theta):
    """A sheet folded back on itself over a loop of 4 cm, dropped by 1 mm: its upper layer falls on the lower."""
    shape, loop = (nodes // 2 + 1, nodes), 0.02
    uv = lattice(shape, 0.15, 0.3)
    begin = 0.15 - np.pi * loop / 2
    angle = np.clip((uv[:, 1] - begin) / loop, 0, np.pi)
    x = np.minimum(uv[:, 1], begin) + loop * np.sin(angle) - np.maximum(uv[:, 1] - begin - np.pi * loop, 0)
    start = np.column_stack([uv[:, 0], x, 1e-3 + loop * (1 - np.cos(angle))])
    scene = loose(start, uv, times, obstacles=(Obstacle("plane", friction=0.3),), thickness=thickness, shape=shape)
    rollout = model().prepare(scene).run(theta)
    assert rollout.status == ("ok",)
    return rollout.position[0]


CELL = 0.3 / 16


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.1, 0.4])
def test_the_folds_of_a_drape_do_not_cross(share):
    triangles, times = grid_triangles((17, 17)), np.linspace(0.1, 0.8, 8)
    assert sum(crossings(x, triangles) for x in drape(SPHERE, times)) > 50
    assert [crossings(x, triangles) for x in drape(SPHERE, times, share * CELL)] == [0] * 8


@pytest.mark.parametrize("share", [0.1, 0.4])
def test_the_layers_of_a_fold_do_not_cross(share):
    triangles, times = grid_triangles((9, 17)), np.linspace(0.1, 0.8, 8)
    assert sum(crossings(x, triangles) for x in pile(0.0, times)) > 50
    assert [crossings(x, triangles) for x in pile(share * CELL, times)] == [0] * 8


LAYERED = {name: IMPLICIT[name] for name in ("baraff_witkin bdf2", "baraff_witkin rk45", "inextensible bdf2")}
COARSE, FRAMES = 0.3 / 12, np.linspace(0.1, 0.6, 6)


@pytest.mark.parametrize(("model", "theta"), LAYERED.values(), ids=LAYERED)
@pytest.mark.parametrize("share", [0.1, 0.4])
def test_in_models_that_do_not_stretch_much_layers_do_not_cross(model, theta, share):
    thickness, square, strip = share * COARSE, grid_triangles((13, 13)), grid_triangles((7, 13))
    x = drape(SPHERE, FRAMES, thickness, 13, model, theta)
    assert [crossings(frame, square) for frame in x] == [0] * 6
    x = pile(thickness, FRAMES, 13, model, theta)
    assert [crossings(frame, strip) for frame in x] == [0] * 6


@pytest.mark.parametrize(("model", "theta"), LAYERED.values(), ids=LAYERED)
def test_without_a_thickness_they_do(model, theta):
    x = drape(SPHERE, FRAMES, 0.0, 13, model, theta)
    y = pile(0.0, FRAMES, 13, model, theta)
    assert sum(crossings(frame, grid_triangles((13, 13))) for frame in x) > 20
    assert sum(crossings(frame, grid_triangles((7, 13))) for frame in y) > 20


@pytest.mark.parametrize(("model", "theta"), LAYERED.values(), ids=LAYERED)
@pytest.mark.parametrize("share", [0.1, 0.4])
def test_a_fold_comes_to_rest_with_its_layers_a_thickness_apart(model, theta, share):
    """Up to a tenth of it, the upper layer may press the lower one into the ground for a while."""
    thickness = share * COARSE
    x = folded(thickness, FRAMES, 13, model, theta)
    assert [crossings(frame, grid_triangles((7, 13))) for frame in x] == [0] * 6
    assert x[..., 2].min() > -0.1 * thickness
    upper = x[-1].reshape(13, 7, 3)[-4:, :, 2]
    np.testing.assert_allclose(upper, thickness, rtol=0.03)


@pytest.mark.parametrize(("model", "theta"), LAYERED.values(), ids=LAYERED)
def test_a_layer_that_falls_on_another_does_not_bounce(model, theta):
    """A strip laid back over itself, its lower half held: the upper layer stays where it has come down."""
    shape, uv, thickness, loop = (25, 7), lattice((25, 7), 0.24, 0.06), 5e-3, 0.04 / np.pi
    angle = np.clip((uv[:, 0] - 0.10) / loop, 0, np.pi)
    x = np.minimum(uv[:, 0], 0.10) + loop * np.sin(angle) - np.maximum(uv[:, 0] - 0.14, 0)
    start = np.column_stack([x, uv[:, 1], loop * (1 - np.cos(angle))])
    held, times = uv[:, 0] <= 0.1001, np.append(0.0, np.linspace(0.084, 0.204, 21))
    grips = uv[held], np.stack([start[held]] * 2)
    scene = Scene(0.24, 0.06, 0.2, np.array([0.0, 1.0]), *grips, times, uv, resolution=shape, start=start,
                  velocity=np.zeros((175, 3)), thickness=thickness)  # fmt: skip
    rollout = model().prepare(scene).run(theta)
    assert rollout.status == ("ok",)
    upper = rollout.position[0].reshape(22, 7, 25, 3)[1:, :, 18:, 2]
    assert upper.max() < 1.5 * thickness  # where impacts bounced, 11 to 19 mm


@pytest.mark.parametrize(("model", "theta"), UNDAMPED.values(), ids=UNDAMPED)
def test_layers_that_meet_keep_the_momentum_of_what_is_on_them(model, theta):
    """A loose strip folded over, whose layers go for each other; 5 g lie on the upper one."""
    shape, uv, thickness, loop, speed = (25, 7), lattice((25, 7), 0.24, 0.06), 5e-3, 0.04 / np.pi, 0.3
    angle = np.clip((uv[:, 0] - 0.10) / loop, 0, np.pi)
    x = np.minimum(uv[:, 0], 0.10) + loop * np.sin(angle) - np.maximum(uv[:, 0] - 0.14, 0)
    start = np.column_stack([x, uv[:, 1], loop * (1 - np.cos(angle))])
    velocity = np.zeros((175, 3))
    velocity[:, 2] = np.where(uv[:, 0] > 0.14, -speed, np.where(uv[:, 0] < 0.10, speed, 0.0))
    times = np.linspace(0.0, 0.3, 7)
    scene = loose(start, uv, times, thickness=thickness, gravity=(0.0, 0.0, 0.0), shape=shape)
    scene = dataclasses.replace(scene, velocity=velocity)
    simulation = model().prepare(scene, [catalogue().make("effects", "point_mass")])
    # On a node; its own share of the sheet's mass is in `mass`.
    node, weight = 3 * 25 + 20, 5e-3
    rollout = simulation.run([[*theta[0], weight, *(uv[node] / uv.max(axis=0))]])
    assert rollout.status == ("ok",)
    mass = simulation.sheet.mass.copy()
    mass[node] += weight
    centre = np.einsum("n,tnc->tc", mass, rollout.position[0]) / mass.sum()
    began = mass @ simulation.start[1] / mass.sum()  # speeds that were measured are smoothed
    np.testing.assert_allclose(np.diff(centre, axis=0) / 0.05, np.tile(began, (6, 1)), atol=2e-3 * speed)
    gap = rollout.position[0, -1, uv[:, 0] > 0.16, 2].mean() - rollout.position[0, -1, uv[:, 0] < 0.08, 2].mean()
    assert gap > 0.9 * thickness  # they have met, and not passed each other


def two_layers(gap, closing, thickness, dt):
    """Two pieces, one `gap` above the other and shifted, falling on it; → x, v after one step, masses, `layers`."""
    uv = lattice((7, 7), 0.06, 0.06)
    lower = np.column_stack([uv, 0 * uv[:, 0]])
    upper = np.column_stack([uv + np.array([3e-3, 4e-3]), 0 * uv[:, 0] + gap])
    x = np.vstack([lower, upper]).T
    v = np.zeros_like(x)
    v[2, 49:] = -closing
    mass = np.random.default_rng(2).uniform(0.5, 2.0, 98)
    triangles, rest = grid_triangles((7, 7)), np.vstack([uv, uv + 1.0])
    sheet = sheet_of(rest, mass, mass, np.vstack([triangles, triangles + 49]), (0, 0, 0), 1.2)
    scene = loose(lower, uv, np.array([0.0]), thickness=thickness, shape=(7, 7))
    return x + dt * v, v, mass, layers_of(scene, sheet)


@pytest.mark.slow
def test_layers_that_would_pass_each_other_in_one_step_are_kept_on_their_sides():
    """One step of four thicknesses; position and momentum go from one layer to the other, and none is lost."""
    x, v, mass, layers = two_layers(gap=2e-3, closing=4.0, thickness=1e-3, dt=1e-3)
    centre, momentum = (mass * x).sum(axis=1), (mass * v).sum(axis=1)
    keep_apart(x, v, 1e-3, 1 / mass, layers)
    np.testing.assert_allclose((mass * x).sum(axis=1), centre, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose((mass * v).sum(axis=1), momentum, rtol=1e-12, atol=1e-12)
    assert crossings(x.T, layers.triangles) == 0
    assert v[2, 49:].mean() - v[2, :49].mean() > -0.5 * 4.0


def test_layers_far_enough_apart_are_not_touched():
    x, v, mass, layers = two_layers(gap=2e-3, closing=0.5, thickness=1e-3, dt=1e-3)
    before = x.copy(), v.copy()
    keep_apart(x, v, 1e-3, 1 / mass, layers)
    np.testing.assert_array_equal((x, v), before)
