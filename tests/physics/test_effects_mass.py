"""Effects of the mass: what hangs on the cloth stretches it, what it weighs does not matter in free fall."""

from __future__ import annotations

import numpy as np
import pytest
from effect_scenes import (
    STIFF,
    STRETCH,
    G,
    cloth,
    effect_named,
    fall,
    hanging,
    on_every_model,
    run,
    swing_frequency,
    terminal_speed,
)

from clothbench.plugins.discovery import catalogue

WIDTH, LENGTH = 0.05, 0.4


def sinking(name, *pairs):
    """How much lower the middle and the end of a hanging strip come to lie by an effect [m]; its E [N/m]."""
    scene = hanging(WIDTH, LENGTH, np.array([0.0, 0.1]), [(0.025, 0.2), (0.025, 0.4)], (4, 25))
    theta, along, across = cloth(name, scene, 2 * STRETCH)
    lower = run(name, scene, theta)[0, :, 2] - run(name, scene, theta, *pairs)[0, :, 2]
    return lower, along - across**2 / along


@on_every_model
@pytest.mark.parametrize("width", [0.012, 0.04])
def test_a_heavy_hem_stretches_the_strip_above_it(name, width):
    """An extra tension ρ_h w g above the hem, that falls off linearly inside: ρ_h w g (L − w/2)/E at the end."""
    lower, own = sinking(name, ("heavy_hem", [0.8, width]))
    pull = 0.8 * width * G / own
    np.testing.assert_allclose(lower, [pull * 0.2, pull * (0.4 - width / 2)], rtol=0.05)


@on_every_model
def test_a_point_mass_pulls_on_what_is_above_it(name):
    """m g/W more tension above it and none below."""
    lower, own = sinking(name, ("point_mass", [0.0008, 0.5, 0.8]))
    pull = 0.0008 * G / WIDTH / own
    assert lower[0] == pytest.approx(pull * 0.2, rel=0.05)
    assert lower[1] == pytest.approx(pull * 0.32, rel=0.08)  # and a little more around it, where it pulls on a point


@on_every_model
def test_a_point_mass_moves_continuously_across_the_mesh(name):
    places = [0.62, 0.6245, 0.6255, 0.63]  # a grid line lies at 0.625
    lower = [sinking(name, ("point_mass", [0.0008, 0.5, v]))[0][1] for v in places]
    assert np.diff(lower).min() > 0
    assert np.diff(lower).max() < 0.02 * lower[0]


@on_every_model
@pytest.mark.parametrize("pair", [("total_mass", [1.4]), ("heavy_hem", [0.5, 0.04]), ("point_mass", [0.004, 0.3, 0.6])])
def test_in_free_fall_no_mass_matters(name, pair):
    times = np.linspace(0.0, 0.4, 5)
    fallen = fall(name, times, pair)[:, :, 2]
    np.testing.assert_allclose(fallen[0] - fallen, np.repeat(0.5 * G * times[:, None] ** 2, 25, axis=1), atol=1e-3)


@on_every_model
def test_a_heavier_sheet_falls_faster_through_air(name):
    assert terminal_speed(name, ("linear_drag", [1.0]), ("total_mass", [1.4])) == pytest.approx(1.4 * 0.1 * G, rel=1e-3)


@on_every_model
def test_a_heavier_limp_sheet_swings_just_as_fast(name):
    assert swing_frequency(name, ("total_mass", [1.4])) == pytest.approx(swing_frequency(name), rel=0.005)


@pytest.mark.parametrize("name", ["mass_spring", "mass_spring_verlet"])
def test_a_lighter_sheet_is_taken_in_shorter_steps(name):
    """Stable all over the model's bounds at the least ratio, and as it was from the stated mass on."""

    def pull(t):
        return np.stack([0 * t, 0.05 * np.sin(6 * t), 0 * t], axis=1)

    model = catalogue().make("models", name)
    scene = hanging(0.2, 0.3, np.array([0.0, 0.7]), [(0.1, 0.3)], (7, 10), moved=pull)
    simulation = model.prepare(scene, [effect_named("total_mass")])
    base = model.parameters.from_unit(np.random.default_rng(0).random((8, len(model.parameters))))
    steps = {r: simulation.stages_and_step(np.hstack([base, np.full((8, 1), r)]))[1] for r in (0.7, 1.0, 1.5)}
    assert set(simulation.run(np.hstack([base, np.full((8, 1), 0.7)])).status) == {"ok"}
    assert (steps[0.7] < steps[1.0]).all()
    np.testing.assert_array_equal(steps[1.0], model.prepare(scene).stages_and_step(base)[1])
    np.testing.assert_array_equal(steps[1.0], steps[1.5])


@on_every_model
def test_a_sheet_hangs_along_tilted_gravity(name):
    scene = hanging(0.1, 0.3, np.array([0.0, 0.1]), [(0.05, 0.0), (0.05, 0.1), (0.05, 0.3)], (5, 13))
    x = run(name, scene, cloth(name, scene, STIFF)[0], ("gravity_tilt", [0.15, 0.0]))[-1]
    for lower in x[1:]:
        along = (lower - x[0]) / np.linalg.norm(lower - x[0])
        np.testing.assert_allclose(along, [0.0, np.sin(0.15), -np.cos(0.15)], atol=2e-3)
