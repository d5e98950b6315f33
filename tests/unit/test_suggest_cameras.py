"""What a camera would tell of an experiment, against direct formulas, and which points it sees."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from clothbench import Camera, ClothbenchError, Obstacle, Scene
from clothbench.suggest.cameras import FILLED, Placed, behind_obstacles, derivative, framing, look_of, placed, seen_from
from clothbench.suggest.information import information
from clothbench.suggest.settings import PLACEMENTS, Sensor, Wanted, as_recorded, wanted_of

RANDOM = np.random.default_rng(8)
UP = np.array([0.0, 0.0, 1.0])
SENSOR = Sensor(noise=0.7, depth_noise=2e-3, field_of_view=40.0, size=(640, 480))
WRONG = 3e-3  # m


def scene(**changes) -> Scene:
    """A sheet of 0.3 m × 0.3 m hanging from two corners in the x–z plane, seen at 7 × 7 points for three frames."""
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(0, 0.3, 7), np.linspace(0, 0.3, 7)))
    held, times = np.array([[0.0, 0.0], [0.3, 0.0]]), np.linspace(0.0, 0.2, 3)
    grips = np.repeat(np.array([[[-0.15, 0.0, 1.0], [0.15, 0.0, 1.0]]]), 3, axis=0)
    made = Scene(0.3, 0.3, 0.2, times, held, grips, times, np.stack([u, v], axis=1))
    return dataclasses.replace(made, **changes)


def flat(made: Scene) -> np.ndarray:
    """Where the points of the hanging sheet are (T, N, 3) m."""
    u, v = made.points.T
    return np.repeat(np.stack([u - 0.15, 0 * u, 1 - v], axis=1)[None], len(made.times), axis=0)


def from_place(way, position: np.ndarray, sensor: Sensor = SENSOR, up=UP) -> Placed:
    """A camera that sees every point."""
    camera, target = framing(position.reshape(-1, 3), np.array(way) / np.linalg.norm(way), np.array(up), sensor)
    return Placed("", camera, target, np.array(up), np.ones(position.shape[:2], bool))


def measured(camera: Camera, points: np.ndarray) -> np.ndarray:
    """Pixel and depth (..., 3)."""
    pixel, depth = camera.project(points)
    return np.concatenate([pixel, depth[..., None]], axis=-1)


def by_differences(camera: Camera, points: np.ndarray) -> np.ndarray:
    steps = 1e-5 * np.eye(3)
    return np.stack([(measured(camera, points + s) - measured(camera, points - s)) / 2e-5 for s in steps], axis=-1)


def told(view: Placed, sensor: Sensor, position: np.ndarray, jacobian: np.ndarray, wrong: float) -> np.ndarray:
    return information(look_of(view, sensor, position.ravel(), wrong)(jacobian), 1.0)


def test_the_derivative_is_that_of_the_projection():
    camera = from_place((1, -2, 0.5), flat(scene())).camera
    points = RANDOM.normal([0.0, 0.0, 0.85], 0.1, size=(20, 3))
    assert derivative(camera, points) == pytest.approx(by_differences(camera, points), rel=1e-5, abs=1e-5)


@pytest.mark.parametrize("kind", ["colour", "depth"])
def test_information_is_the_direct_formula(kind):
    """Σ (A J)ᵀ (κ² A Aᵀ + N)⁻¹ A J over the points that are seen, A by differences of the projection."""
    position, sensor = flat(scene()), dataclasses.replace(SENSOR, kind=kind)
    position = position + RANDOM.normal(scale=0.01, size=position.shape)
    view = from_place((1, -2, 0.5), position)
    view.seen[:] = RANDOM.random(view.seen.shape) > 0.3
    jacobian = RANDOM.normal(size=(position.size, 4))
    direct, count = np.zeros((4, 4)), 3 if kind == "depth" else 2
    for point, rows, seen in zip(position.reshape(-1, 3), jacobian.reshape(-1, 3, 4), view.seen.ravel(), strict=True):
        a = by_differences(view.camera, point)[:count]
        noise = np.array([0.7, 0.7, 2e-3 * measured(view.camera, point)[2] ** 2])[:count]
        direct += seen * (a @ rows).T @ np.linalg.inv(WRONG**2 * a @ a.T + np.diag(noise**2)) @ (a @ rows)
    assert told(view, sensor, position, jacobian, WRONG) == pytest.approx(direct, rel=1e-5)
    first = look_of(view, sensor, position[:1].ravel(), WRONG)(jacobian[: position[0].size])  # a shorter one
    assert len(first) == count * position.shape[1]


def test_what_moves_along_the_line_of_sight_is_not_told():
    """One parameter moves all points across the sheet; the camera is far away, so that sights are all but parallel."""
    position, far = flat(scene()), dataclasses.replace(SENSOR, field_of_view=1.0)
    jacobian = np.tile([0.0, 0.1, 0.0], position.size // 3)[:, None]
    front, side, between = (
        told(from_place(way, position, far), far, position, jacobian, WRONG)[0, 0]
        for way in ((0, -1, 0), (1, 0, 0), (1, -1, 0))
    )
    assert front < 1e-3 * side
    assert between == pytest.approx(side / 2, rel=0.1)
    depth = dataclasses.replace(far, kind="depth", depth_noise=1e-9)
    assert told(from_place((0, -1, 0), position, far), depth, position, jacobian, WRONG)[0, 0] > 0.9 * side


def test_limits():
    """Without noise a picture is all but the line of sight, and depth beside it as much as markers; where the noise is
    all there is, it counts by the square of what a pixel is there.
    """
    position = flat(scene())
    view = from_place((1, -2, 0.5), position)
    jacobian = RANDOM.normal(size=(position.size, 3))
    exact = dataclasses.replace(SENSOR, noise=1e-7, depth_noise=1e-10)
    sight = position - view.camera.place
    sight /= np.linalg.norm(sight, axis=-1, keepdims=True)
    rows = jacobian.reshape(*position.shape, 3)
    across = rows - sight[..., None] * np.einsum("tnc,tncp->tnp", sight, rows)[:, :, None]
    assert told(view, exact, position, jacobian, WRONG) == pytest.approx(
        information(across.reshape(-1, 3), WRONG), rel=1e-5
    )
    depth = dataclasses.replace(exact, kind="depth")
    assert told(view, depth, position, jacobian, WRONG) == pytest.approx(information(jacobian, WRONG), rel=1e-5)
    twice = dataclasses.replace(SENSOR, noise=2 * SENSOR.noise)
    assert told(view, twice, position, jacobian, 0.0) == pytest.approx(told(view, SENSOR, position, jacobian, 0.0) / 4)
    nowhere = dataclasses.replace(view, seen=np.zeros_like(view.seen))
    assert not told(nowhere, SENSOR, position, jacobian, WRONG).any()


def test_estimates_from_noisy_pixels_spread_as_promised():
    """The place of a sheet that swings by an unknown angle, estimated from 400 noisy pictures."""
    made = scene()

    def swung(angle: float) -> np.ndarray:
        away = flat(made) - [0, 0, 1.0]
        return np.stack([away[..., 0], -away[..., 2] * np.sin(angle), 1 + away[..., 2] * np.cos(angle)], axis=-1)

    position, spread = swung(0.3), {}
    jacobian = ((swung(0.3001) - swung(0.2999)) / 2e-4).reshape(-1, 1)
    for name, way in (("front", (0, -1, 0)), ("side", (1, -0.5, 0))):
        view = from_place(way, position)
        pixel, more, less = (view.camera.project(swung(angle))[0].ravel() for angle in (0.3, 0.3001, 0.2999))
        slope = (more - less) / 2e-4
        noisy = RANDOM.normal(pixel, SENSOR.noise, (400, len(pixel)))
        spread[name] = np.std((noisy - pixel) @ slope / (slope @ slope))  # of the fits by least squares
        assert spread[name] == pytest.approx(told(view, SENSOR, position, jacobian, 0.0)[0, 0] ** -0.5, rel=0.15)
    assert spread["side"] < spread["front"] / 1.5


def test_every_placement_has_the_motion_in_its_picture():
    made = scene()
    position = flat(made) + np.linspace(0, 0.1, 3)[:, None, None] * [0.0, 1.0, 0.0]
    views = placed(made, made, position, Wanted(cameras=tuple(PLACEMENTS), camera=SENSOR))
    assert [view.name for view in views] == list(PLACEMENTS)
    for view in views:
        pixel, depth = view.camera.project(position)
        off = np.abs(pixel - (np.array(SENSOR.size) - 1) / 2) / (np.array(SENSOR.size) / 2)
        assert off.max() == pytest.approx(FILLED)
        assert depth.min() > 0
        assert view.camera.place - view.target == pytest.approx(
            np.linalg.norm(view.camera.place - view.target) * np.array(PLACEMENTS[view.name][0])
            / np.linalg.norm(PLACEMENTS[view.name][0])
        )  # fmt: skip
        assert -view.camera.rotation[1] @ view.up > 0.5
    front, *_ = views
    assert (np.diff(front.camera.project(position)[0][0, :7, 0]) > 0).all()  # the warp runs to the right
    assert front.seen.all()


def test_edge_on_and_outside_the_picture():
    made = scene()
    position = flat(made)
    front, side = (from_place(way, position).camera for way in ((0, -1, 0), (1, 0, 0)))
    assert seen_from(front, made, position).all()
    assert not seen_from(side, made, position).any()
    moved = position + 0.15 * np.array([1.0, 0.0, 0.0])
    assert 0.3 < seen_from(front, made, moved).mean() < 0.9
    assert not seen_from(front, made, position - [0.0, 2.0, 0.0]).any()  # behind the camera


def test_the_sheet_hides_what_lies_behind_it():
    """Folded along its middle: the left half hangs 4 cm behind the right one."""
    made = scene()
    u, v = made.points.T
    behind = u < 0.149
    folded = np.stack([np.abs(u - 0.15), np.where(behind, 0.04, 0.0), 1 - v], axis=1)
    position = np.repeat(folded[None], 3, axis=0)
    inner = (np.abs(u - 0.15) < 0.11) & (v > 0.04) & (v < 0.26) & (np.abs(u - 0.15) > 0.01)
    for way, hidden in (((0, -1, 0), behind), ((0, 1, 0), ~behind)):
        seen = seen_from(from_place(way, position).camera, made, position)
        assert not seen[:, inner & hidden].any()
        assert seen[:, inner & ~hidden].all()


def test_obstacles_hide_too():
    made, eye = scene(), np.array([0.0, -1.0, 0.2])
    position = flat(made)
    table = dataclasses.replace(made, obstacles=(Obstacle("plane", (0.0, 0.0, 0.6)),))
    assert behind_obstacles(eye, table, position).all()
    assert not behind_obstacles(eye + UP, table, position).any()
    ball = Obstacle("sphere", (-0.07, -0.5, 0.55), radius=0.03)
    hidden = behind_obstacles(eye, dataclasses.replace(made, obstacles=(ball,)), position)
    assert 0 < hidden.mean() < 0.5
    path = made.grip_position + np.linspace(0, 1, 3)[:, None, None] * [1.0, 0.0, 0.0]
    carried = dataclasses.replace(
        made, obstacles=(dataclasses.replace(ball, carried=True),), grip_position=path
    )  # which takes it away
    assert (behind_obstacles(eye, carried, position).any(axis=1) == [True, False, False]).all()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ({"cameras": "front,sideways"}, "setting 'cameras' names 'sideways', expected some of front, three-quarter, "),
        ({"cameras": ""}, "setting 'cameras' names '', expected some of front"),
        ({"camera.noise": "1"}, "found camera.noise= and no cameras=; say where it may stand, as cameras=all"),
        ({"cameras": "none", "camera.noise": "1"}, "found camera.noise= and no cameras=; say where it may stand"),
        ({"cameras": "all", "camera": "front"}, "found camera=, expected camera.kind=, camera.noise=, "),
        ({"cameras": "all", "camera.depth_noise": "2"}, "found camera.depth_noise= of a colour camera"),
        ({"cameras": "all", "camera.zoom": "2"}, "found camera.zoom=, expected camera.kind=, "),
        ({"cameras": "all", "camera.kind": "stereo"}, "setting 'camera.kind' is 'stereo', expected colour or depth"),
        ({"cameras": "all", "camera.noise": "0"}, "setting 'camera.noise' is '0', expected a number above 0"),
        ({"cameras": "all", "camera.field_of_view": "200"}, "is '200', expected degrees below 170"),
        ({"cameras": "all", "camera.size": "1280"}, "setting 'camera.size' is '1280', expected pixels, as 1280x720"),
        ({"cameras": "all", "camera.size": "99999x99999"}, "pixels at most"),
    ],
)
def test_words_that_make_no_sense(words, said):
    with pytest.raises(ClothbenchError, match=said):
        as_recorded(wanted_of(words), words, None)


def test_words_as_they_are_given():
    wanted = wanted_of({"cameras": "[side, front]", "camera.kind": "depth", "camera.size": "640x480"})
    assert wanted.cameras == ("side", "front")
    assert (wanted.camera.kind, wanted.camera.size, wanted.camera.noise) == ("depth", (640, 480), 0.5)
    assert wanted_of({"cameras": "all"}).cameras == tuple(PLACEMENTS)
    assert wanted_of({}).cameras is None
