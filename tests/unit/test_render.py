"""Camera, projector and renderer against OpenCV, ray casting and textbook geometry."""

import cv2
import numpy as np
import pytest

from clothbench import Camera, ClothbenchError, Projector
from clothbench.vision.depth_camera import sight
from clothbench.vision.render import (
    AMBIENT,
    LIT,
    depth_images,
    expose,
    silhouettes,
    striped,
)
from clothbench.vision.surface import cubic_weights, surface_of

CAMERA = Camera.looking_at((0.3, -1.2, 0.7), (0.02, 0.0, 0.85), (90, 110), 0.42)


def lattice(count=9, side=0.3):
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(0, side, count), np.linspace(0, side, count)))
    return np.stack([u, v], axis=1)


def hung(uv, depth=0.0):
    """An upright sheet (1, N, 3) m, bulging by a sine across."""
    return np.stack([uv[:, 0] - 0.15, depth * np.sin(10 * uv[:, 0]), 1.0 - uv[:, 1]], axis=-1)[None]


def test_points_land_where_opencv_puts_them():
    lens = Camera((640, 480), [[500, 0, 320], [0, 510, 235], [0, 0, 1]], CAMERA.rotation, CAMERA.translation,
                  [0.1, -0.05, 0.002, -0.003, 0.01])  # fmt: skip
    points = np.random.default_rng(0).uniform(-0.3, 0.3, (40, 3)) + np.array([0, 0, 0.85])
    turn = cv2.Rodrigues(np.asarray(lens.rotation))[0]
    expected = cv2.projectPoints(points, turn, np.asarray(lens.translation), lens.matrix, lens.distortion)[0][:, 0]
    pixel, depth = lens.project(points)
    np.testing.assert_allclose(pixel, expected, atol=1e-6)
    assert (depth > 0).all()
    assert np.isnan(lens.project(np.array([0.3, -3.0, 0.7]))[0]).all()  # behind it


def test_what_a_lens_would_fold_back_is_not_in_the_picture():
    lens = Camera((640, 480), [[500, 0, 320], [0, 500, 240], [0, 0, 1]], np.eye(3), np.zeros(3), [-0.3, 0, 0, 0, 0])
    across = np.linspace(0, 3, 61)  # at 1 m; r (1 − 0.3 r²) is largest at 1.054
    pixel = lens.project(np.stack([across, 0 * across, 1 + 0 * across], axis=-1))[0]
    assert np.isfinite(pixel[across < 1.05]).all()
    assert (np.diff(pixel[across < 1.05, 0]) > 0).all()
    assert np.isnan(pixel[across > 1.06]).all()


@pytest.mark.parametrize("bends", [[-0.4, 0.2, 0, 0, 0], [-0.35, 0.15, 1e-3, -1e-3, -0.03], [0.2, -0.5, 0, 0, 0.3]])
def test_lines_of_sight_lead_back_to_their_pixels_through_a_strong_lens(bends):
    lens = Camera((640, 480), [[400, 3, 319.5], [0, 410, 239.5], [0, 0, 1]], np.eye(3), np.zeros(3), bends)
    lines = sight(lens)
    there = np.isfinite(lines).all(axis=-1)
    assert there.mean() > 0.99  # in the farthest corners such a lens may show nothing
    x, y = np.meshgrid(np.arange(640), np.arange(480))
    np.testing.assert_allclose(lens.project(lines)[0][there], np.stack([x, y], axis=-1)[there], atol=0.01)


def test_the_middle_of_the_image_is_what_it_looks_at():
    pixel, depth = CAMERA.project(np.array([0.02, 0.0, 0.85]))
    np.testing.assert_allclose(pixel, [44.5, 54.5])
    assert depth == pytest.approx(np.linalg.norm([0.28, 1.2, 0.15]))
    side = CAMERA.rotation[0] * 0.21  # half of what it sees across
    assert CAMERA.project(np.array([0.02, 0.0, 0.85]) + side)[0][0] == pytest.approx(44.5 + 45)


def test_depth_of_a_plane_is_that_of_its_rays():
    """Every pixel's ray meets the plane y = 0 in closed form; the hem is where the rays leave the sheet."""
    surface = surface_of(lattice(3), 2)
    depth = depth_images(CAMERA, surface, hung(lattice(3)))[0]
    y, x = np.mgrid[0:110, 0:90]
    ray = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(CAMERA.matrix).T @ CAMERA.rotation
    eye = -CAMERA.rotation.T @ CAMERA.translation
    away = -eye[1] / ray[..., 1]
    place = eye + away[..., None] * ray
    inside = (np.abs(place[..., 0]) < 0.15) & (place[..., 2] > 0.7) & (place[..., 2] < 1.0)
    assert np.count_nonzero(np.isfinite(depth) != inside) <= 2  # pixel middles right on the hem
    both = inside & np.isfinite(depth)
    np.testing.assert_allclose(depth[both], away[both], rtol=1e-9)


@pytest.mark.parametrize("behind", [-1, 1])
def test_the_nearer_layer_hides_the_other(behind):
    """A sheet folded along its middle, one half 0.1 m behind the other: what shows is the near half."""
    uv = lattice(5)
    flat = hung(uv)
    side = np.sign(np.round(flat[0, :, 0], 9))
    folded = np.stack([-np.abs(flat[..., 0]), 0.1 * (side == behind)[None], flat[..., 2]], axis=-1)
    near, far = (
        depth_images(CAMERA, surface_of(uv[half]), folded[:, half])[0] for half in (side != behind, side == behind)
    )
    shown = np.isfinite(near)
    assert (shown & np.isfinite(far)).sum() > 0.3 * shown.sum()  # or nothing would be hidden
    depth = depth_images(CAMERA, surface_of(uv), folded)[0]
    np.testing.assert_allclose(depth[shown], near[shown], rtol=1e-9)


def test_stripes_have_the_projector_s_period_and_lie_level_on_a_plane():
    camera = Camera.looking_at((0, -1.0, 0.85), (0, 0, 0.85), (100, 100), 0.25)
    projector = Projector(Camera.looking_at((0, -1.0, 0.85), (0, 0, 0.85), (400, 400), 0.5), 10.0)
    image, shape = striped(camera, projector, surface_of(lattice(), 2), hung(lattice()))
    assert shape.all()  # the sheet fills the picture
    assert np.ptp(image[0], axis=1).max() < 1e-5
    # 10 px of 800 px/m at 1 m are 12.5 mm, which 400 px/m show as 5 px.
    power = np.abs(np.fft.rfft(image[0, :, 50] - image[0, :, 50].mean()))
    assert np.argmax(power) == 20
    assert image.max() <= AMBIENT + LIT + 1e-6
    assert image.min() >= AMBIENT - 1e-6


@pytest.mark.parametrize("nearer", [0.0, 0.01, 0.05])
def test_a_projector_above_the_camera_shows_depth_as_a_shift_of_stripes(nearer):
    """The middle pixel's ray meets the sheet at y = −nearer; triangulation says which stripe lights that point."""
    camera = Camera.looking_at((0, -2.0, 0.85), (0, 0, 0.85), (201, 201), 0.25)
    projector = Projector(Camera.looking_at((0, -2.0, 1.85), (0, 0, 0.85), (4000, 4000), 0.5), 100.0)
    image, _ = striped(camera, projector, surface_of(lattice(), 2), hung(lattice()) - [0, nearer, 0])
    ray = np.array([0.0, 2.0 - nearer, -1.0]) / np.linalg.norm([0.0, 2.0, -1.0])  # from projector to point, over 1
    forward, down = np.array([0.0, 2.0, -1.0]) / np.sqrt(5), np.array([0.0, -1.0, -2.0]) / np.sqrt(5)
    focal = 4000 * np.sqrt(5) / 0.5
    row = 1999.5 + focal * (down @ ray) / (forward @ ray)
    assert image[0, 100, 100] == pytest.approx(AMBIENT + LIT * (0.5 + 0.5 * np.cos(2 * np.pi * row / 100.0)), abs=1e-5)


def test_a_surface_does_not_care_for_the_order_of_its_nodes():
    uv, order = lattice(6), np.random.default_rng(1).permutation(36)
    bulged = hung(uv, 0.03)
    for refine in (1, 3):
        one = depth_images(CAMERA, surface_of(uv, refine), bulged)
        other = depth_images(CAMERA, surface_of(uv[order], refine), bulged[:, order])
        np.testing.assert_allclose(one, other, rtol=1e-13)


def test_refined_lattices_follow_cubics_exactly():
    lines = np.array([0.0, 0.1, 0.25, 0.3, 0.5, 0.6])
    at = np.linspace(0, 0.6, 31)
    np.testing.assert_allclose(cubic_weights(lines, at) @ (lines**3 - lines), at**3 - at, atol=1e-12)
    scattered = np.random.default_rng(2).uniform(0, 0.3, (25, 2))
    assert surface_of(scattered, 4).weight is None
    with pytest.raises(ClothbenchError, match="lie on one line"):
        surface_of(np.array([[0.0, 0.0], [0.1, 0.1], [0.2, 0.2]]))


def test_a_node_that_was_not_seen_takes_only_its_triangles_along():
    uv = lattice(5)
    gap = hung(uv)
    gap[0, 12] = np.nan
    whole, holed = (silhouettes(CAMERA, surface_of(uv), p)[0] for p in (hung(uv), gap))
    assert 0.1 < (whole & ~holed).sum() / whole.sum() < 0.3  # 6 of 32 triangles
    assert not (holed & ~whole).any()


def test_the_sensor_adds_its_noise():
    grey = expose(np.full((50, 80, 80), 0.5), np.random.default_rng(3), noise=3.0)
    assert grey.dtype == np.uint8
    assert grey.mean() == pytest.approx(127.5, abs=0.1)
    assert grey.std() == pytest.approx(np.hypot(3.0, 1 / np.sqrt(12)), rel=0.02)
    assert (expose(np.full((1, 4, 4), 0.5), np.random.default_rng(3), 0.0) == 128).all()
    with pytest.raises(ClothbenchError, match="noise is -1"):
        expose(np.zeros((1, 2, 2)), np.random.default_rng(0), -1)


@pytest.mark.parametrize(
    ("make", "found"),
    [
        (lambda: Camera((9, 9), np.eye(2), np.eye(3), np.zeros(3)), "matrix has shape"),
        (lambda: Camera((9, 9), np.diag([5, -5, 1]), np.eye(3), np.zeros(3)), "found focal lengths 5 and -5 px"),
        (lambda: Camera((9, 9), [[5, 0, 4], [0, 5, 4], [5, 7, 9]], np.eye(3), np.zeros(3)), "and \\[5.0, 7.0, 9.0\\]"),
        (lambda: Camera((9, 9), np.eye(3), np.diag([1, 1, -1]), np.zeros(3)), "no proper rotation"),
        (lambda: Camera((0, 9), np.eye(3), np.eye(3), np.zeros(3)), "size is"),
        (lambda: Camera.looking_at((0, 0, 1), (0, 0, 0), (9, 9), 1.0), "looks along `up`"),
        (lambda: Projector(CAMERA, 0.0), "period is 0.0"),
    ],
)
def test_what_is_no_camera_is_refused(make, found):
    with pytest.raises(ClothbenchError, match=found):
        make()
