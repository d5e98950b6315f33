"""The figure at the head of the README, and that of the worn skirt: `python tools/fold_figure.py [FOLDER]`.

`static_dynamic.png`: one column for each stand-in fabric, at the same moment of its first waving trial: the filmed
stripes, the angle map that the tracker makes of them with the edges of its folds in yellow, and the angle map of the
simulation with the true parameters. `worn-skirt.png`: a moment of the skirt on hips as filmed, as simulated with the
true parameters, and as simulated without the hips.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from clothbench import read_recording
from clothbench.engine.suite import suites_folder
from clothbench.plugins.discovery import catalogue
from clothbench.recordings.nodes import Recording
from clothbench.recordings.scenes import scene_of
from clothbench.vision.orientation import turned
from clothbench.vision.render import striped

FABRICS, FRAME, ZOOM, SPREAD = ("linen", "fleece", "satin", "knit"), 32, 2, 1.2  # SPREAD: rad from black to white
SKIRT_FRAME, SKIRT_ROWS = 21, slice(34, 132)
WHERE = Path(__file__).resolve().parent.parent / "docs" / "images"


def column(fabric: str) -> np.ndarray:
    """Three pictures one above the other, BGR."""
    recording = read_recording(suites_folder() / "embedded" / "static_dynamic" / f"{fabric}-waving-1.nc")
    observation, sight, position = observed_and_simulated(recording)
    angle, shape = sight.stripes(position, slice(FRAME, FRAME + 1))
    view = observation.view
    seen = shaded(view.angle[FRAME], view.silhouette[FRAME])
    edges = cv2.morphologyEx(view.fold[FRAME].astype(np.uint8), cv2.MORPH_GRADIENT, np.ones((2, 2), np.uint8)) > 0
    seen[edges] = (60, 200, 240)
    film = cv2.cvtColor(recording.video.frame[FRAME], cv2.COLOR_GRAY2BGR)
    return np.vstack([film, seen, shaded(angle[0], shape[0])])


def worn(fabric: str) -> np.ndarray:
    """The skirt as filmed, as simulated on its hips, and as simulated without them, one above the other."""
    recording = read_recording(suites_folder() / "embedded" / "static_dynamic_body" / f"{fabric}-waving-body.nc")
    pictures = [recording.video.frame[SKIRT_FRAME]]
    for settings in ({}, {"obstacles": []}):
        observation, sight, position = observed_and_simulated(recording, **settings)
        view = observation.view
        image, _ = striped(view.camera, view.projector, sight.surface, position[[SKIRT_FRAME]])
        pictures.append((255 * image[0]).astype(np.uint8))
    return np.vstack([picture[SKIRT_ROWS] for picture in pictures])


def observed_and_simulated(recording: Recording, **settings: Any) -> tuple[Any, Any, np.ndarray]:
    """What is seen of a recording, how it is looked at, and its frames (T, N, 3) m with the true parameters."""
    plugins = catalogue()
    observation = plugins.make("trackers", "stripes").track(recording)
    simulation = plugins.make("models", "baraff_witkin").prepare(scene_of(recording, spacing=0.0375, **settings))
    truth = np.array([[float(recording.notes[f"truth_{n}"]) for n in simulation.parameters.names]])
    sight = plugins.make("metrics", "fold").sights.of(observation)
    return observation, sight, simulation.run(truth).position[0]


def shaded(angle: np.ndarray, silhouette: np.ndarray) -> np.ndarray:
    """Level stripes grey, those that rise or fall darker and brighter; white where there is no cloth."""
    grey = np.clip(turned(angle - np.pi / 2) / SPREAD + 0.5, 0.0, 1.0) * 255
    return cv2.cvtColor(np.where(silhouette, grey, 255).astype(np.uint8), cv2.COLOR_GRAY2BGR)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, default=WHERE, metavar="FOLDER", help="default: docs/images")
    where = parser.parse_args().folder
    for name, draw in (("static_dynamic.png", column), ("worn-skirt.png", worn)):
        picture = np.hstack([draw(fabric) for fabric in FABRICS])
        larger = cv2.resize(picture, None, fx=ZOOM, fy=ZOOM, interpolation=cv2.INTER_NEAREST)
        if not cv2.imwrite(str(where / name), larger, [cv2.IMWRITE_PNG_COMPRESSION, 9]):
            parser.error(f"{where / name}: cannot be written; give a folder of yours")


if __name__ == "__main__":
    main()
