"""Recordings of kind "depth": what is stored, what is refused, and folders that become one."""

from __future__ import annotations

import dataclasses
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from clothbench import Camera, ClothbenchError, DepthImages, read_depth, write_depth
from clothbench.core.files import in_order
from clothbench.core.observation import GripPath
from clothbench.datasets.depth_folder import read_folder
from clothbench.recordings.depth import Colour
from clothbench.recordings.kinds import read_any, read_sheet

CAMERA = Camera.looking_at(np.array([0.0, -1.0, 0.8]), np.array([0.0, 0.0, 0.8]), (48, 40), 0.5)
TIME = np.arange(6) / 20.0


HELD_AT, HELD = np.array([[0.0, 0.0], [0.3, 0.0]]), np.array([[0.0, 0.0, 1.0], [0.3, 0.0, 1.0]])


def grips_at(position: np.ndarray) -> GripPath:
    """Grips (G, 3) m that stay where they are."""
    return GripPath(TIME, HELD_AT[: len(position)], np.tile(position, (len(TIME), 1, 1)))


def images(**changes) -> DepthImages:
    depth = np.full((6, 40, 48), 1000, np.uint16)
    depth[:, :3] = 0
    corners = np.array([[0.0, 0.0, 1.0], [0.3, 0.0, 1.0]])
    grips = GripPath(TIME, corners[:, :2], np.tile(corners, (6, 1, 1)))
    colour = Colour(TIME - 0.01, np.full((6, 40, 48, 3), 90, np.uint8))
    content = {"name": "run", "time": TIME, "depth": depth, "depth_step": 1e-3, "camera": CAMERA, "cloth_width": 0.3,
               "cloth_height": 0.4, "colour": colour, "grips": grips, "notes": {"room": "4"}}  # fmt: skip
    return DepthImages(**{**content, **changes})


@pytest.mark.parametrize("without", [{}, {"colour": None}, {"grips": None}, {"colour": None, "grips": None}])
def test_a_file_holds_all_of_it(tmp_path, without):
    given = images(**without)
    path = write_depth(given, tmp_path / "run.nc")
    again = read_depth(path)
    assert again.hash == given.hash
    assert again.notes == {"room": "4"}
    assert np.array_equal(again.depth, given.depth)
    assert np.array_equal(again.camera.matrix, CAMERA.matrix)
    assert (again.colour is None, again.grips is None) == (given.colour is None, given.grips is None)
    assert read_any(path).hash == read_sheet(path).hash == given.hash


def test_metres_are_not_a_number_where_nothing_was_measured():
    depth = images().metres(0)
    assert np.isnan(depth[:3]).all()
    assert depth[5, 5] == 1.0


def frames(**changes):
    depth = np.array(images().depth)
    for frame, value in changes.items():
        depth[int(frame[1:])] = value
    return depth


@pytest.mark.parametrize(
    ("change", "found"),
    [
        ({"time": TIME[::-1]}, "expected strictly increasing"),
        ({"time": np.array([0, 0.05, 0.1, 0.15, 0.2, 9.0])}, "found a jump of 8.8 s at index 5"),
        ({"depth": frames(f2=0, f4=0)}, "found 2 frames that hold no depth at all (2, 4)"),
        ({"depth": images().depth[:, :30]}, "found shape (6, 30, 48), expected (6, 40, 48)"),
        ({"depth_step": 1.0}, "found a middle of all depths of 1000 m"),
        ({"depth_step": 0.0}, "'depth_step': found 0.0, expected metres above 0"),
        ({"cloth_width": -1.0}, "'cloth_width': found -1.0"),
        ({"gravity": (0.0, 0.0, np.nan)}, "'gravity': found (0.0, 0.0, nan), expected three finite numbers"),
        ({"split": "test"}, "'split': found 'test'"),
        ({"name": ""}, "'name': found nothing"),
        ({"noise_sigma": -1e-3}, "'noise_sigma': found -0.001, expected metres, 0 or above"),
        ({"noise_sigma": 5.0}, "'noise_sigma': found 5 m on a cloth of 0.3 m by 0.4 m, expected 0.1 m at most"),
        ({"thickness": np.nan}, "'thickness': found nan, expected metres, 0 or above"),
        ({"notes": {"obstacle_shape": "plane"}}, "run: 'obstacle_shape': found a note that nodes tracked in"),
        ({"notes": {"obstacle_shapes": "plane"}}, "'obstacle_shapes': found a note that nodes tracked in recordings"),
        ({"notes": {"material": "silk"}}, "'material': found a note that nodes tracked in recordings"),
        ({"colour": Colour(TIME[:5], np.zeros((6, 40, 48, 3), np.uint8))}, "'colour_time': found 5 stamps, expected 6"),
        ({"colour": Colour(TIME, np.zeros((6, 20, 24, 3), np.uint8))}, "registered to the depth"),
        ({"grips": GripPath(TIME, np.array([[0.0, 0.0]]), np.full((6, 1, 3), np.nan))}, "not finite"),
        ({"grips": GripPath(TIME, np.array([[0.9, 0.0]]), np.zeros((6, 1, 3)))}, "expected inside the 0.3 m × 0.4 m"),
        (
            {"grips": grips_at(1e3 * HELD)},
            "'grip_position': found grips 300 m apart in the middle of all",
        ),
        ({"grips": grips_at(1e3 * HELD[:1])}, "'grip_position': found grips 999.2"),
        ({"camera": dataclasses.replace(CAMERA, translation=1e3 * CAMERA.translation)}, "of that; are these, or the"),
        (
            {"grips": GripPath(np.r_[np.arange(9), 500, 501] / 100, HELD_AT, HELD + np.arange(11)[:, None, None] / 99)},
            "'grip_time': found none from 0.08 to 5 s, where 0.01 s between stamps are usual, and 33% of the frames",
        ),
        ({"grips": GripPath(TIME + 7, np.array([[0.0, 0.0]]), np.zeros((6, 1, 3)))}, "covers 0% of the frames"),
    ],
)
def test_every_fault_of_a_sensor_has_its_line(change, found):
    with pytest.raises(ClothbenchError) as caught:
        images(**change)
    assert found in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_without_calibration_is_refused(tmp_path):
    import h5py

    path = write_depth(images(), tmp_path / "run.nc")
    with h5py.File(path, "a") as stream:
        del stream.attrs["camera_matrix"]
    with pytest.raises(ClothbenchError, match="'camera_matrix' is missing; a depth recording needs it"):
        read_depth(path)


def test_stamps_of_no_pictures_are_refused(tmp_path):
    import h5py

    path = write_depth(images(), tmp_path / "run.nc")
    with h5py.File(path, "a") as stream:
        del stream["colour"]
    with pytest.raises(ClothbenchError, match="variable 'colour' is missing beside 'colour_time'"):
        read_depth(path)


ABOUT = {
    "name": "bench/run 1", "cloth_width": 0.3, "cloth_height": 0.4, "rate": 20, "split": "fit", "weather": "fair",
    "camera": {"size": [48, 40], "fx": 100.0, "fy": 100.0, "cx": 23.5, "cy": 19.5},
}  # fmt: skip


def folder_of(tmp_path, about=ABOUT, colour=True):
    import cv2

    folder = tmp_path / "session"
    for part in ("depth", "colour"):
        (folder / part).mkdir(parents=True)
    for k in range(6):
        cv2.imwrite(str(folder / "depth" / f"{k:03d}.png"), images().depth[k])
        if colour:
            cv2.imwrite(str(folder / "colour" / f"{k:03d}.png"), np.full((40, 48, 3), (200, 10, 30), np.uint8))
    (folder / "recording.json").write_text(json.dumps(about))
    return folder


@pytest.mark.parametrize(("word", "meant"), [("grip", "grips"), ("splitt", "split"), ("arealdensity", "areal_density")])
def test_a_word_that_is_nearly_one_is_refused(tmp_path, word, meant):
    """As a note it would vanish: a sheet without its grips, or of no known weight."""
    about = {k: v for k, v in ABOUT.items() if k != meant}
    with pytest.raises(ClothbenchError, match=f"recording.json: found '{word}', expected '{meant}'"):
        read_folder(folder_of(tmp_path, {**about, word: "x"}))


def test_a_folder_of_frames_becomes_a_recording(clothbench, tmp_path):
    folder_of(tmp_path)
    ran = clothbench("import", "session", "out=made")
    assert ran.returncode == 0, ran.stderr
    made = read_depth(tmp_path / "made" / "bench_run_1.nc")
    assert np.array_equal(made.depth, images().depth)
    assert np.allclose(made.time, TIME)
    assert made.colour.frame[0, 0, 0].tolist() == [30, 10, 200]
    assert (made.split, made.notes) == ("fit", {"weather": "fair"})
    said = "clothbench: session/recording.json: kept as notes, which neither trackers nor models heed: weather\n"
    assert ran.stderr.endswith(said)
    assert clothbench("validate", "made").returncode == 0
    ran = clothbench("import", "session", "out=made here")
    assert "next: clothbench run recording='made here/bench_run_1.nc' tracker=depth_mesh" in ran.stdout


@pytest.mark.parametrize("form", ["npy", "NPY", "ascii", "binary", "carriage returns"])
def test_clouds_become_depth(tmp_path, form):
    from clothbench.datasets.depth_folder import read_folder

    folder = folder_of(tmp_path, colour=False)
    shutil.rmtree(folder / "depth")
    (folder / "clouds").mkdir()
    x, y = np.meshgrid(np.linspace(-0.2, 0.2, 60), np.linspace(-0.15, 0.15, 60))
    points = np.stack([x.ravel(), y.ravel(), 1.0 + 0.1 * x.ravel()], axis=1)
    for k in range(3):
        file = folder / "clouds" / f"{k}.{form if form.lower() == 'npy' else 'ply'}"
        head = "ply\nformat {} 1.0\nelement vertex 3600\n" + 3 * "property float {}\n" + "end_header\n"
        if form.lower() == "npy":
            with file.open("wb") as stream:  # by its name NumPy would put one ending more
                np.save(stream, points)
        elif form in ("ascii", "carriage returns"):
            body = "\n".join(" ".join(f"{v:.6f}" for v in p) for p in points)
            whole = head.format("ascii", *"xyz") + body + "\n"
            file.write_text(whole, newline="\r\n" if form == "carriage returns" else "\n")
        else:
            file.write_bytes(head.format("binary_little_endian", *"xyz").encode() + points.astype("<f4").tobytes())
    made = read_folder(folder)
    assert made.depth.shape == (3, 40, 48)
    row, column = np.nonzero(made.depth[0])
    across = (column - 23.5) / 100.0 * made.metres(0)[row, column]
    assert np.abs(made.metres(0)[row, column] - 1.0 - 0.1 * across).max() < 2e-3


@pytest.mark.parametrize("rows", ["0 0 1\n" * 3, "0 0 1\n" * 3 + "0 0", "0 0 1\n" * 3 + "3 0 1 2\n"])
def test_a_cloud_cut_short_is_refused(tmp_path, rows):
    """Of four vertices and a face: rows are missing, and what stands in the fourth place is no vertex."""
    from clothbench.datasets.depth_folder import read_cloud

    head = "element vertex 4\n" + "".join(f"property float {c}\n" for c in "xyz") + "element face 1\n"
    head += "property list uchar int vertex_indices\nend_header\n"
    (tmp_path / "a.ply").write_text("ply\nformat ascii 1.0\n" + head + "0 0 1\n" * 4 + "3 0 1 2\n")
    assert read_cloud(tmp_path / "a.ply").shape == (4, 3)
    (tmp_path / "b.ply").write_text("ply\nformat ascii 1.0\n" + head + rows)
    with pytest.raises(ClothbenchError, match=r"b.ply: found \d rows, expected 5, the first 4 with 3 numbers each"):
        read_cloud(tmp_path / "b.ply")


@pytest.mark.parametrize(
    ("change", "found"),
    [
        ({"camera": None}, "'camera' is missing: size and matrix, or fx, fy, cx, cy; without a calibration"),
        ({"camera": {"size": [48, 40], "fx": 1}}, "'camera': found KeyError 'cx'"),
        ({"camera": {**ABOUT["camera"], "size": [64, 48]}}, "000.png: found 48 × 40 px, expected camera.size (64, 48)"),
        ({"camera": {**ABOUT["camera"], "size": [48.9, 40]}}, "size is [48.9, 40], expected whole numbers of pixels"),
        ({"camera": {**ABOUT["camera"], "fy": -500}}, "matrix: found focal lengths 100 and -500 px"),
        ({"camera": {**ABOUT["camera"], "distorsion": [0] * 5}}, "'camera': found 'distorsion', expected cx, cy, dist"),
        ({"rate": None}, "'rate' is missing"),
        ({"rate": 0}, "'rate': found 0, expected frames per second"),
        ({"time": [0.0, 1.0]}, "'time': found 2 stamps, expected 6"),
        ({"colour_time": [0.0, 0.05]}, "'colour_time': found 2 stamps, expected 6, one for each picture"),
        ({"depth_step": 1.0}, "is depth_step, 1 m, that of the sensor?"),
        ({"grips": {"time": [0, 1]}}, "'grips': found KeyError 'material'"),
        (
            {"grips": {"time": [0, 1], "material": 5, "position": [[[0, 0, 1]]] * 2}},
            "'grip_material': found shape (), expected (grip, uv)",
        ),
        (
            {"grips": {"time": [[0, 1], [2, 3]], "material": [[0, 0]], "position": [[[0, 0, 1]]] * 2}},
            "'grip_time': found shape (2, 2), expected (grip_time)",
        ),
    ],
)
def test_a_bad_folder_is_refused_in_one_line(clothbench, tmp_path, change, found):
    about = {k: v for k, v in {**ABOUT, **change}.items() if v is not None}
    folder_of(tmp_path, about)
    ran = clothbench("import", "session", "out=made")
    assert ran.returncode == 2
    assert found in ran.stderr
    assert len(ran.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "made").exists()


@pytest.mark.parametrize(
    ("change", "found"),
    [
        ({"time": TIME.tolist()}, "'rate': found it beside 'time', expected one of them"),
        ({"camera": {**ABOUT["camera"], "matrix": np.eye(3).tolist()}}, "'camera': found 'fx' beside 'matrix'"),
        (
            {"grips": {"time": [0, 1], "material": [[0, 0]], "position": [[[0, 0, 1]]] * 2, "unit": "mm"}},
            "'grips': found 'unit', expected time, material, position (s, m, m)",
        ),
        ({"name": None}, "'name': found None, expected text"),
        ({"name": 5}, "'name': found 5, expected text"),
        ({"name": " "}, "'name': found ' ', expected text"),
    ],
)
def test_what_a_folder_states_twice_or_in_words_that_mean_nothing_is_refused(tmp_path, change, found):
    with pytest.raises(ClothbenchError, match=re.escape(f"recording.json: {found}")):
        read_folder(folder_of(tmp_path, {**ABOUT, **change}))


def test_clouds_go_through_the_lens_and_back(tmp_path):
    from clothbench.datasets.depth_folder import projected
    from clothbench.vision.depth_camera import seen_points

    camera = dataclasses.replace(images().camera, distortion=np.array([-0.4, 0.1, 0.0, 0.0, 0.0]))
    x, y = np.meshgrid(np.linspace(-0.2, 0.2, 90), np.linspace(-0.15, 0.15, 90))
    depth = projected(np.stack([x, y, 1 + 0 * x], axis=-1).reshape(-1, 3), camera, 1e-3, tmp_path)
    back = seen_points(np.where(depth > 0, 1e-3 * depth, np.nan), camera)
    assert np.nanmax(back[..., 0]) == pytest.approx(0.2, abs=6e-3)  # a pixel is 10 mm


def test_another_recording_of_that_name_is_not_written_over(tmp_path):
    from clothbench.datasets.depth_folder import depth_recording

    folder = folder_of(tmp_path)
    (tmp_path / "made").mkdir()
    (tmp_path / "made" / "bench_run_1.nc").symlink_to(tmp_path / "elsewhere.nc")  # which nobody named
    made = depth_recording(folder, tmp_path / "made")
    assert not made.is_symlink()
    assert not (tmp_path / "elsewhere.nc").exists()
    assert depth_recording(folder, tmp_path / "made") == made
    before = made.read_bytes()
    (folder / "recording.json").write_text(json.dumps({**ABOUT, "rate": 25}))
    with pytest.raises(ClothbenchError, match=r"bench_run_1.nc: found another recording, expected no file of that"):
        depth_recording(folder, tmp_path / "made")
    made.write_text("no recording")
    with pytest.raises(ClothbenchError, match="found another recording"):
        depth_recording(folder, tmp_path / "made")
    assert before.startswith(b"\x89HDF")


def test_frames_come_in_the_order_of_their_numbers(tmp_path):
    from clothbench.datasets.depth_folder import read_folder

    folder = folder_of(tmp_path)
    for part in ("depth", "colour"):
        for k, number in enumerate((8, 9, 10, 11, 100, 101)):
            (folder / part / f"{k:03d}.png").rename(folder / part / f"f{number}.png")
    assert np.array_equal(read_folder(folder).depth, images().depth)


STAMPS = ["1305031102.15", "1305031102.175304", "1305031102.2", "1305031102.26", "1305031103", "1305031103.05"]
TAKE = ["take1.1", "take1.2", "take1.9", "take1.10", "take1.11", "take1.20"]


COUNTED = [f"swing2.{number}" for number in range(98, 104)]
EVERY_FIFTH = [f"swing2.{number}" for number in range(90, 120, 5)]
SECONDS = ["0.1", "0.15", "0.2", "0.25", "0.3", "0.35"]
EARLY = ["0.0", "0.05", "0.1", "0.2", "0.35", "0.4"]
ONE_SECOND = ["1305031102.15", "1305031102.175304", "1305031102.2", "1305031102.23", "1305031102.26", "1305031102.3"]


@pytest.mark.parametrize("names", [STAMPS, TAKE, COUNTED, EVERY_FIFTH, SECONDS, EARLY, ONE_SECOND])
def test_or_of_their_times(tmp_path, names):
    """What a program writes of a time has as many digits as it takes."""
    folder = folder_of(tmp_path)
    for part in ("depth", "colour"):
        for k, name in enumerate(names):
            (folder / part / f"{k:03d}.png").rename(folder / part / f"{name}.png")
    assert np.array_equal(read_folder(folder).depth, images().depth)


def test_names_that_may_count_or_tell_times_are_refused():
    names = [Path(f"take/swing2.{number}.png") for number in (8, 9, 12, 13, 16)]
    with pytest.raises(ClothbenchError, match=r"^take/swing2\.12\.png: found it beside swing2\.8\.png, .* same number"):
        in_order(names)


def test_fractions_that_are_the_same_number_count_whatever_follows_them():
    assert in_order([Path("2.10a.csv"), Path("2.1b.csv")]) == [Path("2.1b.csv"), Path("2.10a.csv")]


def test_a_zero_after_the_point_is_one_of_a_fraction():
    names = [Path(f"take/0.{digits}.png") for digits in ("01", "1", "3")]
    assert in_order(reversed(names)) == names


def test_frames_that_stand_there_twice_are_refused(tmp_path):
    """They would be seen at half the speed, or nobody would know which were taken."""
    folder = folder_of(tmp_path)
    (folder / "clouds").mkdir()
    (folder / "clouds" / "0.ply").touch()
    with pytest.raises(ClothbenchError, match="session: found frames in both depth and clouds, expected one of them"):
        read_folder(folder)
    shutil.rmtree(folder / "depth")
    (folder / "clouds" / "0.npy").touch()
    with pytest.raises(ClothbenchError, match=r"clouds: found frames that end in .npy and .ply, expected one of them"):
        read_folder(folder)


def test_so_is_a_folder_whose_name_is_nearly_one(tmp_path):
    folder = folder_of(tmp_path)
    (folder / "colour").rename(folder / "color")
    with pytest.raises(ClothbenchError, match="session: found a folder 'color', expected 'colour'; rename it"):
        read_folder(folder)


def test_colour_on_another_clock_is_no_colour():
    late = Colour(TIME + 1.7e9, images().colour.frame)
    with pytest.raises(ClothbenchError, match=r"'colour_time': found 1.7e.* expected one clock"):
        images(colour=late)


def test_a_tracker_that_was_told_the_colour_needs_pictures():
    from clothbench_trackers.depth_mesh import DepthMesh

    with pytest.raises(ClothbenchError, match=r"run: found no variable 'colour', expected one: depth_mesh was given"):
        DepthMesh(colour=[200, 0, 0]).track(images(colour=None))


def test_numbers_may_have_either_order_of_bytes(tmp_path):
    import h5py

    path = write_depth(images(), tmp_path / "run.nc")
    with h5py.File(path, "a") as file:
        old = file["depth"]
        new = file.create_dataset("turned", data=old[()].astype(">u2"))
        for k, scale in enumerate(old.dims):
            new.dims[k].attach_scale(scale[0])
        new.attrs["units"] = old.attrs["units"]
        del file["depth"]
        file.move("turned", "depth")
    assert read_depth(path).hash == images().hash


def test_a_picture_of_depth_is_no_depth(tmp_path):
    import cv2

    from clothbench.datasets.depth_folder import read_folder

    folder = folder_of(tmp_path)
    cv2.imwrite(str(folder / "depth" / "002.png"), np.full((40, 48), 90, np.uint8))
    with pytest.raises(ClothbenchError, match=r"002.png: found uint8 .* a picture of depth, not depth"):
        read_folder(folder)


def test_clouds_in_millimetres_are_refused(tmp_path):
    from clothbench.datasets.depth_folder import read_cloud

    np.save(tmp_path / "a.npy", np.full((9, 3), 1000.0))
    with pytest.raises(ClothbenchError, match=r"a.npy: found a middle depth of 1000, .* millimetres"):
        read_cloud(tmp_path / "a.npy")


def test_what_a_tracker_made_of_images_is_a_recording_of_nodes():
    from clothbench import Observation
    from clothbench.recordings.tracked import nodes_of, seen_in

    u, v = (a.ravel() for a in np.meshgrid([0.0, 0.15, 0.3], [0.0, 0.2, 0.4]))
    position = np.broadcast_to(np.stack([u, 0 * u, 1 - v], axis=1), (6, 9, 3)).copy()
    position[2, 4] = np.nan
    seen = Observation(TIME, position, np.isfinite(position).all(axis=-1), 1e-3, np.stack([u, v], axis=1))
    for given in (images(), images(grips=None)):
        nodes = nodes_of(given, seen)
        assert nodes.grip_material.tolist() == [[0.0, 0.0], [0.3, 0.0]]
        again = seen_in(nodes)
        assert np.array_equal(again.position, position, equal_nan=True)
        assert np.allclose(again.eye, [0.0, -1.0, 0.8])
    lost = dataclasses.replace(
        seen, position=np.where(v[:, None] > 0, position, np.nan), visible=seen.visible & (v > 0)
    )
    with pytest.raises(ClothbenchError, match="no grips stated, and the upper corners in 0 frames"):
        nodes_of(images(grips=None), lost)
    position[4:, 2] = np.nan
    gone = dataclasses.replace(seen, position=position, visible=np.isfinite(position).all(axis=-1))
    with pytest.raises(ClothbenchError, match=r"upper corner at u = 0.3 m, v = 0 m from frame 0 to 3 of 6, expected"):
        nodes_of(images(grips=None), gone)


def sheet(frames=6):
    """A level sheet before the camera, and what a folder's recording.json may state of it."""
    from clothbench_trackers.depth_mesh import DepthMesh

    depth = np.zeros((frames, 40, 48), np.uint16)
    depth[:, 1:39, 9:38] = 1000 + np.random.default_rng(0).integers(-2, 3, (frames, 38, 29))
    return {"depth": depth, "colour": None, "grips": None}, DepthMesh(mesh=(3, 3), smooth=0)


def test_tracked_nodes_are_the_same_in_the_first_cell_and_in_those_that_read_them(tmp_path):
    """Of what is kept, all has to be what it was: a note had become a thickness on the way."""
    from clothbench.estimation.watched import watched
    from clothbench.plugins.discovery import catalogue
    from clothbench.recordings.scenes import scene_of

    told, tracker = sheet()
    given = images(**told, thickness=2e-3, noise_sigma=4e-3, path="run.nc")
    kept = tmp_path / "tracked"
    kept.mkdir()
    every = [watched(given, tracker, {}, catalogue(), folder) for folder in (None, kept, kept)]
    (there,) = kept.iterdir()
    there.unlink()
    there.symlink_to(tmp_path / "elsewhere.nc")  # a store may be a stranger's: nothing is written where its links lead
    every.append(watched(given, tracker, {}, catalogue(), kept))
    assert not there.is_symlink()
    assert not (tmp_path / "elsewhere.nc").exists()
    for nodes, seen in every:
        assert nodes.hash == every[0][0].hash
        assert (nodes.path, nodes.notes.keys()) == ("run.nc", {"room", "tracked_from", "camera_place"})
        assert scene_of(nodes, areal_density=0.1).thickness == 2e-3
        assert nodes.noise_sigma == seen.sigma == 4e-3


def test_a_stated_noise_goes_before_a_judged_one_and_an_option_before_both(tmp_path):
    from clothbench import Observation
    from clothbench.recordings.tracked import nodes_of

    told, tracker = sheet()
    judged = tracker.track(images(**told)).sigma
    assert 0 < judged < 4e-3
    again = read_depth(write_depth(images(**told, noise_sigma=4e-3), tmp_path / "run.nc"))
    assert again.noise_sigma == tracker.track(again).sigma == 4e-3
    assert type(tracker)(mesh=(3, 3), smooth=0, sigma=1e-3).track(again).sigma == 1e-3
    u, v = (a.ravel() for a in np.meshgrid([0.0, 0.3], [0.0, 0.4]))
    place = np.broadcast_to(np.stack([u, 0 * u, 1 - v], axis=1), (6, 4, 3))
    for sigma, taken in ((np.nan, 4e-3), (2e-3, 2e-3)):
        seen = Observation(TIME, place, np.ones((6, 4), bool), sigma, np.stack([u, v], axis=1))
        assert nodes_of(again, seen).noise_sigma == taken


def test_what_is_not_stated_leaves_the_hash_as_it_was():
    assert images(noise_sigma=np.nan, thickness=None).hash == images().hash
    assert len({images().hash, images(noise_sigma=1e-3).hash, images(thickness=1e-3).hash}) == 3


def test_a_folder_may_state_noise_and_thickness(tmp_path):
    read = read_folder(folder_of(tmp_path, {**ABOUT, "noise_sigma": 2e-3, "thickness": 1e-3}))
    assert (read.noise_sigma, read.thickness, read.notes) == (2e-3, 1e-3, {"weather": "fair"})
    folder = tmp_path / "other"
    folder.mkdir()
    with pytest.raises(ClothbenchError, match=r"'obstacle_shape': found a note .* \(scene.outline, scene.obstacles\)"):
        read_folder(folder_of(folder, {**ABOUT, "obstacle_shape": "plane"}))


def test_while_nobody_knows_where_the_grips_are_nothing_is_seen():
    """Held still before they are first seen and after the last time they would move the cloth as nobody did."""
    from clothbench import Observation
    from clothbench.recordings.tracked import nodes_of

    u, v = (a.ravel() for a in np.meshgrid([0.0, 0.15, 0.3], [0.0, 0.2, 0.4]))
    time = np.arange(60) / 20.0
    position = np.stack([u, 0 * u, 1 - v], axis=1) + 0.5 * time[:, None, None] * [0, 1, 0]
    visible = np.ones((60, 9), bool)
    visible[:3, 0] = visible[30:33, 0] = visible[-2:, 2] = False
    depth, colour = np.full((60, 40, 48), 1000, np.uint16), None
    seen = Observation(time, position, visible, 1e-3, np.stack([u, v], axis=1))
    nodes = nodes_of(images(grips=None, time=time, depth=depth, colour=colour), seen)
    assert np.array_equal(nodes.grip_time, time[3:-2])
    assert np.allclose(nodes.grip_position[:, :, 1], 0.5 * time[3:-2, None])
    assert np.array_equal(nodes.visible[3:-2], visible[3:-2])
    assert not nodes.visible[:3].any()
    assert not nodes.visible[-2:].any()
