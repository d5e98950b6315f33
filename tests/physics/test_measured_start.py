"""A run that begins with a motion goes on as the run did in which that motion was seen."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from clothbench.core.optional import why_skipped
from clothbench.core.scene import Scene, initial_velocity
from clothbench.modelling.grid import unstretched
from clothbench.plugins.discovery import catalogue
from clothbench.recordings.nodes import Recording
from clothbench.recordings.scenes import first_motion, scene_of

SIZE, SHAPE = (0.3, 0.4), (7, 9)
UV = np.stack(np.meshgrid(*(np.linspace(0.0, s, n) for s, n in zip(SIZE, SHAPE, strict=True))), axis=-1).reshape(-1, 2)
MODELS = [
    (name, options)
    for name in ("mass_spring", "mass_spring_verlet", "baraff_witkin", "inextensible")
    for options in ({},)
] + [("baraff_witkin", {"integrator": "rk45"}), ("mass_spring", {"precision": "single"})]  # fmt: skip
MODELS += [("mujoco", {}), ("newton", {})]


def swung(times: np.ndarray) -> Scene:
    """A sheet whose upper corners swing across it, from rest at t = 0."""
    stamps = np.linspace(0.0, 1.2, 121)
    across = 0.03 * np.sin(2 * np.pi * stamps) * np.clip(stamps / 0.2, 0, 1)
    corners = np.array([[0.0, 0.0], [SIZE[0], 0.0]])
    place = np.tile([[-0.145, 0.0, 1.0], [0.145, 0.0, 1.0]], (121, 1, 1))
    place[..., 1] += across[:, None]
    bent = np.stack([UV[:, 0] - 0.15, 0.02 * np.sin(np.pi * UV[:, 0] / 0.3), 1.0 - UV[:, 1]], axis=1)
    return Scene(*SIZE, 0.2, stamps, corners, place, times, UV, resolution=SHAPE, start=bent)


@pytest.mark.parametrize(("name", "options"), MODELS, ids=lambda case: str(case))
def test_before_it_was_seen_a_sheet_came_from_where_it_flies_to(name, options):
    """What a clock that runs behind looks at is earlier than the first stamp, from which the run goes on."""
    if name in ("mujoco", "newton"):
        pytest.importorskip(name)
    model, late = catalogue().make("models", name, **options), catalogue().make("effects", "clock_offset")
    times, flying = np.array([0.0, 0.02, 0.04, 0.06]), np.tile([0.0, 1.0, 0.0], (len(UV), 1))
    start = np.stack([UV[:, 0], 0 * UV[:, 0], -UV[:, 1]], axis=1)
    free = Scene(
        *SIZE, 0.2, np.array([0.0, 1.0]), np.zeros((0, 2)), np.zeros((2, 0, 3)), times, UV, (0.0, 0.0, 0.0),
        resolution=SHAPE, start=start, velocity=flying, air_density=0.0,
    )  # fmt: skip
    simulation = model.prepare(free, (late,))
    theta = simulation.parameters.defaults.copy()
    theta[[k for k, one in enumerate(simulation.parameters.names) if "drag" in one or "air" in one]] = 0.0
    theta[-1] = 0.04
    seen = simulation.run(theta).position[0, :, :, 1].mean(axis=1)
    assert seen == pytest.approx(times - 0.04, abs=2e-3)


@pytest.mark.parametrize(("name", "options"), MODELS, ids=lambda case: str(case))
def test_a_run_goes_on_where_it_was_cut(name, options):
    if name in ("mujoco", "newton"):
        pytest.importorskip(name)
    model, begin, step = catalogue().make("models", name, **options), 0.5, 1e-3
    later = np.linspace(begin, begin + 0.12, 7)
    whole = model.prepare(swung(np.concatenate([[begin - step, begin, begin + step], later[1:]])))
    seen = whole.run(whole.parameters.defaults[None]).position[0]
    velocity = (seen[2] - seen[0]) / (2 * step)
    cut = dataclasses.replace(swung(later), start=seen[1], velocity=velocity)
    assert cut.start_time == begin
    on = model.prepare(cut)
    rollout = on.run(on.parameters.defaults[None])
    assert rollout.status == ("ok",)
    moved = np.linalg.norm(seen[3:] - seen[1], axis=-1).max()
    away = np.linalg.norm(rollout.position[0, 1:] - seen[3:], axis=-1)
    assert moved > 0.02
    assert np.sqrt((away**2).mean()) < 0.12 * moved  # the cubic that stands for the velocities leaves a little out
    stopped = model.prepare(dataclasses.replace(cut, velocity=np.zeros_like(velocity)))
    halted = stopped.run(stopped.parameters.defaults[None]).position[0, 1:]
    assert np.sqrt((np.linalg.norm(halted - seen[3:], axis=-1) ** 2).mean()) > 1.5 * np.sqrt((away**2).mean())


@pytest.mark.parametrize("name", ["mass_spring", "baraff_witkin", "inextensible"])
def test_grips_that_an_effect_holds_elsewhere_take_the_measured_shape_along(name):
    """Nothing is torn in the first step: every mesh line begins with its length."""
    model, offset = catalogue().make("models", name), catalogue().make("effects", "grip_offset")
    scene = swung(np.array([0.0, 1e-3]))
    scene = dataclasses.replace(scene, velocity=np.zeros_like(scene.start))
    shifts, theta = np.array([[0.0, 0.02, 0.0], [0.01, -0.03, 0.005], [0.0, 0.0, 0.0]]), model.parameters.defaults
    found = model.prepare(scene, (offset,)).run(np.array([[*theta, *shift] for shift in shifts]))
    for shift, (begin, after) in zip(shifts, found.position, strict=True):
        nodes = begin.reshape(*SHAPE[::-1], 3)
        np.testing.assert_allclose(nodes[0, [0, -1]], scene.grip_position[0] + shift, atol=1e-12)
        for axis, step in ((1, SIZE[0] / 6), (0, SIZE[1] / 8)):
            assert np.abs(np.linalg.norm(np.diff(nodes, axis=axis), axis=-1) / step - 1).max() < 0.02
        assert np.linalg.norm(after - begin, axis=1).max() < 2e-4
    bare = model.prepare(scene).run(theta[None])
    np.testing.assert_array_equal(found.position[2], bare.position[0])


def test_models_that_know_rest_only_are_skipped():
    scene = dataclasses.replace(swung(np.array([0.0, 0.1])), velocity=np.zeros((len(UV), 3)))
    model = type("Still", (), {"capabilities": frozenset({"dynamic"})})()
    assert "starts from rest only" in (why_skipped(model, scene) or "")
    assert why_skipped(catalogue().make("models", "mass_spring"), scene) is None


def test_noise_of_a_measured_shape_is_not_let_loose_as_stretch():
    random = np.random.default_rng(2)
    true = np.stack([UV[:, 0] - 0.15, 0.1 * np.cos(UV[:, 1]), 1.0 - UV[:, 1]], axis=1)
    lines = tuple(np.linspace(0.0, s, n) for s, n in zip(SIZE, SHAPE, strict=True))
    held = np.array([0, 6])
    shape = unstretched(true + random.normal(0.0, 4e-3, true.shape), lines, held, true[held])
    nodes = shape.reshape(*SHAPE[::-1], 3)
    assert np.array_equal(shape[held], true[held])
    for axis, step in ((1, SIZE[0] / 6), (0, SIZE[1] / 8)):
        assert np.abs(np.linalg.norm(np.diff(nodes, axis=axis), axis=-1) / step - 1).max() < 0.01
    assert np.sqrt(((shape - true) ** 2).sum(axis=1).mean()) < 7e-3  # no farther away than the noise


def test_the_first_motion_of_a_recording_is_that_of_a_parabola_through_its_first_frames():
    time = np.arange(12) / 20.0
    velocity, bend = np.array([0.3, -0.1, 0.2]), np.array([0.5, 1.0, -2.0])
    place = np.stack([UV[:, 0], 0 * UV[:, 0], 1.0 - UV[:, 1]], axis=1)
    position = place + time[:, None, None] * velocity + (time**2)[:, None, None] * bend
    position[:4, 3] = np.nan
    corners = np.array([[0.0, 0.0], [SIZE[0], 0.0]])
    recording = Recording(
        name="thrown", time=time, material=UV, position=position, grip_time=time, grip_material=corners,
        grip_position=position[:, [0, 6]], cloth_width=SIZE[0], cloth_height=SIZE[1], areal_density=0.2,
    )  # fmt: skip
    scene = scene_of(recording, start="measured")
    known = np.arange(len(UV)) != 3
    assert scene.velocity is not None
    assert scene.start is not None
    assert np.allclose(scene.velocity[known], velocity, atol=1e-9)
    assert np.allclose(scene.start[known], position[0, known], atol=1e-9)
    assert np.isnan(scene.start[3]).all()
    assert np.allclose(initial_velocity(scene, UV), velocity, atol=1e-9)
    assert scene_of(recording).velocity is None


def test_a_first_motion_is_not_drawn_far_beyond_what_was_seen_of_it():
    """A sheet at rest, filmed fast, with noise of 1 mm: a node is seen at the end of the first 0.2 s only."""
    time, corners = np.arange(30) / 100.0, np.array([[0.0, 0.0], [SIZE[0], 0.0]])
    still = np.stack([UV[:, 0], 0 * UV[:, 0], 1.0 - UV[:, 1]], axis=1)
    position = still + np.random.default_rng(1).normal(0.0, 1e-3, (30, *still.shape))
    position[:16, 3] = np.nan
    recording = Recording(
        name="still", time=time, material=UV, position=position, grip_time=time, grip_material=corners,
        grip_position=np.tile(still[[0, 6]], (30, 1, 1)), cloth_width=SIZE[0], cloth_height=SIZE[1], areal_density=0.2,
    )  # fmt: skip
    place, velocity = first_motion(recording)
    assert np.isnan(place[3]).all()
    assert np.nanmax(np.linalg.norm(place - still, axis=1)) < 5e-3
    assert np.nanmax(np.linalg.norm(velocity, axis=1)) < 0.15
