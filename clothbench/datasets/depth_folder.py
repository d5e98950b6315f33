"""A folder of depth frames, or of point clouds, as one recording of kind "depth".

FOLDER/recording.json      what the frames do not say (below)
FOLDER/depth/*.png         16 bit, in the order of their names, numbers in them as numbers; 0: nothing measured
FOLDER/colour/*.png|jpg    as many, registered to the depth; may be missing
FOLDER/clouds/*.ply|npy    instead of `depth`: points (n, 3) m in the camera's frame, x right, y down, z forwards

recording.json needs `name`, `cloth_width`, `cloth_height` [m], `time` (a list of s) or `rate` [1/s], and `camera`:
`size` [width, height] px and `matrix` (3 × 3), or `fx`, `fy`, `cx`, `cy`; where it stands, `rotation` and `translation`
(x_camera = R x_world + t), or it is taken to look along +y from the origin, level. `depth_step` [m] is 0.001 unless
stated. `colour_time`, `grips` (`time`, `material`, `position`), `gravity` and the texts of a recording's header may be
there too; what else there is becomes a note.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from clothbench.core.camera import Camera, distorted
from clothbench.core.errors import ClothbenchError, misspelled, seen
from clothbench.core.files import file_name, in_order, read_arrays, read_json
from clothbench.core.observation import GripPath
from clothbench.core.pictures import picture_of
from clothbench.core.progress import FileProgress
from clothbench.recordings.codec import write
from clothbench.recordings.depth import LAYOUT, Colour, DepthImages
from clothbench.recordings.kinds import read_any
from clothbench.recordings.rig import FOR_NODES, RawRecording

LEVEL = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # a camera that looks along +y, z up
MILLIMETRE = 1e-3
FARTHEST = 65535  # steps that a depth frame of 16 bit can tell; what is farther counts as not measured
SUGGESTED = {"name", "kind", "field_of_view_deg", "position_m", "target_m", "up"}  # what `suggest` writes beside them
OF_CAMERAS = {"size", "matrix", "fx", "fy", "cx", "cy", "distortion", "rotation", "translation"} | SUGGESTED
OF_GRIPS = ("time", "material", "position")
OWN = {"camera", "time", "rate", "colour_time", "grips", "gravity", "depth_step"}
TAKEN = OWN | {f.name for f in fields(DepthImages)}


def depth_recording(folder: Path, out: Path, progress: FileProgress | None = None) -> Path:
    """Read a folder and write `out`/NAME.nc; faults are one line with file, found and expected."""
    images = read_folder(folder, progress)
    path = out / f"{file_name(images.name)}.nc"
    require_no_other(path, images)
    return write(images, path, LAYOUT)


def require_no_other(path: Path, recording: RawRecording) -> None:
    """Refuse to write over a file that holds anything else."""
    if not path.exists():
        return
    try:
        same = read_any(path).hash == recording.hash
    except ClothbenchError:
        same = False
    if not same:
        raise ClothbenchError(
            f"{path}: found another recording, expected no file of that name; give this one another name, or out=FOLDER"
        )


def read_folder(folder: Path, progress: FileProgress | None = None) -> DepthImages:
    """The recording that a folder of frames amounts to."""
    about = _about(folder)
    where = folder / "recording.json"
    clouds, images = _files(folder / "clouds", (".ply", ".npy")), _files(folder / "depth", (".png",))
    _check_parts(folder, clouds, images)
    files = clouds or images
    if not files:
        raise ClothbenchError(f"{folder}: found no frames, expected depth/*.png (16 bit) or clouds/*.ply or *.npy")
    time = _stamps(about, len(files), where)
    camera = camera_of(_needed(about, "camera", where), where)
    step = _number(about, "depth_step", where, MILLIMETRE)
    if not step > 0:
        raise ClothbenchError(f"{where}: 'depth_step': found {step:g}, expected metres above 0")
    frames = []
    for number, file in enumerate(files):
        frames.append(projected(read_cloud(file), camera, step, file) if clouds else read_png(file, camera))
        if progress is not None:
            progress(number + 1, len(files), file.name)
    return DepthImages(
        name=_name(about, where), time=time, depth=np.stack(frames), depth_step=step,
        camera=camera, colour=_colour(folder, about, time, camera), grips=_grips(about, where), path=str(folder),
        **_header(about, where),
    )  # fmt: skip


def _check_parts(folder: Path, clouds: Sequence[Path], images: Sequence[Path]) -> None:
    """Each frame stands there once, and what would be passed over has a name that could not be meant."""
    if clouds and images:
        raise ClothbenchError(f"{folder}: found frames in both depth and clouds, expected one of them; move one away")
    if len(endings := {file.suffix.lower() for file in clouds}) > 1:
        raise ClothbenchError(
            f"{folder / 'clouds'}: found frames that end in {' and '.join(sorted(endings))}, expected one of them; "
            "move the others away"
        )
    there, parts = {path.name for path in folder.iterdir() if path.is_dir()}, {"depth", "clouds", "colour"}
    if found := misspelled(there - parts, parts - there):
        raise ClothbenchError(f"{folder}: found a folder {found[0]!r}, expected {found[1]!r}; rename it")


def read_png(file: Path, camera: Camera) -> np.ndarray:
    """A depth frame (H, W) of whole numbers; one that is not 16 bit, or not of the camera's size, is refused."""
    import cv2

    image = picture_of(file, cv2.IMREAD_UNCHANGED)
    if image is None:
        raise ClothbenchError(f"{file}: found no image that can be read, expected a PNG of 16 bit")
    if image.dtype != np.uint16 or image.ndim != 2:
        raise ClothbenchError(
            f"{file}: found {image.dtype} with {image.ndim} dimensions, expected one channel of 16 bit; an image of "
            "8 bit is a picture of depth, not depth"
        )
    if image.shape != camera.size[::-1]:
        raise ClothbenchError(
            f"{file}: found {image.shape[1]} × {image.shape[0]} px, expected camera.size {camera.size}"
        )
    return image


def read_cloud(file: Path) -> np.ndarray:
    """Points (n, 3) m of a NumPy file, or of the vertices of a PLY file (ASCII or binary)."""
    try:
        points = read_arrays(file)["array"] if file.suffix.lower() == ".npy" else _ply(file)
    except (OSError, ValueError, IndexError) as fault:
        raise ClothbenchError(f"{file}: found no points that can be read ({fault}), expected points (n, 3)") from fault
    if points.ndim != 2 or points.shape[1] < 3 or points.dtype.kind not in "iuf":
        raise ClothbenchError(f"{file}: found an array of shape {points.shape}, expected points (n, 3) in metres")
    points = np.asarray(points[:, :3], dtype=float)
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) and not 0.05 <= np.median(np.abs(points[:, 2])) <= 20.0:
        raise ClothbenchError(
            f"{file}: found a middle depth of {np.median(points[:, 2]):g}, expected 0.05 … 20 m; are these millimetres?"
        )
    return points


PLY_TYPES = {"char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
             "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
             "double": "f8", "float64": "f8"}  # fmt: skip


def _ply(file: Path) -> np.ndarray:
    """x, y, z of the vertices, which have to be the first element."""
    raw = file.read_bytes()
    end = re.search(rb"end_header\r?\n", raw)
    head, mark, body = (raw[: end.start()], True, raw[end.end() :]) if end else (raw, False, b"")
    lines = head.decode("ascii", "replace").splitlines()
    if not mark or lines[0].strip() != "ply":
        raise ClothbenchError(f"{file}: found no PLY header, expected 'ply' … 'end_header'")
    words = [line.split() for line in lines if line.strip()]
    form = next((w[1] for w in words if w[0] == "format"), "")
    elements = [k for k, w in enumerate(words) if w[0] == "element"]
    if not elements or words[elements[0]][1] != "vertex":
        raise ClothbenchError(f"{file}: found no vertices first, expected 'element vertex N'")
    count, last = int(words[elements[0]][2]), elements[1] if len(elements) > 1 else len(words)
    names = [(w[-1], w[1]) for w in words[elements[0] + 1 : last] if w[0] == "property"]
    if not {"x", "y", "z"} <= {name for name, _ in names} or any(kind not in PLY_TYPES for _, kind in names):
        raise ClothbenchError(f"{file}: found vertices of {[n for n, _ in names]}, expected numbers x, y and z")
    if form == "ascii":
        rows = [line.split() for line in body.decode().splitlines() if line.strip()]
        stated = sum(int(words[k][2]) for k in elements)  # the others follow the vertices, a row each
        if len(rows) < stated or any(len(row) != len(names) for row in rows[:count]):
            raise ClothbenchError(
                f"{file}: found {len(rows)} rows, expected {stated}, the first {count} with {len(names)} numbers each; "
                "is it whole?"
            )
        numbers = np.array(rows[:count], dtype=float)
        table = {name: numbers[:, k] for k, (name, _) in enumerate(names)}
    else:
        order = {"binary_little_endian": "<", "binary_big_endian": ">"}.get(form)
        if order is None:
            raise ClothbenchError(f"{file}: found format {form!r}, expected ascii or binary")
        kind = np.dtype([(name, order + PLY_TYPES[of]) for name, of in names])
        if len(body) < count * kind.itemsize:
            raise ClothbenchError(
                f"{file}: found {len(body)} bytes of {count} vertices, expected {count * kind.itemsize}"
            )
        vertices = np.frombuffer(body, kind, count)
        table = {name: vertices[name] for name, _ in names}
    return np.stack([np.asarray(table[c], dtype=float) for c in "xyz"], axis=1)


def projected(points: np.ndarray, camera: Camera, step: float, file: Path) -> np.ndarray:
    """Points (n, 3) m in the camera's frame as a depth frame (H, W): the nearest in every pixel; 0 where there is none.

    Clouds come thinner than the camera's pixels now and then: choose `size` and `matrix` so that a pixel has a point.
    """
    front = points[points[:, 2] > 0]
    width, height = camera.size
    with np.errstate(over="ignore", invalid="ignore"):  # what is nowhere is not inside
        flat = front[:, :2] / front[:, 2:]
        flat = distorted(flat, camera.distortion) if camera.distortion.any() else flat
        place = np.round(flat @ camera.matrix[:2, :2].T + camera.matrix[:2, 2])
        inside = ((place >= 0) & (place < [width, height])).all(axis=1) & (front[:, 2] / step <= FARTHEST)
    pixel = np.where(inside[:, None], place, 0).astype(int)
    if not inside.any():
        raise ClothbenchError(f"{file}: found no point that the camera sees, expected some; is z forwards, in metres?")
    out = np.full((height, width), np.inf)
    np.minimum.at(out, (pixel[inside, 1], pixel[inside, 0]), front[inside, 2])
    depth, seen = np.zeros((height, width), np.uint16), np.isfinite(out)
    depth[seen] = np.round(out[seen] / step)
    return depth


def _about(folder: Path) -> dict[str, Any]:
    file = folder / "recording.json"
    if not file.exists():
        raise ClothbenchError(f"{file}: no such file; it states name, cloth size, camera and stamps of the frames")
    found = read_json(file, "an object with name, camera, …")
    if not isinstance(found, dict):
        raise ClothbenchError(f"{file}: found {type(found).__name__}, expected an object with name, camera, …")
    return found


def _needed(about: Mapping[str, Any], name: str, where: Path) -> Any:
    if name not in about:
        hint = (
            ": size and matrix, or fx, fy, cx, cy; without a calibration depth is no geometry"
            if name == "camera"
            else ""
        )
        raise ClothbenchError(f"{where}: {name!r} is missing{hint}")
    return about[name]


def _name(about: Mapping[str, Any], where: Path) -> str:
    """The recording's name, which becomes that of its file."""
    if not isinstance(name := _needed(about, "name", where), str) or not name.strip():
        raise ClothbenchError(f"{where}: 'name': found {name!r}, expected text")
    return seen(name)


def _files(folder: Path, endings: Sequence[str]) -> list[Path]:
    return in_order(p for p in folder.glob("*") if p.suffix.lower() in endings) if folder.is_dir() else []


def _stamps(about: Mapping[str, Any], count: int, where: Path) -> np.ndarray:
    if "time" in about:
        time = _numbers(about, "time", where)
        if time.shape != (count,):
            raise ClothbenchError(f"{where}: 'time': found {time.size} stamps, expected {count}, one for each frame")
        if "rate" in about:
            raise ClothbenchError(f"{where}: 'rate': found it beside 'time', expected one of them; take the other out")
        return time
    _needed(about, "rate", where)
    rate = _number(about, "rate", where)
    if not (rate > 0 and math.isfinite(count / rate)):
        raise ClothbenchError(f"{where}: 'rate': found {about['rate']!r}, expected frames per second, above 0")
    return np.arange(count) / rate


def _number(about: Mapping[str, Any], name: str, where: Path, otherwise: float = np.nan) -> float:
    value = about.get(name, otherwise)
    if not isinstance(value, int | float) or isinstance(value, bool):
        raise ClothbenchError(f"{where}: {name!r}: found {value!r}, expected a number")
    try:
        return float(value)
    except OverflowError:
        raise ClothbenchError(f"{where}: {name!r}: found a number of {len(str(value))} digits, expected one") from None


def _numbers(about: Mapping[str, Any], name: str, where: Path) -> np.ndarray:
    try:
        return np.array(about[name], dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise ClothbenchError(f"{where}: {name!r}: found something else, expected a list of numbers") from None


def camera_of(told: Any, where: Path) -> Camera:
    """The camera that a JSON object states; without a place it looks along +y from the origin, level."""
    if isinstance(told, dict):
        if unknown := [name for name in told if name not in OF_CAMERAS]:
            known = ", ".join(sorted(OF_CAMERAS - SUGGESTED))
            raise ClothbenchError(
                f"{where}: 'camera': found {unknown[0]!r}, expected {known}; correct it or take it out"
            )
        if ("rotation" in told) != ("translation" in told):
            lacks = "translation" if "rotation" in told else "rotation"
            raise ClothbenchError(
                f"{where}: 'camera': found no {lacks!r}, expected both or neither; they say where it is"
            )
        if "matrix" in told and (twice := [name for name in ("fx", "fy", "cx", "cy") if name in told]):
            raise ClothbenchError(
                f"{where}: 'camera': found {twice[0]!r} beside 'matrix', which has it; take one of them out"
            )
    try:
        if any(isinstance(n, bool) or n != int(n) for n in told["size"]):
            raise ClothbenchError(f"'camera': size is {told['size']}, expected whole numbers of pixels")
        size = tuple(int(n) for n in told["size"])
        if "matrix" in told:
            matrix = np.array(told["matrix"], dtype=float)
        else:
            matrix = np.array([[told["fx"], 0, told["cx"]], [0, told["fy"], told["cy"]], [0, 0, 1.0]], dtype=float)
        more = {name: np.array(told[name], dtype=float) for name in ("distortion",) if name in told}
        rotation = np.array(told.get("rotation", LEVEL), dtype=float)
        translation = np.array(told.get("translation", np.zeros(3)), dtype=float)
        return Camera(size, matrix, rotation, translation, **more)  # type: ignore[arg-type]
    except (KeyError, TypeError, ValueError, OverflowError, AttributeError) as fault:
        raise ClothbenchError(
            f"{where}: 'camera': found {type(fault).__name__} {fault}, expected size and matrix, or fx, fy, cx, cy"
        ) from fault
    except ClothbenchError as fault:
        raise ClothbenchError(f"{where}: {fault}") from fault


def _colour(folder: Path, about: Mapping[str, Any], time: np.ndarray, camera: Camera) -> Colour | None:
    import cv2

    files = _files(folder / "colour", (".png", ".jpg", ".jpeg"))
    if not files:
        return None
    if len(files) != len(time):
        raise ClothbenchError(f"{folder / 'colour'}: found {len(files)} pictures, expected {len(time)}, one a frame")
    frames = []
    for file in files:
        image = picture_of(file, cv2.IMREAD_COLOR)
        if image is None or image.shape[:2] != camera.size[::-1]:
            found = "no picture that can be read" if image is None else f"{image.shape[1]} × {image.shape[0]} px"
            raise ClothbenchError(f"{file}: found {found}, expected camera.size {camera.size}, registered to the depth")
        frames.append(image[..., ::-1])
    where = folder / "recording.json"
    stamps = _numbers({"colour_time": time, **about}, "colour_time", where)
    if stamps.shape != time.shape:
        raise ClothbenchError(
            f"{where}: 'colour_time': found {stamps.size} stamps, expected {len(time)}, one for each picture"
        )
    return Colour(stamps, np.stack(frames))


def _grips(about: Mapping[str, Any], where: Path) -> GripPath | None:
    if "grips" not in about:
        return None
    if isinstance(about["grips"], dict) and (unknown := [name for name in about["grips"] if name not in OF_GRIPS]):
        raise ClothbenchError(
            f"{where}: 'grips': found {unknown[0]!r}, expected {', '.join(OF_GRIPS)} (s, m, m); take it out"
        )
    try:
        return GripPath(*(np.array(about["grips"][name], dtype=float) for name in OF_GRIPS))
    except (KeyError, TypeError, ValueError, OverflowError) as fault:
        raise ClothbenchError(
            f"{where}: 'grips': found {type(fault).__name__} {fault}, expected time, material and position"
        ) from fault


def _header(about: Mapping[str, Any], where: Path) -> dict[str, Any]:
    """The other fields of the recording, and notes of what it has no field for."""
    for name in ("cloth_width", "cloth_height"):
        _needed(about, name, where)
    out: dict[str, Any] = {k: v for k, v in about.items() if k in LAYOUT.texts and k != "name"}
    if wrong := [name for name, value in out.items() if not isinstance(value, str)]:
        raise ClothbenchError(f"{where}: {wrong[0]!r}: found {out[wrong[0]]!r}, expected text")
    out = {name: seen(text) for name, text in out.items()}
    out |= {k: _number(about, k, where) for k in (*LAYOUT.numbers, *FOR_NODES) if k in about and k not in OWN}
    if "gravity" in about:
        gravity = _numbers(about, "gravity", where)
        if gravity.shape != (3,):
            raise ClothbenchError(f"{where}: 'gravity': found {about['gravity']!r}, expected three numbers [m/s²]")
        out["gravity"] = tuple(gravity.tolist())
    strays = {k: seen(str(v)) for k, v in about.items() if k not in TAKEN}
    if wrong := [name for name in strays if not re.fullmatch(r"\w[\w .-]*", name)]:
        raise ClothbenchError(f"{where}: {wrong[0]!r}: found a name that is none, expected letters, digits and _")
    absent = LAYOUT.known.union(OWN) - set(about)
    if found := misspelled(strays.keys() - LAYOUT.known, absent):
        raise ClothbenchError(f"{where}: found {found[0]!r}, expected {found[1]!r}; a note needs a name less like it")
    return out | {"notes": {k: v for k, v in strays.items() if k not in LAYOUT.known}}


def notes_in(folder: Path) -> list[str]:
    """The words of a folder's recording.json that are kept as notes: neither a tracker nor a model heeds them."""
    return [name for name in _about(folder) if name not in LAYOUT.known and name not in TAKEN]
