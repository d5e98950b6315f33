"""`stripes`: stripes projected on a filmed cloth → silhouette, angle map and folds (Bhat et al. 2003)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from clothbench import ClothbenchError, Observation, Recording, View, angle_map, fold_mask, for_each, read_recording


class Stripes:
    """Dominant orientation of the stripes at every pixel by the steerable filters G2, H2, and where it changes fast
    (Bhat et al. 2003, section 4, eq. 4). The tracked nodes of the recording, if it has any, stay beside the view, and
    count as those of `markers` do.

    level: share of full grey above which a pixel shows cloth (a dark background is assumed, of which the largest bright
    part is the cloth); blur: px, of the filters' coefficients; threshold: rad/px, of the angle's gradient in a fold.
    The paper leaves the last two open.
    """

    name = "stripes"
    version = 2

    def __init__(self, level: float = 0.12, blur: float = 2.0, threshold: float = 0.006):
        for what, value, most in (("level", level, 1.0), ("blur", blur, 50.0), ("threshold", threshold, 10.0)):
            if not isinstance(value, int | float) or isinstance(value, bool) or not 0 < value <= most:
                raise ClothbenchError(f"stripes: {what} is {value!r}, expected a number above 0, at most {most:g}")
        self.level, self.blur, self.threshold = level, blur, threshold

    def track(self, source: Recording | Path) -> Observation:
        """The view of a recording (object or .nc file) with a video of projected stripes."""
        recording = source if isinstance(source, Recording) else read_recording(source)
        where, video = recording.path or recording.name, recording.video
        if video is None or video.projector is None:
            lacks = "video" if video is None else "projector's calibration"
            raise ClothbenchError(f"{where}: found no {lacks}, which the tracker 'stripes' needs; take tracker=markers")
        silhouette, fold = (np.empty(video.frame.shape, bool) for _ in range(2))
        angle = np.empty(video.frame.shape, np.float32)

        def look(t: int) -> None:
            grey = video.frame[t]
            silhouette[t] = largest_bright_part(grey, 255.0 * self.level)
            angle[t] = angle_map(grey.astype(np.float32) / 255.0, self.blur)
            fold[t] = fold_mask(angle[t], silhouette[t], self.threshold)

        for_each(look, range(len(angle)))
        view = View(video.camera, silhouette, video.projector, angle, fold, self.blur, self.threshold)
        r = recording
        return Observation(
            r.time, r.position, r.counts, r.noise_sigma, r.material, view, eye=r.eye, sight=r.sight,
            size=(r.cloth_width, r.cloth_height),
        )  # fmt: skip


def largest_bright_part(grey: np.ndarray, level: float) -> np.ndarray:
    """The largest connected part (H, W) bool of a grey image above `level`, after a median over 3 × 3 pixels."""
    import cv2

    bright = (cv2.medianBlur(grey, 3) > level).astype(np.uint8)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(bright, connectivity=4)
    if len(stats) < 2:
        return np.zeros(grey.shape, bool)
    return labels == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
