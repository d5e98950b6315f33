"""From a recording to the scene that a model is asked to simulate."""

from __future__ import annotations

import math

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.scene import AIR_DENSITY, Scene
from clothbench.recordings.nodes import Recording

BOW = 0.01  # of the width, by which a sheet in a picture is bowed
FIRST_FRAMES, FIRST_SECONDS = 5, 0.2  # at least, of the motion that a sheet starts from


def scene_of(
    recording: Recording,
    *,
    areal_density: float | None = None,
    resolution: tuple[int, int] | None = None,
    air_density: float = AIR_DENSITY,
    spacing: float | None = None,
    start: str = "rest",
) -> Scene:
    """The scene of one recording. `areal_density` [kg/m²] stands in where the recording does not know it.

    spacing [m]: of the mesh's nodes, at most, whatever the cloth's size; it takes the place of `resolution`.
    start: "rest", the sheet settles in its grips' first pose, or "measured", it goes on from where it was first seen,
    as it moved then.
    """
    density = recording.areal_density
    if not math.isfinite(density):
        if areal_density is None:
            raise ClothbenchError(
                f"{recording.path or recording.name}: attribute 'areal_density' is not known; "
                "state what to assume with scene.areal_density=VALUE [kg/m²] (improve: areal_density=VALUE)"
            )
        density = areal_density
    if start == "measured" and recording.sight is not None:
        raise ClothbenchError(
            f"{recording.path or recording.name}: found points in a picture, which says nothing of their depth; "
            "scene.start=measured needs places in space: use scene.start=rest"
        )
    if spacing is not None:
        nodes = [1 + math.ceil(length / spacing - 1e-6) for length in (recording.cloth_width, recording.cloth_height)]
        resolution = (max(3, nodes[0]), max(3, nodes[1]))
    seen = np.flatnonzero(recording.visible.any(axis=1))[:3]
    with np.errstate(invalid="ignore"):
        early = np.where(recording.visible[seen, :, None], recording.position[seen], np.nan)
    place, velocity = first_motion(recording) if start == "measured" else (_first_seen(early), None)
    if recording.sight is not None:
        place = _bowed(recording, place)
    return Scene(
        width=recording.cloth_width,
        height=recording.cloth_height,
        areal_density=density,
        grip_time=recording.grip_time,
        grip_material=recording.grip_material,
        grip_position=recording.grip_position,
        times=recording.time,
        points=recording.material,
        gravity=recording.gravity,
        air_density=air_density,
        resolution=resolution,
        start=place,
        velocity=velocity,
        camera=recording.sight,
    )


def first_motion(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Where each node was (N, 3) m and how fast (N, 3) m/s at the first frame, from a parabola through the first ones.

    A node that is seen too seldom in them has NaN for both, the place included: there it would be of a later time.
    """
    time = recording.time - recording.time[0]
    count = max(FIRST_FRAMES, int(np.searchsorted(time, FIRST_SECONDS)))
    terms = np.vander(time[:count], 3, increasing=True)
    place, velocity = (np.full((len(recording.material), 3), np.nan) for _ in range(2))
    for n in range(len(recording.material)):
        seen = recording.visible[:count, n]
        if seen.sum() >= FIRST_FRAMES - 1:
            fit = np.linalg.lstsq(terms[: len(seen)][seen], recording.position[:count][seen, n], rcond=None)[0]
            place[n], velocity[n] = fit[0], fit[1]
    if not np.isfinite(place).any():
        raise ClothbenchError(
            f"{recording.path or recording.name}: found no node seen in {FIRST_FRAMES - 1} of its first {count} "
            "frames, which scene.start=measured needs; use scene.start=rest"
        )
    return place, velocity


def _bowed(recording: Recording, place: np.ndarray) -> np.ndarray:
    """Places (N, 3) m in a picture moved a little from the camera, most in the middle: as they were seen they lie on
    one plane, in which no sheet would ever buckle.
    """
    assert recording.sight is not None
    away = np.nanmean(place, axis=0) - recording.sight.place
    bow = BOW * recording.cloth_width * np.sin(np.pi * recording.material[:, :1] / recording.cloth_width)
    return place + bow * away / np.linalg.norm(away)


def _first_seen(early: np.ndarray) -> np.ndarray:
    """Position of each node in the first of a few frames (F, N, 3) in which it was seen → (N, 3)."""
    start = np.full(early.shape[1:], np.nan)
    for frame in early[::-1]:
        seen = np.isfinite(frame).all(axis=-1)
        start[seen] = frame[seen]
    return start
