"""What a tracker made of raw images, as a recording of nodes: from here on, raw and tracked recordings are alike."""

from __future__ import annotations

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.observation import GripPath, Observation
from clothbench.recordings.colour_video import ColourVideo
from clothbench.recordings.depth import DepthImages
from clothbench.recordings.nodes import EYE, Recording
from clothbench.recordings.nodes_rules import COVERED, check_grip_gap, while_held
from clothbench.recordings.rig import HEADER
from clothbench.recordings.video import text_of

Images = DepthImages | ColourVideo  # what trackers make nodes of


def nodes_of(images: Images, seen: Observation) -> Recording:
    """The recording of nodes that a tracker's observation of some images amounts to, with all that the images state.

    Where nobody stated the grips, they are what the tracker found held, else the two upper corners, wherever they were
    seen. Nothing counts as seen before or after anybody knows where the grips were.
    """
    sigma = images.noise_sigma if np.isnan(seen.sigma) else seen.sigma
    grips = images.grips or seen.grips or corners_of(images, seen)
    camera = seen.sight or images.camera
    counts = seen.visible & while_held(seen.time, grips.time, grips.position)[:, None]
    return Recording(
        time=seen.time, material=seen.material, position=np.where(counts[..., None], seen.position, np.nan),
        grip_time=grips.time, grip_material=grips.material, grip_position=grips.position, noise_sigma=sigma,
        sight=seen.sight, confidence=seen.confidence, path=images.path,
        notes=images.notes | {"tracked_from": images.hash} | ({EYE: text_of(camera.place)} if camera else {}),
        **{name: getattr(images, name) for name in HEADER},
    )  # fmt: skip


def corners_of(images: Images, seen: Observation) -> GripPath:
    """The two upper corners as grips, while both are known: on straight lines where they were not seen in between."""
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
        if (there[-1] - there[0] + 1) / len(seen.time) < COVERED:
            u, v = seen.material[n]
            raise ClothbenchError(
                f"{images.path or images.name}: found no grips stated, and the upper corner at u = {u:g} m, v = {v:g} "
                f"m from frame {there[0]} to {there[-1]} of {len(seen.time)}, expected {COVERED:.0%} of them; cut the "
                "recording there, or state grip_time, grip_material and grip_position"
            )
        u, v = seen.material[n]
        what = f"the upper corner at u = {u:g} m, v = {v:g} m"
        check_grip_gap(seen.time, there, what, str(images.path or images.name))
        known = seen.position[there, n]
        path = [np.interp(seen.time, seen.time[there], known[:, c], left=np.nan, right=np.nan) for c in range(3)]
        paths.append(np.stack(path, axis=-1))
    return GripPath.while_known(seen.time, seen.material[which], np.stack(paths, axis=1))


def seen_in(recording: Recording) -> Observation:
    """The observation that a recording of nodes is as it stands."""
    return Observation(
        recording.time, recording.position, recording.counts, recording.noise_sigma, recording.material,
        eye=recording.eye, sight=recording.sight, confidence=recording.confidence,
    )  # fmt: skip
