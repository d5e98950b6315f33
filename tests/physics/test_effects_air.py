"""Effects of the air on moving sheets, against balances of forces that have an answer on paper."""

from __future__ import annotations

import numpy as np
import pytest
from effect_scenes import (
    STIFF,
    G,
    cloth,
    effect_named,
    fall,
    falling,
    hanging,
    on_every_model,
    run,
    swing_frequency,
    terminal_speed,
)
from scipy.linalg import expm

from clothbench.plugins.discovery import catalogue

WEIGHT = 0.1 * G  # N/m² of the falling sheet
AIR = 1.2  # kg/m³


@on_every_model
@pytest.mark.parametrize("coefficient", [0.5, 1.0])
def test_linear_drag_ends_a_fall_at_weight_over_coefficient(name, coefficient):
    assert terminal_speed(name, ("linear_drag", [coefficient])) == pytest.approx(WEIGHT / coefficient, rel=1e-3)


@on_every_model
@pytest.mark.parametrize("coefficient", [0.5, 1.2])
def test_quadratic_drag_ends_a_fall_at_its_terminal_speed(name, coefficient):
    """v = √(2 ρ g/(ρ_air C_N))."""
    expected = np.sqrt(2 * WEIGHT / (AIR * coefficient))
    assert terminal_speed(name, ("quadratic_drag", [coefficient, 0.0])) == pytest.approx(expected, rel=1e-3)


@on_every_model
def test_drag_crisis_lets_it_fall_faster(name):
    """½ ρ_air C_N v²/(1 + k_f v²) = ρ g."""
    expected = np.sqrt(WEIGHT / (0.5 * AIR - 0.2 * WEIGHT))
    found = terminal_speed(name, ("drag_crisis", [1.0, 0.2]))
    assert found == pytest.approx(expected, rel=2e-3)


@on_every_model
def test_a_rising_wind_slows_the_fall_by_its_own_speed(name):
    still = terminal_speed(name, ("quadratic_drag", [1.0, 0.0]))
    risen = terminal_speed(name, ("steady_wind", [1.0, 0.0, 0.0, 0.0, 0.4]))
    assert risen == pytest.approx(still - 0.4, rel=2e-3)


@on_every_model
def test_added_mass_slows_the_swing(name):
    """ω = ω₁/√(1 + m_a/ρ) for a motion along the normal."""
    ratio = swing_frequency(name, ("added_mass", [0.1])) / swing_frequency(name)
    assert ratio == pytest.approx(1 / np.sqrt(1 + 0.1 / 0.2), rel=0.01)


def lean(name, *pairs):
    """Angle [rad] to the vertical at which a sheet hangs still, and how far it is from straight [m]."""
    along = np.linspace(0.05, 0.3, 6)
    scene = hanging(0.1, 0.3, np.array([0.0, 0.1]), [(0.05, v) for v in along], (5, 13), density=0.1)
    y, z = run(name, scene, cloth(name, scene, STIFF)[0], *pairs)[0, :, 1:].T
    return np.arctan2(y[-1], -z[-1]), np.abs(y - z * y[-1] / z[-1]).max()


@on_every_model
@pytest.mark.parametrize("steady", [0.0, 0.4])
def test_air_that_follows_late_lets_a_sheet_fall_as_its_equations_say(name, steady):
    """ρ v̇ = −ρ g − h y − b v, ẏ = v̇ − y/τ: fast while the air follows, then to the terminal speed of b alone."""
    late, density, times = 0.15, 0.1, np.array([0.0, 0.4, 0.6, 0.8, 1.2])
    found = fall(name, times, ("air_memory", [0.8, steady, late])).mean(axis=1)[:, 2]
    pull = np.array([-steady / density, -0.8 / density])  # v̇ of v and y
    rates = np.zeros((4, 4))  # of height, v, y and 1
    rates[0, 1], rates[1, 1:3], rates[1, 3] = 1.0, pull, -G
    rates[2] = rates[1] - np.array([0.0, 0.0, 1 / late, 0.0])
    expected = np.array([(expm(rates * t) @ [0.0, 0.0, 0.0, 1.0])[0] for t in times])
    np.testing.assert_allclose(found[1:], expected[1:], rtol=0.01)


@pytest.mark.parametrize("name", ["baraff_witkin", "inextensible"])
@pytest.mark.parametrize(("effect", "values"), [("air_memory", [0.8, 0.4, 0.15]), ("added_mass", [0.1])])
def test_implicit_steps_are_of_second_order_from_the_moment_a_sheet_is_let_go(name, effect, values):
    """The step before the first is on the parabola of what pulls now, and memories see the first change of speed."""
    times = np.array([0.0, 0.4, 0.8])
    scene = falling(times, 0.0)
    theta, own = cloth(name, scene, STIFF)[0], [effect_named(effect)]
    heights = []
    for dt in (4e-3, 2e-3, 1e-3):
        rollout = catalogue().make("models", name, dt=dt).prepare(scene, own).run(np.append(theta, values)[None])
        heights.append(rollout.position[0, -1, :, 2].mean())
    first, second = np.abs(np.diff(heights))
    assert second < 0.3 * first + 1e-9
    assert first < 1e-3


@pytest.mark.parametrize("name", ["baraff_witkin", "inextensible"])
@pytest.mark.parametrize("air", [("air_memory", [0.8, 0.0, 0.15]), ("linear_drag", [0.5])], ids=lambda air: air[0])
@pytest.mark.parametrize("stiffer", [("viscoelasticity", [1e-9, 0.0, 0.2]), ("bending_anisotropy", [1e-5, 0.0])])
def test_what_stiffens_a_sheet_leaves_the_air_of_second_order(name, air, stiffer):
    """A sheet that falls flat does not bend: it falls as without; in steps of first order 4 mm less far."""
    times = np.linspace(0.0, 0.8, 5)
    with_it, without = (fall(name, times, *pairs)[:, :, 2].mean(axis=1) for pairs in ((air, stiffer), (air,)))
    np.testing.assert_allclose(with_it, without, atol=5e-5)


@on_every_model
@pytest.mark.parametrize("speed", [0.4, -0.8])
def test_a_sheet_in_the_wind_hangs_straight_at_the_angle_of_balance(name, speed):
    """ρ g sin α = ½ ρ_air C_N w² cos² α at every point: no curvature, so no bending or tension across."""
    angle, bent = lean(name, ("steady_wind", [1.1, 0.02, 0.0, speed, 0.0]))
    push = 0.5 * AIR * 1.1 * speed**2 / WEIGHT
    sine = (np.sqrt(1 + 4 * push**2) - 1) / (2 * push)
    assert angle == pytest.approx(np.sign(speed) * np.arcsin(sine), rel=0.01)
    assert bent < 1e-3


@on_every_model
def test_a_wide_jet_is_a_wind(name):
    jet, _ = lean(name, ("local_jet", [1.0, 0.5, np.pi / 2, 0.05, 0.0, -0.15, 2.0]))
    wind, _ = lean(name, ("steady_wind", [1.0, 0.0, 0.0, 0.5, 0.0]))
    assert jet == pytest.approx(wind, rel=0.01)


@on_every_model
def test_lift_carries_a_falling_slope_sideways_and_does_no_work(name):
    """At first ÿ = ½ ρ_air C_L (g t)² sin α cos α/ρ, towards its lower edge; the speed stays that of a free fall."""
    times = np.linspace(0.0, 0.3, 301)
    position = fall(name, times, ("lift", [0.2]), slope=np.pi / 4).mean(axis=1)
    velocity = np.gradient(position, times, axis=0)[5:-5]
    fallen = (position[0, 2] - position[:, 2])[5:-5]
    np.testing.assert_allclose((velocity**2).sum(axis=1), 2 * G * fallen, rtol=5e-3, atol=1e-4)
    expected = 0.5 * AIR * 0.2 * G**2 * 0.5 / 0.1 * times[120] ** 4 / 12
    drift = position[120] - position[0]
    assert drift[1] == pytest.approx(-expected, rel=0.03)
