"""Trackers of colour videos on a flat cloth whose place is known; and observations in a picture."""

from __future__ import annotations

import dataclasses

import cv2
import flat_video as flat
import numpy as np
import pytest
from clothbench_trackers.picture_graph import Follower, graph_of, held_path

from clothbench import ClothbenchError, GripPath, Observation, Rollout, scene_of
from clothbench.plugins.discovery import catalogue
from clothbench.recordings.colour_video import Marks
from clothbench.recordings.nodes import read_recording, write_recording
from clothbench.recordings.tracked import nodes_of, seen_in
from clothbench.vision.template import Keypoints, find_template, first_view

MESH = (8, 4)
FOUR = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]) * flat.SIZE


def tracker(name, **options):
    return catalogue().make("trackers", name, mesh=MESH, **options)


def truth(material, count=6):
    return np.array([flat.place(material, k) for k in range(count)])


def pixels_off(seen):
    """From the true pixels to those of what was seen (T, N)."""
    true = flat.CAMERA.project(truth(seen.material, len(seen.time)))[0]
    told = seen.sight.project(np.nan_to_num(seen.position))[0]
    return np.where(seen.visible, np.linalg.norm(true - told, axis=-1), np.nan)


@pytest.mark.parametrize(("name", "most"), [("sift_graph", 0.5), ("optical_flow", 1.0)])
def test_nodes_are_where_they_are_in_the_picture(name, most):
    seen = tracker(name).track(flat.video())
    assert seen.visible.mean() > 0.9
    assert np.nanmedian(pixels_off(seen)) < most
    assert seen.confidence.shape == seen.visible.shape
    assert ((seen.confidence >= 0) & (seen.confidence <= 1)).all()
    assert 0 < seen.sigma < 1e-3


@pytest.mark.parametrize("name", ["sift_graph", "optical_flow"])
def test_a_stated_noise_goes_before_a_judged_one_and_an_option_before_both(name):
    video = flat.video(noise_sigma=3e-3)
    assert tracker(name).track(video).sigma == 3e-3
    assert tracker(name, sigma=2e-3).track(video).sigma == 2e-3


def test_the_literal_rule_takes_the_keypoints_own_place():
    off = pixels_off(tracker("sift_graph", place="literal").track(flat.video()))
    spacing = 480 * 0.4 / 0.62 / MESH[0]
    assert 0.1 * spacing < np.nanmedian(off) < spacing


def test_nodes_ahead_are_seen_in_every_frame_of_a_fast_motion():
    """Some frames are looked at side by side, in the part of the picture that the cloth may reach in the last."""
    first = cv2.resize(flat.template(), (310, 155), interpolation=cv2.INTER_AREA)
    pictures = []
    for k in range(6):
        picture, left = np.full((260, 460, 3), 90, np.uint8), 20 + 14 * k  # of 15.5 px that a window lets through
        picture[50:205, left : left + 310] = first
        pictures.append(picture)
    stream, ends = flat.encoded(pictures)
    video = flat.video(stream=stream, ends=ends, camera=None, world="cloth")
    seen = catalogue().make("trackers", "sift_graph", mesh=(10, 5), window=1.0).track(video)
    assert seen.visible.reshape(6, 5, 10)[:, :, -1].all()


def test_what_is_hidden_is_a_gap():
    seen = tracker("sift_graph").track(flat.video(covered=3))
    true = flat.CAMERA.project(truth(seen.material))[0]
    behind = true[..., 0] > 345
    assert not seen.visible[4:][behind[4:]].any()
    assert seen.visible[4:][true[4:, :, 0] < 290].mean() > 0.9
    assert np.isnan(seen.position[~seen.visible]).all()


def test_a_plain_cloth_is_not_seen_and_not_made_up():
    first = flat.CAMERA.project(flat.place(FOUR, 0))[0]
    seen = tracker("sift_graph").track(flat.video(plain=True, marks=Marks(FOUR, first)))
    assert not seen.visible.any()
    with pytest.raises(ClothbenchError, match="a plain cloth shows nothing to go by"):
        tracker("sift_graph").track(flat.video(plain=True))


@pytest.mark.parametrize("how", ["corners", "marks"])
def test_grips_are_found_in_the_picture(how):
    seen = tracker("sift_graph", grips=how).track(flat.video())
    corners = np.array([[0.0, 0.0], [flat.SIZE[0], 0.0]])
    assert np.array_equal(seen.grips.material, corners)
    assert np.linalg.norm(seen.grips.position - truth(corners), axis=-1).max() < 2e-3
    assert np.abs(seen.grips.position[..., 1]).max() < 1e-3  # on the plane of the first frame


@pytest.mark.parametrize("name", ["sift_graph", "optical_flow"])
@pytest.mark.parametrize(
    ("lost", "refused"),
    [({3}, ""), (set(range(6)), "in [01] frames; mark it"), ({4, 5}, "from frame 0 to 3 of 6, expected 90%")],
)
def test_a_mark_that_is_lost_is_no_measurement(name, lost, refused, monkeypatch):
    """The right mark is lost in some frames, and then taken to be 40 px off: that must count for nothing."""
    corners = np.array([[0.0, 0.0], [flat.SIZE[0], 0.0]])
    true = list(enumerate(flat.CAMERA.project(truth(corners))[0]))[0 if name == "sift_graph" else 1 :]
    step = Follower.step

    def losing(self, picture):
        if len(self.pixel) > 2:  # the nodes
            return step(self, picture)
        frame, pixel = true.pop(0)
        self.pixel = pixel + np.array([[0, 0], [40, 0]]) * (frame in lost)
        return np.array([True, frame not in lost])

    monkeypatch.setattr(Follower, "step", losing)
    video = flat.video()
    if refused:
        with pytest.raises(ClothbenchError, match=rf"held at u = 0.4 m, v = 0 m {refused}"):
            tracker(name, grips="marks").track(video)
    else:
        seen = tracker(name, grips="marks").track(video)
        assert np.linalg.norm(seen.grips.position - truth(corners), axis=-1).max() < 2e-3


def test_a_mark_behind_a_hand_is_not_found_on_what_hides_it():
    """Two marks go towards each other over a printed ground; a board hides the right one for six frames."""
    random = np.random.default_rng(1)

    def printed(height, width):
        soft = cv2.GaussianBlur(random.integers(0, 255, (height, width)).astype(np.uint8), (0, 0), 2.5)
        return cv2.normalize(soft, None, 0, 255, cv2.NORM_MINMAX)

    ground, marks = printed(400, 600), [printed(60, 60), printed(60, 60)]

    def frame(k):
        picture, place = ground.copy(), np.array([[100 + 3 * k, 150], [400 - 3 * k, 150]])
        for (x, y), mark in zip(place, marks, strict=True):
            picture[y - 30 : y + 30, x - 30 : x + 30] = mark
        if 10 <= k < 16:
            x, y = place[1]
            picture[y - 45 : y + 45, x - 45 : x + 45] = 128
        return cv2.cvtColor(picture, cv2.COLOR_GRAY2RGB), place

    first, place = frame(0)
    follower = Follower(first, place, 21)
    for k in range(30):
        picture, place = frame(k)
        off = np.linalg.norm(follower.found_in(picture) - place, axis=1)
        assert off[0] < 0.5
        assert np.isnan(off[1]) if 10 <= k < 16 else np.isnan(off[1]) or off[1] < 0.5
    blinked = Follower(first, frame(0)[1], 21)
    off = [np.linalg.norm(blinked.found_in(p) - place, axis=1)[1] for p, place in map(frame, (0, 3, 6, 9, 12, 9, 6))]
    assert np.isnan(off[4])
    assert off[-1] < 0.5  # it came back near where it was lost


def test_grips_that_were_lost_for_long_are_refused():
    """Seen in some frames at the beginning and at the end; in between nobody knows how the hands moved."""
    seen = tracker("optical_flow").track(flat.video())
    time, visible = 0.2 * np.arange(6.0), seen.visible.copy()
    visible[1:5] = False
    lost = Observation(time, np.where(visible[..., None], seen.position, np.nan), visible, seen.sigma, seen.material)
    with pytest.raises(ClothbenchError, match=r"in no frame for 1 s after 0 s, expected gaps of 0\.5 s at most"):
        nodes_of(flat.video(time=time), lost)
    path = seen.sight.project(np.nan_to_num(seen.position))[0]
    graph = graph_of(flat.video(), MESH, next(flat.video().frames()))
    with pytest.raises(ClothbenchError, match="the point held at u = 0 m, v = 0 m in no frame for 1 s after 0 s"):
        held_path(flat.video(time=time), graph, "corners", path, visible, None)


def test_a_detector_of_hands_is_asked(tmp_path, monkeypatch):
    (tmp_path / "my_hands.py").write_text("import numpy as np\ndef both(frame):\n    return [[100, 60], [380, 60]]\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    seen = tracker("sift_graph", grips="my_hands:both").track(flat.video())
    there = seen.sight.project(seen.grips.position)[0]
    np.testing.assert_allclose(there[2], [[100, 60], [380, 60]], atol=1e-6)
    with pytest.raises(ClothbenchError, match="found no such function"):
        tracker("sift_graph", grips="my_hands:none").track(flat.video())


def test_grips_that_are_stated_are_kept():
    path = GripPath(np.arange(6) / 30.0, np.array([[0.0, 0.0], [0.4, 0.0]]), np.zeros((6, 2, 3)))
    video = flat.video(grips=path)
    seen = tracker("sift_graph").track(video)
    assert seen.grips is None
    assert np.array_equal(nodes_of(video, seen).grip_position, path.position)


@pytest.mark.parametrize("calibrated", [True, False])
def test_without_a_place_of_the_camera_the_world_is_the_cloths(calibrated):
    video = flat.video(world="cloth", **({} if calibrated else {"camera": None}))
    seen = tracker("sift_graph").track(video)
    flat_cloth = np.stack([seen.material[:, 0], 0 * seen.material[:, 0], -seen.material[:, 1]], axis=1)
    off = np.linalg.norm(seen.position[0] - flat_cloth, axis=-1)
    assert np.nanmedian(off) < 1e-3
    true = flat.CAMERA.project(truth(seen.material))[0]
    told = seen.sight.project(np.nan_to_num(seen.position))[0]
    assert np.nanmedian(np.linalg.norm(true - told, axis=-1)[seen.visible]) < 0.5


def test_keypoints_are_where_blobs_are():
    """A picture that OpenCV doubles without care for the middle of its pixels has them a quarter of one to the right
    and below.
    """
    y, x = np.mgrid[:240, :320]
    blobs = np.mgrid[40:280:40, 40:240:40].reshape(2, -1).T + np.random.default_rng(0).uniform(0, 1, (30, 2))
    picture = 40 + sum(150 * np.exp(-((x - u) ** 2 + (y - v) ** 2) / 32) for u, v in blobs)
    place = Keypoints.of(np.clip(picture, 0, 255).astype(np.uint8)).place
    nearest = np.linalg.norm(place - blobs[:, None], axis=-1).argmin(axis=1)
    assert np.abs((place[nearest] - blobs).mean(axis=0)).max() < 0.02


def test_the_first_view_puts_the_cloth_where_it_is():
    shape = flat.template().shape[:2]
    found = find_template(Keypoints.of(flat.template()), Keypoints.of(flat.frames(1)[0]), shape, "flat")
    view = first_view(found, shape, flat.SIZE, flat.PIXELS, flat.CAMERA, True)
    np.testing.assert_allclose(view.places(FOUR), flat.place(FOUR, 0), atol=4e-3)
    pixel = flat.CAMERA.project(flat.place(FOUR, 0))[0]
    np.testing.assert_allclose(flat.CAMERA.project(view.lifted(pixel))[0], pixel, atol=1e-9)


def test_a_tracked_video_is_a_recording_in_the_picture(tmp_path):
    video = flat.video()
    seen = tracker("sift_graph").track(video)
    again = seen_in(read_recording(write_recording(nodes_of(video, seen), tmp_path / "seen.nc")))
    assert np.array_equal(again.sight.matrix, seen.sight.matrix)
    np.testing.assert_allclose(again.confidence, seen.confidence)
    assert again.coordinates == 2
    scene = scene_of(nodes_of(video, seen), areal_density=0.1)
    assert scene.camera is not None
    with pytest.raises(ClothbenchError, match="says nothing of their depth"):
        scene_of(nodes_of(video, seen), areal_density=0.1, start="measured")


def test_what_moves_along_the_line_of_sight_is_not_seen():
    material = np.array([[0.1, 0.05], [0.3, 0.1]])
    position = truth(material, 4)
    seen = Observation(np.arange(4.0), position, np.ones((4, 2), bool), 1e-3, material, sight=flat.CAMERA)
    eye = flat.CAMERA.place
    farther = eye + 1.3 * (position - eye)
    np.testing.assert_allclose(seen.differences(farther[None]), 0, atol=1e-12)
    aside = position + 0.01 * flat.CAMERA.rotation[0]
    np.testing.assert_allclose(seen.differences(aside), np.broadcast_to([0.01, 0.0], (4, 2, 2)), atol=1e-12)
    np.testing.assert_allclose(seen.in_space(seen.differences(aside)), aside - position, atol=1e-12)
    score = {u: catalogue().make("metrics", "node_error", unit=u)(seen, rolled(aside)).value[0] for u in ("cm", "px")}
    assert score["cm"] == pytest.approx(1.0)
    away = np.linalg.norm(flat.CAMERA.project(aside)[0] - flat.CAMERA.project(position)[0], axis=-1).mean()
    assert score["px"] == pytest.approx(away, rel=1e-6)
    assert catalogue().make("metrics", "node_error").floor(seen) == pytest.approx(np.sqrt(np.pi / 2))


def rolled(position):
    return Rollout(np.arange(4.0), position[None], ("ok",), np.array([1]), 2)


def test_pixels_are_those_of_the_camera_its_lens_included():
    lens = dataclasses.replace(
        flat.CAMERA, matrix=flat.CAMERA.matrix * np.array([[1.0], [1.4], [1.0]]), distortion=[-0.3, 0.1, 0, 0, 0]
    )
    material = FOUR[:2]
    seen = flat.place(material, 0)[None].repeat(2, axis=0)
    there = seen[None] + np.array([0.01, 0.05, 0.02])  # aside, away from the camera and up
    o = Observation(np.arange(2.0), seen, np.ones((2, 2), bool), 1e-3, material, sight=lens)
    run = Rollout(np.arange(2.0), there, ("ok",), np.ones(1), 100)
    off = np.linalg.norm(lens.project(there)[0] - lens.project(seen)[0], axis=-1)
    score = catalogue().make("metrics", "node_error", unit="px")(o, run)
    assert score.value[0] == pytest.approx(off.mean())
    assert (score.residual**2).sum() == pytest.approx((off**2).sum())
    depth = lens.project(seen)[1]  # a pixel is as large as the square root of its area, which is higher than wide
    np.testing.assert_allclose(o.pixel_size(), depth / (flat.CAMERA.matrix[0, 0] * 1.4**0.5))


def test_what_needs_depth_refuses_a_picture():
    material = np.array([[0.1, 0.05], [0.3, 0.1]])
    position = truth(material, 4)
    seen = Observation(np.arange(4.0), position, np.ones((4, 2), bool), 1e-3, material, sight=flat.CAMERA)
    with pytest.raises(ClothbenchError, match="a picture, which has no depth"):
        catalogue().make("metrics", "profile")(seen, rolled(position))
    plain = Observation(np.arange(4.0), position, np.ones((4, 2), bool), 1e-3, material)
    with pytest.raises(ClothbenchError, match="px: the recording has no picture"):
        catalogue().make("metrics", "node_error", unit="px")(plain, rolled(position))


@pytest.mark.parametrize(
    ("name", "options", "found"),
    [
        ("sift_graph", {"place": "middle"}, "expected one of offset, literal"),
        ("sift_graph", {"window": 0.5}, "window is 0.5"),
        ("sift_graph", {"grips": "hands"}, "expected corners, marks, or module:function"),
        ("optical_flow", {"back": -1}, "back is -1"),
        ("optical_flow", {"mesh": 20}, "mesh is 20, expected two whole numbers"),
        ("sift_graph", {"sigma": "small"}, "sigma is 'small', expected metres above 0"),
    ],
)
def test_wrong_options_are_one_line(name, options, found):
    with pytest.raises(ClothbenchError) as fault:
        catalogue().make("trackers", name, **options)
    assert found in str(fault.value)
