"""The importer `phi_sft_r1`, on the real sequence: its camera, its cloth, and the trackers on its clouds."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from clothbench import ClothbenchError, read_depth, seen_points, to_world
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
def images(folder, tmp_path_factory):
    out = tmp_path_factory.mktemp("phi")
    (report,) = convert(folder, out)
    assert (report.frames_in, report.frames_kept) == (50, 50)
    return read_depth(out / report.output)


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
