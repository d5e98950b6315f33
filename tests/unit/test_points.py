"""Recordings of kind "points": what is stored, what is refused, and what is made of clouds without identity."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

from clothbench import ClothbenchError, Observation, Obstacle, PointCloud, Rollout, read_points, scene_of, write_points
from clothbench.cli.commands import main
from clothbench.engine.suite import plan
from clothbench.estimation.trials import Trial, simulated
from clothbench.estimation.watched import cloud_seen
from clothbench.plugins.discovery import catalogue
from clothbench.recordings.kinds import read_any, read_sheet
from clothbench.recordings.nodes import read_recording

TIME = np.arange(6) / 20.0
GRIPS = np.array([[0.0, 0.0], [0.3, 0.0]])


def hung(**changes) -> PointCloud:
    """A sheet of 0.3 × 0.4 m that hangs from its upper corners, seen at 120 places that differ from frame to frame."""
    random = np.random.default_rng(3)
    u, v = random.uniform(0.0, 1.0, (2, 6, 120)) * np.array([0.3, 0.4])[:, None, None]
    position = np.stack([u, 0.02 * np.sin(9 * u), 1.0 - v], axis=-1)
    position[:, 100:][random.random((6, 20)) < 0.5] = np.nan
    position[4] = np.nan  # a blank frame
    held = np.broadcast_to([[0.0, 0.0, 1.0], [0.3, 0.0, 1.0]], (6, 2, 3))
    content = {"name": "hung", "time": TIME, "position": position, "grip_time": TIME, "grip_material": GRIPS,
               "grip_position": held, "cloth_width": 0.3, "cloth_height": 0.4, "areal_density": 0.15,
               "noise_sigma": 1e-3, "fabric": "cotton", "notes": {"room": "4"}}  # fmt: skip
    return PointCloud(**{**content, **changes})


@pytest.mark.parametrize(
    "more",
    [
        {},
        {"thickness": 0.002, "obstacles": (Obstacle("plane"),)},
        {"outline": np.array([[0.0, 0.0], [0.3, 0.0], [0.3, 0.4], [0.1, 0.4]])},
    ],
)
def test_a_file_holds_all_of_it(tmp_path, capsys, more):
    given = hung(**more)
    path = write_points(given, tmp_path / "hung.nc")
    again = read_points(path)
    assert again.hash == given.hash == read_any(path).hash == read_sheet(path).hash
    np.testing.assert_array_equal(again.position, given.position)
    assert (again.kind, again.fabric, again.notes, again.noise_sigma) == ("points", "cotton", {"room": "4"}, 1e-3)
    assert again.thickness == more.get("thickness")
    assert [o.shape for o in again.obstacles or ()] == [o.shape for o in given.obstacles or ()]
    assert main(["validate", str(path)]) == 0
    assert capsys.readouterr().out == f"{path}: ok\n"


def moved(frame: int, point: int, *place: float) -> np.ndarray:
    position = np.array(hung().position)
    position[frame, point] = place
    return position


@pytest.mark.parametrize(
    ("change", "found"),
    [
        ({"name": ""}, "attribute 'name': found nothing"),
        ({"time": TIME[::-1]}, "variable 'time': found 0.2 s after 0.25 s at index 1, expected strictly increasing"),
        ({"time": 1e3 * TIME}, "variable 'time': found frames 50 s apart"),
        ({"position": hung().position[:4]}, "variable 'position': found 4 along 'time', expected 6 as in 'time'"),
        ({"position": hung().position[..., :2]}, "variable 'position': found 2 along 'space', expected 3"),
        ({"position": hung().position[:, 0]}, "variable 'position': found shape (6, 3), expected (time, point, space)"),
        ({"position": np.full((6, 9, 3), np.nan)}, "variable 'position': found only NaN"),
        ({"position": moved(2, 5, np.inf, 0, 0)}, "the first at frame 2, point 5, expected metres"),
        ({"position": moved(2, 5, np.nan, 0, 1)}, "points of which a coordinate is missing, the first at frame 2"),
        ({"position": 1e3 * hung().position}, "expected 25 m at most of a cloth 0.5 m across; are these millimetres?"),
        ({"position": np.where(np.isnan(hung().position), np.nan, 1.0)}, "found points 0 m apart at most"),
        ({"position": moved(3, 7, -999, -999, -999)}, "found point 7 at frame 3 at (-999, -999, -999) m"),
        ({"position": moved(3, 7, 0.1, 2.0, 1.0)}, "m from the nearest grip, expected 1 m at most of a cloth 0.5 m"),
        ({"grip_position": 1e3 * hung().grip_position}, "variable 'grip_position': found grips 300 m apart"),
        ({"grip_material": GRIPS + 0.5}, "variable 'grip_material': found (0.5, 0.5) m at row 0"),
        ({"grip_material": GRIPS[:0], "grip_position": np.zeros((6, 0, 3))}, "found no entries along 'grip'"),
        ({"grip_time": TIME + 0.2}, "variable 'grip_time': found 0.2..0.45 s"),
        (
            {
                "grip_time": np.r_[np.arange(9), 500, 501] / 100,
                "grip_position": hung().grip_position[:1] + np.linspace(0, 0.1, 11)[:, None, None],
            },
            "variable 'grip_time': found none from 0.08 to 5 s, where 0.01 s",
        ),
        ({"cloth_width": 300.0}, "attribute 'cloth_width': found 300 m"),
        ({"areal_density": "150"}, "attribute 'areal_density': found '150', expected a number"),
        ({"areal_density": -1.0}, "attribute 'areal_density': found -1.0"),
        ({"gravity": (0.0, 0.0, 9.81)}, "which pulls up"),
        ({"noise_sigma": 1.0}, "attribute 'noise_sigma': found 1 m"),
        ({"split": "train"}, "attribute 'split': found 'train'"),
        ({"thickness": -1.0}, "attribute 'thickness': found -1.0"),
    ],
)  # fmt: skip
def test_every_fault_is_one_line_with_file_and_field(change, found):
    with pytest.raises(ClothbenchError, match=re.escape(found)) as caught:
        hung(**change)
    said = str(caught.value)
    assert said.startswith("hung: " if change.get("name") != "" else ": ")
    assert "\n" not in said


def test_a_reader_of_nodes_says_which_kind_it_found(tmp_path):
    path = write_points(hung(), tmp_path / "hung.nc")
    with pytest.raises(ClothbenchError, match=r"attribute 'kind': found 'points', expected 'nodes'$"):
        read_recording(path)


def test_cloth_that_only_an_obstacle_bears_needs_no_grips():
    lying = hung(grip_material=GRIPS[:0], grip_position=np.zeros((6, 0, 3)), obstacles=(Obstacle("plane"),))
    assert lying.counts.any()


def test_a_lattice_as_dense_as_the_clouds_is_simulated_and_the_cloud_keeps_its_own_points():
    cloud = hung()
    seen = catalogue().make("trackers", "cloud").track(cloud)
    assert seen.cloud
    assert seen.position.shape == (6, 120, 3)
    assert not seen.visible[4].any()
    assert seen.sigma == 1e-3
    u, v = (np.unique(column) for column in seen.material.T)
    assert (u[0], u[-1], v[0], v[-1]) == (0.0, 0.3, 0.0, 0.4)
    assert np.diff(u)[0] == pytest.approx(np.diff(v)[0], rel=0.1)
    assert 0.8 * 110 < len(seen.material) < 1.5 * 110
    scene = scene_of(cloud)
    np.testing.assert_array_equal(scene.points, seen.material)
    assert scene.start is None
    model = catalogue().make("models", "mass_spring", resolution=5)
    metric = catalogue().make("metrics", "chamfer")
    trial = Trial("hung", seen, model.prepare(scene, []), metric)
    rollout = simulated(trial, trial.simulation.parameters.defaults[None])
    assert rollout.position.shape == (1, 6, len(seen.material), 3)
    assert 0 < metric(seen, rollout).value[0] < 30  # mm, about half the points' spacing
    assert np.isnan(metric.floor(seen))


def test_a_lattice_lies_on_the_outline():
    corners = np.array([[0.0, 0.0], [0.3, 0.0], [0.3, 0.2], [0.0, 0.2]])
    lattice = hung(outline=corners).lattice
    assert 20 < len(lattice) < 100
    assert lattice[:, 1].max() < 0.201


def test_a_cloud_with_as_many_points_as_are_simulated_has_no_identity_either():
    seen = catalogue().make("trackers", "cloud").track(hung())
    points = np.array(seen.position[:, : len(seen.material)])
    same = Observation(seen.time, points, seen.visible[:, : len(seen.material)], 1e-3, seen.material, cloud=True)
    whole = np.nan_to_num(points, nan=5.0)  # which, were it one to one, would count nowhere
    rollout = Rollout(same.time, whole[None], ("ok",), np.zeros(1, int), len(seen.material))
    assert catalogue().make("metrics", "hausdorff")(same, rollout).value[0] > 1e3
    with pytest.raises(ClothbenchError, match="points without identity"):
        catalogue().make("metrics", "node_error")(same, rollout)
    with pytest.raises(ClothbenchError, match="points without identity"):
        same.differences(rollout.position)


@pytest.mark.parametrize(
    ("settings", "found"),
    [
        (
            {"metric": ["node_error"]},
            "which the metric 'node_error' does not compare; take metric=chamfer or hausdorff",
        ),
        ({"report": ["relative_error"]}, "which the metric 'relative_error' does not compare"),
        ({"tracker": "markers"}, "which the tracker 'markers' does not read; take tracker=cloud"),
        ({"scene": {"start": "measured"}}, "use scene.start=rest"),
        ({"scene": {"outline": [[0, 0], [0.3, 0], [0.3, 0.3]]}}, "found scene.outline, expected an outline in the"),
        ({"study": "improve"}, "found kind 'points', whose points nobody knows again"),
    ],
)
def test_what_needs_an_identity_is_refused_before_a_run(tmp_path, settings, found):
    path = write_points(hung(), tmp_path / "hung.nc")
    known = {"study": "calibration", "model": ["mass_spring"], "optimizer": ["ga"], "recording": str(path)}
    known |= {"tracker": "cloud", "budget": 4, "seed": 0, "jobs": 0, "rerun": False, "out": "runs"}
    known |= {} if "study" in settings else {"metric": ["chamfer"]}
    with pytest.raises(ClothbenchError, match=re.escape(found)) as caught:
        plan({**known, **settings}, catalogue())
    assert str(caught.value).startswith(f"{path}: ")


def test_a_tracker_that_gives_something_else_of_a_cloud_is_told():
    cloud = hung()
    seen = catalogue().make("trackers", "cloud").track(cloud)
    assert cloud_seen(cloud, seen, "own") is seen
    with pytest.raises(ClothbenchError, match="tracker 'own': found another observation of hung than of a cloud"):
        cloud_seen(cloud, dataclasses.replace(seen, material=seen.material / 2), "own")
