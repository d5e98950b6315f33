"""The recording format: round trip, hash, and one line for every fault."""

import dataclasses
import errno
import os
from pathlib import Path

import h5netcdf.legacyapi
import h5py
import numpy as np
import pytest
from clothbench_trackers.markers import Markers
from conftest import swinging_recording

from clothbench import (
    Camera,
    ClothbenchError,
    Obstacle,
    Recording,
    Rollout,
    Video,
    read_recording,
    scene_of,
    write_recording,
)
from clothbench.cli.commands import main
from clothbench.recordings.nodes import find_recordings
from clothbench.recordings.nodes_rules import stamp_rounding, while_held
from clothbench.recordings.supports import check_supports
from clothbench.recordings.tracked import seen_in


def test_round_trip_keeps_everything(recording, tmp_path):
    again = read_recording(write_recording(recording, tmp_path / "a.nc"))
    assert again.hash == recording.hash
    assert again.fabric == "paper"
    np.testing.assert_array_equal(again.position, recording.position)


def test_hash_depends_on_content_not_on_place(recording, tmp_path):
    first = read_recording(write_recording(recording, tmp_path / "a.nc"))
    second = read_recording(write_recording(recording, tmp_path / "deep" / "b.nc"))
    assert first.hash == second.hash
    assert swinging_recording(split="held_out").hash != recording.hash


def test_arrays_are_read_only_and_not_the_callers(recording):
    time = np.array(recording.time)
    copy = swinging_recording(time=time)
    time[0] = -5.0
    assert copy.time[0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        copy.time[0] = 1.0


def test_what_the_format_does_not_know_is_kept_as_notes(tmp_path):
    path = write_recording(swinging_recording(notes={"clock_offset_removed_s": "0.25"}), tmp_path / "a.nc")
    assert read_recording(path).notes == {"clock_offset_removed_s": "0.25"}


def test_where_the_camera_stood_is_what_the_note_says_else_that_of_the_picture_or_the_video(recording):
    left, right = (Camera.looking_at((x, -1.2, 0.9), (0, 0, 0), (8, 6), 0.4) for x in (-0.5, 0.5))
    video = Video(np.zeros((11, 6, 8), np.uint8), right)
    for told, x in (
        ({}, None), ({"video": video}, 0.5), ({"video": video, "sight": left}, -0.5),
        ({"video": video, "notes": {"camera_place": "0.1 -1.2 0.9"}}, 0.1),
    ):  # fmt: skip
        made = dataclasses.replace(recording, **told)
        for eye in (made.eye, Markers().track(made).eye, seen_in(made).eye):
            assert (eye is None) == (x is None)
            assert eye is None or np.allclose(eye, [x, -1.2, 0.9])
    with pytest.raises(ClothbenchError, match="'camera_place': found 'by the door', expected 3 finite numbers"):
        swinging_recording(notes={"camera_place": "by the door"})


@pytest.mark.parametrize(
    ("word", "meant"),
    [
        ("areal_densty", "areal_density"), ("cloth_widht", "cloth_width"), ("Fabric", "fabric"), ("splitt", "split"),
        ("obstacle_shapes", "obstacle_shape"),
    ],
)  # fmt: skip
def test_an_attribute_that_is_nearly_one_that_is_missing_is_refused(tmp_path, word, meant):
    """As a note it would vanish: a cloth of no known weight, a recording that is fitted though it was held out."""

    def misspell(stream):
        if meant in stream.ncattrs():
            del stream.attrs[meant]
        stream.attrs[word] = "0.2"

    with pytest.raises(ClothbenchError, match=rf"bad.nc: attribute '{word}': expected '{meant}', which the file lacks"):
        read_recording(_with(tmp_path, misspell))
    with pytest.raises(ClothbenchError, match="expected 'obstacle_shape', which the file lacks"):
        write_recording(swinging_recording(notes={"obstacle_shapes": "disc"}), tmp_path / "unwritten.nc")
    assert not (tmp_path / "unwritten.nc").exists()
    stated = _with(tmp_path, lambda f: f.attrs.update({"areal_densty": "0.2", "cloth_with_hems": "yes", "room": "4"}))
    assert set(read_recording(stated).notes) == {"areal_densty", "cloth_with_hems", "room"}


@pytest.mark.parametrize(("word", "meant"), [("confidance", "confidence"), ("Outline", "outline"), ("frames", "frame")])
def test_so_is_a_variable(tmp_path, word, meant):
    """Passed over, it would be as if nobody had measured it."""
    path = _with(tmp_path, lambda f: f.createVariable(word, float, f.variables["time"].dimensions))
    with pytest.raises(ClothbenchError, match=rf"bad.nc: variable '{word}': expected '{meant}', which the file lacks"):
        read_recording(path)
    read_recording(_with(tmp_path, lambda f: f.createVariable("warmth", float, f.variables["time"].dimensions)))


def test_grips_in_milliseconds_beside_frames_in_seconds_are_refused(recording, tmp_path):
    """All frames lie within their stamps, and in none would they seem to move."""
    assert len(recording.grip_time) > 9
    with pytest.raises(ClothbenchError, match=r"'grip_time': found .* expected both in seconds; are the grips' milli"):
        read_recording(_with(tmp_path, lambda f: f.variables["grip_time"].__setitem__(..., 1000 * recording.grip_time)))


def test_equal_stamps_since_1970_are_equal():
    time = 1.7e9 + np.arange(60) / 30
    nowhere = np.zeros((60, 1, 3))
    assert while_held(time, time + 2e-7, nowhere).all()
    assert not while_held(time, time + 1e-3, nowhere).all()
    assert stamp_rounding(time - time[0]) == 1e-9


def held_at(stamps: np.ndarray, speed: float = 0.01):
    """A recording of 101 frames in ten seconds, of which grips at that speed [m/s] were told at `stamps` (K,) s."""
    plain = swinging_recording()
    time, shape = np.linspace(0.0, 10.0, 101), plain.position[:1]
    return swinging_recording(
        time=time, position=np.repeat(shape, len(time), axis=0), grip_time=stamps,
        grip_position=plain.grip_position[:1] + speed * stamps[:, None, None],
    )  # fmt: skip


def test_a_hole_in_the_grips_log_is_not_taken_for_grips():
    """On a straight line across a second they would be led as nobody led them."""
    whole = np.arange(1001) / 100
    seen = held_at(whole[(whole <= 5.0) | (whole >= 5.65)])
    lost = (seen.time > 5.0 + 1e-9) & (seen.time < 5.65 - 1e-9)
    assert lost.sum() == 6
    assert np.array_equal(seen.counts, seen.visible & ~lost[:, None])
    for told in (whole[::100], whole[(whole <= 5.0) | (whole >= 5.45)], np.array([0.0, 10.0]), np.array([0, 0.01, 10])):
        assert held_at(told).counts.any(axis=1).all()  # slow, short, or a path that somebody stated
    with pytest.raises(
        ClothbenchError, match=r"'grip_time': found none from 5 to 7 s, where 0.01 s .* 81% of the frames .* cut the"
    ):
        held_at(whole[(whole <= 5.0) | (whole >= 7.0)])


def test_grips_that_are_logged_only_while_they_move_are_known_in_between():
    whole = np.arange(1001) / 100
    assert held_at(whole[(whole <= 5.0) | (whole >= 8.0)], speed=1e-4).counts.any(axis=1).all()


def test_a_recording_is_written_through_a_link(recording, tmp_path):
    (tmp_path / "link.nc").symlink_to(tmp_path / "a.nc")
    assert read_recording(write_recording(recording, tmp_path / "link.nc")).hash == recording.hash
    assert (tmp_path / "link.nc").is_symlink()


def test_a_failed_write_leaves_the_old_file(recording, tmp_path, monkeypatch):
    path = write_recording(recording, tmp_path / "a.nc")
    before = path.read_bytes()
    monkeypatch.setattr("xarray.Dataset.to_netcdf", lambda *a, **k: (_ for _ in ()).throw(OSError("disk full")))
    with pytest.raises(OSError, match="disk full"):
        write_recording(swinging_recording("other"), path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["a.nc"]


def _times(stream, name: str, factor: float) -> None:
    stream[name][...] = stream[name][...] * factor


def _with(tmp_path: Path, change) -> Path:
    """A good file, spoilt by `change(open file)`."""
    path = write_recording(swinging_recording(), tmp_path / "bad.nc")
    with h5netcdf.legacyapi.Dataset(path, "a") as stream:
        change(stream)
    return path


def test_gravity_may_be_three_numbers_as_other_programs_write_it(tmp_path):
    path = _with(tmp_path, lambda f: setattr(f, "gravity", np.array([0.0, 1.0, -9.5])))
    assert read_recording(path).gravity == (0.0, 1.0, -9.5)


@pytest.mark.parametrize(
    ("change", "found"),
    [
        (lambda f: setattr(f["position"], "units", "mm"), "variable 'position': found units 'mm', expected 'm'"),
        (lambda f: setattr(f, "format", "other"), "attribute 'format': found 'other'"),
        (lambda f: setattr(f, "format_version", 2), "attribute 'format_version': found 2, expected the number 1"),
        (lambda f: setattr(f, "kind", "video"), "attribute 'kind': found 'video'"),
        (lambda f: setattr(f, "gravity", "down"), "attribute 'gravity': found 'down'"),
        (lambda f: setattr(f, "cloth_width", "wide"), "attribute 'cloth_width': found 'wide', expected a number"),
        (lambda f: setattr(f, "cloth_width", -1.0), "expected metres above 0"),
        (lambda f: setattr(f, "areal_density", 0.0), "attribute 'areal_density': found 0.0"),
        (lambda f: setattr(f, "gravity", "0 0 nan"), "attribute 'gravity': found"),
        (lambda f: setattr(f, "gravity", np.array([0.0, -9.8])), "attribute 'gravity': found"),
        (lambda f: setattr(f, "name", ""), "attribute 'name': found nothing"),
        (lambda f: f["position"].__setitem__((slice(None), slice(None), 0), np.nan), "no node with all of x, y and z"),
        (lambda f: setattr(f, "split", "train"), "attribute 'split': found 'train'"),
        (lambda f: f["time"].__setitem__(3, 0.0), "expected strictly increasing"),
        (lambda f: f["grip_time"].__setitem__(slice(None), np.arange(26) + 100.0), "covers 0% of the frames"),
        (lambda f: f["position"].__setitem__((2, 3, 1), np.inf), "1 infinite values, the first at frame 2, node 3"),
        (lambda f: f["position"].__setitem__(slice(None), np.nan), "found only NaN"),
        (lambda f: f["grip_position"].__setitem__((0, 0, 0), np.nan), "variable 'grip_position': found a value"),
        (lambda f: f["material"].__setitem__(4, [0.05, 0.0]), r"found row 1 2 times \(the same material point\)"),
        (lambda f: f["material"].__setitem__(4, [5.0, 0.0]), "expected inside the 0.2 m × 0.2 m cloth"),
        (lambda f: setattr(f, "cloth_width", 200.0), "'cloth_width': found 200 m, expected 0.005 to 20 m; is it in"),
        (lambda f: setattr(f, "gravity", "0 0 -9810"), "expected m/s², 50 at most"),
        (lambda f: setattr(f, "gravity", "0 0 9.81"), "found 0 0 9.81 m/s², which pulls up, .* is the sign wrong"),
        (lambda f: setattr(f, "noise_sigma", 1.0), r"'noise_sigma': found 1 m on a cloth .*; are these millimetres"),
        (lambda f: _times(f, "position", 1000), r"'position': found nodes 286.* m apart .*; are these millimetres\?"),
        (
            lambda f: _times(f, "position", 1e-3),
            r"'position': found nodes .* 0.28 m on the cloth.*; is it scaled twice",
        ),
        (
            lambda f: _times(f, "grip_position", 1e3),
            r"'grip_position': found grips 200 m apart, .*; are these millimet",
        ),
        (
            lambda f: (_times(f, "time", 1e3), _times(f, "grip_time", 1e3)),
            "frames 50 s apart, expected 2 s at most; ar",
        ),
    ],
)
def test_every_fault_is_one_line_with_file_and_field(tmp_path, change, found):
    path = _with(tmp_path, change)
    with pytest.raises(ClothbenchError, match=found) as caught:
        read_recording(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_a_header_that_claims_more_than_the_file_can_hold_is_refused_before_memory_is_taken(recording, tmp_path):
    good, path = write_recording(recording, tmp_path / "good.nc"), tmp_path / "a.nc"
    with h5netcdf.legacyapi.Dataset(good) as known, h5netcdf.legacyapi.Dataset(path, "w") as file:
        for name in known.ncattrs():
            file.setncattr(name, known.getncattr(name))
        dims = {dim for variable in known.variables.values() for dim in variable.dimensions}
        for name in dims:
            file.createDimension(name, 10**9 if name == "node" else known.dimensions[name].size)
        for name, variable in known.variables.items():
            chunks = tuple(min(file.dimensions[d].size, 100) for d in variable.dimensions)
            made = file.createVariable(name, variable.dtype, variable.dimensions, chunksizes=chunks, zlib=True)
            made.setncattr("units", variable.getncattr("units"))
    assert path.stat().st_size < 100_000
    with pytest.raises(
        ClothbenchError, match=r"a\.nc: variable '\w+': found a claim of .*1000000000 .* GB\) in a file of"
    ):
        read_recording(path)


def test_a_file_cut_off_and_a_text_file_are_refused(recording, tmp_path):
    path = write_recording(recording, tmp_path / "a.nc")
    path.write_bytes(path.read_bytes()[:5000])
    with pytest.raises(ClothbenchError, match="truncated file of 5000 bytes"):
        read_recording(path)
    path.write_text("time,node")
    with pytest.raises(ClothbenchError, match="expected NetCDF-4"):
        read_recording(path)
    with pytest.raises(ClothbenchError, match="no such file"):
        read_recording(tmp_path / "none.nc")


def test_a_file_that_may_not_be_read_is_a_fault_of_its_own_only(recording, tmp_path, monkeypatch, capsys):
    """The tests may run as root, who may read all."""
    for name in ("a.nc", "locked.nc", "z.nc"):
        write_recording(recording, tmp_path / name)

    def opening(path, *how):
        if path.name == "locked.nc":
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
        return open(path, *how)

    monkeypatch.setattr("clothbench.recordings.netcdf.open", opening, raising=False)
    assert main(["validate", str(tmp_path)]) == 1
    said = capsys.readouterr().out.splitlines()
    assert [line.endswith(": ok") for line in said] == [True, False, True]
    assert said[1].endswith("locked.nc: cannot be read (Permission denied); give a file of yours")


def test_a_node_that_is_nowhere_near_the_cloth_is_refused(recording):
    position = np.array(recording.position)
    position[5, 4] = -999.0  # as some write what was not seen
    with pytest.raises(ClothbenchError, match=r"found node 4 at frame 5 at \(-999, -999, -999\) m, .*NaN where it was"):
        dataclasses.replace(recording, position=position)
    position[5, 4] = np.nanmedian(position[5], axis=0) + np.array(
        [2.0, 0.0, 0.0]
    )  # wild, but cloth has been tracked so
    assert dataclasses.replace(recording, position=position).position.shape == position.shape


def held_grid(nodes: int, width: float = 0.3, height: float = 0.3, inset: float = 0.0, **changes) -> Recording:
    """A flat sheet that its two upper corners hold, seen at nodes × nodes places that begin so far inside its hems."""
    u, v = (np.linspace(inset, side - inset, nodes) for side in (width, height))
    material = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    places = np.stack([material[:, 0], 0 * material[:, 0], -material[:, 1]], axis=1)
    grips = np.array([[0.0, 0.0, 0.0], [width, 0.0, 0.0]])
    time = np.linspace(0, 1, 11)
    content = {
        "name": "held", "time": time, "material": material, "position": np.tile(places, (11, 1, 1)), "grip_time": time,
        "grip_material": grips[:, :2], "grip_position": np.tile(grips, (11, 1, 1)), "cloth_width": width,
        "cloth_height": height,
    }  # fmt: skip
    return Recording(**{**content, **changes})


@pytest.mark.parametrize(("nodes", "inset"), [(3, 0.0), (3, 0.05), (4, 0.0), (11, 0.01)])
@pytest.mark.parametrize("change", ["grips exchanged", "counted from the right", "v upwards"])
def test_grips_in_another_order_than_their_places_are_refused(nodes, inset, change):
    sound = held_grid(nodes, inset=inset)
    changed = {
        "grips exchanged": {"grip_position": sound.grip_position[:, ::-1]},
        "counted from the right": {"material": sound.material * [-1.0, 1.0] + [0.3, 0.0]},
        "v upwards": {"material": sound.material * [1.0, -1.0] + [0.0, 0.3]},
    }[change]
    with pytest.raises(ClothbenchError, match=r"'grip_position': found grip 0 at no time nearer .* in another order"):
        dataclasses.replace(sound, **changed)


def test_grips_are_in_order_between_few_stamps_and_where_they_hold_an_obstacle_or_let_go():
    sound = held_grid(5)
    away = sound.time[:, None, None] * np.array([0.5, 0.0, 0.0])
    few = np.array([-1.0, 4.0])
    path = sound.grip_position[:1] + few[:, None, None] * np.array([0.5, 0.0, 0.0])
    dataclasses.replace(sound, position=sound.position + away, grip_time=few, grip_position=path)
    dataclasses.replace(sound, position=sound.position - 2 * away)  # released as the recording begins
    plate = Obstacle("disc", (0.15, 0.0, -0.3), (0.0, 0.0, 1.0), radius=0.09, carried=True)
    below = sound.grip_position - [0.0, 0.0, 0.25]
    dataclasses.replace(sound, obstacles=(plate,), grip_position=below)


def test_grips_that_are_known_a_little_aside_are_for_a_model_to_explain(recording):
    aside = 0.14 * np.hypot(recording.cloth_width, recording.cloth_height)
    dataclasses.replace(recording, grip_position=recording.grip_position + np.array([aside, 0.0, 0.0]))


def test_at_a_prompt_arrays_show_their_shapes_and_what_is_not_stated_is_left_out(recording):
    shown = repr(recording)
    t, n, _ = recording.position.shape
    assert shown.startswith("Recording(name='")
    assert f"position=array({t} × {n} × 3)" in shown
    assert len(shown.splitlines()) == 1
    assert "outline" not in shown
    many = Rollout(np.zeros(2), np.zeros((1000, 2, 3, 3)), ("ok",) * 1000, np.zeros(1000, int), 9)
    assert "status=tuple(1000)" in repr(many)


def test_positions_that_are_all_one_are_refused_of_a_file(recording, tmp_path):
    for place in (0.0, 1.5):
        made = dataclasses.replace(recording, position=np.full_like(recording.position, place), path="")
        write_recording(made, tmp_path / "one.nc")  # a program may yet fill it in
        with pytest.raises(ClothbenchError, match=r"found nodes 0 m apart in space at most and .* is it scaled twice"):
            read_recording(tmp_path / "one.nc")
    one = np.full_like(recording.position, np.nan)
    one[:, 0] = recording.position[:, 0]  # of which nothing is known about the size
    assert dataclasses.replace(recording, position=one).visible.sum() == len(one)


@pytest.mark.parametrize("gravity", [(0.0, 9.81, 0.0), (0.0, -9.0, 3.0), (0.0, 0.0, 0.0), (0.5, 0.0, -9.8)])
def test_gravity_may_go_along_another_axis_or_be_none(gravity):
    assert swinging_recording(gravity=gravity).gravity == gravity


def test_recordings_are_found_whatever_their_endings_case_and_where_links_lead(recording, tmp_path):
    kept, folder = tmp_path / "kept", tmp_path / "all"
    for path in (kept / "away.nc", folder / "b" / "b.NC", folder / "a.nc", folder / ".half" / "hidden.nc"):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_recording(recording, path)
    (folder / "again").symlink_to(folder / "b")  # what lies in the folder itself is found there, and once
    (folder / "b" / "loop").symlink_to(folder)
    (folder / "linked").symlink_to(kept)
    found = find_recordings([folder])
    assert [path.relative_to(folder).as_posix() for path in found] == ["a.nc", "b/b.NC", "linked/away.nc"]
    assert main(["validate", str(folder)]) == 0


def test_a_folder_of_recordings_that_may_not_be_looked_into_is_told(recording, tmp_path, monkeypatch, capsys):
    write_recording(recording, tmp_path / "a.nc")
    (tmp_path / "locked").mkdir()

    def scan(path, real=os.scandir):
        if Path(path) == tmp_path / "locked":
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
        return real(path)

    monkeypatch.setattr(os, "scandir", scan)
    assert main(["validate", str(tmp_path)]) == 2
    assert capsys.readouterr().err == f"clothbench: {tmp_path / 'locked'}: Permission denied\n"


@pytest.mark.data
def test_every_broken_recording_is_refused_in_one_line(data_dir):
    paths = sorted((data_dir / "bad-recordings").glob("*.nc"))
    assert len(paths) >= 12
    for path in paths:
        with pytest.raises(ClothbenchError) as caught:
            read_recording(path)
        assert "\n" not in str(caught.value)


@pytest.mark.data
def test_every_practice_recording_is_read(data_dir):
    paths = sorted((data_dir / "practice-cases").rglob("*.nc"))
    assert len({read_recording(p).hash for p in paths}) == len(paths) > 0


SUPPORTS = {
    "outline": np.array([[0.0, 0.0], [0.2, 0.0], [0.2, 0.15], [0.1, 0.2], [0.0, 0.15]]),
    "obstacles": (
        Obstacle("plane", (0.0, 0.0, -1.0), friction=0.3),
        Obstacle("disc", (0.1, 0.0, 0.5), radius=0.05, clamps=True),
        Obstacle("sphere", (0.1, -0.2, 0.5), radius=0.05, friction=0.2, carried=True),
    ),
    "thickness": 4e-4,
}


def test_outline_obstacles_and_thickness_are_kept(tmp_path):
    plain = swinging_recording()
    stated = dataclasses.replace(plain, **SUPPORTS)
    again = read_recording(write_recording(stated, tmp_path / "r.nc"))
    assert again.hash == stated.hash != plain.hash
    assert np.array_equal(again.outline, SUPPORTS["outline"])
    assert again.thickness == 4e-4
    for one, other in zip(again.obstacles, SUPPORTS["obstacles"], strict=True):
        assert dataclasses.asdict(one) == dataclasses.asdict(other)
    scene = scene_of(again, areal_density=0.2)
    assert (len(scene.obstacles), scene.thickness, len(scene.outline)) == (3, 4e-4, 5)
    assert scene_of(plain, areal_density=0.2).obstacles == ()
    assert scene_of(again, areal_density=0.2, obstacles=[], thickness=0.0).obstacles == ()


def test_cloth_that_only_an_obstacle_holds_needs_no_grips(tmp_path):
    plain = swinging_recording()
    free = {"grip_material": np.zeros((0, 2)), "grip_position": np.zeros((len(plain.grip_time), 0, 3))}
    borne = dataclasses.replace(plain, obstacles=SUPPORTS["obstacles"][:2], **free)
    assert read_recording(write_recording(borne, tmp_path / "r.nc")).grip_material.shape == (0, 2)
    with pytest.raises(ClothbenchError, match="no entries along 'grip'"):
        dataclasses.replace(plain, **free)
    with pytest.raises(ClothbenchError, match="no entries along 'grip'"):  # nothing carries what should be carried
        dataclasses.replace(plain, obstacles=SUPPORTS["obstacles"], **free)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"outline": np.array([[0.0, 0.0], [9.0, 0.0], [0.0, 9.0]])}, "variable 'outline': .* expected them within"),
        (
            {"outline": np.array([[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.2, 0.1], [0.2, 0.2], [0.0, 0.2]])},
            r"variable 'outline': grip_material 1 is at \(0.2, 0\) m, off the outline, expected it on the cloth",
        ),
        ({"thickness": -1.0}, "attribute 'thickness': found -1.0"),
        ({"thickness": 0.5}, "attribute 'thickness': found 0.5 m, expected 0.02 m at most of a cloth 0.2 m across"),
        (
            {"confidence": np.full((11, 25), -3.0)},
            "variable 'confidence': found -3 at frame 0, node 0, expected 0 to 1",
        ),
        ({"confidence": np.full((11, 25), np.inf)}, "variable 'confidence': found inf at frame 0, node 0"),
        ({"confidence": np.full((11, 25), np.nan)}, "variable 'confidence': found nan at frame 0, node 0"),
    ],
)
def test_wrong_supports_are_refused(change, says):
    with pytest.raises(ClothbenchError, match=says):
        dataclasses.replace(swinging_recording(), **change)


def test_a_strip_may_be_as_thick_as_a_sheet():
    """One of 25 mm by 300 mm had to be thinner than 2.5 mm."""
    check_supports(None, 2.6e-3, np.zeros((0, 2)), np.array([0.025, 0.3]), "strip.nc")


@pytest.mark.parametrize(
    ("attributes", "says"),
    [
        ({"obstacle_shape": "plane"}, "'obstacle_shape': found 1 words, expected 3"),
        ({"obstacle_carried": "0 1"}, "'obstacle_carried': found 2 words, expected 3"),
        ({"obstacle_carried": "0 1 1"}, "a disc that clamps the cloth stands still"),
        ({"obstacle_shape": "plane cone disc"}, "shape is 'cone'"),
        ({"obstacle_clamps": None}, "'obstacle_clamps' is missing"),
        ({"obstacle_clamps": "0 no 0"}, "attribute 'obstacle_clamps': found 'no', expected 0 or 1"),
        ({"obstacle_carried": "0 0 0.0"}, "attribute 'obstacle_carried': found '0.0', expected 0 or 1"),
    ],
)
def test_half_stated_obstacles_are_refused(tmp_path, attributes, says):

    path = write_recording(dataclasses.replace(swinging_recording(), **SUPPORTS), tmp_path / "r.nc")
    with h5py.File(path, "a") as file:
        for name, value in attributes.items():
            del file.attrs[name]
            if value is not None:
                file.attrs[name] = value
    with pytest.raises(ClothbenchError, match=says):
        read_recording(path)


@pytest.mark.parametrize(
    ("name", "shape", "says"),
    [
        ("obstacle_radius", (2,), "'obstacle_radius': found 2 along 'obstacle', expected 3 as in"),
        ("obstacle_normal", (3, 2), "'obstacle_normal': found 2 along 'space', expected 3"),
    ],
)
def test_obstacles_of_unequal_shapes_are_refused(tmp_path, name, shape, says):
    path = write_recording(dataclasses.replace(swinging_recording(), **SUPPORTS), tmp_path / "r.nc")
    with h5py.File(path, "a") as file:
        dims, unit = [file["obstacle"], file["space"]][: len(shape)], file[name].attrs["units"]
        del file[name]
        made = file.create_dataset(name, shape, data=np.ones(shape))
        made.attrs["units"] = unit
        for k, dim in enumerate(dims):
            made.dims[k].attach_scale(dim)
    with pytest.raises(ClothbenchError, match=says):
        read_recording(path)


@pytest.mark.parametrize(
    ("height", "says"), [(np.nan, "three finite numbers"), (1e300, "'obstacle_centre': found 1e.300")]
)
def test_an_obstacle_that_is_nowhere_is_refused(tmp_path, height, says):
    """A plane at NaN is never touched: the cloth would fall through it."""
    path = write_recording(dataclasses.replace(swinging_recording(), **SUPPORTS), tmp_path / "r.nc")
    with h5py.File(path, "a") as file:
        file["obstacle_centre"][0, 2] = height
    with pytest.raises(ClothbenchError, match=says):
        read_recording(path)


def test_no_obstacles_are_as_if_nothing_was_stated(tmp_path):
    none = dataclasses.replace(swinging_recording(), obstacles=())
    again = read_recording(write_recording(none, tmp_path / "r.nc"))
    assert again.obstacles is None
    assert again.hash == none.hash == swinging_recording().hash


@pytest.mark.parametrize("size", ["80.7 72", "1e300 72", "0 72"])
def test_a_size_in_pixels_is_whole(tmp_path, size):
    camera = Camera.looking_at(np.array([0.1, -1.0, -0.1]), np.array([0.1, 0.0, -0.1]), (80, 72), 0.5)
    path = write_recording(dataclasses.replace(swinging_recording(), sight=camera), tmp_path / "r.nc")
    with h5py.File(path, "a") as file:
        file.attrs["sight_size"] = size
    with pytest.raises(
        ClothbenchError, match=f"'sight_size': found '{size}', expected width and height in whole pixels"
    ):
        read_recording(path)


def test_a_calibration_of_no_video_is_refused(tmp_path):
    path = write_recording(swinging_recording(), tmp_path / "r.nc")
    with h5py.File(path, "a") as file:
        file.attrs["camera_matrix"] = "1 0 0 0 1 0 0 0 1"
    with pytest.raises(ClothbenchError, match="variable 'frame' is missing beside attribute 'camera_matrix'"):
        read_recording(path)


@pytest.mark.parametrize("name", ["areal_density", "noise_sigma", "cloth_width"])
def test_a_number_that_is_none_is_refused_in_words(name):
    with pytest.raises(ClothbenchError, match=rf"attribute '{name}': found None, expected a number \(NaN where"):
        swinging_recording(**{name: None})
