"""What a tracker made of raw images, as a recording of nodes: from here on, raw and tracked recordings are alike."""

from __future__ import annotations

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.observation import Observation
from clothbench.recordings.depth import DepthImages, Grips
from clothbench.recordings.nodes import Recording
from clothbench.recordings.video import text_of

EYE = "camera_place"  # note: where the camera stood, m


def nodes_of(images: DepthImages, seen: Observation) -> Recording:
    """The recording of nodes that a tracker's observation of some images amounts to, with all that the images state.

    Where nobody stated the grips, the two upper corners are held, wherever they were seen.
    """
    grips = images.grips or corners_of(images, seen)
    header = ("name", "fabric", "sensor", "source", "licence", "declared_effects", "motion", "split",
              "cloth_width", "cloth_height", "areal_density", "gravity")  # fmt: skip
    return Recording(
        time=seen.time, material=seen.material, position=np.where(seen.visible[..., None], seen.position, np.nan),
        grip_time=grips.time, grip_material=grips.material, grip_position=grips.position, noise_sigma=seen.sigma,
        notes=images.notes | {"tracked_from": images.hash, EYE: text_of(images.camera.place)}, path=images.path,
        **{name: getattr(images, name) for name in header},
    )  # fmt: skip


def corners_of(images: DepthImages, seen: Observation) -> Grips:
    """The two upper corners as grips, on straight lines where they were not seen."""
    corners = np.array([[0.0, 0.0], [images.cloth_width, 0.0]])
    which = [int(np.argmin(((seen.material - corner) ** 2).sum(axis=1))) for corner in corners]
    paths = []
    for n in which:
        there = np.flatnonzero(seen.visible[:, n])
        if len(there) < 2:
            raise ClothbenchError(
                f"{images.path or images.name}: found no grips stated, and the upper corners in {len(there)} frames, "
                "expected either; state grip_time, grip_material and grip_position"
            )
        path = [np.interp(seen.time, seen.time[there], seen.position[there, n, c]) for c in range(3)]
        paths.append(np.stack(path, axis=-1))
    return Grips(np.array(seen.time), seen.material[which], np.stack(paths, axis=1))


def seen_in(recording: Recording) -> Observation:
    """The observation that a recording of nodes is as it stands."""
    eye = np.array([float(part) for part in recording.notes[EYE].split()]) if EYE in recording.notes else None
    return Observation(
        recording.time, recording.position, recording.visible, recording.noise_sigma, recording.material, eye=eye
    )  # fmt: skip
