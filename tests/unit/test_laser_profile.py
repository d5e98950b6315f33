"""The laser tracker on rendered images whose truth is known, and files of kind "laser"."""

import dataclasses

import numpy as np
import pytest
from clothbench_trackers.laser_profile import LaserProfile, in_plane, scatter
from scipy.spatial import cKDTree

from clothbench import ClothbenchError, LaserImages, read_laser, write_laser
from clothbench.core.optional import kinds_read
from clothbench.estimation.watched import require_readable
from clothbench.plugins import discovery
from clothbench.recordings.kinds import read_any
from clothbench.studies.folding.laser_camera import rendered, upper_side
from clothbench.testing import check_tracker


def hook() -> np.ndarray:
    """A strip that lies flat, rises in a quarter circle of 5 cm and stands straight: (4001, 2) m."""
    u = np.linspace(0.0, 0.9, 4001)
    slope = np.clip((u - 0.6) / 0.05, 0.0, np.pi / 2)
    step = np.diff(u, prepend=0.0)
    return np.stack([np.cumsum(np.cos(slope) * step), np.cumsum(np.sin(slope) * step)], axis=1)


@pytest.fixture(scope="module")
def images() -> LaserImages:
    return rendered("hook", hook(), 0.0, 3)


def test_points_lie_on_the_sheet(images):
    seen = LaserProfile().track(images)
    points = seen.position[0, seen.visible[0]]
    assert np.abs(points[:, 1]).max() < 1e-9  # in the laser's plane
    away = cKDTree(hook()).query(points[:, [0, 2]])[0]
    assert np.sqrt((away**2).mean()) < 0.5e-3
    assert 0.3 < seen.sigma / np.sqrt((away**2).mean()) < 1.5
    back = cKDTree(points[:, [0, 2]]).query(hook()[40:-40])[0]
    assert np.quantile(back, 0.99) < 5e-3  # and the whole of it is seen


def test_pixels_are_traced_back_through_the_lens(images):
    import cv2

    points = np.stack([np.linspace(0, 1, 9), np.zeros(9), np.linspace(0.0, 0.4, 9)], axis=1)
    turn = cv2.Rodrigues(np.array(images.camera_rotation))[0]
    pixels = cv2.projectPoints(
        points, turn, np.array(images.camera_translation), np.array(images.camera_matrix), np.array(images.distortion)
    )[0][:, 0]
    assert in_plane(images, pixels) == pytest.approx(points, abs=1e-5)


def test_what_lies_under_a_layer_is_not_seen():
    """A strip that rises in a bow and goes back over itself, 10 cm above: the lower layer is lit beside it only."""
    u = np.linspace(0.0, 1.2, 2401)
    turn = np.clip((u - 0.7) / 0.05, 0.0, np.pi)
    step = np.diff(u, prepend=0.0)
    folded = np.stack([np.cumsum(np.cos(turn) * step), np.cumsum(np.sin(turn) * step)], axis=1)
    end = folded[-1, 0]
    seen = upper_side(folded)
    lower = u < 0.7
    assert seen[lower & (folded[:, 0] < end - 0.15)].all()
    assert not seen[lower & (folded[:, 0] > end + 0.15)].any()


def test_what_meets_the_plane_behind_the_camera_was_not_seen(images):
    level = dataclasses.replace(images, laser_plane=np.array([0.0, 0.0, 1.0, images.camera_translation[1] + 9.0]))
    assert in_plane(level, np.array([[800.0, 890.0]])).shape == (0, 3)  # it looks down, the plane is high above


def test_speckle_alone_is_no_line(images):
    dark = np.random.default_rng(0).integers(0, 20, images.image.shape).astype(np.uint8)
    with pytest.raises(ClothbenchError, match="found no laser line of contrast 25"):
        LaserProfile().track(dataclasses.replace(images, image=dark))


def test_of_a_line_too_short_to_judge_nobody_knows_the_noise(images):
    short = np.zeros_like(images.image)
    short[0, 699:702, 600:620] = [[120], [250], [120]]
    seen = LaserProfile().track(dataclasses.replace(images, image=short))
    assert seen.visible.any()
    assert np.isnan(seen.sigma)


def test_the_noise_of_a_line_has_two_degrees_of_freedom_less_than_points():
    """Of 45 neighbours that lie 0.1 mm to either side in turn, about the straight line through them."""
    along = np.linspace(0.0, 0.2, 201)
    aside = 1e-4 * (-1.0) ** np.arange(201)
    points = np.stack([along, 0 * along, 0.5 * along], axis=1) + aside[:, None] * np.array([-0.5, 0, 1]) / 1.25**0.5
    assert scatter(points) == pytest.approx(1e-4 * np.sqrt((45 - 1 / 45) / 43), rel=1e-4)
    assert np.isnan(scatter(points[:44]))


def test_a_file_gives_what_the_images_gave(images, tmp_path):
    path = write_laser(images, tmp_path / "hook.nc")
    again = read_laser(path)
    assert again.hash == images.hash == read_any(path).hash
    assert np.array_equal(LaserProfile().track(path).position, LaserProfile().track(images).position, equal_nan=True)
    check_tracker(LaserProfile, source=path)


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"name": ""}, "attribute 'name'"),
        ({"camera_matrix": np.eye(2)}, r"variable 'camera_matrix': found shape \(2, 2\), expected \(3, 3\)"),
        ({"camera_matrix": np.diag([-5.0, 5.0, 1.0])}, "variable 'camera_matrix': found focal lengths -5 and 5 px"),
        ({"image": np.zeros((1, 8, 900), np.uint8)}, "variable 'image': found shape"),
        ({"camera_rotation": 2 * np.eye(3)}, "variable 'camera_rotation': found no rotation"),
        ({"camera_rotation": np.diag([1.0, 1.0, -1.0])}, "variable 'camera_rotation': found no rotation"),
        ({"laser_plane": np.array([0.0, 2.0, 0.0, 0.0])}, "variable 'laser_plane'"),
    ],
    ids=["name", "matrix", "focal", "image", "rotation", "mirror", "plane"],
)
def test_bad_images_are_refused_in_one_line(images, change, fault):
    with pytest.raises(ClothbenchError, match=fault):
        dataclasses.replace(images, **change)


def test_what_it_reads_is_said_so_that_nobody_is_sent_to_it_in_vain(recording):
    assert kinds_read(LaserProfile) == {"laser"}
    with pytest.raises(ClothbenchError, match=r"does not read; take tracker=markers or stripes$"):
        require_readable(recording, "depth_mesh", discovery.catalogue())
    with pytest.raises(ClothbenchError, match="found kind 'nodes', which the tracker 'laser_profile' does not read"):
        require_readable(recording, "laser_profile", discovery.catalogue())
    (outcome,) = check_tracker(LaserProfile, only=["keeps what it offers"])
    assert outcome.skipped == "shows no steps"


def test_bad_options_are_refused():
    with pytest.raises(ClothbenchError, match="width is -1, expected a number above 0"):
        LaserProfile(width=-1)
    with pytest.raises(ClothbenchError, match="width is inf, expected a number above 0"):
        LaserProfile(width=float("inf"))
    with pytest.raises(ClothbenchError, match=r"width is 1000\.0, expected 100 pixels at most"):
        LaserProfile(width=1e3)
    with pytest.raises(ClothbenchError, match=r"shortest is 0\.5, expected a whole number ≥ 1"):
        LaserProfile(shortest=0.5)
    with pytest.raises(ClothbenchError, match="no option 'blur'; there are: width, contrast, shortest"):
        discovery.catalogue().make("trackers", "laser_profile", blur=2)
