"""What Bullet's sheet does where the answer is known, and that nobody hears of it."""

import subprocess
import sys

import numpy as np
import pytest
from clothbench import Scene
from clothbench.testing import scenes

from clothbench_pybullet.mesh import springs, write_obj
from clothbench_pybullet.model import PybulletCloth

pytestmark = pytest.mark.skipif(PybulletCloth.skip_reason() is not None, reason="PyBullet is not installed")
THETA = np.array([[30.0, 1e-3, 0.0]])


def at_nodes(scene, simulation):
    """The same scene, looked at in the nodes."""
    return scenes.dataclasses.replace(scene, points=simulation.uv, start=None)


def test_it_falls_freely_the_better_the_shorter_its_steps():
    scene = scenes.free_fall()
    fallen = []
    for scale in (1.0, 0.5):
        height = PybulletCloth(step_scale=scale).prepare(scene).run(THETA).position[0, :, :, 2].mean(axis=1)
        fallen.append((height[0] - height[-1]) / (9.81 * scene.times[-1] ** 2 / 2) - 1)
    assert 0 < fallen[1] < fallen[0] < 0.01  # symplectic Euler falls by g dt t/2 too far
    assert fallen[1] == pytest.approx(fallen[0] / 2, rel=0.1)


def test_at_rest_flat_springs_bear_nodes_of_equal_weight():
    """Forces k (|d| − L) d/|d| of springs as long as in the flat sheet, and m = ρ A / n everywhere."""
    scene = scenes.still(scenes.stretched())
    simulation = PybulletCloth().prepare(scene)
    simulation = PybulletCloth().prepare(at_nodes(scene, simulation))
    x, flat = simulation.run(THETA).position[0, 0], np.pad(simulation.uv, ((0, 0), (0, 1)))
    one, other = np.nonzero(springs(simulation.faces, simulation.nodes)[0].toarray())
    d, rest = x[other] - x[one], np.linalg.norm(flat[other] - flat[one], axis=1)
    length = np.linalg.norm(d, axis=1)
    force = np.zeros_like(x)
    np.add.at(force, one, (THETA[0, 0] * (1 - rest / length))[:, None] * d)
    weight = simulation.mass / simulation.nodes * 9.81
    force[:, 2] -= weight
    free = np.setdiff1d(np.arange(simulation.nodes), simulation.sheet.held)
    assert np.abs(force[free]).max() < 1e-3 * weight


def test_a_limp_strip_that_begins_too_long_does_not_crumple():
    """It hangs level across, where one that springs back stays in creases."""
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(0, 0.3, 17), np.linspace(0, 0.075, 5)))
    start = np.stack([0.8 * u, v, 4 * (u**2 - 0.3 * u)], axis=1)
    ends = (u == 0) | (u == 0.3)
    scene = Scene(
        width=0.3, height=0.075, areal_density=0.15, grip_time=np.array([0.0, 1.0]), resolution=(17, 5),
        grip_material=np.stack([u, v], axis=1)[ends], grip_position=np.stack([start[ends], start[ends]]),
        times=np.array([0.0, 0.1]), points=np.stack([u, v], axis=1), start=start,
    )  # fmt: skip
    rollout = PybulletCloth().prepare(scene).run(np.array([[750.0, 0.0, 0.0]]))
    across = rollout.position[0, -1, np.isclose(u, 0.15), 2]
    assert np.ptp(across) < 5e-4
    assert across.mean() == pytest.approx(-0.0797, rel=5e-3)  # the catenary


def test_held_nodes_are_where_they_are_led(tmp_path):
    from clothbench_pybullet.world import Cloth, World

    simulation = PybulletCloth().prepare(scenes.hanging())
    write_obj(tmp_path / "sheet.obj", simulation.uv, simulation.faces)
    cloth = Cloth(tmp_path / "sheet.obj", simulation.mass, (0.0, 0.0, -9.81), 30.0, 1e-3, 1.0)
    held, here = simulation.sheet.held, np.pad(simulation.uv, ((0, 0), (0, 1)))
    world = World(cloth, here, held, 5e-4)
    path = here[held] + 0.05 * np.sin(np.linspace(0, 3, 50))[:, None, None]
    for before, after in zip(path[:-1].tolist(), path[1:].tolist(), strict=True):
        world.lead(before, after)
        world.step()
        np.testing.assert_allclose(world.places()[held], after, rtol=0, atol=1e-15)
    world.close()


def test_steps_too_long_are_told_by_the_status():
    rollout = PybulletCloth(dt=0.02).prepare(scenes.swinging()).run(np.array([[1000.0, 0.0, 0.0], [1.0, 0.02, 0.0]]))
    assert rollout.status[0] == "diverged"
    assert np.isnan(rollout.position[0]).any()


def test_it_prints_nothing():
    code = (
        "from clothbench.testing import scenes; from clothbench_pybullet.model import PybulletCloth as Cloth; "
        "model = Cloth(); model.prepare(scenes.free_fall()).run(model.parameters.defaults[None]); print('{}')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=300)
    assert (done.stdout, done.stderr) == ("{}\n", "")
