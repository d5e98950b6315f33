"""`inextensible` against mechanics: it keeps its lengths and angles, and θ, α and β mean what they say on any mesh."""

import dataclasses
import itertools

import numpy as np
import pytest
from clothbench_models.baraff_witkin import BaraffWitkin
from clothbench_models.inextensible import TAUT, Inextensible
from effect_scenes import effect_named, falling, hanging
from implicit_scenes import (
    DENSITY,
    PENDULUM,
    G,
    aside,
    beam_frequency,
    beam_vibration,
    error,
    shaken,
    simulate,
    slack,
    swing_wave,
)

from clothbench import ClothbenchError, Scene
from clothbench.core.protocols import Material
from clothbench.reference import mechanics as references
from clothbench.studies.mechanics import scenes, trials
from clothbench.testing.scenes import overhanging, with_times

CLOTH = (1e-5, 1.5, 2e-7)
BARE = (1e-6, 0.0, 0.0)


# --- constraints ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("integrator", ["bdf2", "implicit_euler"])
@pytest.mark.parametrize("tolerance", [1e-3, 1e-5, 1e-6])
def test_lengths_and_angles_stay_within_the_tolerance_while_a_sheet_swings(integrator, tolerance):
    """Beside it, the lines that carry the weight lengthen as those of a sheet of 20 kN/m."""
    scene = scenes.swinging(17, 0.1, 1.0, 0.005)
    scene = dataclasses.replace(scene, times=np.arange(0.0, scene.times[-1], 0.004))  # at steps, not between them
    x = simulate(Inextensible(tolerance=tolerance, integrator=integrator), scene, *BARE)
    x = x.reshape(len(x), 17, -1, 3)
    assert np.ptp(x[:, -1, 0, 1]) > 0.15
    wide, high = scene.width / (x.shape[2] - 1), scene.height / 16
    along_u, along_v = np.diff(x, axis=2), np.diff(x, axis=1)
    mean_u, mean_v = (along_u[:, 1:] + along_u[:, :-1]) / 2, (along_v[:, :, 1:] + along_v[:, :, :-1]) / 2
    strain_u, strain_v = (np.linalg.norm(d, axis=-1) / h - 1 for d, h in ((along_u, wide), (along_v, high)))
    weight = 1.2 * scene.areal_density * G * scene.height / TAUT
    # What is held is C − cλ; across, and in shear, λ is what earlier steps left: cλ was up to 0.34 of the tolerance in
    # a step that left C − cλ at 0.89. Few frames show it.
    assert np.quantile(np.abs(strain_u).max(axis=(1, 2)), 0.99) < 1.1 * tolerance
    assert np.abs(strain_u).max() < 1.5 * tolerance
    assert -1.1 * tolerance < strain_v.min() < strain_v.max() < weight + 1.1 * tolerance
    assert np.abs((mean_u * mean_v).sum(axis=-1)).max() / (wide * high) < 1.5 * tolerance


@pytest.mark.parametrize("along", [9, 17, 33])
def test_a_hanging_strip_gives_way_as_20_kilonewtons_per_metre(along):
    scene = hanging(0.05, 0.4, np.array([0.0, 0.2]), [(0.025, 0.4)], (max(3, along // 8 + 1), along))
    z = simulate(Inextensible(tolerance=1e-8), scene, *BARE)[:, 0, 2]
    np.testing.assert_allclose(-0.4 - z, DENSITY * G * 0.4**2 / (2 * TAUT), rtol=1e-3)


def test_it_swings_like_a_very_stiff_sheet_of_triangles():
    scene = aside(np.arange(0.0, 2.001, 0.02))
    hard = simulate(Inextensible(), scene, *BARE)
    soft = simulate(BaraffWitkin(), scene, 1e-6, 5000.0, 2500.0, 0, 0, 0, 0, 0, 0)
    assert np.ptp(hard[:, -1, 1]) > 0.1
    assert np.sqrt(((hard - soft) ** 2).mean()) < 2e-5


@pytest.mark.parametrize("shear", [10.0, 50.0, 200.0])
def test_a_stated_shear_stiffness_is_that_of_triangles(shear):
    """A sheet hung from one corner, whose two others come together: the softer the more."""
    scene = shaken(np.array([0.0, 0.3]), 9, 0.0)
    scene = Scene(0.3, 0.3, DENSITY, scene.grip_time, scene.grip_material[:1], scene.grip_position[:, :1], scene.times,
                  scene.points, resolution=(9, 9))  # fmt: skip
    x = simulate(Inextensible(shear=shear), scene, *CLOTH)
    triangles = simulate(BaraffWitkin(), scene, CLOTH[0], 5000.0, shear, 0, 0, 0, 0, 0, 0)[0]
    np.testing.assert_allclose(x[0], triangles, atol=2e-4)
    np.testing.assert_allclose(x[1], x[0], atol=1e-6)
    lower = x[0, -1, 2] + 0.3 * np.sqrt(2)  # than that, an unsheared square does not reach
    assert lower < -3e-3 if shear == 10.0 else lower > -1.5e-3


# --- motion -----------------------------------------------------------------------------------------------------------


def test_free_fall_is_exact():
    times = np.linspace(0.0, 0.5, 6)
    z = simulate(Inextensible(), falling(times, 0.3), *BARE)[:, :, 2]
    np.testing.assert_allclose(z - z[0], np.broadcast_to(-0.5 * G * times[:, None] ** 2, z.shape), atol=1e-7)


@pytest.mark.parametrize("along", [9, 17, 33])
def test_period_and_sag_are_within_a_percent_on_every_mesh(along):
    close = {9: 0.01, 17: 0.0025, 33: 0.001}[along]
    assert abs(error("inextensible", trials.swing(along)[0])) < close
    hung = trials.catenary(along)[0]
    span = scenes.SPAN * trials.HANGING
    sag = references.catenary_sag(trials.HANGING, span, scenes.DENSITY * G, TAUT)
    assert abs(error("inextensible", hung, sag)) < close


@pytest.mark.parametrize(("alpha", "beta"), [(1.0, 0.0), (0.0, 1.0), (0.5, 0.5)])
def test_a_free_strip_vibrates_as_a_beam_and_rayleigh_s_damping_stops_it(alpha, beta):
    """ω = (4.730/L)² √(θ/ρ) to second order, and γ = α/(2ρ) + β ω²/(2θ); α and β here as shares of 0.05 ω."""
    theta, errors = 1e-4, []
    expected = beam_frequency(theta)
    damping = 2 * DENSITY * 0.05 * expected * alpha, 2 * theta / expected * 0.05 * beta
    for along in (9, 17):
        model = Inextensible(dt=2 * np.pi / expected / 400)
        omega, gamma = beam_vibration(model, theta, along, (theta, *damping))
        assert gamma == pytest.approx(damping[0] / (2 * DENSITY) + damping[1] * omega**2 / (2 * theta), rel=3e-3)
        errors.append(omega / expected - 1)
    assert abs(errors[-1]) < 0.02
    assert errors[0] / errors[1] == pytest.approx(4, abs=0.5)


@pytest.mark.parametrize("alpha", [0.0, 0.3, 1.5])
def test_a_swing_fades_with_alpha_over_twice_the_density(alpha):
    omega, gamma = swing_wave(Inextensible(), (1e-7, alpha, 0.0))
    assert omega == pytest.approx(PENDULUM, rel=0.015)
    assert gamma == pytest.approx(alpha / (2 * scenes.DENSITY), rel=0.02, abs=5e-4)


@pytest.mark.parametrize("dt", [1e-3, 4e-3])
def test_implicit_euler_overdamps_a_swing_in_vacuum(dt):
    """By γ = ω² dt/2."""
    omega, gamma = swing_wave(Inextensible(integrator="implicit_euler", dt=dt), (1e-7, 0.0, 0.0))
    assert gamma == pytest.approx(omega**2 * dt / 2, rel=0.02)


@pytest.mark.parametrize(("integrator", "ratio"), [("bdf2", 4), ("implicit_euler", 2)])
def test_the_order_of_the_schemes(integrator, ratio):
    """Differences between runs of step upon half the step."""
    scene = aside(np.arange(0.0, 2.001, 0.02))
    runs = [simulate(Inextensible(integrator=integrator, dt=dt, tolerance=1e-8), scene, *BARE)
            for dt in (2e-3, 1e-3, 5e-4, 2.5e-4)]  # fmt: skip
    steps = [np.sqrt(((b - a) ** 2).mean()) for a, b in itertools.pairwise(runs)]
    assert steps[0] / steps[1] == pytest.approx(ratio, rel=0.1)
    assert steps[1] / steps[2] == pytest.approx(ratio, rel=0.06)
    assert steps[-1] < {"bdf2": 1e-6, "implicit_euler": 1e-4}[integrator]


@pytest.mark.parametrize("integrator", ["bdf2", "implicit_euler"])
@pytest.mark.parametrize("scene", [lambda t: shaken(t, 13, 0.0), lambda t: slack(t, 9)], ids=["taut", "slack"])
def test_a_settled_sheet_stays_at_rest(integrator, scene):
    x = simulate(Inextensible(integrator=integrator), scene(np.array([0.0, 0.01, 0.5])), *CLOTH)
    assert np.abs(x[1] - x[0]).max() / 0.01 < 1e-4  # m/s
    assert np.abs(x[2] - x[0]).max() < 1e-5


@pytest.mark.parametrize("name", ["stretch_stiffening", "poisson_coupling", "viscoelasticity"])
def test_what_acts_on_stretch_leaves_rest_where_it_is(name):
    """Over all of its bounds: nothing stretches here. Settling knows of it as a share of its own stiff springs."""
    model, effect, scene = Inextensible(), effect_named(name), with_times(overhanging(), np.array([0.0]))
    values = [effect.parameters.from_unit(np.full(len(effect.parameters), at)) for at in (0.0, 0.3, 0.7, 1.0)]
    rest = model.prepare(scene).run(np.array([CLOTH])).position[0]
    beside = model.prepare(scene, (effect,)).run(np.array([[*CLOTH, *phi] for phi in values]))
    assert set(beside.status) == {"ok"}
    assert np.abs(beside.position - rest).max() < 1e-4


# --- batches, options, materials --------------------------------------------------------------------------------------


@pytest.mark.parametrize("integrator", ["bdf2", "implicit_euler"])
def test_members_of_a_batch_come_out_as_one_by_one(integrator):
    simulation = Inextensible(integrator=integrator).prepare(shaken(np.linspace(0, 0.3, 4), 7))
    theta = np.array([CLOTH, (1e-4, 0.5, 0.0), BARE])
    together = simulation.run(theta)
    for b in range(3):
        np.testing.assert_array_equal(together.position[b], simulation.run(theta[b : b + 1]).position[0])


def test_a_member_that_diverges_leaves_the_others_alone():
    simulation = Inextensible(dt=8e-3).prepare(shaken(np.linspace(0.0, 1.5, 16), 9))
    theta = np.array([(1e-3, 0.0, 0.0), (1e-7, 0.0, 0.0), (1e-2, 0.0, 0.0)])
    rollout = simulation.run(theta)
    assert rollout.status == ("ok", "diverged", "ok")
    assert "the step is too long" in rollout.reasons[1]
    assert np.isfinite(rollout.position[1, 0]).all()  # what it did before
    assert np.isnan(rollout.position[1, -1]).all()
    for b in (0, 2):
        np.testing.assert_array_equal(rollout.position[b], simulation.run(theta[b : b + 1]).position[0])


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"integrator": "rk45"}, "integrator is 'rk45', expected one of implicit_euler, bdf2"),
        ({"resolution": (9, 2)}, "resolution is (9, 2), expected one or two whole numbers ≥ 3"),
        ({"dt": "fast"}, "dt is 'fast', expected a number above 0"),
        ({"step_scale": 0}, "step_scale is 0, expected a number above 0 and at most 100"),
        ({"tolerance": None}, "tolerance is None, expected a number above 0 and at most 0.1"),
        ({"tolerance": 1.0}, "tolerance is 1.0, expected a number above 0 and at most 0.1"),
        ({"shear": 0.0}, "shear is 0.0, expected a number above 0"),
    ],
)
def test_wrong_options_are_refused_in_one_line(options, complaint):
    with pytest.raises(ClothbenchError) as fault:
        Inextensible(**options)
    assert str(fault.value) == f"inextensible: {complaint}"


def test_a_material_gives_its_bending_alone():
    theta = Inextensible().of_material(Material(2e-5, 450.0, 100.0), shaken(np.array([0.0]), 5))
    np.testing.assert_array_equal(theta, [2e-5, 0.0, 0.0])
