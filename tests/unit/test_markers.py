"""Marker files and node recordings become observations, and what is wrong with a file is said in one line."""

from __future__ import annotations

import dataclasses
import math
import re
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from clothbench_trackers import marker_files
from clothbench_trackers.markers import UP, Markers, fill_gaps, fit_rigid, recording_from_markers

from clothbench import ClothbenchError, Obstacle, Recording, Tracker, read_recording, write_recording

RATE = 100.0
LABELS = ("grip", "middle", "lower", "post_a", "post_b", "post_c")
MATERIAL = {"grip": (0.0, 0.0), "middle": (0.0, 0.1), "lower": (0.05, 0.2)}
POSTS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.8, 0.3]])
TURN = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
SHIFT = np.array([0.5, -0.2, 1.0])


def run(frames: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """Time (T,) s and positions (T, 6, 3) m of three markers that move and three posts that rest."""
    time = np.arange(frames) / RATE
    moving = np.random.default_rng(7).uniform(0.1, 0.4, size=(frames, 3, 3))
    return time, np.concatenate([moving, np.broadcast_to(POSTS + 0.01, (frames, 3, 3))], axis=1)


def cell(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.9f}"


def csv_lines(time, position, labels=LABELS, unit="mm") -> list[str]:
    scale = 1 / marker_files.UNITS[unit]
    names = [f"{label}_{axis}" for label in labels for axis in "xyz"]
    rows = [",".join([f"{t:.4f}", *map(cell, p.ravel() * scale)]) for t, p in zip(time, position, strict=True)]
    return [f"# unit: {unit}", ",".join(["time", *names]), *rows]


def trc_lines(time, position, labels=LABELS) -> list[str]:
    over = [name for label in labels for name in (label, "", "")]
    axes = [f"{axis}{i}" for i in range(1, len(labels) + 1) for axis in "XYZ"]
    rows = [
        "\t".join([str(i), f"{t:.4f}", *map(cell, p.ravel() * 1000)])
        for i, (t, p) in enumerate(zip(time, position, strict=True), 1)
    ]
    return [
        "PathFileType\t4\t(X/Y/Z)\trun.trc",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits",
        f"{RATE:g}\t{RATE:g}\t{len(time)}\t{len(labels)}\tmm",
        "\t".join(["Frame#", "Time", *over]),
        "\t".join(["", "", *axes]),
        "",
        *rows,
    ]


def write(path: Path, lines: list[str]) -> Path:
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def write_c3d(path: Path, position: np.ndarray, labels=LABELS, unit="mm", unseen=()) -> Path:
    c3d = pytest.importorskip("c3d")
    writer = c3d.Writer(point_rate=RATE, point_units=unit)
    points = np.zeros((*position.shape[:2], 5), dtype=np.float32)
    points[..., :3] = position * 1000
    for frame, node in unseen:
        points[frame, node, 3:] = -1
    writer.add_frames([(frame, np.zeros((0, 1))) for frame in points])
    writer.set_point_labels(labels)
    with path.open("wb") as stream, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the writer misses analogue channels
        writer.write(stream)
    return path


@pytest.fixture
def good(tmp_path) -> Path:
    return write(tmp_path / "run.csv", csv_lines(*run()))


def refused(match: str, source, **settings) -> str:
    with pytest.raises(ClothbenchError, match=match) as caught:
        Markers(**settings).track(source)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def a_recording(**changes) -> Recording:
    time, position = run()
    position = position[:, :3].copy()
    position[3, 1] = np.nan
    known = {
        "name": "run",
        "time": time,
        "material": np.array(list(MATERIAL.values())),
        "position": position,
        "grip_time": time,
        "grip_material": np.array([[0.3, 0.0]]),
        "grip_position": position[:, :1],
        "cloth_width": 0.3,
        "cloth_height": 0.4,
        "noise_sigma": 0.002,
    }
    return Recording(**{**known, **changes})


def test_it_is_a_tracker_that_the_catalogue_finds():
    from clothbench.plugins.discovery import catalogue

    tracker = catalogue().make("trackers", "markers")
    assert isinstance(tracker, Tracker)
    assert (tracker.name, tracker.version) == ("markers", 2)


def test_while_nobody_knows_where_the_grips_are_nothing_counts():
    """Scored against grips that a simulation holds still there, a good model would look wrong."""
    time, position = run(40)
    whole = a_recording(time=time, position=position[:, :3], grip_time=time, grip_position=position[:, :1])
    assert Markers().track(whole).visible.all()
    inexact = np.linspace(1e-12, -1e-12, 37)  # as sums of decimals are
    cut = dataclasses.replace(whole, grip_time=time[1:-2] + inexact, grip_position=position[1:-2, :1])
    seen = Markers(fill_gaps_up_to=1.0).track(cut)
    assert seen.visible[1:-2].all()
    assert not seen.visible[[0, -2, -1]].any()
    assert np.array_equal(seen.position, whole.position)
    assert cut.visible.all()
    none = {"grip_material": np.zeros((0, 2)), "grip_position": np.zeros((37, 0, 3)), "obstacles": (Obstacle("plane"),)}
    assert Markers().track(dataclasses.replace(cut, **none)).visible.all()  # there are none to be known


def test_a_recording_keeps_its_gaps_and_its_sigma(tmp_path):
    recording = a_recording()
    path = write_recording(recording, tmp_path / "run.nc")
    for source in (recording, path, str(path)):
        seen = Markers().track(source)
        np.testing.assert_array_equal(seen.position, recording.position)
        np.testing.assert_array_equal(seen.visible, recording.visible)
        np.testing.assert_array_equal(seen.material, recording.material)
        assert seen.sigma == 0.002
        assert not seen.visible[3, 1]
    assert Markers(sigma=0.001).track(recording).sigma == 0.001
    stated = Markers(frame_tolerance=float("0.005"), up="".join(["z"]), rate=None)  # as they are when not stated
    assert np.array_equal(stated.track(recording).visible, Markers().track(recording).visible)


def test_a_recording_is_in_the_world_already():
    assert "'up'" in refused("run: settings", a_recording(), up="y")


@pytest.mark.parametrize("unit", marker_files.UNITS)
def test_csv_in_any_unit_is_read_in_metres(tmp_path, unit):
    time, position = run()
    position[2, 0] = np.nan
    seen = Markers(material=MATERIAL).track(write(tmp_path / "run.csv", csv_lines(time, position, unit=unit)))
    np.testing.assert_allclose(seen.position, position[:, :3], atol=1e-8)
    np.testing.assert_allclose(seen.time, time)
    assert np.argwhere(~seen.visible).tolist() == [[2, 0]]
    assert seen.material.tolist() == [list(uv) for uv in MATERIAL.values()]
    assert math.isnan(seen.sigma)


def test_csv_with_semicolons_and_decimal_commas_is_read_as_any_other(tmp_path):
    lines = csv_lines(*run())
    european = [line.replace(",", ";").replace(".", ",") for line in lines]
    dots = [line.replace(",", ";") for line in lines]
    whole = Markers(material=MATERIAL).track(write(tmp_path / "run.csv", lines))
    rated = ["# rate: 100,0", *european]
    for other in (european, dots, ["# unit: mm;;;", *european[1:]], rated):
        seen = Markers(material=MATERIAL).track(write(tmp_path / "other.csv", other))
        assert np.array_equal(seen.position, whole.position)
        assert np.array_equal(seen.time, whole.time)


def test_a_marker_of_a_csv_may_rest_at_the_origin_or_pass_it(tmp_path):
    time, position = run(40)
    position[:, 0] = 0.0
    position[:, 1] = np.linspace(-1, 1, 41)[:-1, None]  # at 0 in frame 20
    seen = Markers(material=MATERIAL).track(write(tmp_path / "run.csv", csv_lines(time, position)))
    assert seen.visible.all()
    assert (seen.position[20, :2] == 0).all()


@pytest.mark.parametrize("unseen", [slice(0, 3), slice(5, 6), slice(9, 12)])
def test_a_marker_of_a_csv_that_jumps_to_the_origin_was_not_seen(tmp_path, unseen):
    time, position = run()
    position[:, 1] = np.linspace(0.2, 0.3, 12)[:, None]
    position[unseen, 1] = 0.0
    message = refused("jumps", write(tmp_path / "run.csv", csv_lines(time, position)), material=MATERIAL)
    assert f"marker 'middle', frame {unseen.start + 1} of the file: found 0 0 0" in message
    assert "leave its cells empty" in message


def test_csv_may_state_unit_and_rate_as_settings(tmp_path):
    time, position = run()
    lines = [line.partition(",")[2] for line in csv_lines(time, position)[1:]]
    path = write(tmp_path / "run.csv", lines)
    seen = Markers(material=MATERIAL, unit="mm", rate=RATE).track(path)
    np.testing.assert_allclose(seen.time, time)
    refused("neither a time column nor a frame rate", path, material=MATERIAL, unit="mm")
    refused("unit: found none, expected mm, cm, m", path, material=MATERIAL, rate=RATE)
    refused("frames per second above 0", path, material=MATERIAL, unit="mm", rate=0)


def test_csv_without_a_clock_counts_frames_in_which_nothing_was_seen(tmp_path):
    time, position = run()
    position[20:30] = np.nan
    lines = [line.partition(",")[2] for line in csv_lines(time, position)[1:]]
    seen = Markers(material=MATERIAL, unit="mm", rate=RATE).track(write(tmp_path / "run.csv", [*lines, ""]))
    np.testing.assert_allclose(seen.time, time)
    assert not seen.visible[20:30].any()
    empty = "," * csv_lines(time, position)[1].count(",")  # as a table ends that once was longer
    seen = Markers(material=MATERIAL).track(write(tmp_path / "run.csv", [*csv_lines(time, position), empty]))
    np.testing.assert_allclose(seen.time, time)


def test_csv_without_a_clock_has_no_empty_line_between_its_frames(tmp_path):
    """Without it all that follows would come one frame too early."""
    lines = [line.partition(",")[2] for line in csv_lines(*run())[1:]]
    path = write(tmp_path / "run.csv", ["", *lines[:1], "", *lines[1:4], " ", *lines[4:]])
    with pytest.raises(ClothbenchError, match=r"run.csv: line 7: found nothing at all, expected frames without a gap"):
        Markers(material=MATERIAL, unit="mm", rate=RATE).track(path)
    with_clock = csv_lines(*run())
    path = write(path, [*with_clock[:4], "", *with_clock[4:]])
    assert Markers(material=MATERIAL).track(path).time.size == len(with_clock) - 2


def test_csv_files_one_after_the_other_have_one_unit(tmp_path):
    lines = csv_lines(*run())
    assert Markers(material=MATERIAL).track(write(tmp_path / "run.csv", [*lines, "# unit: mm", "# unit: mm"])).time.size
    path = write(tmp_path / "b.csv", [*lines, "# unit: m"])
    refused("line '# unit:': found 'mm' and 'm', expected one of them", path, material=MATERIAL)


def test_csv_frame_numbers_keep_dropped_frames_apart(tmp_path):
    lines = ["# unit: m,,", "# rate: 50", "frame,a:X,a:Y,a:Z", "10,1,2,3", "11,1,2,nan", "14,0,0,0"]
    path = write(tmp_path / "run.csv", lines)
    refused("marker 'a', frame 2 of the file: found a part of the coordinates", path, material={"a": (0, 0)})
    seen = Markers(material={"a": (0, 0)}).track(write(path, [*lines[:4], "11,,,", lines[5]]))
    np.testing.assert_allclose(seen.time, [0.2, 0.22, 0.28])
    assert seen.visible[:, 0].tolist() == [True, False, True]  # in a CSV file 0 0 0 is a place


def test_trc_is_read_with_blanks_and_zeros_as_gaps(tmp_path):
    time, position = run()
    position[4, 1], position[5, 2] = np.nan, 0.0
    seen = Markers(material=MATERIAL).track(write(tmp_path / "run.trc", trc_lines(time, position)))
    assert np.argwhere(~seen.visible).tolist() == [[4, 1], [5, 2]]
    shown = seen.visible
    np.testing.assert_allclose(seen.position[shown], position[:, :3][shown], atol=1e-8)
    assert np.isnan(seen.position[~shown]).all()


def test_c3d_is_read_with_negative_residuals_as_gaps(tmp_path):
    time, position = run()
    path = write_c3d(tmp_path / "run.c3d", position, unseen=[(2, 1), (7, 0)])
    seen = Markers(material=MATERIAL).track(path)
    assert np.argwhere(~seen.visible).tolist() == [[2, 1], [7, 0]]
    np.testing.assert_allclose(seen.position[seen.visible], position[:, :3][seen.visible], atol=1e-6)
    np.testing.assert_allclose(seen.time, time, atol=1e-6)
    refused("rate: found 100.0 in the file, expected 60", path, material=MATERIAL, rate=60)


def test_c3d_without_a_unit_needs_the_setting(tmp_path):
    path = write_c3d(tmp_path / "run.c3d", run()[1], unit="")
    refused("unit: found none", path, material=MATERIAL)
    assert Markers(material=MATERIAL, unit="mm").track(path).position.shape == (12, 3, 3)


@pytest.mark.parametrize("share", [0.0, 0.0001, 0.1, 0.3, 0.6, 0.9])
def test_a_cut_c3d_file_is_refused(tmp_path, share):
    path = write_c3d(tmp_path / "run.c3d", run(frames=500)[1])
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    refused("run.c3d: (header|data): found", path, material=MATERIAL)


def test_c3d_with_a_label_twice_is_refused(tmp_path):
    labels = ("grip", *LABELS[1:5], "grip")
    refused("'grip' twice", write_c3d(tmp_path / "run.c3d", run()[1], labels), material=MATERIAL)


def test_what_is_not_c3d_is_refused(tmp_path):
    pytest.importorskip("c3d")
    path = tmp_path / "run.c3d"
    path.write_bytes(b"no marker in here " * 100)
    refused("expected C3D", path, material=MATERIAL)


def test_without_the_c3d_package_the_line_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "c3d", None)
    path = tmp_path / "run.c3d"
    path.write_bytes(b"\x02\x50" + bytes(1022))
    refused(r"pip install clothbench\[c3d\]", path, material=MATERIAL)


def replaced(lines: list[str], number: int, old: str, new: str) -> list[str]:
    assert old in lines[number]
    return [line.replace(old, new, 1) if i == number else line for i, line in enumerate(lines)]


@pytest.mark.parametrize(
    ("break_it", "match"),
    [
        (lambda c: [*c[:-1], c[-1][:40]], "line 14: found . columns, expected 19"),
        (lambda c: c[:2], "no frames below the header"),
        (lambda c: [], "header: found no columns"),
        (lambda c: replaced(c, 5, ",", ",far"), "line 6, column 2: found 'far"),
        (lambda c: [*c, "0.9" + ",inf" * 18], "infinite value"),
        (lambda c: [*c[:4], c[5], c[4], *c[6:]], "time: found 0.02 s in frame 4"),
        (lambda c: [*c, c[-1]], "strictly increasing"),
        (lambda c: replaced(c, 3, "0.0100", ""), "time: found nan s in frame 2"),
        (lambda c: replaced(c, 0, "mm", "inch"), "unit: found 'inch', expected mm, cm, m"),
        (lambda c: c[1:], "unit: found none"),
        (lambda c: ["# rate: 50", *c], "stamps over 0.11 s, expected 0.22 s"),
        (lambda c: ["# rate: fast", *c], "found 'fast', expected a number"),
        (lambda c: replaced(c, 1, "grip_y", "grip_z"), "header: found grip_x, grip_z, grip_z"),
        (lambda c: [line.replace("middle", "grip") for line in c], "'grip' twice"),
        (lambda c: [*c[:2], *(line.replace(",", ";") for line in c[2:])], "line 3: found 1 columns, expected 19"),
        (lambda c: ["Format Version,1.23,Take Name,Swing", *c], "header: found Motive's own layout.* export C3D"),
    ],
)
def test_a_bad_csv_file_is_refused(tmp_path, break_it, match):
    message = refused("run.csv", write(tmp_path / "run.csv", break_it(csv_lines(*run()))), material=MATERIAL)
    assert re.search(match, message), message


@pytest.mark.parametrize(
    ("break_it", "match"),
    [
        (lambda c: c[:-2], "10 frames, expected 12"),
        (lambda c: [*c[:-1], c[-1][:50]], "line 18: found . columns, expected 20"),
        (lambda c: c[:3], "header: found 3 lines"),
        (lambda c: [line.replace("\t", " ") for line in c], "parted by tabs|header lines 4 and 5"),
        (lambda c: replaced(c, 2, "\t6\t", "\t7\t"), "NumMarkers: found 6 labels, expected 7"),
        (lambda c: replaced(c, 2, "100", "sixty"), "DataRate: found 'sixty'"),
        (lambda c: replaced(c, 2, "100", "60"), "stamps over 0.11 s, expected 0.18"),
        (lambda c: replaced(c, 2, "mm", ""), "unit: found none"),
        (lambda c: replaced(c, 3, "lower", "grip"), "'grip' twice"),
        (lambda c: replaced(c, 8, "0.0200", "0.0100"), "time: found 0.01 s in frame 3"),
        (lambda c: replaced(c, 8, "0.0200", "later"), "line 9, column 2: found 'later'"),
    ],
)
def test_a_bad_trc_file_is_refused(tmp_path, break_it, match):
    refused(match, write(tmp_path / "run.trc", break_it(trc_lines(*run()))), material=MATERIAL)


@pytest.mark.parametrize(
    ("settings", "match"),
    [
        ({}, "setting 'material': found none"),
        ({"material": 3}, "setting 'material': found int"),
        ({"material": {}}, "labels: found none"),
        ({"material": {"midle": (0, 0)}}, "found label 'midle'.*did you mean 'middle'"),
        ({"material": {"unheard": (0, 0)}}, "it has grip, middle"),
        ({"material": {"grip": (0, 0, 0)}}, "two numbers u, v"),
        ({"material": {"grip": "ab"}}, "two numbers u, v"),
        ({"material": {"grip": (0, 0), "lower": (0, 0)}}, "twice"),
        ({"material": MATERIAL, "unit": "cm"}, "unit: found mm in the file, expected cm"),
        ({"material": MATERIAL, "unit": "ft"}, "setting 'unit': found 'ft'"),
        ({"material": MATERIAL, "up": "w"}, "setting 'up': found 'w'"),
        ({"material": MATERIAL, "sigma": -1}, "setting 'sigma': found -1"),
        ({"material": MATERIAL, "fill_gaps_up_to": "long"}, "setting 'fill_gaps_up_to': found 'long'"),
        ({"material": MATERIAL, "fill_gaps_up_to": None}, "setting 'fill_gaps_up_to': found None"),
        ({"material": MATERIAL, "frame_tolerance": None}, "setting 'frame_tolerance': found None"),
    ],
)
def test_a_bad_setting_is_refused(good, settings, match):
    refused(match, good, **settings)


def test_an_unknown_setting_of_a_file_is_refused_with_the_nearest(good):
    with pytest.raises(ClothbenchError, match="did you mean 'fill_gaps_up_to'"):
        record(good, fill_gap_up_to=1)


def test_a_file_of_another_kind_or_none_is_refused(tmp_path):
    refused("ending '.xlsx'", tmp_path / "run.xlsx", material=MATERIAL)
    refused("no such file", tmp_path / "run.trc", material=MATERIAL)


def test_markers_nobody_saw_are_refused(tmp_path):
    time, position = run()
    path = write(tmp_path / "run.csv", csv_lines(time, np.full_like(position, np.nan)))
    refused("no sample of any node", path, material=MATERIAL)


def test_material_may_lie_in_a_small_file(tmp_path, good):
    table = write(tmp_path / "material.csv", ["label,u,v", *(f"{k},{u},{v}" for k, (u, v) in MATERIAL.items())])
    np.testing.assert_array_equal(Markers(material=table).track(good).material, list(MATERIAL.values()))
    refused("material.csv: header", good, material=write(table, ["marker,x,y", "grip,0,0"]))
    refused("material.csv: label 'grip'", good, material=write(table, ["label,u,v", "grip,0"]))
    refused(
        "material.csv: label 'grip'.*twice",
        good,
        material=write(table, ["label,u,v", "grip,0,0", "grip,0,1"]),
    )
    refused("no such file", good, material=tmp_path / "nowhere.csv")


def test_a_filled_gap_is_a_straight_line_that_does_not_count(tmp_path):
    time, position = run()
    position[4:6, 0] = position[8, 1] = position[0, 2] = np.nan
    path = write(tmp_path / "run.csv", csv_lines(time, position))
    bare, filled = (Markers(material=MATERIAL, fill_gaps_up_to=s).track(path) for s in (0, 0.02))
    np.testing.assert_array_equal(bare.visible, filled.visible)
    assert np.isnan(bare.position[~bare.visible]).all()
    np.testing.assert_allclose(filled.position[8, 1], position[[7, 9], 1].mean(axis=0), atol=1e-8)
    assert np.isnan(filled.position[4:6, 0]).all()  # 0.03 s between its edges
    assert np.isnan(filled.position[0, 2]).all()  # nothing before it


def test_filling_goes_by_time_not_by_frames():
    time = np.array([0.0, 0.3, 0.4])
    position = np.array([0.0, math.nan, 4.0])[:, None, None] * np.ones(3)
    np.testing.assert_allclose(fill_gaps(time, position, 0.4)[1, 0], 3.0)
    since_1970 = 1.7e9 + np.arange(300) / 100
    position = np.where(np.arange(300) % 2, math.nan, 1.0)[:, None, None] * np.ones(3)
    assert np.isfinite(fill_gaps(since_1970, position, 0.02)[:-1]).all()


def test_y_up_becomes_z_up_without_a_mirror():
    for axis, turn in UP.items():
        np.testing.assert_array_equal(turn @ np.eye(3)["xyz".index(axis)], [0, 0, 1])
        assert np.linalg.det(turn) == pytest.approx(1)


def test_up_and_a_stated_frame_are_applied_in_this_order(good):
    position = run()[1][:, :3]
    upright = Markers(material=MATERIAL, up="y").track(good).position
    np.testing.assert_allclose(upright, position[..., [0, 2, 1]] * [1, -1, 1], atol=1e-8)
    frame = np.column_stack([TURN, SHIFT]).tolist()
    for matrix in (frame, [*frame, [0, 0, 0, 1]]):
        seen = Markers(material=MATERIAL, up="y", frame=matrix).track(good)
        np.testing.assert_allclose(seen.position, upright @ TURN.T + SHIFT, atol=1e-8)


@pytest.mark.parametrize(
    ("frame", "match"),
    [
        (np.eye(3), "found shape"),
        ("sideways", "expected a 3×4 or 4×4"),
        (np.full((3, 4), np.nan), "not finite"),
        (np.diag([2.0, 2, 2, 1]), "scales, shears or mirrors"),
        (np.diag([1.0, 1, -1, 1]), "scales, shears or mirrors"),
        (np.vstack([np.eye(4)[:3], [1.0, 0, 0, 1]]), "transposed"),
        ({"post_a": (0, 0, 0), "post_b": (1, 0, 0)}, "at least three labels"),
        ({"post_a": (0, 0), "post_b": (1, 0), "post_c": (1, 1)}, "three numbers"),
        ({"post_a": (0, 0, 0), "post_b": (1, 0, 0), "post_x": (0, 1, 0)}, "did you mean 'post_"),
        ({"post_a": (0, 0, 0), "post_b": (1, 0, 0), "post_c": (2, 0, 0)}, "on one line"),
        ({"post_a": (0, 0, 0), "post_b": (1, 0, 0), "post_c": (0, 0.8, 0.4)}, "off by"),
        ({"post_a": (0, 0, 0), "post_b": (1, 0, 0), "lower": (0, 0.8, 0.3)}, "off by"),
    ],
)
def test_a_frame_that_is_not_rigid_or_not_sure_is_refused(good, frame, match):
    refused(match, good, material=MATERIAL, frame=frame)


def test_references_fix_the_frame_whatever_is_up(good):
    world = dict(zip(LABELS[3:], (POSTS + 0.01) @ TURN.T + SHIFT, strict=True))
    for up in "xyz":
        seen = Markers(material=MATERIAL, up=up, frame=world).track(good)
        np.testing.assert_allclose(seen.position, run()[1][:, :3] @ TURN.T + SHIFT, atol=1e-7)


def test_references_need_to_be_seen(tmp_path):
    time, position = run()
    position[:, 4] = np.nan
    path = write(tmp_path / "run.csv", csv_lines(time, position))
    world = dict(zip(LABELS[3:], POSTS, strict=True))
    refused("'post_b', which is never seen", path, material=MATERIAL, frame=world)


def test_the_fit_never_mirrors():
    flat = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.01]])
    transform = fit_rigid(flat, flat * [1, 1, -1])
    assert np.linalg.det(transform[:, :3]) == pytest.approx(1)


def record(path, **changes) -> Recording:
    told = {"material": MATERIAL, "grips": ["grip"], "cloth_width": 0.3, "cloth_height": 0.4}
    return recording_from_markers(path, **{**told, **changes})


def test_a_marker_file_becomes_a_recording(good, tmp_path):
    made = record(good, sigma=0.001, about={"fabric": "cotton", "areal_density": 0.2, "split": "fit"})
    read = read_recording(write_recording(made, tmp_path / "run.nc"))
    assert read.hash == made.hash
    assert (read.name, read.fabric, read.split, read.noise_sigma) == ("run", "cotton", "fit", 0.001)
    _, position = run()
    np.testing.assert_allclose(read.grip_position[:, 0], position[:, 0], atol=1e-8)
    np.testing.assert_allclose(read.position, position[:, 1:3], atol=1e-8)
    assert read.material.tolist() == [[0.0, 0.1], [0.05, 0.2]]
    assert read.grip_material.tolist() == [[0.0, 0.0]]


def test_gaps_in_nodes_stay_and_gaps_in_grips_need_leave(tmp_path):
    time, position = run()
    position[5, 0] = position[6, 1] = position[0, 0] = position[-1, 0] = np.nan
    path = write(tmp_path / "run.csv", csv_lines(time, position))
    with pytest.raises(ClothbenchError, match=r"none for 0.02 s after 0.04 s.*'fill_gaps_up_to'"):
        record(path)
    made = record(path, fill_gaps_up_to=0.05)
    np.testing.assert_allclose(made.grip_time, np.delete(time, [0, 5, 11]))
    np.testing.assert_allclose(made.time, time[1:-1])  # what the grip did before and after is not known
    assert np.argwhere(~made.visible).tolist() == [[5, 0]]


def test_a_single_frame_is_a_line_and_no_gap(tmp_path):
    time, position = run()
    path = write(tmp_path / "run.csv", csv_lines(time[:1], position[:1]))
    with pytest.raises(ClothbenchError) as caught:
        record(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("is_up", "told"), [("y", "z"), ("x", "z"), ("z", "y"), ("y", "x"), ("z", "x")])
def test_cloth_that_hangs_along_another_axis_is_refused_with_the_one_that_is_up(tmp_path, is_up, told):
    time, position = run()
    position[:, 0] = [0.1, 0.2, 1.0]
    position[:, 1:3] = [[0.1, 0.2, 0.9], [0.12, 0.2, 0.8]] + 0.01 * np.sin(60 * time)[:, None, None]
    position[3, 1] = np.nan
    path = write(tmp_path / "run.csv", csv_lines(time, position @ UP[is_up]))
    with pytest.raises(
        ClothbenchError,
        match=rf"^{re.escape(str(path))}: setting 'up': found '{told}', and the cloth beside its grips, along {is_up}, "
        rf"expected cloth below its grips; where it is held level, blown or dragged, say so by frame=np.eye\(4\); else "
        rf"set up='{is_up}'$",
    ):
        record(path, up=told)
    np.testing.assert_allclose(record(path, up=is_up).position, position[:, 1:3], atol=1e-8)
    assert record(path, up=told, frame=np.eye(4)).position.shape == (12, 2, 3)
    assert record(path, up=told, about={"obstacles": (Obstacle("plane"),)}).obstacles
    down = tuple(-9.81 * UP[told] @ UP[is_up].T[:, 2])
    assert record(path, up=told, about={"gravity": down}).gravity == down
    upside = write(tmp_path / "upside.csv", csv_lines(time, -position @ UP[is_up]))
    with pytest.raises(ClothbenchError, match=rf"along {is_up}, expected cloth below .*; else turn it by 'frame'$"):
        record(upside, up=told)


@pytest.mark.parametrize("missing", [slice(5, 6), slice(4, 8)])
def test_frames_that_are_missing_from_the_file_are_gaps_of_the_grips_too(tmp_path, missing):
    time, position = (np.delete(each, missing, axis=0) for each in run())
    path = write(tmp_path / "run.csv", csv_lines(time, position))
    gap = np.diff(time).max()
    with pytest.raises(ClothbenchError, match=rf"none for {gap:g} s after .*'fill_gaps_up_to'"):
        record(path)
    np.testing.assert_allclose(record(path, fill_gaps_up_to=gap).grip_time, time)
    shaken = run()[0] + np.tile([0.0, 0.003], 6)  # of 0.01 s
    record(write(tmp_path / "shaken.csv", csv_lines(shaken, run()[1])))


@pytest.mark.parametrize("steps", [(2, 2, 2, 2, 2, 1, 1, 1, 1, 1, 1), (1, 1, 1, 1, 1, 1, 2, 2, 2, 2, 2)])
def test_a_clock_that_changes_its_pace_drops_nothing(tmp_path, steps):
    """100 Hz and 50 Hz in one file: whichever had fewer frames was told to be a gap."""
    time = np.cumsum([0, *steps]) / 100
    np.testing.assert_allclose(record(write(tmp_path / "run.csv", csv_lines(time, run()[1]))).grip_time, time)


@pytest.mark.parametrize("kept", [(0, 1), (0, 1, 3)])
def test_frames_that_are_dropped_over_and_over_are_gaps(tmp_path, kept):
    """One in three had passed: half of the steps were twice as long as the others, so that none of them stood out."""
    period = kept[-1] + 2
    time = np.array([number for number in range(40) if number % period in kept][:12]) / 100
    with pytest.raises(ClothbenchError, match=r"none for 0.02 s after .*'fill_gaps_up_to'"):
        record(write(tmp_path / "run.csv", csv_lines(time, run()[1])))


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"grips": []}, "list of different marker labels"),
        ({"grips": "grip"}, "list of different marker labels"),
        ({"grips": ["grip", "grip"]}, "list of different marker labels"),
        ({"grips": ["post_a"]}, "label with its"),
        ({"grips": list(MATERIAL)}, "every marker held"),
        ({"material": None}, "setting 'material'"),
        ({"cloth_width": "wide"}, "setting 'cloth_width'"),
        ({"cloth_height": 0.1}, "expected inside the 0.3 m × 0.1 m cloth"),
        ({"about": {"colour": "red"}}, "setting 'about': found 'colour'"),
    ],
)
def test_a_recording_that_cannot_be_made_is_refused(good, changes, match):
    with pytest.raises(ClothbenchError, match=match):
        record(good, **changes)


def test_a_grip_nobody_saw_is_refused(tmp_path):
    time, position = run()
    position[:, 0] = np.nan
    with pytest.raises(ClothbenchError, match="0 frames with all of them seen"):
        record(write(tmp_path / "run.csv", csv_lines(time, position)))
