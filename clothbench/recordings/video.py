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

FRAME = Variable(("time", "y", "x"), "1", np.uint8, level=9, exact=True)
PROJECTOR = ("projector_size", *(f"projector_{n}" for n in LENSES if n != "distortion"), "stripe_period")
ATTRIBUTES = (*(f"camera_{name}" for name in LENSES), *PROJECTOR)


def _pack(video: Video) -> tuple[Arrays, Stated]:
    """The frames, and the attributes that state their calibration, numbers as text."""
    out: dict[str, Any] = {f"camera_{name}": _text(getattr(video.camera, name)) for name in LENSES}
    if (projector := video.projector) is not None:
        lens = projector.lens
        out |= {f"projector_{name}": _text(getattr(lens, name)) for name in LENSES if name != "distortion"}
        out |= {"projector_size": _text(lens.size), "stripe_period": float(projector.period)}
    return {"frame": video.frame}, out


def _unpack(arrays: Arrays, stated: Stated, path: Path) -> Video | None:
    """The video of a file; None where it has none."""
    if "frame" not in arrays:
        return None
    frame = arrays["frame"]
    camera = _lens(stated, "camera", (frame.shape[2], frame.shape[1]), path)
    projector = None
    if any(name in stated for name in PROJECTOR):
        width, height = _numbers(stated, "projector_size", (2,), path)
        lens = _lens(stated, "projector", (int(width), int(height)), path)
        projector = _said(path, lambda: Projector(lens, float(_numbers(stated, "stripe_period", (), path))))
    return Video(frame, camera, projector)


def _lens(stated: Stated, prefix: str, size: tuple[int, int], path: Path) -> Camera:
    names = [name for name in LENSES if not (prefix == "projector" and name == "distortion")]
    given = {name: _numbers(stated, f"{prefix}_{name}", LENSES[name], path) for name in names}
    return _said(path, lambda: Camera(size, **given))


def _said(path: Path, make: Any) -> Any:
    """`make()`; what it refuses is said with the file's name."""
    try:
        return make()
    except ClothbenchError as fault:
        raise ClothbenchError(f"{path}: {fault}") from fault


def _numbers(stated: Stated, name: str, shape: tuple[int, ...], path: Path) -> np.ndarray:
    if name not in stated:
        raise ClothbenchError(f"{path}: attribute {name!r} is missing; a recording with 'frame' needs it")
    try:
        return np.array([float(part) for part in str(stated[name]).split()]).reshape(shape)
    except ValueError:
        count = int(np.prod(shape))
        raise ClothbenchError(f"{path}: attribute {name!r}: found {stated[name]!r}, expected {count} numbers") from None


def _text(values: Any) -> str:
    return " ".join(repr(float(v)) for v in np.ravel(values))


VIDEO = Part({"frame": FRAME}, ATTRIBUTES, _pack, _unpack)
