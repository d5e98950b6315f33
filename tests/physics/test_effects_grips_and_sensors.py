"""Effects of the grips and of the sensor: geometry that is exact, and filters that have a solution on paper."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from effect_scenes import STIFF, cloth, effect_named, hanging, on_every_model, run
from scipy.integrate import solve_ivp

from clothbench import Camera, ClothbenchError, Scene
from clothbench.core.scene import minimum_jerk
from clothbench.plugins.discovery import catalogue
from clothbench.testing import scenes

TIME = np.cumsum(np.array([0.0, 0.01, 0.03, 0.005, 0.02, 0.04, 0.01, 0.02, 0.015, 0.05]))


def grips(name, values, time, position):
    return effect_named(name).grips(time, position, np.array(values, dtype=float))


def seen(name, values, time, position, points=None):
    points = np.zeros((position.shape[1], 2)) if points is None else points
    return effect_named(name).positions(time, position, points, np.array(values, dtype=float))


@pytest.fixture
def clamp():
    """Four grips of a clamp, two by two, that moves: (10, 4, 3) m."""
    held = np.array([[0.1, 0.0, 1.0], [0.3, 0.0, 1.0], [0.1, 0.02, 0.99], [0.3, 0.02, 1.01]])
    path = np.stack([0.1 * TIME, 0.3 * TIME**2, 0.0 * TIME], axis=1)
    return held[None, [0, 2, 3, 1]] + path[:, None]


@pytest.mark.parametrize(
    ("name", "method", "change", "said"),
    [
        ("clock_offset", "times", lambda out: out + np.nan, r"'times' gave ndarray of shape \(\d+,\), expected finite"),
        ("clock_offset", "times", lambda out: out[:-1], r"'times' gave ndarray of shape .* numbers of shape \(\d+,\)"),
        ("clock_offset", "times", lambda out: None, "'times' gave NoneType"),
        (
            "clock_offset",
            "times",
            lambda out: out[::-1].copy(),
            "'times' gave .* s and then .* s, expected times in the",
        ),
        ("frame_scale", "positions", lambda out: out + np.nan, "'positions' gave ndarray of shape .*, expected finite"),
        ("frame_scale", "positions", lambda out: out[..., 0], r"'positions' gave .* numbers of shape \(\d+, \d+, 3\)"),
        ("grip_offset", "grips", lambda out: out[:, :1], r"'grips' gave ndarray of shape \(\d+, 1, 3\), expected"),
    ],
)
def test_what_moves_grips_or_times_to_nowhere_is_refused_before_a_compiled_loop_waits_for_it(
    name, method, change, said
):
    effect = effect_named(name)
    usual = getattr(effect, method)
    setattr(effect, method, lambda *about: change(usual(*about)))
    simulation = catalogue().make("models", "mass_spring").prepare(scenes.swinging(), [effect])
    with pytest.raises(ClothbenchError, match=f"effect '{name}': {said}"):
        simulation.run(simulation.parameters.defaults[None])


# --- grips ------------------------------------------------------------------------------------------------------------


def test_offset_shifts_all_grips(clamp):
    np.testing.assert_allclose(
        grips("grip_offset", [0.01, -0.02, 0.03], TIME, clamp) - clamp,
        np.broadcast_to([0.01, -0.02, 0.03], clamp.shape), atol=1e-15,
    )  # fmt: skip


def test_rotation_about_the_vertical_keeps_centroid_height_and_distances(clamp):
    turned = grips("grip_rotation", [0.2, 0.0], TIME, clamp)
    np.testing.assert_allclose(turned.mean(axis=1), clamp.mean(axis=1), atol=1e-15)
    np.testing.assert_allclose(turned[..., 2], clamp[..., 2], atol=1e-15)
    before, after = clamp[0, 3] - clamp[0, 0], turned[0, 3] - turned[0, 0]
    assert np.arctan2(*after[[1, 0]]) - np.arctan2(*before[[1, 0]]) == pytest.approx(0.2)


def test_rotation_about_the_line_keeps_its_ends(clamp):
    turned = grips("grip_rotation", [0.0, np.pi / 2], TIME, clamp)
    np.testing.assert_allclose(turned[:, [0, 3]], clamp[:, [0, 3]], atol=1e-15)
    away = turned[0, 1] - turned[0, 0]  # was (0, 0.02, −0.01): a quarter turn about x brings y to z
    np.testing.assert_allclose(away, [0.0, 0.01, 0.02], atol=1e-12)


def test_slip_lowers_the_grips_smoothly_from_its_time_on():
    time = np.linspace(0.0, 1.0, 401)
    at = np.zeros((401, 2, 3))
    fallen = grips("grip_slip", [0.01, 0.5], time, at)
    assert (fallen[time <= 0.5] == 0).all()
    np.testing.assert_allclose(fallen[time >= 0.5501], np.broadcast_to([0, 0, -0.01], fallen[time >= 0.5501].shape))
    assert (np.diff(fallen[:, 0, 2]) <= 0).all()
    late = 128.0 + np.arange(401) / 512  # a clock that began long before; powers of two, which leave no rounding
    soon = late - 128.0
    np.testing.assert_array_equal(*(grips("grip_slip", [0.01, 0.5], clock, at) for clock in (late, soon)))


@pytest.mark.parametrize("damping", [0.1, 1.0, 1.7])
def test_compliant_grips_follow_like_a_damped_oscillator(clamp, damping):
    found = grips("grip_compliance", [0.06, damping], TIME, clamp)
    omega = 2 * np.pi / 0.06
    for c in range(3):
        path = clamp[:, 1, c]

        def fall(t, y, path=path):
            return [y[1], -2 * damping * omega * y[1] - omega**2 * (y[0] - np.interp(t, TIME, path))]

        exact = solve_ivp(fall, (0, TIME[-1]), [path[0], 0.0], t_eval=TIME, rtol=1e-9, atol=1e-12, max_step=1e-3)
        np.testing.assert_allclose(found[:, 1, c], exact.y[0], atol=1e-7)


def test_a_stiff_mount_is_none(clamp):
    found = grips("grip_compliance", [1e-6, 0.5], TIME, clamp)
    np.testing.assert_allclose(found, clamp, atol=1e-6)


@on_every_model
def test_what_lies_on_a_grip_goes_where_the_effect_puts_it(name):
    scene = hanging(0.1, 0.2, np.array([0.0, 0.1]), [(0.0, 0.0), (0.1, 0.0)], (3, 5))
    theta = cloth(name, scene, STIFF)[0]
    bare, shifted = run(name, scene, theta), run(name, scene, theta, ("grip_offset", [0.01, 0.02, -0.03]))
    np.testing.assert_allclose(shifted - bare, np.broadcast_to([0.01, 0.02, -0.03], bare.shape), atol=1e-12)


@on_every_model
def test_what_only_the_sensor_tells_apart_is_seen_as_if_run_alone(name):
    """Members that move alike are run once; those that are looked at at other times, or move otherwise, are not."""
    swung = np.array([0.0, 0.1]), [(0.0, 0.2), (0.1, 0.1)], (3, 5)
    scene = hanging(0.1, 0.2, *swung, moved=lambda t: np.stack([0.1 * t, 0 * t, 0 * t], axis=1))
    theta = cloth(name, scene, STIFF)[0]
    sensors = [("frame_scale", 1.0), ("clock_offset", 0.0), ("frame_scale", 1.05), ("frame_scale", 0.95)]
    rows = np.tile(np.concatenate([theta, [1.0], [0.0]]), (5, 1))
    for row, (effect, value) in zip(rows, sensors, strict=False):
        row[len(theta) + (effect == "clock_offset")] = value
    rows[3, len(theta) + 1] = 0.03
    rows[4, 0] *= 0.9
    model = catalogue().make("models", name)
    simulation = model.prepare(scene, [effect_named("frame_scale"), effect_named("clock_offset")])
    together = simulation.run(rows)
    for k, row in enumerate(rows):
        alone = simulation.run(row[None])
        np.testing.assert_array_equal(together.position[k], alone.position[0])
        assert together.steps[k] <= alone.steps[0]  # a rest that was found for another counts for that one
    assert len({together.position[k].tobytes() for k in (0, 2, 3, 4)}) == 4


@on_every_model
def test_a_patch_moves_with_its_grip(name):
    """Cloth inside the patch keeps its place beside a grip that is jerked; without the patch it lags."""
    times = np.linspace(0.0, 0.4, 41)

    def jerk(t):
        s = np.clip(t / 0.2, 0, 1)
        return np.stack([0 * t, 0.05 * s**3 * (10 - 15 * s + 6 * s**2), 0 * t], axis=1)

    inside, outside = (0.05, 0.02), (0.05, 0.1)
    scene = hanging(0.1, 0.2, times, [(0.05, 0.0), inside, outside], (5, 11), moved=jerk)
    theta = cloth(name, scene, STIFF)[0]

    def stray(*pairs):
        beside = run(name, scene, theta, *pairs)
        beside = beside - beside[:, :1]
        return np.abs(beside - beside[0]).max(axis=(0, 2))[1:]

    free, held = stray(), stray(("grip_patch", [0.06]))
    assert held[0] < min(1.5e-3, 0.25 * free[0])
    assert held[1] > 0.01  # what is below still swings


def test_how_stiff_a_patch_is_does_not_depend_on_the_step():
    """A strip held out by one edge hangs in the same shape, and stays there; a step above 5 ms makes it softer only."""
    width, height, times = 0.2, 0.05, np.array([0.0, 0.1, 0.2])
    held = np.array([[0.0, v] for v in np.linspace(0, height, 6)])
    at = np.column_stack([held, np.ones(6)])
    points = np.array([[u, v] for v in (0.0, height) for u in np.linspace(0, width, 9)])
    scene = Scene(width, height, 0.12, np.array([0.0, 0.2]), held, np.stack([at, at]), times, points,
                  resolution=(21, 6), start=np.column_stack([points, np.ones(18)]))  # fmt: skip

    def hung(**options):
        model = catalogue().make("models", "baraff_witkin", **options)
        theta = [1e-4, 200.0, 50.0, 1e-6, 0.02, 0.02, 0.0, 0.0, 0.0, 0.04]
        rollout = model.prepare(scene, [effect_named("grip_patch")]).run(np.array([theta]))
        assert rollout.status == ("ok",)
        np.testing.assert_allclose(rollout.position[0, 1:], rollout.position[0, :2], atol=2e-5)
        return rollout.position[0, -1]

    fine = hung(dt=5e-4)
    for options in ({"dt": 2e-3}, {"integrator": "implicit_euler"}, {"integrator": "rk45"}):
        np.testing.assert_allclose(hung(**options), fine, atol=2e-5)
    assert 0.0 < np.abs(hung(dt=8e-3) - fine).max() < 0.02


@pytest.mark.parametrize("name", ["mass_spring", "mass_spring_verlet"])
def test_explicit_steps_are_as_short_as_a_patch_asks_for(name):
    """A heavy sheet of soft springs is stable in all of the patch's bounds; what takes short steps keeps them."""
    held, times = np.array([[0.0, 0.0], [0.3, 0.0]]), np.linspace(0.0, 1.0, 101)
    aside = 0.05 * np.sin(9 * times)[:, None, None] * minimum_jerk(times / 0.3)[:, None, None] * [0.0, 1.0, 0.0]
    at = np.column_stack([held[:, 0], np.zeros(2), np.zeros(2)]) + aside
    scene = Scene(0.3, 0.3, 1.0, times, held, at, np.array([0.0, 1.0]), held, resolution=(9, 9))
    model, patch = catalogue().make("models", name), effect_named("grip_patch")
    simulation, default = model.prepare(scene, [patch]), model.parameters.defaults
    soft = model.parameters.low
    soft[2 if name == "mass_spring" else 12] = 0.01 if name == "mass_spring" else 1.0
    stiff = default * np.where(np.array([p.unit for p in model.parameters]) == "N/m", 4.0, 1.0)
    sizes = [0.0, patch.parameters.defaults[0], patch.parameters.high[0]]
    rows = [np.append(base, size) for base in (soft, stiff) for size in sizes]
    rollout = simulation.run(np.array(rows))
    assert set(rollout.status) == {"ok"}
    assert rollout.steps[1] > 1.2 * rollout.steps[0]
    assert rollout.steps[4] == pytest.approx(rollout.steps[3], rel=0.1)


# --- sensor -----------------------------------------------------------------------------------------------------------


@pytest.fixture
def cloud():
    return np.random.default_rng(8).normal(size=(10, 6, 3))


def test_frame_effects_are_a_similarity_about_the_centroid(cloud):
    middle = cloud.mean(axis=(0, 1))
    turned = seen("frame_rotation", [0.0, 0.0, 0.1], TIME, cloud) - middle
    about_z = np.array([[np.cos(0.1), -np.sin(0.1), 0], [np.sin(0.1), np.cos(0.1), 0], [0, 0, 1]])
    np.testing.assert_allclose(turned, (cloud - middle) @ about_z.T, atol=1e-14)
    np.testing.assert_allclose(seen("frame_scale", [1.02], TIME, cloud) - middle, 1.02 * (cloud - middle), atol=1e-14)
    shift = [0.01, 0.02, -0.03]
    np.testing.assert_allclose(seen("frame_translation", shift, TIME, cloud), cloud + np.array(shift), atol=1e-15)


def test_rotation_vectors_have_no_order(cloud):
    there = seen("frame_rotation", [0.1, -0.05, 0.15], TIME, cloud)
    back = seen("frame_rotation", [-0.1, 0.05, -0.15], TIME, there)
    np.testing.assert_allclose(back, cloud, atol=1e-14)


def test_a_lost_member_does_not_spoil_the_centroid(cloud):
    lost = cloud.copy()
    lost[7:] = np.nan
    found = seen("frame_scale", [1.02], TIME, lost)
    np.testing.assert_allclose(found[:7], seen("frame_scale", [1.02], TIME[:7], cloud[:7]), atol=1e-15)


def test_lowpass_answers_a_ramp_and_a_pause_exactly():
    """τ ẏ = x − y: y = t − τ (1 − exp(−t/τ)) on a ramp, then it catches up by exp(−t/τ); on uneven stamps."""
    ramp = np.minimum(TIME, 0.065)
    assert 0.065 in np.round(TIME, 12)
    found = seen("tracker_lowpass", [0.03], TIME, np.broadcast_to(ramp[:, None, None], (10, 1, 3)))[:, 0, 0]
    rising = TIME - 0.03 * (1 - np.exp(-TIME / 0.03))
    behind = 0.03 * (1 - np.exp(-0.065 / 0.03))
    expected = np.where(TIME <= 0.0651, rising, 0.065 - behind * np.exp(-(TIME - 0.065) / 0.03))
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_markers_stand_off_a_plane_and_a_cylinder():
    points = np.stack([a.ravel() for a in np.meshgrid(np.linspace(0, 0.2, 9), np.linspace(0, 0.1, 5))], axis=1)
    u, v = points.T
    flat = np.stack([u, 0 * u, -v], axis=1)[None]  # u × v is +y
    found = seen("marker_standoff", [0.007], TIME[:1], flat, points)
    np.testing.assert_allclose(found - flat, np.broadcast_to([0.0, 0.007, 0.0], flat.shape), atol=1e-12)
    radius = 0.2
    round_ = np.stack([radius * np.sin(u / radius), radius * np.cos(u / radius), -v], axis=1)[None]
    out = seen("marker_standoff", [0.007], TIME[:1], round_, points)[0]
    inner = (u > 0.01) & (u < 0.19)
    np.testing.assert_allclose(np.hypot(out[inner, 0], out[inner, 1]), radius + 0.007, atol=2e-5)


def test_markers_in_one_line_have_no_normal():
    points = np.stack([np.linspace(0, 1, 5), np.zeros(5)], axis=1)
    line = np.random.default_rng(1).normal(size=(2, 5, 3))
    np.testing.assert_array_equal(seen("marker_standoff", [0.01], TIME[:2], line, points), line)


# --- the camera -------------------------------------------------------------------------------------------------------

VIEW = Camera.looking_at(np.array([0.0, -1.0, 0.0]), np.zeros(3), (640, 480), 0.8)


def sighted(name, value, position):
    return effect_named(name).sights(TIME, position, VIEW, np.array([value]))


def test_a_lens_bends_the_picture_as_opencv_does(cloud):
    bent = Camera(VIEW.size, VIEW.matrix, VIEW.rotation, VIEW.translation, np.array([-0.2, 0, 0, 0, 0]))
    found, wanted = VIEW.project(sighted("lens_distortion", -0.2, cloud))[0], bent.project(cloud)[0]
    seen = np.isfinite(wanted)  # no camera sees what its lens would fold back from far off the axis
    assert seen.mean() > 0.4
    np.testing.assert_allclose(found[seen], wanted[seen], atol=1e-9)


def test_a_slow_video_shows_later_moments():
    """After the last stamp, too, up to which the loop then has to run; what was not seen in pictures is left alone."""
    effect, model = effect_named("frame_rate"), catalogue().make("models", "mass_spring")
    stamps, ratio = np.linspace(0.0, 0.3, 7), 1.15
    np.testing.assert_array_equal(effect.times(stamps, np.array([1.0])), stamps)
    scene = scenes.with_times(scenes.swinging(), stamps)
    theta = model.parameters.defaults
    slow = model.prepare(scene, (effect,)).run(np.array([[*theta, ratio]])).position
    later = model.prepare(scenes.with_times(scene, ratio * stamps)).run(theta[None]).position
    np.testing.assert_allclose(slow, later, atol=1e-12)
    in_space = dataclasses.replace(scene, camera=None)
    stamped = model.prepare(in_space, (effect,)).run(np.array([[*theta, ratio]])).position
    np.testing.assert_array_equal(stamped, model.prepare(in_space).run(theta[None]).position)


def test_a_rolling_shutter_reads_lower_rows_later():
    speed = np.array([0.3, 0.0, 0.0])
    start = np.array([[0.0, 0.0, 0.2], [0.0, 0.0, 0.0], [0.0, 0.0, -0.2]])
    position = start + TIME[:, None, None] * speed
    found = sighted("rolling_shutter", 0.02, position)
    rows = VIEW.project(position)[0][..., 1]
    late = 0.02 * (rows / 480 - 0.5)
    np.testing.assert_allclose(found - position, late[..., None] * speed, atol=1e-12)
