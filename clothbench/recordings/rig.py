"""What recordings of raw images have in common: the camera, pictures, grips if they are known, and rules for all."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass, field
from numbers import Real
from pathlib import Path
from typing import ClassVar, Protocol

import numpy as np

from clothbench.core.camera import LENSES, Camera
from clothbench.core.errors import ClothbenchError
from clothbench.core.observation import GripPath
from clothbench.recordings.codec import freeze, hash_of, number
from clothbench.recordings.layout import SPLITS, Arrays, Layout, Part, Stated, Variable
from clothbench.recordings.nodes_rules import (
    JUMP,
    check_clock,
    check_density,
    check_finite,
    check_length,
    check_near,
    check_noise,
    check_notes,
    check_overlap,
    check_points,
    check_shapes,
    check_spread,
    spreads,
)
from clothbench.recordings.supports import SUPPORTS, check_supports
from clothbench.recordings.video import lens_of, size_of, text_of

TEXTS = ("name", "fabric", "sensor", "source", "licence", "declared_effects", "motion", "split")
HEADER = (*TEXTS, "cloth_width", "cloth_height", "areal_density", "gravity", "thickness")  # as tracked nodes have it


class Stating(Protocol):
    """What every recording of images states in its header."""

    @property
    def name(self) -> str: ...
    @property
    def areal_density(self) -> float: ...
    @property
    def split(self) -> str: ...


@dataclass(frozen=True, eq=False, kw_only=True)
class RawRecording(ABC):
    """What recordings of images of one run have in common, whatever took them. Arrays are read-only; all SI.

    time: (T,) s; cloth_width, cloth_height: m; grips: None where they are not known; areal_density: kg/m² (NaN = not
    known); gravity: (3,) m/s²; noise_sigma: m, of a coordinate of nodes that are tracked in it (NaN = not known, a
    tracker judges it); thickness: m, how far apart the cloth's layers stay, or None. `path` is where it was read
    from, not part of its identity.
    """

    name: str
    time: np.ndarray
    cloth_width: float
    cloth_height: float
    grips: GripPath | None = None
    areal_density: float = math.nan
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    noise_sigma: float = math.nan
    thickness: float | None = None
    fabric: str = ""
    sensor: str = ""
    source: str = ""
    licence: str = ""
    declared_effects: str = ""
    motion: str = ""
    split: str = ""
    notes: dict[str, str] = field(default_factory=dict)
    path: str = field(default="", compare=False)
    layout: ClassVar[Layout]

    def __post_init__(self) -> None:
        freeze(self, self.layout)
        self.check(self.path or self.name)

    @abstractmethod
    def check(self, where: str) -> None:
        """Every rule of the kind, in the order in which a reader would trip over it."""

    @property
    def kind(self) -> str:
        """As its header states it."""
        return self.layout.kind

    @property
    def hash(self) -> str:
        """SHA-256 over everything measured and stated, whatever the file's encoding."""
        return hash_of(self, self.layout)


def pack_camera(camera: Camera, prefix: str = "camera") -> tuple[Arrays, Stated]:
    """The attributes PREFIX_size, PREFIX_matrix, … of a camera."""
    stated = {f"{prefix}_{name}": text_of(getattr(camera, name)) for name in LENSES}
    return {}, stated | {f"{prefix}_size": text_of(camera.size)}


def unpack_camera(stated: Stated, path: Path, whose: str, prefix: str = "camera") -> Camera:
    """The camera that the attributes PREFIX_… state."""
    return lens_of(stated, prefix, size_of(stated, f"{prefix}_size", path, whose), path, whose)


def camera_attributes(prefix: str = "camera") -> tuple[str, ...]:
    return (*(f"{prefix}_{name}" for name in LENSES), f"{prefix}_size")


def _pack_grips(grips: GripPath) -> tuple[Arrays, Stated]:
    return {"grip_time": grips.time, "grip_material": grips.material, "grip_position": grips.position}, {}


def _unpack_grips(arrays: Arrays, stated: Stated, path: Path) -> GripPath | None:
    if not arrays:
        return None
    if missing := sorted(set(GRIPS.variables) - set(arrays)):
        raise ClothbenchError(f"{path}: variable '{missing[0]}' is missing beside the other grip variables; add it")
    return GripPath(arrays["grip_time"], arrays["grip_material"], arrays["grip_position"])


GRIPS = Part(
    {
        "grip_time": Variable(("grip_time",), "s"),
        "grip_material": Variable(("grip", "uv"), "m"),
        "grip_position": Variable(("grip_time", "grip", "space"), "m", level=4),
    },
    (), _pack_grips, _unpack_grips,
)  # fmt: skip


def _pack_noise(sigma: float) -> tuple[Arrays, Stated]:
    return {}, {} if math.isnan(sigma) else {"noise_sigma": float(sigma)}


def _unpack_noise(arrays: Arrays, stated: Stated, path: Path) -> float:
    return number(stated, "noise_sigma", path)


FOR_NODES = {"noise_sigma": Part({}, ("noise_sigma",), _pack_noise, _unpack_noise), "thickness": SUPPORTS["thickness"]}


def check_for_nodes(r: RawRecording, tracked: Layout, where: str) -> None:
    """What the recording of the nodes that a tracker makes of it takes over: their noise, the thickness, the notes."""
    size = np.array([r.cloth_width, r.cloth_height])
    check_noise(r.noise_sigma, size, where)
    check_supports(None, r.thickness, np.zeros((0, 2)), size, where)
    check_notes(r.notes, r.layout, tracked, where)


def check_jumps(time: np.ndarray, name: str, where: str) -> None:
    """No gap between stamps is many times the usual one."""
    steps = np.diff(time)
    worst = int(np.argmax(steps))
    if steps[worst] > JUMP * np.median(steps):
        raise ClothbenchError(
            f"{where}: variable '{name}': found a jump of {steps[worst]:g} s at index {worst + 1}, where "
            f"{np.median(steps):g} s is usual; cut the recording there, or mend the stamps"
        )


def check_grips(r: RawRecording, where: str) -> None:
    """The grips of a raw recording, if it states any: whole, on the cloth, no farther from each other than cloth can
    be, and at the times of the frames.
    """
    grips = r.grips
    if grips is None:
        return
    check_shapes(_pack_grips(grips)[0], GRIPS, where)
    check_clock(grips.time, "grip_time", where)
    check_finite(grips.position, "grip_position", where)
    check_finite(grips.material, "grip_material", where)
    check_near(grips.position, "grip_position", where)
    across = math.hypot(r.cloth_width, r.cloth_height)
    check_spread(spreads(grips.position), across, where, "grips", "grip_position")
    check_points(grips.material, "grip_material", np.array([r.cloth_width, r.cloth_height]), where)
    check_overlap(r.time, grips.time, grips.position, where)


def check_numbers(r: object, names: Iterable[str], where: str) -> None:
    """These attributes are numbers: what a program makes may have anything in their place."""
    for name in names:
        if not isinstance(value := getattr(r, name), Real):
            raise ClothbenchError(
                f"{where}: attribute '{name}': found {value!r}, expected a number (NaN where it is not known)"
            )


def check_stated(r: Stating, where: str, lengths: tuple[str, ...] = ()) -> None:
    """The header of a recording of images; lengths: attributes [m] that have to be above 0."""
    if not r.name:
        raise ClothbenchError(f"{where}: attribute 'name': found nothing, expected the recording's name")
    for name in lengths:
        check_length(name, getattr(r, name), where)
    check_density(r.areal_density, where)
    if r.split not in SPLITS:
        raise ClothbenchError(f"{where}: attribute 'split': found {r.split!r}, expected 'fit', 'held_out' or ''")
