"""The importer `phi_sft_r1`, on the real sequence: its camera, its cloth, and the trackers on its clouds."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import cKDTree

from clothbench import ClothbenchError, read_depth, read_video, seen_points, to_world
from clothbench.datasets.phi_sft_r1 import cloud_of, convert, size_of
from clothbench.plugins.discovery import catalogue

MESH = (14, 14)


@pytest.fixture(scope="module")
def folder(data_dir):
    found = data_dir / "phi-sft-R1"
    if not found.is_dir():
        pytest.skip("phi-sft-R1 is not among the measured data")
    return found


@pytest.fixture(scope="module")
def recordings(folder, tmp_path_factory):
    out = tmp_path_factory.mktemp("phi")
    reports = convert(folder, out)
    assert [(report.frames_in, report.frames_kept) for report in reports] == [(50, 50), (50, 50)]
    return [out / report.output for report in reports]


@pytest.fixture(scope="module")
def images(recordings):
    return read_depth(recordings[0])


@pytest.fixture(scope="module")
def video(recordings):
    return read_video(recordings[1])


def test_the_camera_gives_the_clouds_back(folder, images):
    cloud = cloud_of(sorted(folder.glob("ground_truth/*.pt"))[7])
    here = to_world(seen_points(images.metres(7), images.camera), images.camera)[images.depth[7] > 0]
    there = np.stack([cloud[:, 0], cloud[:, 2], -cloud[:, 1]], axis=1)  # the camera looks along +y, level
    away = cKDTree(there).query(here)[0]
    assert np.median(away) < 2e-3
    assert np.percentile(away, 99) < 5e-3


def test_the_cloth_is_as_large_as_its_template(folder, images):
    assert size_of(folder / "templates" / "0_R1_quad.obj") == pytest.approx((0.558, 0.555), abs=1e-3)
    assert "not stated" in images.notes["frame_rate"]
    assert np.isnan(images.areal_density)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "edges"), [("depth_mesh", 2e-3), ("cloud_template", 1e-3)])
def test_trackers_follow_a_real_cloth(images, name, edges):
    seen = catalogue().make("trackers", name, mesh=MESH).track(images)
    assert seen.visible.mean() > 0.95
    away = []
    for frame, (nodes, there) in enumerate(zip(seen.position, seen.visible, strict=True)):
        cloud = to_world(seen_points(images.metres(frame), images.camera), images.camera)[images.depth[frame] > 0]
        away.append(cKDTree(cloud).query(nodes[there])[0])
    assert np.median(np.concatenate(away)) < 3.5e-3  # a pixel is 4.6 mm
    nodes = seen.position.reshape(len(images.time), *MESH, 3)
    steps = [np.linalg.norm(np.diff(nodes, axis=2), axis=-1) - images.cloth_width / 13,
             np.linalg.norm(np.diff(nodes, axis=1), axis=-1) - images.cloth_height / 13]  # fmt: skip
    assert np.sqrt(np.nanmean(np.concatenate([s.ravel() for s in steps]) ** 2)) < edges


def test_a_folder_without_clouds_is_refused(tmp_path):
    with pytest.raises(ClothbenchError, match=r"found no ground_truth/point_cloud_NNN\.pt"):
        convert(tmp_path, tmp_path / "out")


def test_the_template_is_the_cloth_of_the_first_picture(video):
    seen = (
        catalogue().make("trackers", "sift_graph", mesh=(13, 13)).track(dataclasses.replace(video, **first(video, 2)))
    )
    assert seen.visible[0].mean() > 0.98
    place = seen.sight.project(seen.position[0])[0].reshape(13, 13, 2)
    assert (np.diff(place[..., 0], axis=1) > 20).all()  # u to the right, v down
    assert (np.diff(place[..., 1], axis=0) > 20).all()


def first(video, count):
    return {"time": video.time[:count], "ends": video.ends[:count], "stream": video.stream[: video.ends[count - 1]]}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "options", "low", "high", "share"),
    [("sift_graph", {}, 0.0, 2.5e-3, 0.95), ("sift_graph", {"place": "literal"}, 8e-3, 20e-3, 0.9),
     ("optical_flow", {}, 0.0, 2.5e-3, 0.85)],
)  # fmt: skip
def test_a_graph_follows_a_real_cloth(folder, video, name, options, low, high, share):
    """Nodes lifted onto the clouds: what a cell's edge is off by. The paper's rule is off by a third of a cell."""
    short = dataclasses.replace(video, **first(video, 13))
    seen = catalogue().make("trackers", name, mesh=(13, 13), **options).track(short)
    assert seen.visible.mean() > share
    off = []
    for frame, path in list(enumerate(sorted(folder.glob("ground_truth/*.pt"))[:13]))[::6]:
        x, y, z = cloud_of(path).T
        (fx, _, cx), (_, fy, cy), _ = video.camera.matrix
        pixel = seen.sight.project(np.nan_to_num(seen.position[frame]))[0]
        pixel[~seen.visible[frame]] = np.nan
        there = LinearNDInterpolator(np.stack([fx * x / z + cx, fy * y / z + cy], axis=1), np.stack([x, y, z], axis=1))
        nodes = there(pixel).reshape(13, 13, 3)
        for axis, size in ((1, video.cloth_width), (0, video.cloth_height)):
            off.append(np.abs(np.linalg.norm(np.diff(nodes, axis=axis), axis=-1) - size / 13).ravel())
    assert low < np.nanmedian(np.concatenate(off)) < high
