"""`drape`: shadows of a drapemeter → outlines, from which drape coefficient and folds are read."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clothbench import (
    LEAST_FOLD,
    ClothbenchError,
    Observation,
    Outlines,
    Silhouettes,
    centroid,
    darkness,
    drape_points,
    drape_quantities,
    folds_of,
    outline_in,
    smoothed,
)
from clothbench_trackers.options import is_number

EDGE = 0.3  # px, standard deviation of an edge that is found between pixels of a soft picture
INK, FOLD = (200, 60, 40), (40, 90, 220)  # red, green, blue


class Drape:
    """Each shadow's outline r(φ), about its centroid or about `centre` (x, y) [px], where it is known that the plates'
    middle lies there in every picture (Cusick 1968 weighed paper; images since Collier 1991).
    """

    name = "drape"
    version = 4
    kinds = frozenset({"silhouette"})

    def __init__(self, centre: tuple[float, float] | None = None):
        two = isinstance(centre, Sequence) and not isinstance(centre, str) and len(centre) == 2
        if centre is not None and not (two and all(map(is_number, centre))):
            raise ClothbenchError(f"drape: centre is {centre!r}, expected [x,y] in pixels, or null")
        self.centre = None if centre is None else (float(centre[0]), float(centre[1]))

    def track(self, source: Silhouettes) -> Observation:
        """The outlines of all captures; the material points are those in which drapes are simulated, none is seen."""
        if not isinstance(source, Silhouettes):
            raise ClothbenchError(f"drape: found {type(source).__name__}, expected a recording of kind 'silhouette'")
        if self.centre is not None:
            for number, image in enumerate(source.image):
                if not _is_dark(image, self.centre):
                    where = f"{source.path or source.name}: capture {number}"
                    raise ClothbenchError(
                        f"{where}: found no shadow at centre={list(self.centre)}, "
                        "expected the plates' middle [x,y] px, which every shadow covers; correct it, or leave it out"
                    )
        pixel = source.pixel_size
        radius = np.stack([outline_in(image, pixel, self.centre) for image in source.image])
        seen = Outlines(radius, source.plate_radius, source.disc_radius, source.sample, EDGE * pixel, pixel)
        points = drape_points(source.plate_radius, source.disc_radius)
        shape = (len(radius), len(points))
        return Observation(
            np.arange(len(radius), dtype=float), np.full((*shape, 3), np.nan), np.zeros(shape, bool), np.nan, points,
            outlines=seen,
        )  # fmt: skip

    def pictures(self, source: Silhouettes, frame: int, seen: Observation) -> dict[str, np.ndarray]:
        """The shadow; its outline with the plate; the folds found on it."""
        import cv2

        assert seen.outlines is not None
        scale = max(1, 640 // source.image.shape[2])
        shadow = cv2.resize(source.image[frame], None, fx=scale, fy=scale, interpolation=cv2.INTER_NEAREST)
        shadow = cv2.cvtColor(shadow, cv2.COLOR_GRAY2RGB)
        middle = np.array(self.centre or centroid(darkness(source.image[frame])))
        radius = seen.outlines.radius[frame]
        turn = 2 * np.pi * np.arange(len(radius)) / len(radius)
        ray = np.stack([np.cos(turn), -np.sin(turn)], axis=1)

        def places(r: np.ndarray) -> np.ndarray:
            at = (middle + 0.5 + r[:, None] / source.pixel_size * ray) * scale
            return np.round(at).astype(np.int32)

        pale = cv2.addWeighted(shadow, 0.25, np.full_like(shadow, 255), 0.75, 0)
        outlined = cv2.polylines(pale.copy(), [places(radius)], True, INK, 2, cv2.LINE_AA)
        cv2.polylines(outlined, [places(np.full_like(radius, source.plate_radius))], True, FOLD, 1, cv2.LINE_AA)
        folded = outlined.copy()
        peaks, _ = folds_of(smoothed(radius))
        for place in places(radius)[peaks]:
            cv2.circle(folded, tuple(map(int, place)), 3 * scale, FOLD, 2, cv2.LINE_AA)
        coefficient = drape_quantities(radius, source.plate_radius, source.disc_radius)[0]
        text = f"DC {100 * coefficient:.1f} %, {len(peaks)} folds of {1e3 * LEAST_FOLD:g} mm or more"
        cv2.putText(folded, text, (8, 24), cv2.FONT_HERSHEY_SIMPLEX, 0.7, (60, 60, 60), 1, cv2.LINE_AA)
        return {"shadow": shadow, "outline and plate": outlined, "folds": folded}


def _is_dark(image: np.ndarray, at: tuple[float, float]) -> bool:
    """Whether a place (x, y) px lies in the shadow that a picture (H, W) shows."""
    dark, (x, y) = darkness(image), np.round(at).astype(int)
    return 0 <= y < len(dark) and 0 <= x < dark.shape[1] and bool(dark[y, x] >= 0.5 * dark.max())
