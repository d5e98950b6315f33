"""What a recording may state of the cloth and its surroundings beside its size: outline, obstacles and thickness.

| name | dims | units | meaning |
|---|---|---|---|
| `outline` | corner, uv | m | the polygon that the sheet has been cut to |
| `obstacle_centre`, `obstacle_normal` | obstacle, space | m, 1 | where each obstacle stands, and which way it faces |
| `obstacle_radius`, `obstacle_friction` | obstacle | m, 1 | as in `clothbench.Obstacle`; a plane's radius is infinite |

Attributes: `obstacle_shape`, one word each ("plane", "disc", "sphere"); `obstacle_clamps`, 0 or 1 each, and
`obstacle_carried`, whether it moves along with the grips (none does where that is not stated); `thickness` [m], how far
apart the cloth's own layers stay. All of them are optional, the obstacles' together.
"""

from __future__ import annotations

from numbers import Real
from pathlib import Path

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.outline import checked_outline
from clothbench.core.scene import Obstacle
from clothbench.core.scene_rules import grip_off
from clothbench.recordings.codec import number
from clothbench.recordings.layout import Arrays, Part, Stated, Variable
from clothbench.recordings.nodes_rules import check_near, check_shapes

NUMBERS = ("obstacle_centre", "obstacle_normal", "obstacle_radius", "obstacle_friction")
STATED = ("obstacle_shape", "obstacle_clamps")
CARRIED = "obstacle_carried"
THICKEST = 0.1  # of the longer side of a cloth, as which its layers may be apart: strips are as thick as sheets


def _pack_outline(outline: np.ndarray) -> tuple[Arrays, Stated]:
    return {"outline": outline}, {}


def _unpack_outline(arrays: Arrays, stated: Stated, path: Path) -> np.ndarray | None:
    return arrays.get("outline")


def _pack_obstacles(obstacles: tuple[Obstacle, ...]) -> tuple[Arrays, Stated]:
    if not obstacles:  # as if nothing were stated of them
        return {}, {}
    words = {
        "obstacle_shape": " ".join(o.shape for o in obstacles),
        "obstacle_clamps": " ".join(str(int(o.clamps)) for o in obstacles),
    }
    if any(o.carried for o in obstacles):
        words[CARRIED] = " ".join(str(int(o.carried)) for o in obstacles)
    return {name: np.array([getattr(o, name.removeprefix("obstacle_")) for o in obstacles]) for name in NUMBERS}, words


def _unpack_obstacles(arrays: Arrays, stated: Stated, path: Path) -> tuple[Obstacle, ...] | None:
    if not arrays and not any(name in stated for name in (*STATED, CARRIED)):
        return None
    if missing := sorted({*NUMBERS, *STATED} - {*arrays, *stated}):
        raise ClothbenchError(f"{path}: '{missing[0]}' is missing beside what else is stated of obstacles; add it")
    check_shapes(arrays, SUPPORTS["obstacles"], str(path))
    check_near(arrays["obstacle_centre"], "obstacle_centre", str(path))
    count = len(arrays["obstacle_centre"])
    words = {name: str(stated[name]).split() for name in (*STATED, CARRIED) if name in stated}
    for name, each in words.items():
        if len(each) != count:
            raise ClothbenchError(
                f"{path}: attribute '{name}': found {len(each)} words, expected {count}, one for each obstacle"
            )
        if name != "obstacle_shape" and (other := [word for word in each if word not in ("0", "1")]):
            raise ClothbenchError(f"{path}: attribute '{name}': found {other[0]!r}, expected 0 or 1 for each obstacle")
    shapes, clamps = (words[name] for name in STATED)
    rows = zip(shapes, clamps, words.get(CARRIED, ["0"] * count), *(arrays[n].tolist() for n in NUMBERS), strict=True)
    try:
        return tuple(
            Obstacle(shape, tuple(centre), tuple(normal), radius, friction, clamps=clamp == "1", carried=carry == "1")
            for shape, clamp, carry, centre, normal, radius, friction in rows
        )
    except ClothbenchError as fault:
        raise ClothbenchError(f"{path}: {fault}") from None


def _pack_thickness(thickness: float) -> tuple[Arrays, Stated]:
    return {}, {"thickness": float(thickness)}


def _unpack_thickness(arrays: Arrays, stated: Stated, path: Path) -> float | None:
    return number(stated, "thickness", path) if "thickness" in stated else None


SUPPORTS = {
    "outline": Part({"outline": Variable(("corner", "uv"), "m")}, (), _pack_outline, _unpack_outline),
    "obstacles": Part(
        {
            "obstacle_centre": Variable(("obstacle", "space"), "m"),
            "obstacle_normal": Variable(("obstacle", "space"), "1"),
            "obstacle_radius": Variable(("obstacle",), "m"),
            "obstacle_friction": Variable(("obstacle",), "1"),
        },
        (*STATED, CARRIED), _pack_obstacles, _unpack_obstacles,
    ),
    "thickness": Part({}, ("thickness",), _pack_thickness, _unpack_thickness),
}  # fmt: skip


def check_supports(
    outline: np.ndarray | None, thickness: float | None, grips: np.ndarray, size: np.ndarray, where: str
) -> None:
    """The outline lies within the sheet of that size (2,) m, encloses something, and has the grips (G, 2) m that hold
    cloth on it; the thickness is a length, far less than the longer side.
    """
    if outline is not None:
        try:
            checked_outline(outline, float(size[0]), float(size[1]))
        except ClothbenchError as fault:
            raise ClothbenchError(f"{where}: variable 'outline': {fault}") from None
        if off := grip_off(outline, grips, size):
            raise ClothbenchError(f"{where}: variable 'outline': {off}")
    if thickness is None:
        return
    if not isinstance(thickness, Real) or not (np.isfinite(thickness) and thickness >= 0):
        raise ClothbenchError(f"{where}: attribute 'thickness': found {thickness}, expected metres, 0 or above")
    check_thin(thickness, float(size.max()), where)


def check_thin(thickness: float, side: float, where: str) -> None:
    """Cloth with a longer side of `side` m is not nearly as thick as that is long; a thickness of NaN is not known."""
    if thickness > THICKEST * side:
        raise ClothbenchError(
            f"{where}: attribute 'thickness': found {thickness:g} m, expected {THICKEST * side:.2g} m at most of a "
            f"cloth {side:g} m across; are these millimetres?"
        )
