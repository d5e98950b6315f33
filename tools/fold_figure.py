"""The figure at the head of the README: `python tools/fold_figure.py [FILE.png]`.

One column for each stand-in fabric, at the same moment of its first waving trial: the filmed stripes, the angle map
that the tracker makes of them with the edges of its folds in yellow, and the angle map of the simulation with the true
parameters.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

from clothbench import read_recording
from clothbench.engine.suite import suites_folder
from clothbench.plugins.discovery import catalogue
from clothbench.recordings.scenes import scene_of
from clothbench.vision.orientation import turned

FABRICS, FRAME, ZOOM, SPREAD = ("linen", "fleece", "satin", "knit"), 32, 2, 1.2  # SPREAD: rad from black to white
WHERE = Path(__file__).resolve().parent.parent / "docs" / "images" / "static_dynamic.png"


def column(fabric: str) -> np.ndarray:
    """Three pictures one above the other, BGR."""
    plugins = catalogue()
    recording = read_recording(suites_folder() / "embedded" / "static_dynamic" / f"{fabric}-waving-1.nc")
    observation = plugins.make("trackers", "stripes").track(recording)
    simulation = plugins.make("models", "baraff_witkin").prepare(scene_of(recording, spacing=0.0375))
    truth = np.array([[float(recording.notes[f"truth_{n}"]) for n in simulation.parameters.names]])
    sight = plugins.make("metrics", "fold").sights.of(observation)
    angle, shape = sight.stripes(simulation.run(truth).position[0], slice(FRAME, FRAME + 1))
    view = observation.view
    seen = shaded(view.angle[FRAME], view.silhouette[FRAME])
    edges = cv2.morphologyEx(view.fold[FRAME].astype(np.uint8), cv2.MORPH_GRADIENT, np.ones((2, 2), np.uint8)) > 0
    seen[edges] = (60, 200, 240)
    film = cv2.cvtColor(recording.video.frame[FRAME], cv2.COLOR_GRAY2BGR)
    return np.vstack([film, seen, shaded(angle[0], shape[0])])


def shaded(angle: np.ndarray, silhouette: np.ndarray) -> np.ndarray:
    """Level stripes grey, those that rise or fall darker and brighter; white where there is no cloth."""
    grey = np.clip(turned(angle - np.pi / 2) / SPREAD + 0.5, 0.0, 1.0) * 255
    return cv2.cvtColor(np.where(silhouette, grey, 255).astype(np.uint8), cv2.COLOR_GRAY2BGR)


def main() -> None:
    where = Path(sys.argv[1]) if len(sys.argv) > 1 else WHERE
    picture = np.hstack([column(fabric) for fabric in FABRICS])
    cv2.imwrite(str(where), cv2.resize(picture, None, fx=ZOOM, fy=ZOOM, interpolation=cv2.INTER_NEAREST))


if __name__ == "__main__":
    main()
