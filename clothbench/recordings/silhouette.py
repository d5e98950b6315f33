"""Recordings of kind "silhouette": shadows of drapes of one fabric in a drapemeter, from above, on disk as NetCDF-4.

| name | dims | units | meaning |
|---|---|---|---|
| `image` | capture, y, x | 1 | uint8, dark where the cloth or the plate is; one picture for each drape |
| `sample` | capture | 1 | int64: which specimen of the fabric was draped |
| `side` | capture | 1 | int64: 1 with its face up, 2 face down, 0 where that is not known |

Attributes as in kind "nodes", of which `name` is needed, and `pixel_size` [m], `disc_radius` and `plate_radius` [m]:
the specimen's, and that of the plates that it lies between; `thickness` [m], NaN where it is not known. Captures are
no film: each is a drape of its own.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from clothbench.core.brief import brief
from clothbench.core.errors import ClothbenchError
from clothbench.recordings.codec import freeze, hash_of, read, write
from clothbench.recordings.layout import Layout, Variable
from clothbench.recordings.nodes_rules import check_shapes
from clothbench.recordings.rig import TEXTS, check_numbers, check_stated
from clothbench.recordings.supports import check_thin

SIDES = {0: "not known", 1: "face up", 2: "face down"}
LEAST_PIXELS = 20  # across the plate's radius
DUST = 0.05  # of what is dark that may lie beside the shadow
WIDEST = 2.0  # m, the radius of a drapemeter that fills a room; usual are specimens of 0.12 to 0.18
LAYOUT = Layout(
    kind="silhouette",
    variables={
        "image": Variable(("capture", "y", "x"), "1", np.uint8, level=6, exact=True),
        "sample": Variable(("capture",), "1", np.int64),
        "side": Variable(("capture",), "1", np.int64),
    },
    texts=TEXTS,
    numbers=("pixel_size", "disc_radius", "plate_radius", "areal_density", "thickness"),
    needed=("name", "pixel_size", "disc_radius", "plate_radius"),
)


@dataclass(frozen=True, eq=False, kw_only=True)
class Silhouettes:
    """Drapes of one fabric, seen from above. Arrays are read-only; SI.

    image: (T, H, W) uint8, dark where the cloth is; sample: (T,); side: (T,), of `SIDES`; pixel_size: m; disc_radius,
    plate_radius: m; areal_density: kg/m², thickness: m (NaN = not known). `path` is where it was read from, not part of
    its identity.
    """

    name: str
    image: np.ndarray
    sample: np.ndarray
    side: np.ndarray
    pixel_size: float
    disc_radius: float
    plate_radius: float
    areal_density: float = math.nan
    thickness: float = math.nan
    fabric: str = ""
    sensor: str = ""
    source: str = ""
    licence: str = ""
    declared_effects: str = ""
    motion: str = ""
    split: str = ""
    notes: dict[str, str] = field(default_factory=dict)
    path: str = field(default="", compare=False)

    __repr__ = brief

    def __post_init__(self) -> None:
        freeze(self, LAYOUT)
        _check(self, self.path or self.name)

    @property
    def kind(self) -> str:
        """As its header states it."""
        return LAYOUT.kind

    @property
    def hash(self) -> str:
        """SHA-256 over everything measured and stated, whatever the file's encoding."""
        return hash_of(self, LAYOUT)


def read_silhouettes(path: str | os.PathLike[str]) -> Silhouettes:
    """Read and check one file; a fault raises `ClothbenchError` with file, variable, found, expected."""
    return read(path, LAYOUT, Silhouettes)


def write_silhouettes(silhouettes: Silhouettes, path: str | os.PathLike[str]) -> Path:
    """Write one file, through a link where one is named, atomically: it is there whole or not at all."""
    return write(silhouettes, path, LAYOUT, asked=True)


def _check(r: Silhouettes, where: str) -> None:
    """Every rule of the kind, in the order in which a reader would trip over it."""
    check_shapes({name: getattr(r, name) for name in LAYOUT.variables}, LAYOUT, where)
    check_numbers(r, LAYOUT.numbers, where)
    check_stated(r, where, ("pixel_size", "plate_radius", "disc_radius"))
    if r.disc_radius > WIDEST:
        raise ClothbenchError(
            f"{where}: attribute 'disc_radius': found {r.disc_radius:g} m, expected {WIDEST:g} m at most; are these "
            "millimetres or centimetres?"
        )
    if r.disc_radius <= r.plate_radius:
        raise ClothbenchError(
            f"{where}: attribute 'disc_radius': found {r.disc_radius} m, expected more than plate_radius "
            f"{r.plate_radius} m"
        )
    if r.plate_radius < LEAST_PIXELS * r.pixel_size:
        raise ClothbenchError(
            f"{where}: attribute 'pixel_size': found {r.pixel_size} m, expected at most "
            f"{r.plate_radius / LEAST_PIXELS:g}: {LEAST_PIXELS} pixels across the plate's radius"
        )
    if r.thickness <= 0 or math.isinf(r.thickness):
        raise ClothbenchError(f"{where}: attribute 'thickness': found {r.thickness}, expected metres above 0, or NaN")
    check_thin(r.thickness, 2 * r.disc_radius, where)
    if wrong := sorted(set(r.side.tolist()) - set(SIDES)):
        raise ClothbenchError(f"{where}: variable 'side': found {wrong[0]}, expected 0, 1 (face up) or 2 (face down)")
    _check_shadows(r, where)


def _check_shadows(r: Silhouettes, where: str) -> None:
    """Each picture shows one dark shape, beside which there is no more than dust, as large as the plate at least and as
    the specimen at most, that ends before the border.
    """
    dark = np.stack([_dark(image) for image in r.image])
    whole, largest = dark.sum(axis=(1, 2)), np.array([_largest_part(one) for one in dark])
    area = np.asarray(largest * r.pixel_size**2)
    border = np.asarray(dark[:, [0, -1]].any(axis=(1, 2)) | dark[:, :, [0, -1]].any(axis=(1, 2)))
    least, most = (np.pi * radius**2 for radius in (r.plate_radius, r.disc_radius))
    for k in range(len(r.image)):
        if not 0.95 * least <= area[k] <= 1.05 * most:
            raise ClothbenchError(
                f"{where}: variable 'image': found a shadow of {area[k] * 1e4:.0f} cm² in capture {k}, expected "
                f"{least * 1e4:.0f} (the plate) to {most * 1e4:.0f} cm² (the flat specimen); check pixel_size and "
                "radii, and that the cloth is dark"
            )
        if largest[k] < (1 - DUST) * whole[k]:
            raise ClothbenchError(
                f"{where}: variable 'image': found several shadows in capture {k}, {largest[k] / whole[k]:.0%} of all "
                "that is dark in the largest, expected one, and dust at most"
            )
        if border[k]:
            raise ClothbenchError(
                f"{where}: variable 'image': found a shadow that reaches the picture's border in capture {k}, expected "
                "all of it to be seen"
            )


def _dark(image: np.ndarray) -> np.ndarray:
    """The pixels (H, W) bool beyond halfway from the ground, the median along the border, to the darkest."""
    ground = float(np.median(np.concatenate([image[0], image[-1], image[:, 0], image[:, -1]])))
    return image < (ground + float(image.min())) / 2


def _largest_part(dark: np.ndarray) -> int:
    """How many pixels of (H, W) bool the largest part has that hangs together; 0 where nothing is dark."""
    import cv2

    *_, stated, _ = cv2.connectedComponentsWithStats(dark.astype(np.uint8))
    return int(stated[1:, cv2.CC_STAT_AREA].max(initial=0))
