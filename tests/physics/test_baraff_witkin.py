"""`baraff_witkin` against mechanics: what each parameter means, on any mesh; what its three integrators do."""

import numpy as np
import pytest
from clothbench_models.baraff_witkin import BaraffWitkin
from effect_scenes import falling, hanging
from implicit_scenes import (
    BEAM,
    DENSITY,
    PENDULUM,
    G,
    aside,
    beam_frequency,
    beam_vibration,
    damped_wave,
    error,
    lattice,
    shaken,
    simulate,
    slack,
    swing_wave,
)

from clothbench import ClothbenchError, Scene
from clothbench.core.protocols import Material
from clothbench.studies.mechanics import trials

NAMES = BaraffWitkin.parameters.names
CLOTH = dict(zip(NAMES, BaraffWitkin.parameters.defaults, strict=True))
BARE = dict.fromkeys(NAMES, 0.0) | {"bend": 1e-6, "stretch": 300.0, "shear": 150.0}  # no damping, no air


def values(base, **changes):
    """The nine parameters in their order."""
    assert set(changes) <= set(NAMES)
    return [{**base, **changes}[name] for name in NAMES]


# --- statics: the same parameters on every mesh ----------------------------------------------------------------------


@pytest.mark.parametrize("along", [9, 17, 33])
def test_a_hanging_strip_stretches_by_its_own_weight(along):
    """ρ g L²/(2 k) at the end, three quarters of it at the middle: exactly, whatever the mesh."""
    scene = hanging(0.05, 0.4, np.array([0.0, 0.1]), [(0.025, 0.4), (0.025, 0.2)], (max(3, along // 8 + 1), along))
    z = simulate(BaraffWitkin(), scene, *values(BARE))[0, :, 2]
    whole = DENSITY * G * 0.4**2 / (2 * 300.0)
    np.testing.assert_allclose([-0.4 - z[0], -0.2 - z[1]], [whole, 0.75 * whole], rtol=1e-5)


def between_columns(across, shear, times, moved=None):
    """A tall sheet held along both sides, 0.1 m apart, which `moved(t)` shifts downwards; seen along its middle."""
    width, height = 0.1, 0.4
    shape = across, 2 * across - 1
    v = np.linspace(0, height, shape[1])
    held = np.concatenate([np.stack([0 * v, v], axis=1), np.stack([0 * v + width, v], axis=1)])
    clock = np.linspace(0.0, max(times[-1], 0.1), 400)
    path = np.stack([held[:, 0], 0 * held[:, 0], -held[:, 1]], axis=1) + np.zeros((400, 1, 1))
    path[:, :, 2] += (moved(clock) if moved else 0 * clock)[:, None]
    points = np.stack([np.linspace(0, width, across), np.full(across, height / 2)], axis=1)
    return Scene(width, height, DENSITY, clock, held, path, times, points, resolution=shape)


@pytest.mark.parametrize("across", [9, 17])
def test_a_sheet_held_at_both_sides_sags_in_its_plane_as_shear_says(across):
    """ρ g W²/(8 k_shear), far from the free ends."""
    scene = between_columns(across, 50.0, np.array([0.0]))
    x = simulate(BaraffWitkin(), scene, *values(BARE, stretch=3000.0, shear=50.0))[0]
    assert -0.2 - x[across // 2, 2] == pytest.approx(DENSITY * G * 0.1**2 / (8 * 50.0), rel=0.004)


@pytest.mark.parametrize("along", [9, 17, 33])
@pytest.mark.parametrize("trial", [trials.swing, trials.catenary])
def test_period_and_sag_are_within_a_percent_on_every_mesh(trial, along):
    assert abs(error("baraff_witkin", trial(along)[0])) < {9: 0.01, 17: 0.0025, 33: 0.001}[along]


# --- motion -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("integrator", "tolerance"), [("bdf2", 1e-9), ("rk45", 5e-6)])
def test_free_fall_is_exact(integrator, tolerance):
    times = np.linspace(0.0, 0.5, 6)
    z = simulate(BaraffWitkin(integrator=integrator), falling(times, 0.3), *values(BARE))[:, :, 2]
    np.testing.assert_allclose(z - z[0], np.broadcast_to(-0.5 * G * times[:, None] ** 2, z.shape), atol=tolerance)


def test_a_free_strip_vibrates_as_a_beam_and_its_bending_damper_stops_it():
    """ω = (4.730/L)² √(D/ρ) to second order, and γ = k_d ω²/(2 D) with what ω the mesh has."""
    bending, errors = 1e-4, []
    damping = 0.1 * bending / beam_frequency(bending)
    for along in (9, 17, 33):
        model = BaraffWitkin(dt=2 * np.pi / beam_frequency(bending) / 400)
        omega, gamma = beam_vibration(model, bending, along, values(BARE, bend=bending, bend_damping=damping))
        assert gamma == pytest.approx(damping * omega**2 / (2 * bending), rel=2e-3)
        errors.append(omega / beam_frequency(bending) - 1)
    assert abs(errors[-1]) < 0.005
    assert errors[0] / errors[1] == pytest.approx(4, abs=0.5)
    assert errors[1] / errors[2] == pytest.approx(4, abs=0.5)


@pytest.mark.parametrize("integrator", ["bdf2", "rk45"])
def test_a_strip_rings_along_itself_and_its_stretch_damper_stops_it(integrator):
    """ω = (π/L) √(k/ρ), γ = k_d ω²/(2 k)."""
    stretch, shape = 300.0, (17, 5)
    wave = np.pi / BEAM[0]
    omega = wave * np.sqrt(stretch / DENSITY)
    damping = 0.06 * stretch / omega
    uv = lattice(*BEAM, shape)
    start = np.column_stack([uv[:, 0] - 1e-4 * np.cos(wave * uv[:, 0]), uv[:, 1], 0 * uv[:, 0]])
    times = np.linspace(0, 8 * np.pi / omega, 161)
    scene = Scene(*BEAM, DENSITY, np.array([0.0, 1.0]), np.zeros((0, 2)), np.zeros((2, 0, 3)), times, uv,
                  gravity=(0.0, 0.0, 0.0), resolution=shape, start=start)  # fmt: skip
    model = BaraffWitkin(integrator=integrator, dt=np.pi / omega / 200)
    x = simulate(model, scene, *values(BARE, stretch=stretch, stretch_damping=damping))
    found, gamma = damped_wave(times, (x[:, :, 0] - uv[:, 0]) @ np.cos(wave * uv[:, 0]), omega)
    assert found == pytest.approx(omega, rel=0.002)
    assert gamma == pytest.approx(damping * found**2 / (2 * stretch), rel=1e-3)


def test_a_sheet_held_at_both_sides_rings_in_shear_and_its_shear_damper_stops_it():
    """ω = (π/W) √(k_shear/ρ), γ = k_d ω²/(2 k_shear)."""
    shear, across = 50.0, 9
    omega = np.pi / 0.1 * np.sqrt(shear / DENSITY)
    damping, period = 0.1 * shear / omega, 2 * np.pi / omega
    times = np.concatenate([[0.0], np.linspace(3.5 * period, 8 * period, 160)])
    scene = between_columns(across, shear, times, lambda t: 1e-3 * np.exp(-(((t / period - 1.5) / 0.35) ** 2)))
    theta = values(BARE, stretch=3000.0, shear=shear, shear_damping=damping)
    z = simulate(BaraffWitkin(dt=period / 400), scene, *theta)[1:, :, 2]
    found, gamma = damped_wave(times[1:], z @ np.sin(np.pi * scene.points[:, 0] / 0.1), omega)
    assert found == pytest.approx(omega, rel=0.01)
    assert gamma == pytest.approx(damping * found**2 / (2 * shear), rel=0.015)


@pytest.mark.parametrize("slope", [0.0, 0.6, np.pi / 2])
@pytest.mark.parametrize(("across", "along", "decline"), [(0.5, 0.4, 0.1), (0.3, 0.8, 0.0)])
def test_a_falling_sheet_reaches_the_speed_of_the_drag_formula(slope, across, along, decline):
    """ρ g cos α = k_N v_N²/(1 + k_f v_N²) across the sheet and ρ g sin α = k_T v_T along it (Bhat et al., eq. 4)."""
    scene = falling(np.array([0.0, 4.0, 4.5]), slope)
    theta = values(CLOTH, quadratic_drag=across, linear_drag=along, drag_decline=decline)
    x = simulate(BaraffWitkin(), scene, *theta)
    speed = (x[1] - x[2]) / 0.5
    push, pull = 0.1 * G * np.cos(slope), 0.1 * G * np.sin(slope)
    normal = np.array([0.0, -np.sin(slope), np.cos(slope)])
    np.testing.assert_allclose(speed @ normal, np.sqrt(push / (across - decline * push)), rtol=1e-4, atol=1e-6)
    inside = np.array([0.0, np.cos(slope), np.sin(slope)])
    np.testing.assert_allclose(speed @ inside, pull / along, rtol=1e-4, atol=1e-6)


# --- integrators ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("integrator", "ratio"), [("bdf2", 4), ("implicit_euler", 2)])
def test_the_order_of_the_implicit_schemes(integrator, ratio):
    """Against Runge–Kutta steps with a tolerance of 10 nm, over two seconds of a swing of 10 cm."""
    scene, theta = aside(np.arange(0.0, 2.001, 0.02)), values(BARE, stretch=100.0, shear=50.0)
    truth = simulate(BaraffWitkin(integrator="rk45", tolerance=1e-8), scene, *theta)
    errors = []
    for dt in (2e-3, 1e-3, 5e-4):
        found = simulate(BaraffWitkin(integrator=integrator, dt=dt, tolerance=1e-8), scene, *theta)
        errors.append(np.sqrt(((found - truth) ** 2).mean()))
    assert errors[0] / errors[1] == pytest.approx(ratio, rel=0.08)
    assert errors[1] / errors[2] == pytest.approx(ratio, rel=0.06)
    assert errors[-1] < {"bdf2": 2e-6, "implicit_euler": 3e-4}[integrator]


def test_default_runge_kutta_steps_agree_with_default_bdf2_steps():
    scene, theta = aside(np.arange(0.0, 2.001, 0.02)), values(CLOTH)
    one, two = (simulate(BaraffWitkin(integrator=name), scene, *theta) for name in ("bdf2", "rk45"))
    assert np.ptp(one[:, -1, 1]) > 0.05
    assert np.sqrt(((one - two) ** 2).mean()) < 3e-5


@pytest.mark.parametrize(("integrator", "dt", "most"), [("bdf2", 2e-3, 5e-4), ("rk45", None, 5e-4)])
def test_a_swing_in_vacuum_goes_on(integrator, dt, most):
    omega, gamma = swing_wave(BaraffWitkin(integrator=integrator, dt=dt), values(BARE, stretch=1000.0))
    assert omega == pytest.approx(PENDULUM, rel=0.01)
    assert abs(gamma) < most


@pytest.mark.parametrize("dt", [1e-3, 4e-3])
def test_implicit_euler_overdamps_a_swing_in_vacuum(dt):
    """By γ = ω² dt/2: at 4 ms a sixth of the energy is gone in a second."""
    omega, gamma = swing_wave(BaraffWitkin(integrator="implicit_euler", dt=dt), values(BARE, stretch=1000.0))
    assert gamma == pytest.approx(omega**2 * dt / 2, rel=0.02)


@pytest.mark.parametrize("integrator", ["bdf2", "implicit_euler", "rk45"])
@pytest.mark.parametrize("scene", [lambda t: shaken(t, 13, 0.0), lambda t: slack(t, 9)], ids=["taut", "slack"])
def test_a_settled_sheet_stays_at_rest(integrator, scene):
    x = simulate(BaraffWitkin(integrator=integrator), scene(np.array([0.0, 0.01, 0.5])), *values(CLOTH))
    assert np.abs(x[1] - x[0]).max() / 0.01 < 1e-4  # m/s
    assert np.abs(x[2] - x[0]).max() < 1e-5


# --- batches, options, materials --------------------------------------------------------------------------------------


@pytest.mark.parametrize("integrator", ["bdf2", "implicit_euler", "rk45"])
def test_members_of_a_batch_come_out_as_one_by_one(integrator):
    simulation = BaraffWitkin(integrator=integrator).prepare(shaken(np.linspace(0, 0.3, 4), 7))
    theta = np.array([values(CLOTH), values(CLOTH, stretch=20.0, shear=5.0), values(CLOTH, bend=1e-4)])
    together = simulation.run(theta)
    for b in range(3):
        np.testing.assert_array_equal(together.position[b], simulation.run(theta[b : b + 1]).position[0])


def test_a_member_that_diverges_leaves_the_others_alone():
    scene = shaken(np.linspace(0.0, 1.5, 16), 9)
    simulation = BaraffWitkin(dt=8e-3).prepare(scene)
    soft, stiff = values(BARE, stretch=20.0, shear=5.0), values(BARE, stretch=2000.0, shear=500.0)
    theta = np.array([soft, stiff, values(CLOTH, stretch=20.0)])
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
        ({"integrator": "leapfrog"}, "integrator is 'leapfrog', expected one of implicit_euler, bdf2, rk45"),
        ({"integrator": ["bdf2"]}, "integrator is ['bdf2'], expected one of implicit_euler, bdf2, rk45"),
        ({"dt": True}, "dt is True, expected a number above 0"),
        ({"step_scale": None}, "step_scale is None, expected a number above 0 and at most 100"),
        ({"resolution": 2}, "resolution is 2, expected one or two whole numbers ≥ 3"),
        ({"dt": 0.0}, "dt is 0.0, expected a number above 0"),
        ({"step_scale": -1}, "step_scale is -1, expected a number above 0 and at most 100"),
        ({"tolerance": 0.5}, "tolerance is 0.5, expected a number above 0 and at most 0.1"),
    ],
)
def test_wrong_options_are_refused_in_one_line(options, complaint):
    with pytest.raises(ClothbenchError) as fault:
        BaraffWitkin(**options)
    assert str(fault.value) == f"baraff_witkin: {complaint}"


def test_a_material_gives_its_parameters_without_damping_or_air():
    theta = BaraffWitkin().of_material(Material(2e-5, 450.0, 100.0), shaken(np.array([0.0]), 5))
    np.testing.assert_array_equal(theta, values(dict.fromkeys(NAMES, 0.0), bend=2e-5, stretch=450.0, shear=100.0))
