"""The model keeps every rule of the conformance kit; its forces are the slope of an energy written down here."""

import numpy as np
import pytest
from clothbench.testing import check_plugin, rule_names, scenes

from clothbench_taichi.model import TaichiSprings, springs

pytestmark = pytest.mark.skipif(TaichiSprings.skip_reason() is not None, reason="Taichi is not installed")


@pytest.mark.parametrize("rule", rule_names("models"))
def test_the_model_keeps_every_rule(rule):
    check_plugin("models", "taichi_springs", only=[rule])


def test_forces_are_the_slope_of_the_springs_energy():
    """E = Σ ½ Y L (|d|/L − 1)²."""
    from clothbench_taichi import kernels

    simulation, k = TaichiSprings().prepare(scenes.hanging()), 30.0
    pairs, share, rest, width = springs(simulation.shape, simulation.sheet.uv)
    random, flat = np.random.default_rng(4), np.pad(simulation.sheet.uv, ((0, 0), (0, 1)))
    x, way = flat + random.normal(0, 0.01, flat.shape), random.normal(size=flat.shape)

    def energy(x):
        length = np.linalg.norm(x[pairs[:, 1]] - x[pairs[:, 0]], axis=1)
        return (k * share * width * rest * (length / rest - 1) ** 2 / 2).sum()

    f = np.zeros((1, *x.shape))
    kernels.forces(x[None], 0 * f, f, pairs.astype(np.int32), share * width, rest, share, k, 0.0)
    slope = (energy(x + 1e-7 * way) - energy(x - 1e-7 * way)) / 2e-7
    assert -(f[0] * way).sum() == pytest.approx(slope, rel=1e-6)


def test_members_do_not_see_each_other():
    simulation = TaichiSprings().prepare(scenes.hanging())
    theta = np.array([[20.0, 1e-4, 0.5], [60.0, 0.0, 1.0]])
    both = simulation.run(theta).position
    np.testing.assert_array_equal(both[1], simulation.run(theta[1:]).position[0])
