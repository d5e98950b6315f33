"""Two frames of a video with the cloth as it was tracked and as the fit has it, side by side."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from clothbench.core.observation import Observation
from clothbench.core.rollout import Rollout
from clothbench.vision.surface import surface_of

SHARES = (1 / 3, 2 / 3)  # of the recording, at which a frame is shown
TRACKED, FITTED = (40, 90, 220), (200, 60, 40)
WIDTH = 900  # px of one picture


def write_frames(folder: Path, frames: Any, seen: Observation, rollout: Rollout) -> None:
    """Files "frame 30.jpg" of a video's frames (an iterator of (H, W, 3)), tracked on the left, fitted on the right;
    nothing where the run had stopped.
    """
    import cv2

    assert seen.sight is not None
    wanted = {round(share * (len(seen.time) - 1)) for share in SHARES}
    triangles = surface_of(seen.material).triangle
    folder.mkdir()
    for k, picture in enumerate(frames):
        if k not in wanted or not np.isfinite(rollout.position[0, k]).all():
            continue
        pair = []
        for position, colour in ((seen.position[k], TRACKED), (rollout.position[0, k], FITTED)):
            pixel, _ = seen.sight.project(position)
            pair.append(with_mesh(picture, pixel, triangles, colour))
        both = np.hstack(pair)
        cv2.imwrite(str(folder / f"frame {k}.jpg"), cv2.cvtColor(at_most(both, 2 * WIDTH), cv2.COLOR_RGB2BGR))


def at_most(picture: np.ndarray, width: int = WIDTH) -> np.ndarray:
    """A picture (H, W, 3) that is no wider than `width` px, for a page."""
    import cv2

    share = width / picture.shape[1]
    return cv2.resize(picture, None, fx=share, fy=share, interpolation=cv2.INTER_AREA) if share < 1 else picture


def with_mesh(picture: np.ndarray, pixel: np.ndarray, triangles: np.ndarray, colour: tuple[int, ...]) -> np.ndarray:
    """A picture (H, W, 3) with the lines of triangles (F, 3) over it, between points (N, 2) px that are known."""
    import cv2

    out = np.ascontiguousarray(picture).copy()
    lines = pixel[triangles[:, [0, 1, 2, 0]]]
    lines = lines[np.isfinite(lines).all(axis=(1, 2))]
    cv2.polylines(out, list(np.round(lines).astype(np.int32)), False, colour, 1, cv2.LINE_AA)
    return out
