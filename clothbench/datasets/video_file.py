"""A video file, or a folder of pictures, as one recording of kind "video".

What the frames do not say comes as settings: `template`, a picture of the flat cloth from hem to hem; `width` and
`height` of the cloth [m], in the picture's proportions; and if they are known `rate` [1/s] (a folder of pictures needs
it; a video states its own, in whose place it is taken),
`camera`, a JSON file with `size` [width, height] px and `matrix`, or `fx`, `fy`, `cx`, `cy`, and `distortion`, and
where the camera stands, `rotation` and `translation`; `marks`, the held points in the first frame, as `x,y;x,y` px of
the upper left and the upper right corner, or of all four corners, clockwise; `name`, `fabric`, `motion`, `split`,
`areal_density`.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from clothbench.core.camera import Camera
from clothbench.core.errors import ClothbenchError
from clothbench.core.files import file_name, in_order, read_json
from clothbench.core.pictures import silenced
from clothbench.core.progress import FileProgress
from clothbench.datasets.depth_folder import camera_of, require_no_other
from clothbench.recordings.codec import write
from clothbench.recordings.colour_video import LAYOUT, ColourVideo, Marks, decoded
from clothbench.vision.template import Keypoints, find_template

SETTINGS = ("template", "width", "height", "rate", "camera", "marks", "name", "fabric", "motion", "split",
            "areal_density", "out")  # fmt: skip
PICTURES = (".png", ".jpg", ".jpeg")
MARKERS = (".csv", ".trc", ".c3d")
LEAST_FRAMES = 5
ASKEW = 0.05  # share by which the proportions of a template may differ from those of the cloth: hems are cut by hand


def is_video(source: Path) -> bool:
    """Whether a path is a file, or a folder of pictures that is none of depth frames; one that is known to be another
    thing is refused.
    """
    if source.is_file() and source.suffix.lower() in (".nc", *MARKERS):
        found, expected = "a recording", f"a video; see it with clothbench validate {shlex.quote(str(source))}"
        if source.suffix.lower() != ".nc":
            found = "motion capture"
            expected = "a video; docs/recordings.md tells under Motion capture how it becomes a recording"
        raise ClothbenchError(f"{source}: found {found}, expected {expected}")
    return source.is_file() or (
        source.is_dir() and not (source / "recording.json").is_file() and bool(_pictures_in(source))
    )


def video_recording(source: Path, settings: Mapping[str, str], progress: FileProgress | None = None) -> Path:
    """Read a video and write `out`/NAME.nc; faults are one line with file, found and expected."""
    video = read_source(source, settings, progress)
    path = Path(settings.get("out", "recordings")) / f"{file_name(video.name)}.nc"
    require_no_other(path, video)
    return write(video, path, LAYOUT)


def read_source(source: Path, settings: Mapping[str, str], progress: FileProgress | None = None) -> ColourVideo:
    """The recording that a video and what is said of it amount to; the cloth is looked for in its first frame."""
    template = _template(settings)
    width, height = (_metres(settings, name) for name in ("width", "height"))
    if source.is_dir():
        stream, ends, time = _pictures(source, _rate(settings), progress)
    else:
        stream, time = _film(source, _rate(settings), progress)
        ends = None
    _require_proportions(template, width, height, settings["template"])
    camera, placed = _camera(settings)
    video = ColourVideo(
        name=settings.get("name", source.stem), time=time, stream=stream, ends=ends, template=template,
        cloth_width=width, cloth_height=height, camera=camera, world="camera" if placed else "cloth",
        marks=_marks(settings, width, height), sensor="colour camera", path=str(source),
        areal_density=_number(settings, "areal_density", np.nan),
        fabric=settings.get("fabric", ""), motion=settings.get("motion", ""), split=settings.get("split", ""),
    )  # fmt: skip
    if video.marks is None or len(video.marks.material) < 4:
        first = next(video.frames())
        find_template(Keypoints.of(template), Keypoints.of(first), template.shape[:2], str(source))
    return video


def _template(settings: Mapping[str, str]) -> np.ndarray:
    if "template" not in settings:
        raise ClothbenchError(
            "template=PICTURE is missing: a picture of the flat cloth from hem to hem, u to the right"
        )
    file = Path(settings["template"])
    stream = np.frombuffer(file.read_bytes() if file.is_file() else b"", np.uint8)
    picture = next(decoded(stream, np.array([len(stream)]))) if len(stream) else None
    if picture is None:
        raise ClothbenchError(f"{file}: found no picture that can be read, expected the template")
    return picture


def _require_proportions(template: np.ndarray, width: float, height: float, file: str) -> None:
    """Refuse a cloth of another shape than its picture, as of swapped width and height: every place on it would be
    wrong, and the tracker none the wiser.
    """
    down, across = template.shape[:2]
    if not 1 / (1 + ASKEW) <= (across / down) / (width / height) <= 1 + ASKEW:
        raise ClothbenchError(
            f"{file}: found {across} × {down} px for a cloth of width={width:g} and height={height:g} m, expected the "
            "same proportions; swap width and height, or crop the picture at the hems"
        )


def _number(settings: Mapping[str, str], name: str, otherwise: float) -> float:
    try:
        return float(settings.get(name, otherwise))
    except ValueError:
        raise ClothbenchError(f"{name}={settings[name]}: expected a number") from None


def _metres(settings: Mapping[str, str], name: str) -> float:
    if name not in settings:
        raise ClothbenchError(f"{name}=METRES is missing: how large the cloth is, which no picture says")
    value = _number(settings, name, np.nan)
    if not 0.01 <= value <= 10:
        raise ClothbenchError(f"{name}={settings[name]}: expected metres, 0.01 to 10")
    return value


def _rate(settings: Mapping[str, str]) -> float | None:
    if "rate" not in settings:
        return None
    rate = _number(settings, "rate", np.nan)
    if not 1 <= rate <= 10_000:
        raise ClothbenchError(f"rate={settings['rate']}: expected frames a second, 1 or more")
    return rate


def _film(file: Path, rate: float | None, progress: FileProgress | None) -> tuple[np.ndarray, np.ndarray]:
    """The bytes of a video file, and a stamp for each of its frames: those of the file, unless a rate is stated."""
    import cv2

    stream = np.frombuffer(file.read_bytes(), np.uint8)
    with silenced():
        film = cv2.VideoCapture(str(file))
    stamps, told = _stamps(film, file, progress)
    if len(stamps) < LEAST_FRAMES:
        raise ClothbenchError(
            f"{file}: found {len(stamps)} frames that can be read, expected a video of {LEAST_FRAMES} or more; convert "
            "it, with ffmpeg say, to MP4 (H.264)"
        )
    time = np.array(stamps)
    if rate is not None:
        time = np.arange(len(time)) / rate
    elif not (np.diff(time) > 0).any():  # no frame has a stamp of its own
        if not told > 0:
            raise ClothbenchError(f"{file}: found neither stamps nor a rate in the video; state rate=FRAMES_PER_SECOND")
        time = np.arange(len(time)) / told
    elif (wrong := np.flatnonzero(np.diff(time) <= 0)).size:
        k = int(wrong[0])
        raise ClothbenchError(
            f"{file}: found frame {k + 1} at {time[k + 1]:g} s after frame {k} at {time[k]:g} s, expected stamps that "
            "grow; if the frames are evenly apart, state rate=FRAMES_PER_SECOND"
        )
    return stream, time - time[0]


def stated_rate(file: Path) -> float:
    """Frames a second that a video file states; 0 where it states none."""
    import cv2

    with silenced():
        film = cv2.VideoCapture(str(file))
    try:
        return float(film.get(cv2.CAP_PROP_FPS))
    finally:
        film.release()


def _stamps(film: Any, file: Path, progress: FileProgress | None) -> tuple[list[float], float]:
    """The stamps [s] of the frames that can be read, and the rate [1/s] that the file states."""
    import cv2

    stamps, planned = [], max(0, int(film.get(cv2.CAP_PROP_FRAME_COUNT)))
    try:
        while _grabbed(film):
            stamps.append(1e-3 * film.get(cv2.CAP_PROP_POS_MSEC))
            if progress is not None:
                progress(len(stamps), max(planned, len(stamps)), file.name)
        return stamps, film.get(cv2.CAP_PROP_FPS)
    finally:
        film.release()


def _grabbed(film: Any) -> bool:
    with silenced():
        return film.grab()


def _pictures_in(folder: Path) -> list[Path]:
    return in_order(p for p in folder.iterdir() if p.suffix.lower() in PICTURES)


def _pictures(
    folder: Path, rate: float | None, progress: FileProgress | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The bytes of a folder's pictures, in the order of their names, where each ends, and their stamps."""
    files = _pictures_in(folder)
    if len(files) < LEAST_FRAMES:
        raise ClothbenchError(f"{folder}: found {len(files)} pictures, expected {LEAST_FRAMES} or more (.png, .jpg)")
    if rate is None:
        raise ClothbenchError(f"{folder}: pictures have no clock; state rate=FRAMES_PER_SECOND")
    parts, size = [], None
    for number, file in enumerate(files, 1):
        part = np.frombuffer(file.read_bytes(), np.uint8)
        picture = next(decoded(part, np.array([len(part)])))
        if picture is None:
            raise ClothbenchError(f"{file}: found no picture that can be read, expected PNG or JPEG")
        if size not in (None, picture.shape):
            raise ClothbenchError(
                f"{file}: found {picture.shape[1]} × {picture.shape[0]} px, expected as in {files[0]}"
            )
        size = picture.shape
        parts.append(part)
        if progress is not None:
            progress(number, len(files), file.name)
    return np.concatenate(parts), np.cumsum([len(part) for part in parts]), np.arange(len(files)) / rate


def _camera(settings: Mapping[str, str]) -> tuple[Camera | None, bool]:
    if "camera" not in settings:
        return None, False
    file = Path(settings["camera"])
    told = read_json(file, "a camera")
    return camera_of(told, file), isinstance(told, dict) and {"rotation", "translation"} <= told.keys()


def _marks(settings: Mapping[str, str], width: float, height: float) -> Marks | None:
    if "marks" not in settings:
        return None
    try:
        pixel = np.array([[float(c) for c in point.split(",")] for point in settings["marks"].split(";")])
    except ValueError:
        pixel = np.zeros((0, 2))
    corner = np.array([[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]])
    if pixel.shape not in ((2, 2), (4, 2)):
        raise ClothbenchError(
            f"marks={settings['marks']}: expected x,y;x,y in px: the upper left and the upper right corner, or all "
            "four corners clockwise"
        )
    return Marks(corner[: len(pixel)], pixel)
