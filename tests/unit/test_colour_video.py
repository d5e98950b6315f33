"""Recordings of kind "video": what is stored, what is refused, and video files that become one."""

from __future__ import annotations

import json
import os

import cv2
import flat_video as flat
import numpy as np
import pytest

from clothbench import ClothbenchError, GripPath, read_video, write_video
from clothbench.cli import main
from clothbench.core.pictures import silenced
from clothbench.datasets import video_file
from clothbench.datasets.video_file import video_recording
from clothbench.recordings.colour_video import Marks
from clothbench.recordings.kinds import read_any, read_sheet

CORNERS = np.array([[0.0, 0.0], [0.4, 0.0]])


def grips(count=6):
    return GripPath(np.arange(count) / 30.0, CORNERS, np.zeros((count, 2, 3)))


@pytest.mark.parametrize(
    "without",
    [{}, {"camera": None, "world": "cloth"}, {"grips": grips()}, {"marks": Marks(CORNERS, np.full((2, 2), 40.0))}],
)
def test_a_file_holds_all_of_it(tmp_path, without):
    given = flat.video(**without)
    path = write_video(given, tmp_path / "run.nc")
    again = read_video(path)
    assert again.hash == given.hash
    assert read_any(path).hash == read_sheet(path).hash == given.hash
    assert np.array_equal(again.template, given.template)
    assert [name for name in ("camera", "grips", "marks") if getattr(again, name) is None] == [
        name for name in ("camera", "grips", "marks") if getattr(given, name) is None
    ]
    frames = list(again.frames())
    assert len(frames) == 6
    assert np.array_equal(frames[3], flat.frames(6)[3])


@pytest.mark.parametrize(
    ("change", "found"),
    [
        ({"time": np.array([0, 1, 2, 3, 4, 90]) / 30}, "found a jump of"),
        ({"cloth_width": 0.0}, "expected metres above 0"),
        ({"gravity": (0.0, 0.0, np.inf)}, "expected three finite numbers"),
        ({"world": "moon"}, "expected 'cloth' or 'camera'"),
        ({"camera": None}, "no camera is stated"),
        ({"world": "cloth", "grips": grips()}, "no camera in whose world they are"),
        ({"template": np.zeros((20, 20, 3), np.uint8)}, "at least 64 px each way"),
        ({"ends": np.array([1, 2])}, "found 2 ends, expected 6"),
        ({"stream": np.arange(600, dtype=np.uint8), "ends": 100 * np.arange(1, 7)}, "no frame that can be read"),
        ({"marks": Marks(CORNERS, np.array([[1.0, 1.0], [900.0, 4.0]]))}, "a mark outside the frame of 480 × 320 px"),
        ({"marks": Marks(CORNERS, np.zeros((3, 2)))}, "found (3, 2), expected (2, 2)"),
    ],
)
def test_faults_are_one_line(change, found):
    with pytest.raises(ClothbenchError) as fault:
        flat.video(**change)
    assert found in str(fault.value)


def test_a_broken_picture_is_told_with_its_frame(tmp_path, capsys):
    given = flat.video()
    stream = given.stream.copy()
    stream[given.ends[2] : given.ends[2] + 40] = 0
    broken = flat.video(stream=stream)
    with pytest.raises(ClothbenchError, match="no picture that can be read at frame 3"):
        list(broken.frames())
    write_video(broken, tmp_path / "broken.nc")
    assert main(["validate", str(tmp_path)]) == 1
    assert "no picture that can be read at frame 3" in capsys.readouterr().out


# --- video files ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A folder of pictures, the same as a video, a template, a camera."""
    folder = tmp_path_factory.mktemp("video")
    (folder / "pictures").mkdir()
    film = cv2.VideoWriter(str(folder / "run.mp4"), cv2.VideoWriter_fourcc(*"mp4v"), 30.0, flat.PIXELS)
    for k, frame in enumerate(flat.frames(6)):
        cv2.imwrite(str(folder / "pictures" / f"{k:03d}.png"), frame[..., ::-1])
        film.write(frame[..., ::-1])
    film.release()
    cv2.imwrite(str(folder / "template.png"), flat.template()[..., ::-1])
    cv2.imwrite(str(folder / "plain.png"), flat.template(plain=True)[..., ::-1])
    cv2.imwrite(str(folder / "other.png"), np.random.default_rng(1).integers(0, 255, (300, 600, 3)).astype(np.uint8))
    matrix = flat.CAMERA.matrix.tolist()
    (folder / "camera.json").write_text(json.dumps({"size": flat.PIXELS, "matrix": matrix}))
    turned = {"size": flat.PIXELS, "matrix": matrix, "rotation": np.eye(3).tolist()}
    (folder / "turned.json").write_text(json.dumps(turned))
    (folder / "text.mp4").write_text("no video")
    return folder


def settings(files, **changes):
    given = {"template": str(files / "template.png"), "width": "0.4", "height": "0.2", **changes}
    return {name: value for name, value in given.items() if value is not None}


def test_a_video_and_a_folder_of_pictures_become_recordings(files, tmp_path):
    whole = settings(files, camera=str(files / "camera.json"), fabric="cotton", out=str(tmp_path))
    film = read_video(video_recording(files / "run.mp4", {**whole, "name": "film"}))
    assert (film.name, film.fabric, film.ends) == ("film", "cotton", None)
    assert np.allclose(np.diff(film.time), 1 / 30, atol=1e-4)
    assert film.camera is not None
    assert film.world == "cloth"
    pictures = read_video(video_recording(files / "pictures", {**whole, "rate": "25", "marks": "10,20;300,25"}))
    assert np.allclose(np.diff(pictures.time), 0.04)
    assert pictures.marks is not None
    assert np.array_equal(pictures.marks.material, CORNERS)
    assert len(list(film.frames())) == len(list(pictures.frames())) == 6


def test_a_stamp_that_comes_twice_is_no_reason_to_take_the_files_rate(files, tmp_path, monkeypatch):
    whole, stamps = settings(files, out=str(tmp_path)), np.array([0, 0.1, 0.1, 0.3, 0.4, 0.5])
    monkeypatch.setattr(video_file, "_stamps", lambda *_: (stamps.tolist(), 30.0))
    with pytest.raises(ClothbenchError, match=r"frame 2 at 0\.1 s after frame 1 at 0\.1 s, expected stamps that grow"):
        video_recording(files / "run.mp4", whole)
    assert np.allclose(read_video(video_recording(files / "run.mp4", {**whole, "rate": "10"})).time, np.arange(6) / 10)
    monkeypatch.setattr(video_file, "_stamps", lambda *_: ([0.0] * 6, 30.0))  # a container without any
    film = read_video(video_recording(files / "run.mp4", {**whole, "name": "film"}))
    assert np.allclose(film.time, np.arange(6) / 30)


def test_a_rate_in_place_of_the_files_own_is_told(files, tmp_path, capsys):
    """A slow-motion film states how fast it is to be shown, so that it may well be meant."""
    known = [f"{name}={value}" for name, value in settings(files, out=str(tmp_path), width="0.41").items()]
    for rate, told in ((["rate=240"], "rate=240 is taken in place of the 30 frames a second that"), (["rate=30"], "")):
        assert main(["import", str(files / "run.mp4"), *known, f"name=at {rate}", *rate]) == 0
        lines = [line for line in capsys.readouterr().err.splitlines() if "clothbench: " in line]
        assert [told in line for line in lines] == [True] * bool(told)


def test_threads_that_want_silence_together_give_the_terminal_back():
    before, one, other = os.fstat(2), silenced(), silenced()
    one.__enter__()
    other.__enter__()
    one.__exit__(None, None, None)
    assert os.fstat(2).st_ino != before.st_ino
    other.__exit__(None, None, None)
    assert (os.fstat(2).st_dev, os.fstat(2).st_ino) == (before.st_dev, before.st_ino)


def test_pictures_come_in_the_order_of_their_numbers(files, tmp_path):
    for k in range(6):
        (tmp_path / f"{k + 8}.png").write_bytes((files / "pictures" / f"{k:03d}.png").read_bytes())
    made = read_video(video_recording(tmp_path, settings(files, rate="25", out=str(tmp_path / "made"))))
    assert np.array_equal(next(made.frames()), flat.frames(6)[0])


@pytest.mark.parametrize(
    ("source", "change", "found"),
    [
        ("run.mp4", {"template": None}, "template=PICTURE is missing"),
        ("run.mp4", {"width": None}, "width=METRES is missing"),
        ("run.mp4", {"height": "20"}, "expected metres, 0.01 to 10"),
        ("run.mp4", {"width": "0.2", "height": "0.4"}, "found 640 × 320 px for a cloth of width=0.2 and height=0.4 m"),
        ("run.mp4", {"width": "0.43"}, "crop the picture at the hems"),
        ("run.mp4", {"template": "{}/text.mp4"}, "found no picture that can be read, expected the template"),
        ("run.mp4", {"template": "{}/plain.png"}, "a plain cloth shows nothing to go by"),
        ("run.mp4", {"template": "{}/other.png"}, "found no cloth in the first frame"),
        ("run.mp4", {"camera": "{}/text.mp4"}, "found no JSON that can be read"),
        ("run.mp4", {"camera": "{}/turned.json"}, "'camera': found no 'translation', expected both or neither"),
        ("run.mp4", {"marks": "3,4"}, "the upper left and the upper right corner"),
        ("text.mp4", {}, "found 0 frames that can be read"),
        ("pictures", {}, "pictures have no clock; state rate="),
    ],
)
def test_what_makes_no_recording_is_one_line(files, tmp_path, source, change, found):
    change = {name: value and value.format(files) for name, value in change.items()}
    with pytest.raises(ClothbenchError) as fault:
        video_recording(files / source, settings(files, out=str(tmp_path / "out"), **change))
    assert found in str(fault.value)
    assert not (tmp_path / "out").exists()
