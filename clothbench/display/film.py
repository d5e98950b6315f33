"""A film: one recording and what models make of it, thinned to what a page can hold; played by `assets/player.js`.

In a cell's folder it is an NPZ file of arrays, in a page packed text.
"""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from clothbench.core.camera import LENSES, Camera, Projector
from clothbench.core.errors import ClothbenchError
from clothbench.core.files import read_arrays
from clothbench.vision.surface import surface_of

FRAMES = 25  # at most
ACROSS = 5  # frames in a row of the picture that holds them all
WIDTH = 240  # px of a frame at most
QUALITY = 50  # of WebP: stripes and their folds stay, the sensor's noise does not
STEPS = 32_000  # in which a coordinate is told, over all that moves: some 30 µm for a metre
REFINE = 4  # cells of a lattice are drawn as so many in each direction, as the metrics on pictures draw them
NOWHERE = np.int16(-32_768)


@dataclass(frozen=True, eq=False)
class Take:
    """What one parameter set makes of a recording. position: (F, N, 3) m; error: (F,) in the film's unit, NaN where
    there is none.
    """

    position: np.ndarray
    error: np.ndarray


@dataclass(frozen=True, eq=False)
class Film:
    """One recording in F frames. identity: what is the same for all films of one recording; time: (F,) s; material:
    (N, 2) m; seen: (F, N, 3) m, NaN where a point was not seen; metric, unit: of errors; floor: of noise, or None;
    picture: all frames in one WebP picture, row by row, empty where there were none; size: (width, height) px of a
    frame; camera, projector: what sees the points in them; flat: whether that is all that
    tells where points are, so that nothing is known along its line of sight; cloud: whether nobody knows which of the
    seen points is which, seen then being (F, P, 3) m of any number; takes: by what they are called.
    """

    identity: str
    name: str
    split: str
    time: np.ndarray
    material: np.ndarray
    seen: np.ndarray
    metric: str
    unit: str
    floor: float | None = None
    picture: bytes = b""
    size: tuple[int, int] = (0, 0)
    camera: Camera | None = None
    projector: Projector | None = None
    flat: bool = False
    cloud: bool = False
    takes: Mapping[str, Take] = field(default_factory=dict)


def chosen_frames(count: int) -> np.ndarray:
    """Numbers of at most `FRAMES` of so many frames, evenly spread."""
    return np.unique(np.linspace(0, count - 1, min(count, FRAMES)).round().astype(int))


def contact_sheet(frames: np.ndarray) -> tuple[bytes, tuple[int, int]]:
    """Frames (F, H, W) or (F, H, W, 3), 8 bits, red first, as one WebP picture; and the (width, height) of each."""
    import cv2

    share = min(1.0, WIDTH / frames.shape[2])
    small = [f if share == 1 else cv2.resize(f, None, fx=share, fy=share, interpolation=cv2.INTER_AREA) for f in frames]
    blank = np.zeros_like(small[0])
    rows = [small[i : i + ACROSS] for i in range(0, len(small), ACROSS)]
    across = len(rows[0])
    sheet = np.vstack([np.hstack(row + [blank] * (across - len(row))) for row in rows])
    if sheet.ndim == 3:
        sheet = cv2.cvtColor(sheet, cv2.COLOR_RGB2BGR)
    return cv2.imencode(".webp", sheet, [cv2.IMWRITE_WEBP_QUALITY, QUALITY])[1].tobytes(), small[0].shape[1::-1]


def scaled(camera: Camera, size: tuple[int, int]) -> Camera:
    """The same camera with a picture of (width, height) px."""
    share = np.array(size) / camera.size
    matrix = camera.matrix.copy()
    matrix[:2] *= share[:, None]
    matrix[:2, 2] += (share - 1) / 2  # a pixel's place is its middle
    return Camera(size, matrix, camera.rotation, camera.translation, camera.distortion)


# --- as files --------------------------------------------------------------------------------------------------------


def write_film(path: Path, film: Film) -> None:
    """One NPZ file; places in whole steps."""
    origin, step = grid_of(film)
    about = {
        name: getattr(film, name)
        for name in ("identity", "name", "split", "metric", "unit", "floor", "size", "flat", "cloud")
    } | {"takes": list(film.takes), "optics": optics(film)}  # fmt: skip
    arrays = {f"position_{n}": in_steps(t.position, origin, step) for n, t in enumerate(film.takes.values())}
    arrays |= {f"error_{n}": np.asarray(t.error, np.float32) for n, t in enumerate(film.takes.values())}
    arrays |= {
        "about": np.array(json.dumps(about)), "time": film.time, "material": film.material, "origin": origin,
        "step": np.array(step), "seen": in_steps(film.seen, origin, step),
        "picture": np.frombuffer(film.picture, np.uint8),
    }  # fmt: skip
    np.savez_compressed(path, allow_pickle=False, **arrays)


def read_film(path: Path) -> Film:
    """One NPZ file of `write_film`; a damaged one is refused in one line."""
    try:
        return _film(read_arrays(path))
    except Exception as fault:  # whatever a page would trip over in it: the file may come from anywhere
        said = (str(fault).splitlines() or [type(fault).__name__])[0]
        raise ClothbenchError(
            f"{path}: found a damaged film ({said}), expected it as it was written; delete its folder and run again"
        ) from fault


def _film(file: Mapping[str, np.ndarray]) -> Film:
    about, origin, step = json.loads(str(file["about"])), file["origin"], float(file["step"])
    takes = {
        word: Take(in_metres(file[f"position_{n}"], origin, step), file[f"error_{n}"])
        for n, word in enumerate(about.pop("takes"))
    }
    told = about.pop("optics")
    camera = Camera(tuple(about["size"]), **told["camera"]) if told else None
    projector = None
    if told and told["projector"]:
        period, size = told["projector"].pop("period"), told["projector"].pop("size")
        projector = Projector(Camera(tuple(size), **told["projector"]), period)
    return Film(
        **{**about, "size": tuple(about["size"])}, time=file["time"], material=file["material"],
        seen=in_metres(file["seen"], origin, step), picture=file["picture"].tobytes(), camera=camera,
        projector=projector, takes=takes,
    )  # fmt: skip


def grid_of(film: Film) -> tuple[np.ndarray, float]:
    """Origin (3,) m and step [m] of the whole numbers in which all places of a film are told."""
    points = np.concatenate([film.seen.reshape(-1, 3), *(t.position.reshape(-1, 3) for t in film.takes.values())])
    known = points[np.isfinite(points).all(axis=1)]
    if not len(known):
        return np.zeros(3), 1.0
    low, high = known.min(axis=0), known.max(axis=0)
    return (low + high) / 2, float((high - low).max() / 2 / STEPS) or 1e-6


def in_steps(position: np.ndarray, origin: np.ndarray, step: float) -> np.ndarray:
    """Places (..., 3) m as whole numbers of 16 bits; what is not known is `NOWHERE`."""
    known = np.isfinite(position)
    return np.where(known, np.round((np.where(known, position, 0.0) - origin) / step), NOWHERE).astype(np.int16)


def in_metres(steps: np.ndarray, origin: np.ndarray, step: float) -> np.ndarray:
    return np.where(steps == NOWHERE, np.nan, steps * step + origin)


def optics(film: Film) -> dict[str, Any] | None:
    """Camera and projector as numbers; None where no camera is known."""
    if film.camera is None:
        return None
    lens = film.projector.lens if film.projector else None
    return {
        "camera": {name: getattr(film.camera, name).tolist() for name in LENSES},
        "projector": lens
        and {
            **{name: getattr(lens, name).tolist() for name in LENSES},
            "period": film.projector.period if film.projector else None, "size": list(lens.size),
        },
    }  # fmt: skip


# --- in a page -------------------------------------------------------------------------------------------------------


def recording_data(film: Film) -> dict[str, Any]:
    """What the player needs of the recording, whatever is made of it."""
    picture = f"data:image/webp;base64,{b64encode(film.picture).decode()}" if film.picture else ""
    return {
        "time": [round(float(t), 4) for t in film.time], "seen": places(film.seen),
        "surface": surface_data(film.material), "picture": picture, "across": min(ACROSS, len(film.time)),
        "size": list(film.size), "flat": film.flat, "cloud": film.cloud,
        "optics": optics(film),
    }  # fmt: skip


def take_data(take: Take) -> dict[str, Any]:
    error = [None if not np.isfinite(e) else float(f"{e:.4g}") for e in take.error]
    return {"position": places(take.position), "error": error}


def places(position: np.ndarray) -> dict[str, Any]:
    """Places (F, N, 3) m: steps from frame to frame as text of whole numbers, which packs well."""
    known = position[np.isfinite(position).all(axis=-1)]
    low, high = (known.min(axis=0), known.max(axis=0)) if len(known) else (np.zeros(3), np.ones(3))
    origin, step = (low + high) / 2, float((high - low).max() / 2 / STEPS) or 1e-6
    steps = in_steps(position, origin, step)
    moved = np.diff(steps, axis=0, prepend=np.zeros((1, *steps.shape[1:]), np.int16)).transpose(2, 1, 0)
    split = np.frombuffer(moved.astype("<i2").tobytes(), np.uint8).reshape(-1, 2).T  # low bytes, then high ones
    return {
        "origin": origin.tolist(), "step": step, "shape": list(position.shape),
        "steps": b64encode(np.ascontiguousarray(split).tobytes()).decode(),
    }  # fmt: skip


def surface_data(material: np.ndarray) -> dict[str, Any]:
    """How points (N, 2) m are joined to a drawn surface: the lines of a lattice and the order of its points, which the
    player refines, or triangles. Nothing where all points lie on one line.
    """
    u, v = (np.unique(material[:, i].round(9)) for i in (0, 1))
    if len(u) * len(v) == len(material) and min(len(u), len(v)) > 1:
        order = np.lexsort(material.round(9).T)
        return {"u": u.tolist(), "v": v.tolist(), "order": order.tolist(), "refine": REFINE}
    try:
        return {"triangle": surface_of(material).triangle.tolist()}
    except ClothbenchError:
        return {"triangle": []}
