"""The tracker `depth_mesh` on sheets whose every point is known: bent without strain, filmed with a sensor's faults."""

from __future__ import annotations

import dataclasses
import weakref
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from clothbench_trackers.depth_mesh import at_times, check_extent, trembling

from clothbench import Camera, ClothbenchError, DepthImages, write_depth
from clothbench.core.observation import GripPath
from clothbench.plugins.discovery import catalogue
from clothbench.recordings.depth import Colour
from clothbench.studies.calibration.cloth import as_grey, contact_sheet, picture_of
from clothbench.vision.depth_camera import DepthSensor, facing, seen_points, sensed, to_world
from clothbench.vision.render import rasterise
from clothbench.vision.surface import surface_of

SIZE = np.array([0.30, 0.40])
TIME = np.arange(8) / 20.0
VIEW = Camera.looking_at(np.array([0.05, -1.1, 0.85]), np.array([0.0, 0.0, 0.8]), (144, 152), 0.48)
NOISY, QUIET = DepthSensor(), DepthSensor(noise=0.0, step=0.0, holes=0.0, flying=0.0)


def bent(uv: np.ndarray, t: float, tilt: float = 0.0) -> np.ndarray:
    """Points (N, 3) m of a sheet that hangs from z = 1, rolled about its own length and swung: lengths are kept."""
    radius, swing = 0.25, 0.15 * np.sin(6 * t) + tilt
    angle = (uv[:, 0] - SIZE[0] / 2) / radius
    across, out, down = radius * np.sin(angle), radius * (1 - np.cos(angle)), uv[:, 1]
    sin, cos = np.sin(swing), np.cos(swing)
    return np.stack([across, cos * out + sin * down, 1.0 + sin * out - cos * down], axis=1)


def lattice(nu: int, nv: int) -> np.ndarray:
    return np.stack(np.meshgrid(np.linspace(0, SIZE[0], nu), np.linspace(0, SIZE[1], nv)), axis=-1).reshape(-1, 2)


@cache
def filmed(
    sensor: DepthSensor = NOISY, tilt: float = 0.0, hidden: float = 0.0, grips: bool = True, blue=True, view=VIEW
):
    """Depth images of the sheet; hidden: share of its width behind something that stands before its right side."""
    fine, random = lattice(25, 33), np.random.default_rng(1)
    triangle = surface_of(fine).triangle
    depth, colour = [], []
    for t in TIME:
        pixel, away = view.project(bent(fine, t, tilt))
        nearest, empty = np.empty(view.size[::-1]), np.empty((*view.size[::-1], 0))
        rasterise(pixel, away, triangle, np.zeros((len(fine), 0)), nearest, empty)
        seen = np.isfinite(nearest)
        picture = np.where(seen[..., None], (50, 80, 170), (190, 180, 170))
        if hidden:
            edge = view.project(np.array([SIZE[0] * (0.5 - hidden), -0.1, 0.8]))[0][0]
            nearest[:, int(edge) :], picture[:, int(edge) :] = 0.6, (150, 60, 50)
        nearest[~np.isfinite(nearest)] = 1.6
        depth.append(sensed(nearest, view, sensor, random))
        colour.append(picture.astype(np.uint8))
    corners = np.array([[0.0, 0.0], [SIZE[0], 0.0]])
    held = GripPath(TIME, corners, np.stack([bent(corners, t, tilt) for t in TIME]))
    return DepthImages(
        name="swing", time=TIME, depth=np.stack(depth), depth_step=1e-3, camera=view, cloth_width=SIZE[0],
        cloth_height=SIZE[1], colour=Colour(TIME, np.stack(colour)) if blue else None, grips=held if grips else None,
    )  # fmt: skip


def tracker(**options):
    return catalogue().make("trackers", "depth_mesh", **options)


def errors(images: DepthImages, tilt: float = 0.0, **options) -> tuple[np.ndarray, np.ndarray]:
    """Distances (T, N) m of nodes from where they are, NaN where not seen; and the nodes' material points."""
    seen = tracker(**options).track(images)
    truth = np.stack([bent(seen.material, t, tilt) for t in seen.time])
    return np.linalg.norm(seen.position - truth, axis=-1), seen.material


def test_without_faults_it_is_off_by_a_fraction_of_a_pixel():
    away, _ = errors(filmed(QUIET))
    assert np.isfinite(away).mean() > 0.98
    assert np.nanmedian(away) < 1.2e-3
    assert np.nanpercentile(away, 95) < 5e-3  # a pixel is 3.3 mm


@pytest.mark.parametrize("tilt", [-0.3, 0.0, 0.3])
def test_with_a_sensors_faults_it_is_off_by_a_pixel(tilt):
    away, _ = errors(filmed(tilt=tilt), tilt)
    assert np.isfinite(away).mean() > 0.95
    assert np.nanmedian(away) < 2.5e-3
    assert np.nanpercentile(away, 95) < 8e-3


def test_without_grips_and_colour_the_outline_tells():
    images = filmed(grips=False, blue=False)
    away, _ = errors(images, far=1.4)
    assert np.isfinite(away).mean() > 0.9
    assert np.nanmedian(away) < 5e-3


@pytest.mark.parametrize(
    "harm", [{"depth_step": 2e-3}, {"cloth_width": 0.15, "cloth_height": 0.2}, {"cloth_width": 0.2}]
)
def test_without_grips_a_sheet_that_is_too_large_is_refused(harm):
    images, far = dataclasses.replace(filmed(grips=False, blue=False), **harm), 1400 * harm.get("depth_step", 1e-3)
    with pytest.raises(ClothbenchError, match=r"^swing: found a sheet of 0.\d+ × 0.\d+ m in 8 of 8 .*; is depth_step"):
        tracker(far=far).track(images)


def test_a_frame_that_shows_too_much_refuses_no_recording_with_grips():
    """Of the frames the grips are known in all but one, which alone had been judged."""
    images, extent = filmed(), np.full((len(TIME), 2), np.nan)
    extent[-1] = 2 * SIZE
    check_extent(images, extent)
    with pytest.raises(ClothbenchError, match="found a sheet of"):
        check_extent(dataclasses.replace(images, grips=None), extent)


def test_what_is_hidden_stays_unseen_and_the_rest_keeps_its_labels():
    images = filmed(hidden=0.3)
    away, material = errors(images)
    behind = material[:, 0] > 0.85 * SIZE[0]
    assert np.isnan(away[:, behind]).all()
    before = material[:, 0] < 0.5 * SIZE[0]
    assert np.isfinite(away[:, before]).mean() > 0.95
    assert np.nanmedian(away[:, before]) < 4e-3


def test_the_isometric_map_beats_the_harmonic_one_where_the_border_is_rough():
    images = filmed()
    rms = {m: np.sqrt(np.nanmean(errors(images, method=m)[0] ** 2)) for m in ("isometric", "harmonic")}
    assert rms["isometric"] < 0.7 * rms["harmonic"]


def test_each_step_leaves_less_and_can_be_left_out():
    (step,) = tracker().steps(filmed(hidden=0.2), [0])
    plane, outliers, colour = (step.masks[name] for name in ("plane", "outliers", "colour"))
    assert plane.sum() > outliers.sum() > 0
    assert not (outliers & ~plane).any()
    assert not (colour & ~outliers).any()
    (bare,) = tracker(support=0, colour=False).steps(filmed(hidden=0.2), [0])
    assert np.array_equal(bare.masks["outliers"], bare.masks["colour"])
    assert bare.masks["outliers"].sum() >= outliers.sum()


def test_uneven_stamps_become_even_ones():
    uneven = TIME + np.array([0, 3, -2, 4, 0, -3, 2, 0]) * 1e-3
    images = dataclasses.replace(filmed(), time=uneven, grips=None, colour=None)
    assert np.ptp(np.diff(tracker(far=1.4).track(images).time)) < 1e-12
    assert np.array_equal(tracker(far=1.4, even=False).track(images).time, uneven)


def test_a_film_shows_the_depth_that_was_taken_nearest(tmp_path):
    uneven = TIME + np.array([0, 45, 45, 45, 45, 45, 45, 0]) * 1e-3  # nearly a frame late in between
    images = dataclasses.replace(filmed(), time=uneven, grips=None, colour=None)
    path = write_depth(images, tmp_path / "swing.nc")
    even = SimpleNamespace(time=np.linspace(uneven[0], uneven[-1], 8), sight=None)
    shown = picture_of(None, str(path), even, np.array([2, 3]))[0]
    assert shown == contact_sheet(as_grey(images.depth[[1, 2]]))[0]


def test_where_frames_were_dropped_nothing_is_seen():
    gap = TIME + np.array([0, 0, 0, 0, 6, 6, 6, 6]) / 20.0  # six frames dropped after the fourth
    images = dataclasses.replace(filmed(), time=gap, grips=None, colour=None)
    seen = tracker(far=1.4).track(images)
    between = (seen.time > gap[3] + 1e-9) & (seen.time < gap[4] - 1e-9)
    assert between.sum() == 4
    assert not seen.visible[between].any()
    assert seen.visible[~between].mean() > 0.9


def test_a_frame_that_was_not_seen_takes_none_with_it_where_stamps_are_off_by_a_trifle():
    random, time = np.random.default_rng(0), np.round(np.arange(60) / 30, 3)  # whole milliseconds
    nodes = random.normal(size=(60, 40, 3))
    nodes[random.random((60, 40)) < 0.1] = np.nan
    even = at_times(time, nodes, np.linspace(time[0], time[-1], 60))
    assert np.isfinite(even).mean() > np.isfinite(nodes).mean() - 0.01


def test_noise_is_judged_by_the_real_stamps():
    random = np.random.default_rng(0)
    time = np.sort(np.arange(120) / 30 + random.normal(0.0, 5e-3, 120))
    place = 0.15 * np.sin(2 * np.pi * 0.8 * time)[:, None, None] + random.random((81, 3))
    still = trembling(np.arange(120) / 30, random.normal(0.0, 1e-3, (120, 81, 3)))
    assert trembling(time, place + random.normal(0.0, 1e-3, place.shape)) == pytest.approx(still, rel=0.1)
    assert 0.8e-3 < still < 1e-3  # the quieter half: a lower bound


def shifted(by):
    """The camera of these tests, turned until the middle of its picture lies `by` m beside the sheet's."""
    return Camera.looking_at(np.array([0.05, -1.1, 0.85]), np.array([by, 0.0, 0.8]), VIEW.size, 0.48)


def test_a_sheet_that_the_pictures_border_cuts_is_not_stretched_to_its_hem():
    images = filmed(view=shifted(0.12))
    seen = tracker().track(images)
    truth = np.stack([bent(seen.material, t) for t in seen.time])
    outside = (images.camera.project(truth)[0] < -0.5).any(axis=-1)
    assert 0.1 < outside.mean() < 0.4
    assert not seen.visible[outside].any()
    away = np.linalg.norm(seen.position - truth, axis=-1)
    assert np.nanmedian(away) < 4.5e-3
    assert np.isfinite(away[~outside]).mean() > 0.95


@pytest.mark.parametrize("turn", [90, 180, -90])
def test_a_camera_may_be_rolled_before_a_hanging_sheet_that_nobody_holds(turn):
    straight = Camera.looking_at(np.array([0.05, -1.1, 0.85]), np.array([0.0, 0.0, 0.8]), (200, 200), 0.65)
    c, s = np.round(np.cos(np.deg2rad(turn))), np.round(np.sin(np.deg2rad(turn)))
    roll = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    view = dataclasses.replace(straight, rotation=roll @ straight.rotation, translation=roll @ straight.translation)
    away, _ = errors(filmed(grips=False, blue=False, view=view), far=1.4)
    assert np.nanmedian(away) < 6e-3


def test_a_picture_is_that_taken_nearest_to_the_frame():
    images, step = filmed(), TIME[1]
    frames = images.colour.frame
    late = Colour(TIME + step, np.concatenate([frames[1:], frames[-1:]]))  # each picture stands a place too early
    moved = dataclasses.replace(images, colour=late)
    assert moved.picture(0) is None
    assert all(np.array_equal(moved.picture(k), frames[k]) for k in range(1, len(TIME)))
    first = tracker().masks(moved, 0, moved.metres(0), np.array([0.0, 0.0]))
    assert np.array_equal(first["colour"], first["outliers"])  # no picture tells what is no cloth
    assert "colour" not in tracker().pictures(moved, 0, tracker().track(moved))


def test_what_a_frames_steps_leave_is_dropped_with_the_frame(monkeypatch):
    """Masks and depths of a whole recording are gigabytes; of a frame, only the nodes stay."""
    monkeypatch.setenv("CLOTHBENCH_THREADS", "1")
    images, mesh, there, most = filmed(), tracker(), weakref.WeakSet(), []
    step = type(mesh)._step

    def watched(self, images, frame, hue):
        made = step(self, images, frame, hue)
        there.add(made)
        most.append(len(there))
        return made

    monkeypatch.setattr(type(mesh), "_step", watched)
    seen = mesh.track(images)
    assert len(most) == len(TIME)
    assert max(most) <= 2
    every = np.array([s.nodes for s in mesh.steps(images, range(len(TIME)))])
    assert np.array_equal(seen.position, every, equal_nan=True)


def test_the_hue_is_what_most_frames_say():
    images = filmed()
    frames = images.colour.frame.copy()
    frames[0] = (190, 180, 170)  # the light was still off, say
    away, _ = errors(dataclasses.replace(images, colour=Colour(TIME, frames)))
    assert np.isfinite(away[1:]).mean() > 0.95


def test_grips_along_one_side_say_nothing_of_where_u_points():
    images = filmed()
    left = np.array([[0.0, 0.0], [0.0, SIZE[1]]])
    held = GripPath(TIME, left, np.stack([bent(left, t) for t in TIME]))
    away, _ = errors(dataclasses.replace(images, grips=held))
    assert np.isfinite(away).mean() > 0.9
    assert np.nanmedian(away) < 5e-3


@pytest.mark.parametrize(("turned", "grips"), [(1.0, True), (-1.0, True), (1.0, False)])
def test_of_a_sheet_that_lies_level_v_goes_away_from_the_grips_or_down_in_the_picture(turned, grips):
    """turned: -1 of a sheet that lies the other way round under the camera."""
    fine, random = lattice(25, 33), np.random.default_rng(1)
    place, middle = np.array([0.15, -0.2, 1.0]), np.array([0.15, -0.2, 0.0])
    above = Camera.looking_at(place, middle, (160, 160), 0.6, up=(0.0, 1.0, 0.0))

    def lying(uv, t):
        x, y = turned * (uv - SIZE / 2).T
        return np.stack([x + 0.15, -y - 0.2, 0.01 * np.sin(20 * uv[:, 0] + 8 * t)], axis=1)

    depth = []
    for t in TIME:
        nearest, empty = np.empty(above.size[::-1]), np.empty((*above.size[::-1], 0))
        rasterise(*above.project(lying(fine, t)), surface_of(fine).triangle, np.zeros((len(fine), 0)), nearest, empty)
        depth.append(sensed(np.where(np.isfinite(nearest), nearest, 2.0), above, NOISY, random))
    corners = np.array([[0.0, 0.0], [SIZE[0], 0.0]])
    held = GripPath(TIME, corners, np.stack([lying(corners, t) for t in TIME]))
    images = DepthImages(
        name="level", time=TIME, depth=np.stack(depth), depth_step=1e-3, camera=above, cloth_width=SIZE[0],
        cloth_height=SIZE[1], grips=held if grips else None,
    )  # fmt: skip
    seen = tracker(far=1.4).track(images)
    away = np.linalg.norm(seen.position - np.stack([lying(seen.material, t) for t in seen.time]), axis=-1)
    assert np.isfinite(away).mean() > 0.9
    assert np.nanmedian(away, axis=1).max() < 6e-3


@pytest.mark.parametrize(
    ("options", "found"),
    [
        ({"mesh": [9]}, "mesh is [9], expected two whole numbers"),
        ({"mesh": 9}, "mesh is 9, expected two whole numbers"),
        ({"near": "close"}, "near is 'close', expected metres above 0, or null"),
        ({"far": -1.0}, "far is -1.0, expected metres above 0, or null"),
        ({"near": 2.0, "far": 1.0}, "near is 2.0 and far is 1.0, expected near below far"),
        ({"sigma": 0}, "sigma is 0, expected metres above 0, or null"),
        ({"jump": 0}, "jump is 0, expected a number above 0"),
        ({"method": "conformal"}, "expected one of isometric, harmonic"),
        ({"jump": np.inf}, "jump is inf, expected a number above 0"),
        ({"smooth": -0.5}, "smooth is -0.5, expected a number 0 or above"),
        ({"support": 9}, "support is 9, expected a whole number from 0 to 8"),
        ({"even": "no"}, "even is 'no', expected true or false"),
        ({"colour": [1, 2]}, "expected [red, green, blue]"),
        ({"colour": "red"}, "colour is 'red', expected [red, green, blue]"),
        ({"colour": [300, 0, 0]}, "whole numbers from 0 to 255"),
        ({"colour": [0.8, 0.2, 0.1]}, "whole numbers from 0 to 255"),
        ({"colour": True}, "colour is True, expected"),
    ],
)
def test_bad_options_are_refused(options, found):
    with pytest.raises(ClothbenchError) as caught:
        tracker(**options)
    assert found in str(caught.value)


def test_no_sheet_and_no_images_are_refused(recording):
    with pytest.raises(ClothbenchError, match="depth_mesh found no sheet in any frame; look at its steps"):
        tracker(near=3.0, far=4.0).track(filmed())
    with pytest.raises(ClothbenchError, match="expected depth images"):
        tracker().track(recording)
    with pytest.raises(ClothbenchError, match="source: found DepthImages, expected nodes"):
        catalogue().make("trackers", "markers").track(filmed())


def test_a_sensors_noise_grows_with_the_square_of_the_distance():
    random = np.random.default_rng(3)
    view = Camera.looking_at(np.array([0.0, -1.0, 0.0]), np.zeros(3), (80, 60), 0.5)
    sensor = DepthSensor(noise=4e-3, step=0.0, holes=0.0, flying=0.0, reach=9.0)
    spread = [np.std(1e-3 * sensed(np.full((60, 80), z), view, sensor, random)) for z in (1.0, 2.0)]
    assert spread == pytest.approx([4e-3, 16e-3], rel=0.06)
    lost = sensed(np.full((60, 80), 1.0), view, DepthSensor(holes=0.1), random) == 0
    assert 0.08 < lost.mean() < 0.12
    assert not sensed(np.full((60, 80), 2.0), view, DepthSensor(reach=1.5), random).any()


def test_points_go_through_the_camera_and_back():
    depth = np.full(VIEW.size[::-1], 1.2)
    world = to_world(seen_points(depth, VIEW), VIEW)
    pixel, away = VIEW.project(world)
    assert np.allclose(away, 1.2)
    assert np.allclose(pixel[10, 20], [20, 10], atol=1e-6)
    assert facing(depth, VIEW)[76, 72] == pytest.approx(1.0, abs=1e-3)
