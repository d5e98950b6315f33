"""Scenes: what a recording becomes, how grips are interpolated, and where a model starts from."""

import dataclasses

import numpy as np
import pytest
from conftest import swinging_recording

from clothbench import ClothbenchError, Obstacle, Scene
from clothbench.core.scene import initial_shape
from clothbench.recordings.scenes import scene_of


def test_unknown_density_must_be_stated():
    unknown = swinging_recording(areal_density=float("nan"))
    with pytest.raises(ClothbenchError, match=r"scene.areal_density=VALUE \[kg/m²\]"):
        scene_of(unknown)
    assert scene_of(unknown, areal_density=0.3).areal_density == 0.3
    assert scene_of(swinging_recording(), areal_density=0.3).areal_density == 0.2


def test_grips_pass_through_their_stamps_and_rest_outside(recording):
    scene = scene_of(recording)
    np.testing.assert_allclose(scene.grips_at(recording.grip_time), recording.grip_position, atol=1e-12)
    outside = scene.grips_at(np.array([-1.0, 9.0]))
    np.testing.assert_allclose(outside, recording.grip_position[[0, -1]], atol=1e-12)


def test_grips_follow_a_smooth_motion_between_slow_irregular_stamps():
    stamps = np.sort(np.random.default_rng(3).uniform(0, 2, 40))
    path = np.stack([np.sin(3 * stamps), np.cos(2 * stamps), stamps * 0], axis=1)[:, None]
    scene = Scene(0.2, 0.2, 0.2, stamps, np.zeros((1, 2)), path, np.linspace(0, 2, 9), np.zeros((1, 2)))
    between = (stamps[1:] + stamps[:-1]) / 2
    expected = np.stack([np.sin(3 * between), np.cos(2 * between), between * 0], axis=1)[:, None]
    assert np.abs(scene.grips_at(between) - expected).max() < 0.01


def test_the_first_guess_hangs_from_the_grips_and_bends_to_what_was_seen():
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(0, 0.2, 5), np.linspace(0, 0.2, 5)))
    uv = np.stack([u, v], axis=1)
    held = np.array([[0.0, 0.0], [0.2, 0.0]])
    at = np.array([[0.0, 0.0, 1.0], [0.0, 0.2, 1.0]])  # the warp points along y
    seen = np.stack([0.05 * np.sin(np.pi * v / 0.4), u, 1 - v], axis=1)
    scene = Scene(0.2, 0.2, 0.2, np.array([0.0, 1.0]), held, np.stack([at, at]), np.array([0.0]), uv)
    flat = initial_shape(scene, uv)
    np.testing.assert_allclose(flat, np.stack([0 * u, u, 1 - v], axis=1), atol=1e-12)
    bent = Scene(0.2, 0.2, 0.2, np.array([0.0, 1.0]), held, np.stack([at, at]), np.array([0.0]), uv, start=seen)
    assert np.abs(initial_shape(bent, uv) - seen).max() < 2e-3


@pytest.mark.parametrize(("across", "down", "rows"), [(9, 3, 1), (121, 3, 3)])
def test_points_on_a_line_are_no_fault_of_the_first_guess(across, down, rows):
    """All that were seen, or all that are nearest to one another on a narrow lattice."""
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(0, 0.2, across), np.linspace(0, 0.2, down)))
    uv, held = np.stack([u, v], axis=1), np.array([[0.0, 0.0], [0.2, 0.0]])
    at = np.array([[0.0, 0.0, 1.0], [0.2, 0.0, 1.0]])
    shape = np.stack([u, 0.05 * v, 1 - v], axis=1)
    seen = np.where((np.arange(len(u)) < rows * across)[:, None], shape, np.nan)
    scene = Scene(0.2, 0.2, 0.2, np.array([0.0, 1.0]), held, np.stack([at, at]), np.array([0.0]), uv, start=seen)
    found = initial_shape(scene, uv)
    np.testing.assert_allclose(found, shape if rows == down else np.stack([u, 0 * u, 1 - v], axis=1), atol=1e-3)


CUT = np.array([[0, 0], [0.2, 0], [0.2, 0.1], [0.1, 0.1], [0.1, 0.2], [0, 0.2]])  # without the corner (0.2, 0.2)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"width": 0.0}, "width is 0.0, expected a number above 0"),
        ({"width": "wide"}, "width is 'wide', expected a number above 0"),
        ({"areal_density": float("nan")}, "areal_density is nan"),
        ({"areal_density": None}, "areal_density is None"),
        ({"air_density": float("nan")}, "air_density is nan, expected a finite number, 0 or above"),
        ({"thickness": -1.0}, "thickness is -1.0"),
        ({"gravity": (0.0, -9.81)}, "gravity is .* expected three finite numbers"),
        ({"gravity": (0.0, 0.0, float("nan"))}, "gravity is .* expected three finite numbers"),
        ({"times": np.array([0.0, 0.0])}, "times must be a strictly increasing list"),
        ({"times": np.array([0.0, np.nan])}, "times holds a stamp that is not finite"),
        ({"times": "now"}, "times is a str, expected an array of numbers"),
        ({"resolution": (2, 5)}, "resolution is .* at least 3 nodes each way"),
        ({"resolution": (9.5, 9)}, "resolution is .* at least 3 nodes each way"),
        ({"resolution": "ab"}, "resolution is 'ab', expected at least 3 nodes each way"),
        ({"points": np.zeros((0, 2))}, "points are none"),
        ({"points": np.array([[0.0, np.nan]])}, "points holds a value that is not finite"),
        ({"start": np.zeros((3, 3))}, r"start has shape \(3, 3\), expected \(1, 3\)"),
        ({"velocity": np.zeros((1, 2))}, r"velocity has shape \(1, 2\), expected \(1, 3\)"),
        ({"grip_time": np.array([1.0, 0.0])}, "grip_time must be a strictly increasing list"),
        ({"grip_time": np.zeros(1), "grip_position": np.zeros((1, 1, 3))}, r"grip_time has shape \(1,\)"),
        ({"grip_position": np.zeros((2, 2, 3))}, r"grip_position has shape \(2, 2, 3\), expected \(2, 1, 3\)"),
        ({"grip_position": np.full((2, 1, 3), np.nan)}, "grip_position holds a value that is not finite"),
        ({"grip_material": np.array([[0.5, 0.0]])}, r"grip_material 0 is at \(0.5, 0\) m, expected it on the sheet"),
        ({"grip_material": np.array([[0.2, 0.2]]), "outline": CUT}, r"grip_material 0 is at .* m, off the outline"),
        ({"obstacles": ({"shape": "plane"},)}, "obstacles hold a dict"),
    ],
)  # fmt: skip
def test_impossible_scenes_are_refused(change, says):
    good = {
        "width": 0.2, "height": 0.2, "areal_density": 0.2, "grip_time": np.array([0.0, 1.0]),
        "grip_material": np.zeros((1, 2)), "grip_position": np.zeros((2, 1, 3)), "times": np.array([0.0, 1.0]),
        "points": np.zeros((1, 2)),
    }  # fmt: skip
    Scene(**good)
    with pytest.raises(ClothbenchError, match=f"^scene: {says}"):
        Scene(**{**good, **change})


def test_clamps_may_stand_a_little_over_the_hem():
    time, points = np.array([0.0, 1.0]), np.zeros((1, 2))
    over = np.array([[0.103, 0.103], [-0.003, 0.0]])  # of the notch's corner, of the sheet's
    made = Scene(0.2, 0.2, 0.2, time, over, np.zeros((2, 2, 3)), time, points, outline=CUT)
    assert len(made.grip_material) == 2


def test_grips_that_carry_something_need_not_hold_cloth():
    time, points, off = np.array([0.0, 1.0]), np.zeros((1, 2)), np.array([[0.2, 0.2]])
    body = Obstacle("plane", carried=True)
    made = Scene(0.2, 0.2, 0.2, time, off, np.zeros((2, 1, 3)), time, points, outline=CUT, obstacles=(body,))
    assert len(made.grip_material) == 1


def test_slack_between_grips_bends_the_first_guess_into_an_arc():
    held = np.array([[0.0, 0.0], [0.3, 0.0]])
    at = np.array([[[0.05, 0.1, 1.0], [0.25, 0.1, 1.0]]] * 2)
    time, points = np.array([0.0, 1.0]), np.zeros((1, 2))
    scene = Scene(0.3, 0.2, 0.2, time, held, at, time, points)
    u = np.linspace(0, 0.3, 301)
    hung = initial_shape(scene, np.stack([u, 0.1 + 0 * u], axis=1))
    np.testing.assert_allclose(hung[[0, -1]], at[0] - [0, 0, 0.1], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(np.diff(hung, axis=0), axis=1), 1e-3, rtol=1e-4)
    assert hung[150, 1] > 0.15
    taut = dataclasses.replace(scene, grip_position=np.add(at, [[-0.05, 0, 0], [0.05, 0, 0]]))
    assert np.ptp(initial_shape(taut, np.stack([u, 0.1 + 0 * u], axis=1))[:, 1]) == 0


def held_at(material, position) -> Scene:
    """A sheet of 30 cm × 20 cm with points of it held, at rest; nobody saw how."""
    material, position = np.array(material, dtype=float), np.array(position, dtype=float)
    time = np.array([0.0, 1.0])
    return Scene(0.3, 0.2, 0.2, time, material, np.array([position] * 2), time, np.zeros((1, 2)))


@pytest.mark.parametrize(
    ("material", "position", "lowest"),
    [
        ([[0, 0]], [[0, 0, 0]], [0.3, 0.2]),
        ([[0.3, 0.2]], [[0, 0, 0]], [0, 0]),
        ([[0, 0], [0, 0.2]], [[0, 0, 0], [0.2, 0, 0]], [0.3, 0.1]),
        ([[0.3, 0], [0.3, 0.2]], [[0, 0, 0], [0, 0.2, 0]], [0, 0.1]),
        ([[0, 0.2], [0.3, 0.2]], [[0, 0, 0], [0.3, 0, 0]], [0.15, 0]),
        ([[0, 0], [0.3, 0.2]], [[0, 0, 0], [np.hypot(0.3, 0.2), 0, 0]], [0, 0.2]),
    ],
    ids=["corner", "other corner", "left side", "right side", "lower edge", "opposite corners"],
)  # fmt: skip
def test_a_sheet_nobody_saw_hangs_as_its_grips_hold_it(material, position, lowest):
    """Unstrained, on its grips, and with what is farthest from them at the bottom."""
    scene = held_at(material, position)
    u, v = (axis.ravel() for axis in np.meshgrid(np.linspace(0, 0.3, 13), np.linspace(0, 0.2, 9)))
    uv = np.stack([u, v], axis=1)
    hung = initial_shape(scene, uv)
    on_grips = initial_shape(scene, scene.grip_material)
    np.testing.assert_allclose(on_grips, scene.grip_position[0], atol=1e-9)
    flat = np.linalg.norm(uv[:, None] - uv[None], axis=2)
    np.testing.assert_allclose(np.linalg.norm(hung[:, None] - hung[None], axis=2), flat, atol=1e-9)
    bottom = initial_shape(scene, np.array([lowest], dtype=float))[0, 2]
    assert bottom == pytest.approx(hung[:, 2].min(), abs=1e-9)


def test_a_sheet_held_by_four_corners_lies_between_them():
    corners = [[0, 0], [0.3, 0], [0, 0.2], [0.3, 0.2]]
    scene = held_at(corners, np.pad(corners, ((0, 0), (0, 1))))
    np.testing.assert_allclose(initial_shape(scene, np.array(corners)), scene.grip_position[0], atol=1e-9)
