"""How far the trackers of colour videos are off: `python tools/picture_errors.py` prints the table of docs/hold.md. The
truth is that of tools/make_hold.py, its soft fabric in hands, printed, striped and plain; frames as JPEG pictures.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import make_hold as hold
import numpy as np

from clothbench import ClothbenchError, ColourVideo, Observation
from clothbench.plugins.discovery import catalogue
from clothbench.recordings.colour_video import Marks

TRACKERS = (
    ("sift_graph", {}),
    ("sift_graph", {"place": "literal"}),
    ("optical_flow", {}),
    ("sift_graph", {"grips": "marks"}),
)


def marked(video: ColourVideo, places: np.ndarray, truth: hold.Truth) -> ColourVideo:
    """The video with its four corners marked in the first frame, as a user would where no pattern shows them."""
    corners = np.array([[0.0, 0.0], [hold.WIDTH, 0.0], [hold.WIDTH, hold.HEIGHT], [0.0, hold.HEIGHT]])
    first = hold.seen_truth(truth, places[:1], corners * (1 - 1e-9))[0]
    return replace(video, marks=Marks(corners, np.round(hold.camera().project(first)[0])))


def errors(seen: Observation, truth: hold.Truth, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """From where each node truly is in the picture to where it was seen (T, N): px, and mm at the cloth's distance."""
    assert seen.sight is not None
    true, _ = hold.camera().project(hold.seen_truth(truth, places, seen.material))
    told, _ = seen.sight.project(np.nan_to_num(seen.position))
    away = np.where(seen.visible, np.linalg.norm(told - true, axis=-1), np.nan)
    return away, 1e3 * away * seen.pixel_size()


def main() -> None:
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    truth, motion = hold.Truth(hold.FABRICS["soft"]), hold.MOTIONS[0]
    for pattern in ("printed", "striped", "plain"):
        video, places = hold.record("soft", motion, truth, pattern, encoded=False)
        if pattern != "printed":
            video = marked(video, places, truth)
        for name, options in TRACKERS:
            label = " ".join([name, *options.values()])
            began = time.perf_counter()
            try:
                seen = catalogue().make("trackers", name, **options).track(video)
            except ClothbenchError as fault:
                print(f"{pattern:<9}{label:<20}{str(fault)[:90]}", flush=True)
                continue
            rate = len(video.time) / (time.perf_counter() - began)
            if not seen.visible.any():
                print(f"{pattern:<9}{label:<20}nothing seen, {rate:4.1f} frames/s", flush=True)
                continue
            px, mm = errors(seen, truth, places)
            shown = [f"{np.nanmedian(a):5.2f} {np.nanpercentile(a, 95):6.2f}" for a in (px, mm)]
            grips = ""
            if seen.grips is not None:
                held = hold.camera().project(hold.hands(motion, video.time))[0]
                told = seen.sight.project(seen.grips.position)[0]
                grips = f", grips {np.sqrt(np.mean(np.sum((held - told) ** 2, axis=-1))):.2f} px rms"
            print(
                f"{pattern:<9}{label:<20}px {shown[0]}, mm {shown[1]}, seen {seen.visible.mean():5.1%}, "
                f"{rate:4.1f} frames/s, sigma {1e3 * seen.sigma:.2f} mm{grips}", flush=True
            )  # fmt: skip


if __name__ == "__main__":
    main()
