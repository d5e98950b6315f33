"""What the tests of contact share: sheets that nothing holds, and the models that they are tried with."""

from __future__ import annotations

from functools import partial

import numpy as np
from clothbench_models.baraff_witkin import BaraffWitkin
from clothbench_models.inextensible import Inextensible
from clothbench_models.mass_spring import MassSpring

from clothbench import Scene
from clothbench.core.scene import Obstacle

G = 9.81
SPHERE = Obstacle("sphere", (0.0, 0.0, -0.05), radius=0.05, friction=0.3)
DISC = Obstacle("disc", radius=0.06, friction=0.3)
SOFT = [[100.0, 0.05, 0.05]]
TRIANGLES, IN_AIR = ([[1e-5, 200.0, 50.0, 2e-7, 0.02, 0.02, *air]] for air in ((0.0, 0.0, 0.0), (0.6, 0.02, 0.05)))
QUADS, DAMPED = ([[1e-5, alpha, 2e-7]] for alpha in (0.0, 1.5))
IMPLICIT = {
    "baraff_witkin bdf2": (BaraffWitkin, IN_AIR),
    "baraff_witkin implicit_euler": (partial(BaraffWitkin, integrator="implicit_euler"), IN_AIR),
    "baraff_witkin rk45": (partial(BaraffWitkin, integrator="rk45"), IN_AIR),
    "inextensible bdf2": (Inextensible, DAMPED),
}


def lattice(shape, width, height):
    """The nodes of an even grid, (n, 2) m, row by row."""
    u, v = np.meshgrid(np.linspace(0, width, shape[0]), np.linspace(0, height, shape[1]))
    return np.column_stack([u.ravel(), v.ravel()])


def loose(start, uv, times, *, obstacles=(), thickness=0.0, gravity=(0.0, 0.0, -G), shape, velocity=None):
    """A sheet that nothing holds, seen at its nodes; velocity (3,) m/s: with which it begins, if it is seen to."""
    width, height = uv.max(axis=0)
    moving = None if velocity is None else np.tile(np.array(velocity, dtype=float), (len(uv), 1))
    return Scene(width, height, 0.2, np.array([0.0, 1.0]), np.zeros((0, 2)), np.zeros((2, 0, 3)), times, uv,
                 gravity=gravity, resolution=shape, start=start, obstacles=obstacles, thickness=thickness,
                 velocity=moving)  # fmt: skip


def drape(obstacle, times, thickness=0.0, nodes=17, model=MassSpring, theta=SOFT):
    """A square sheet of 30 cm laid on a sphere of radius 5 cm or a disc of 6 cm → (T, n, 3) m."""
    shape, uv = (nodes, nodes), lattice((nodes, nodes), 0.3, 0.3)
    start = np.column_stack([uv - 0.15, 1e-3 + 1e-6 * np.sin(40 * uv[:, 0]) * np.cos(30 * uv[:, 1])])
    scene = loose(start, uv, times, obstacles=(obstacle,), thickness=thickness, shape=shape)
    rollout = model().prepare(scene).run(theta)
    assert rollout.status == ("ok",)
    return rollout.position[0]
