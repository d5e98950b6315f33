"""Drapes of the best parameters over those that were captured, as pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from clothbench.core.drape import outlines_of_points
from clothbench.core.rollout import Rollout
from clothbench.engine.cells import Source
from clothbench.estimation.trials import Trial
from clothbench.vision.drape import LEAST_FOLD, drape_quantities

SIDE, MARGIN = 520, 1.08  # px of a picture; of the flat specimen's radius that it shows
CAPTURED, SIMULATED, PLATE, INK = (205, 205, 205), (200, 60, 40), (120, 120, 120), (60, 60, 60)  # red, green, blue
SPLITS = {"fit": "fitted", "held_out": "held out"}


def write_drapes(folder: Path, sources: Sequence[Source], trials: Sequence[Trial], rollouts: Sequence[Rollout]) -> None:
    """One picture a recording, "1 fit name.png": outlines of all captures in grey, of the simulated drapes in red."""
    import cv2

    folder.mkdir()
    for number, (source, trial, rollout) in enumerate(zip(sources, trials, rollouts, strict=True)):
        seen = trial.observation.outlines
        if seen is None or not np.isfinite(rollout.position[0]).all():
            continue
        radius = outlines_of_points(rollout.position[0], (0.0, 0.0, 0.0), seen.plate_radius)
        scale = SIDE / (2 * MARGIN * seen.disc_radius)
        picture = np.full((SIDE, SIDE, 3), 255, np.uint8)
        for one in seen.radius:
            cv2.polylines(picture, [_places(one, scale)], True, CAPTURED, 1, cv2.LINE_AA)
        for one in radius:
            cv2.polylines(picture, [_places(one, scale)], True, SIMULATED, 2, cv2.LINE_AA)
        for circle in (seen.plate_radius, seen.disc_radius):
            cv2.circle(picture, (SIDE // 2, SIDE // 2), round(circle * scale), PLATE, 1, cv2.LINE_AA)
        for line, (who, outlines) in enumerate((("captured", seen.radius), ("simulated", radius))):
            quantities = drape_quantities(outlines, seen.plate_radius, seen.disc_radius)
            coefficient, folds = quantities.mean(axis=0)[:2]
            text = (
                f"{who}: DC {100 * coefficient:.1f} %, {folds:.1f} folds of {1e3 * LEAST_FOLD:g} mm ({len(outlines)})"
            )
            cv2.putText(picture, text, (8, 16 + 16 * line), cv2.FONT_HERSHEY_SIMPLEX, 0.42, INK, 1, cv2.LINE_AA)
        name = f"{number} {SPLITS.get(source.split, source.split)} {source.name.replace('/', ' ')}.png"
        cv2.imwrite(str(folder / name), cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))


def _places(radius: np.ndarray, scale: float) -> np.ndarray:
    """Pixels (K, 2) of an outline (K,) m about the picture's middle, the y axis upwards."""
    turn = 2 * np.pi * np.arange(len(radius)) / len(radius)
    at = SIDE / 2 + scale * radius[:, None] * np.stack([np.cos(turn), -np.sin(turn)], axis=1)
    return np.round(at).astype(np.int32)
