"""What a camera saw of a run, inside its recording: variable `frame` (time, y, x) and the attributes that calibrate it.

camera_matrix [px, row by row], camera_rotation, camera_translation [m], camera_distortion; with stripes on the cloth
projector_size [px], projector_matrix, projector_rotation, projector_translation, and stripe_period [px].
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from clothbench.core.camera import LENSES, Camera, Projector, Video
from clothbench.core.errors import ClothbenchError
from clothbench.recordings.layout import Arrays, Part, Stated, Variable

WIDEST = 100_000  # px of a picture
FRAME = Variable(("time", "y", "x"), "1", np.uint8, level=9, exact=True)
PROJECTOR = ("projector_size", *(f"projector_{n}" for n in LENSES if n != "distortion"), "stripe_period")
ATTRIBUTES = (*(f"camera_{name}" for name in LENSES), *PROJECTOR)


def _pack(video: Video) -> tuple[Arrays, Stated]:
    """The frames, and the attributes that state their calibration, numbers as text."""
    out: dict[str, Any] = {f"camera_{name}": text_of(getattr(video.camera, name)) for name in LENSES}
    if (projector := video.projector) is not None:
        lens = projector.lens
        out |= {f"projector_{name}": text_of(getattr(lens, name)) for name in LENSES if name != "distortion"}
        out |= {"projector_size": text_of(lens.size), "stripe_period": float(projector.period)}
    return {"frame": video.frame}, out


def _unpack(arrays: Arrays, stated: Stated, path: Path) -> Video | None:
    """The video of a file; None where it has none."""
    if "frame" not in arrays:
        if there := [name for name in ATTRIBUTES if name in stated]:
            raise ClothbenchError(
                f"{path}: variable 'frame' is missing beside attribute {there[0]!r}; add what the camera saw, or take "
                "its calibration out"
            )
        return None
    frame = arrays["frame"]
    camera = lens_of(stated, "camera", (frame.shape[2], frame.shape[1]), path)
    projector = None
    if any(name in stated for name in PROJECTOR):
        lens = lens_of(stated, "projector", size_of(stated, "projector_size", path), path)
        projector = _said(path, lambda: Projector(lens, float(numbers_of(stated, "stripe_period", (), path))))
    return Video(frame, camera, projector)


def lens_of(
    stated: Stated, prefix: str, size: tuple[int, int], path: Path, whose: str = "a recording with 'frame'"
) -> Camera:
    """The camera or projector that attributes `PREFIX_…` calibrate."""
    names = [name for name in LENSES if not (prefix == "projector" and name == "distortion")]
    given = {name: numbers_of(stated, f"{prefix}_{name}", LENSES[name], path, whose) for name in names}
    return _said(path, lambda: Camera(size, **given))


def _said(path: Path, make: Any) -> Any:
    """`make()`; what it refuses is said with the file's name."""
    try:
        return make()
    except ClothbenchError as fault:
        raise ClothbenchError(f"{path}: {fault}") from fault


def numbers_of(
    stated: Stated, name: str, shape: tuple[int, ...], path: Path, whose: str = "a recording with 'frame'"
) -> np.ndarray:
    """An attribute of several numbers, as an array of this shape."""
    if name not in stated:
        raise ClothbenchError(f"{path}: attribute {name!r} is missing; {whose} needs it")
    count = int(np.prod(shape))
    try:
        found = np.array([float(part) for part in str(stated[name]).split()])
    except ValueError:
        found = np.empty(0)
    if len(found) != count or not np.isfinite(found).all():
        raise ClothbenchError(f"{path}: attribute {name!r}: found {stated[name]!r}, expected {count} finite numbers")
    return found.reshape(shape)


def size_of(stated: Stated, name: str, path: Path, whose: str = "a recording with 'frame'") -> tuple[int, int]:
    """An attribute of a width and a height [px]."""
    found = numbers_of(stated, name, (2,), path, whose)
    if not ((found == np.round(found)) & (found >= 1) & (found <= WIDEST)).all():
        raise ClothbenchError(
            f"{path}: attribute {name!r}: found {stated[name]!r}, expected width and height in whole pixels, "
            f"1 to {WIDEST}"
        )
    return int(found[0]), int(found[1])


def text_of(values: Any) -> str:
    """Numbers as an attribute has them: exact, one after the other."""
    return " ".join(repr(float(v)) for v in np.ravel(values))


VIDEO = Part({"frame": FRAME}, ATTRIBUTES, _pack, _unpack)
