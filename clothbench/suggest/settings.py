"""What a user may say of the experiments: what the robot can do, how long they last, what they are ranked by."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

from clothbench.core.camera import MOST_PIXELS
from clothbench.core.errors import ClothbenchError
from clothbench.vision.depth_camera import DepthSensor

INFORMATION, TIE = "information", "tie"
COLOUR, DEPTH = "colour", "depth"
ALL, NONE = "all", "none"
MOST_DRAWS = 1000  # of a hundred times as many normal numbers each
SHORTEST, LONGEST = 0.02, 600.0  # s, of a motion: two stamps of the grips' path; an hour of it would fill the memory
WIDEST = 170.0  # degrees, of a field of view: a pinhole's picture has no room for more

# Where a camera may be put: its direction from the middle of the motion, across, out and up of the sheet, and what is
# up in its picture. Seen from the front, the warp runs to the right. A new one is a line here.
PLACEMENTS = {
    "front": ((0, -1, 0), (0, 0, 1)),
    "three-quarter": ((1, -1, 0), (0, 0, 1)),
    "side": ((1, 0, 0), (0, 0, 1)),
    "above": ((0, 0, 1), (0, 1, 0)),
    "front above": ((0, -1, 1), (0, 0, 1)),
    "front below": ((0, -1, -1), (0, 0, 1)),
}


@dataclass(frozen=True)
class Sensor:
    """The camera that is to see an experiment. kind: "colour", which tells where in its picture a point is, or "depth",
    which tells how far away, too; noise: px, of each of the two; depth_noise: m at 1 m, growing with the square of the
    distance; field_of_view: degrees, across the picture; size: (width, height) px.
    """

    kind: str = COLOUR
    noise: float = 0.5
    depth_noise: float = DepthSensor.noise
    field_of_view: float = 60.0
    size: tuple[int, int] = (1280, 720)


@dataclass(frozen=True)
class Wanted:
    """max_speed: m/s and max_acceleration: m/s², of a grip; reach: m, how far a grip may go from where it began;
    durations: s, of the motions, rising; rank: "information" (all parameters together), "tie" (how far apart tied
    effects would be), or a parameter's name; None: by the tie where there is one; draws: parameter sets, drawn as the
    recordings leave them open, at which each experiment is looked at beside the fit; best: so many experiments are
    shown and written; grips: names of those that the robot has; None: all; cameras: names of the places where the one
    camera may stand that is to see the experiment; None: every point is measured in space, as markers are (see
    `as_recorded` for recordings in a picture); camera: what it is.
    """

    max_speed: float = 0.5
    max_acceleration: float = 5.0
    reach: float = 0.15
    durations: tuple[float, ...] = (1.0, 2.0, 4.0)
    rank: str | None = None
    draws: int = 4
    best: int = 5
    grips: tuple[str, ...] | None = None
    cameras: tuple[str, ...] | None = None
    camera: Sensor = Sensor()


WORDS = tuple(field.name for field in fields(Wanted))


def wanted_of(words: Mapping[str, str]) -> Wanted:
    """From words as they were given, by name; what is no number or makes no sense is refused in one line."""
    read: dict[str, object] = {}
    for name in ("max_speed", "max_acceleration", "reach"):
        if name in words:
            read[name] = above_zero(name, words[name])
    for name, least in (("draws", 0), ("best", 1)):
        if name in words:
            read[name] = whole(name, words[name], least)
    if read.get("draws", 0) > MOST_DRAWS:  # type: ignore[operator]
        raise ClothbenchError(f"setting 'draws' is {words['draws']!r}, expected {MOST_DRAWS} at most")
    if "durations" in words:
        parts = words["durations"].removeprefix("[").removesuffix("]").split(",")
        durations = tuple(sorted({above_zero("durations", part) for part in parts}))
        if durations[0] < SHORTEST or durations[-1] > LONGEST:
            raise ClothbenchError(
                f"setting 'durations' is {words['durations']!r}, expected seconds from {SHORTEST:g} to {LONGEST:g}"
            )
        read["durations"] = durations
    for name in ("grips", "cameras"):
        if name in words:
            parts = words[name].removeprefix("[").removesuffix("]").split(",")
            read[name] = tuple(part.strip() for part in parts)
    if "" in read.get("grips", ()):  # type: ignore[operator]
        raise ClothbenchError(
            f"setting 'grips' is {words['grips']!r}, expected names with a comma between each two; leave it out for all"
        )
    if "rank" in words:
        read["rank"] = words["rank"]
    if "cameras" in words:
        read["cameras"] = placements(read["cameras"])  # type: ignore[arg-type]
    wanted = Wanted(**read, camera=sensor_told(camera_words(words), Sensor()))  # type: ignore[arg-type]
    if "cameras" in words:
        refuse_placeless(words, wanted)
    return wanted


def as_recorded(wanted: Wanted, words: Mapping[str, str], sensor: Sensor | None) -> Wanted:
    """For recordings in one camera's picture: seen by one like it, wherever it may stand, unless words say else.

    sensor: that camera; None where points were measured in space: then what is said of a camera needs a place for it.
    """
    if sensor is not None:
        cameras = wanted.cameras if "cameras" in words else tuple(PLACEMENTS)
        wanted = replace(wanted, cameras=cameras, camera=sensor_told(camera_words(words), sensor))
    refuse_placeless(words, wanted)
    return wanted


def refuse_placeless(words: Mapping[str, str], wanted: Wanted) -> None:
    """Refuse what is said of a camera that may stand nowhere."""
    if wanted.cameras is None and (of_camera := camera_words(words)):
        raise ClothbenchError(f"found {next(iter(of_camera))}= and no cameras=; say where it may stand, as cameras=all")


def camera_words(words: Mapping[str, str]) -> dict[str, str]:
    return {key: text for key, text in words.items() if key.partition(".")[0] == "camera"}


def placements(names: tuple[str, ...]) -> tuple[str, ...] | None:
    """The names, or all there are; None where no camera is wanted."""
    if names == (NONE,):
        return None
    for name in names:
        if name not in (*PLACEMENTS, ALL):
            raise ClothbenchError(
                f"setting 'cameras' names {name!r}, expected some of {', '.join(PLACEMENTS)}; all or none"
            )
    return tuple(PLACEMENTS) if ALL in names else tuple(dict.fromkeys(names))


def sensor_told(words: Mapping[str, str], recorded: Sensor) -> Sensor:
    """From words camera.NAME; what they leave unsaid is as recorded."""
    read: dict[str, object] = {}
    for key, text in words.items():
        name = key.removeprefix("camera.")
        if name == "kind":
            if text not in (COLOUR, DEPTH):
                raise ClothbenchError(f"setting {key!r} is {text!r}, expected {COLOUR} or {DEPTH}")
            read[name] = text
        elif name == "size":
            read[name] = size(key, text)
        elif name in ("noise", "depth_noise", "field_of_view"):
            read[name] = above_zero(key, text)
        else:
            known = ", ".join(f"camera.{field.name}=" for field in fields(Sensor))
            raise ClothbenchError(f"found {key}=, expected {known}; where it may stand is said with cameras=")
    sensor = replace(recorded, **read)  # type: ignore[arg-type]
    if "depth_noise" in read and sensor.kind != DEPTH:
        raise ClothbenchError(
            "found camera.depth_noise= of a colour camera, expected a depth camera; add camera.kind=depth"
        )
    if sensor.field_of_view >= WIDEST:
        raise ClothbenchError(
            f"setting 'camera.field_of_view' is '{sensor.field_of_view:g}', expected degrees below {WIDEST:g}"
        )
    return sensor


def size(name: str, text: str) -> tuple[int, int]:
    parts = text.split("x")
    if len(parts) != 2 or not all(part.isdecimal() and int(part) > 0 for part in parts):
        raise ClothbenchError(f"setting {name!r} is {text!r}, expected pixels, as 1280x720")
    width, height = map(int, parts)
    if width * height > MOST_PIXELS:
        raise ClothbenchError(f"setting {name!r} is {text!r}, expected {MOST_PIXELS} pixels at most")
    return width, height


def above_zero(name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0):
        raise ClothbenchError(f"setting {name!r} is {text!r}, expected a number above 0")
    return value


def whole(name: str, text: str, least: int) -> int:
    if not text.isdecimal() or int(text) < least:
        raise ClothbenchError(f"setting {name!r} is {text!r}, expected a whole number, {least} or above")
    return int(text)
