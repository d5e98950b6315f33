"""From a recording to the scene that a model is asked to simulate."""

from __future__ import annotations

import inspect
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from clothbench.core.drape import drape_points
from clothbench.core.errors import ClothbenchError
from clothbench.core.outline import disc_outline
from clothbench.core.scene import AIR_DENSITY, Obstacle, Scene, obstacles_of
from clothbench.recordings.nodes import Recording
from clothbench.recordings.points import PointCloud
from clothbench.recordings.silhouette import Silhouettes

BOW = 0.01  # of the width, by which a sheet in a picture is bowed
STARTS, PERTURBATION = 4, 2e-3  # drapes of one parameter set; m rms at the rim, that their first shapes are off by
WAVES = range(2, 15)  # around the rim, of which a first shape is a mixture
FIRST_FRAMES, FIRST_SECONDS = 5, 0.2  # at least, of the motion that a sheet starts from


def scenes_of(recording: Recording | PointCloud | Silhouettes, **settings: Any) -> list[Scene]:
    """What is simulated for one recording: one scene, or of silhouettes one for each of several first shapes.

    settings: of `scene_of` or `drapes_of`; one that the other has only is refused in one line.
    """
    make: Any = drapes_of if isinstance(recording, Silhouettes) else scene_of
    if strays := sorted(set(settings) - set(inspect.signature(make).parameters)):
        raise ClothbenchError(
            f"setting 'scene.{strays[0]}' says nothing to recordings of kind {recording.kind!r}, "
            f"as {recording.path or recording.name} is; leave it out"
        )
    made = make(recording, **settings)
    return made if isinstance(made, list) else [made]


def scene_of(
    recording: Recording | PointCloud,
    *,
    areal_density: float | None = None,
    resolution: tuple[int, int] | None = None,
    air_density: float = AIR_DENSITY,
    spacing: float | None = None,
    start: str = "rest",
    outline: Sequence[Sequence[float]] | np.ndarray | None = None,
    obstacles: Sequence[Obstacle | Mapping[str, Any]] | None = None,
    thickness: float | None = None,
) -> Scene:
    """The scene of one recording. `areal_density` [kg/m²] stands in where the recording does not know it.

    outline, obstacles, thickness: as in `Scene`; they take the place of what the recording states.

    spacing [m]: of the mesh's nodes, at most, whatever the cloth's size; it takes the place of `resolution`.
    start: "rest", the sheet settles in its grips' first pose, or "measured", it goes on from where it was first seen,
    as it moved then.

    Of a cloud the points are its `lattice`, and nobody saw where these were: the sheet settles as its grips hold it.
    """
    density = areal_density_of(recording, areal_density)
    if isinstance(recording, PointCloud):
        _require_of_cloud(recording, start, outline)
        points, place, velocity, sight = recording.lattice, None, None, None
    else:
        points, sight = recording.material, recording.sight
        place, velocity = _beginning(recording, start)
    if spacing is not None:
        resolution = _spaced(recording.cloth_width, recording.cloth_height, spacing)
    return Scene(
        width=recording.cloth_width,
        height=recording.cloth_height,
        areal_density=density,
        grip_time=recording.grip_time,
        grip_material=recording.grip_material,
        grip_position=recording.grip_position,
        times=recording.time,
        points=points,
        gravity=recording.gravity,
        air_density=air_density,
        resolution=resolution,
        start=place,
        velocity=velocity,
        camera=sight,
        outline=recording.outline if outline is None else np.array(outline),
        obstacles=obstacles_of((recording.obstacles or ()) if obstacles is None else obstacles),
        thickness=(recording.thickness or 0.0) if thickness is None else thickness,
    )


def drapes_of(
    recording: Silhouettes,
    *,
    areal_density: float | None = None,
    resolution: tuple[int, int] | None = None,
    air_density: float = AIR_DENSITY,
    spacing: float | None = None,
    obstacles: Sequence[Obstacle | Mapping[str, Any]] = (),
    thickness: float | None = None,
    starts: int = STARTS,
    perturbation: float = PERTURBATION,
) -> list[Scene]:
    """The scenes of a drapemeter: a disc clamped on its plate, `starts` times, each from another first shape.

    Which of several drapes a cloth falls into is decided by how it was laid on; so many first shapes are off the plane
    by `perturbation` m (rms, at the rim), each a mixture of waves around it, the same at every call. Seen are
    `drape_points`, at rest. obstacles: beside the plate; thickness: m, in place of the recording's; without either the
    layers pass through each other.
    """
    disc, plate = recording.disc_radius, recording.plate_radius
    points = drape_points(plate, disc)
    stated = recording.thickness if math.isfinite(recording.thickness) else 0.0
    return [
        Scene(
            width=2 * disc, height=2 * disc, areal_density=areal_density_of(recording, areal_density),
            grip_time=np.array([0.0, 1.0]), grip_material=np.zeros((0, 2)), grip_position=np.zeros((2, 0, 3)),
            times=np.array([0.0]), points=points, air_density=air_density,
            resolution=_spaced(2 * disc, 2 * disc, spacing) if spacing is not None else resolution,
            start=_laid(points - disc, plate, perturbation, k), outline=disc_outline(disc),
            obstacles=(Obstacle("disc", radius=plate, clamps=True), *obstacles_of(obstacles)),
            thickness=stated if thickness is None else thickness,
        )
        for k in range(starts)
    ]  # fmt: skip


def _laid(from_middle: np.ndarray, plate: float, perturbation: float, k: int) -> np.ndarray:
    """Where points (N, 2) m from a disc's middle lie (N, 3) m when it has been laid on its plate for the k-th time."""
    rng = np.random.default_rng([*b"drape", k])
    away, turn = np.hypot(*from_middle.T), np.arctan2(-from_middle[:, 1], from_middle[:, 0])
    waves = [rng.standard_normal(2) @ [np.cos(m * turn), np.sin(m * turn)] for m in WAVES]
    out = np.clip((away - plate) / (away.max() - plate), 0.0, 1.0)
    height = perturbation * out * np.sum(waves, axis=0) / math.sqrt(len(WAVES))
    return np.column_stack([from_middle[:, 0], -from_middle[:, 1], height])


def areal_density_of(recording: Any, assumed: float | None) -> float:
    """The areal density that a recording of any kind of sheet states, or else what is assumed [kg/m²]; refused where
    there is neither.
    """
    if math.isfinite(recording.areal_density):
        return float(recording.areal_density)
    if assumed is None:
        raise ClothbenchError(
            f"{recording.path or recording.name}: attribute 'areal_density' is not known; "
            "state what to assume with scene.areal_density=VALUE [kg/m²] (improve: areal_density=VALUE)"
        )
    return assumed


def refuse_stated_weight(recordings: Sequence[Any], assumed: float | None) -> None:
    """Refuse an areal density [kg/m²] to assume where every recording states its own: it would say nothing."""
    if assumed is None or any(math.isnan(recording.areal_density) for recording in recordings):
        return
    first = recordings[0]
    raise ClothbenchError(
        f"setting 'scene.areal_density' is {assumed:g}, and {first.path or first.name} states {first.areal_density:g} "
        f"kg/m², as all {len(recordings)} do; leave it out (~scene.areal_density where a suite has it), or change the "
        "recordings"
    )


def _spaced(width: float, height: float, spacing: float) -> tuple[int, int]:
    """Nodes along (u, v) that are at most `spacing` m apart."""
    across, down = (max(3, 1 + math.ceil(length / spacing - 1e-6)) for length in (width, height))
    return across, down


def _beginning(recording: Recording, start: str) -> tuple[np.ndarray, np.ndarray | None]:
    """Where the points were first seen (N, 3) m, and how fast they moved then (N, 3) m/s, where the sheet goes on."""
    if start == "measured" and recording.sight is not None:
        raise ClothbenchError(
            f"{recording.path or recording.name}: found points in a picture, which says nothing of their depth; "
            "scene.start=measured needs places in space: use scene.start=rest"
        )
    if start == "measured":
        return first_motion(recording)
    seen = np.flatnonzero(recording.visible.any(axis=1))[:3]
    with np.errstate(invalid="ignore"):
        early = np.where(recording.visible[seen, :, None], recording.position[seen], np.nan)
    place = _first_seen(early)
    return place if recording.sight is None else _bowed(recording, place), None


def _require_of_cloud(recording: PointCloud, start: str, outline: Any) -> None:
    """Refuse settings of a scene that a cloud cannot follow."""
    if start == "measured":
        raise ClothbenchError(
            f"{recording.path or recording.name}: found points without identity, which do not say how the cloth's own "
            "points moved; use scene.start=rest"
        )
    if outline is not None:  # the lattice is the recording's own, and its points have to lie on the sheet
        raise ClothbenchError(
            f"{recording.path or recording.name}: found scene.outline, expected an outline in the recording, which a "
            "cloud is compared on; state it there"
        )


def first_motion(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Where each node was (N, 3) m and how fast (N, 3) m/s at the first frame, from a parabola through the first ones.

    A node that is seen in less than two thirds of them, or four, has NaN for both, the place included: there it would
    be of a later time, or of a parabola that was drawn far beyond what was seen.
    """
    time = recording.time - recording.time[0]
    count = max(FIRST_FRAMES, int(np.searchsorted(time, FIRST_SECONDS)))
    least = max(FIRST_FRAMES - 1, math.ceil(2 * count / 3))
    terms = np.vander(time[:count], 3, increasing=True)
    place, velocity = (np.full((len(recording.material), 3), np.nan) for _ in range(2))
    for n in range(len(recording.material)):
        seen = recording.visible[:count, n]
        if seen.sum() >= least:
            fit = np.linalg.lstsq(terms[: len(seen)][seen], recording.position[:count][seen, n], rcond=None)[0]
            place[n], velocity[n] = fit[0], fit[1]
    if not np.isfinite(place).any():
        raise ClothbenchError(
            f"{recording.path or recording.name}: found no node seen in {least} of its first {count} frames, "
            "which scene.start=measured needs; use scene.start=rest"
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
