"""Small pictures of what an effect does, one for each family of effects, as SVG in the colours of the page.

Dashed is the cloth, or its curve, without the effect, solid with it; arrows are what acts. A picture is 200 by 120.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

Points = Sequence[tuple[float, float]]
WIDTH, HEIGHT = 200, 120


def drawing(family: str, label: str) -> str:
    """The picture of a family of `clothbench.core.optional.EFFECT_FAMILIES`, "" for any other; label: HTML that says
    in words what it shows.
    """
    if family not in DRAWINGS:
        return ""
    inside = "".join(DRAWINGS[family]())
    return f'<svg class="sketch" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{label}">{inside}</svg>'


def line(points: Points, kind: str) -> str:
    joined = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    return f'<polyline class="{kind}" points="{joined}"/>'


def dot(x: float, y: float, radius: float, kind: str) -> str:
    return f'<circle class="{kind}" cx="{x:.1f}" cy="{y:.1f}" r="{radius}"/>'


def box(x: float, y: float, width: float, height: float, kind: str) -> str:
    return f'<rect class="{kind}" x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{height:.1f}" rx="2"/>'


def arrow(start: tuple[float, float], end: tuple[float, float]) -> str:
    """A shaft and its head, of what acts."""
    along = np.subtract(end, start) / np.hypot(*np.subtract(end, start))
    across = np.array([-along[1], along[0]])
    heads = [np.array(end) - 7 * along + side * 3.5 * across for side in (1, -1)]
    return line([start, end], "acts") + line([tuple(heads[0]), end, tuple(heads[1])], "acts")


def curved(of: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]], kind: str) -> str:
    """A smooth line: points (x, y) of a parameter from 0 to 1."""
    return line(list(zip(*of(np.linspace(0.0, 1.0, 33)), strict=True)), kind)


def hanging(x: float, lean: float, kind: str, top: float = 20.0, length: float = 86.0) -> str:
    """A sheet from the side, held at (x, top), that leans by so much at its lower edge."""
    return curved(lambda s: (x + lean * s**1.6, top + length * np.sqrt(1 - (0.8 * lean / 100) ** 2) * s), kind)


def axes() -> str:
    return line([(28, 12), (28, 104), (184, 104)], "axis")


def air() -> list[str]:
    """A swinging sheet that lags behind; small arrows against its motion."""
    pushes = [arrow((112 - 34 * s**1.6, 20 + 84 * s), (140 - 34 * s**1.6, 20 + 84 * s)) for s in (0.4, 0.65, 0.9)]
    return [hanging(110, -62, "without"), hanging(110, -34, "with"), dot(110, 20, 4, "grip"), *pushes]


def wind() -> list[str]:
    """A sheet at rest that is pushed aside all the time."""
    gusts = [arrow((22, y), (78, y)) for y in (42, 66, 90)]
    return [hanging(94, 0, "without"), hanging(94, 46, "with"), dot(94, 20, 4, "grip"), *gusts]


def mass() -> list[str]:
    """A sheet from the front with a weight along its lower edge."""
    edge = line([(60, 24), (60, 80), (140, 80), (140, 24), (60, 24)], "with")
    return [edge, box(60, 76, 80, 8, "filled"), *(arrow((x, 88), (x, 112)) for x in (76, 100, 124)),
            dot(60, 24, 4, "grip"), dot(140, 24, 4, "grip")]  # fmt: skip


def gravity() -> list[str]:
    """What hangs freely hangs askew to the recording's vertical."""
    return [line([(100, 16), (100, 112)], "without"), line([(100, 18), (120, 84)], "with"), dot(100, 18, 4, "grip"),
            arrow((120, 84), (128, 112))]  # fmt: skip


def stretch() -> list[str]:
    """Force over stretch, which bends up."""
    stiffer = curved(lambda s: (28 + 140 * s, 104 - 44 * s - 46 * s**3), "with")
    return [axes(), line([(28, 104), (180, 56)], "without"), stiffer, arrow((156, 62), (156, 32))]


def bending() -> list[str]:
    """A strip over the edge of a table that droops otherwise."""
    table = box(14, 42, 58, 10, "table")
    return [table, curved(lambda s: (72 + 92 * s - 40 * s**3, 39 + 66 * s**2), "without"),
            curved(lambda s: (72 + 108 * s, 39 + 30 * s**2), "with"), line([(14, 39), (72, 39)], "with"),
            arrow((150, 92), (168, 70))]  # fmt: skip


def grip() -> list[str]:
    """Hands that hold elsewhere than is recorded."""
    hands = [
        box(x - 6, 16, 12, 12, kind) for x, kind in ((56, "without"), (76, "filled"), (124, "without"), (144, "filled"))
    ]
    below = [
        line([(56, 28), (56, 104), (124, 104), (124, 28)], "without"),
        line([(76, 28), (76, 104), (144, 104), (144, 28)], "with"),
    ]
    return [*below, *hands, arrow((62, 12), (84, 12)), arrow((130, 12), (152, 12))]


def clamp() -> list[str]:
    """A sample that is loose between its clamps."""
    jaws = [box(84, 8, 32, 12, "filled"), box(84, 96, 32, 12, "filled")]
    slack = curved(lambda s: (100 + 16 * np.sin(np.pi * s) ** 2, 20 + 76 * s), "with")
    return [line([(100, 20), (100, 96)], "without"), slack, *jaws, arrow((130, 92), (130, 112))]


def clock() -> list[str]:
    """The same motion, stamped at another time."""
    early = curved(lambda s: (30 + 120 * s, 58 - 34 * np.sin(2 * np.pi * s)), "without")
    late = curved(lambda s: (54 + 120 * s, 58 - 34 * np.sin(2 * np.pi * s)), "with")
    return [axes(), early, late, arrow((62, 16), (84, 16))]


def camera() -> list[str]:
    """A camera that sees the sheet beside where it is."""
    body = [box(12, 48, 34, 24, "filled"), line([(46, 54), (56, 48), (56, 72), (46, 66)], "with")]
    rays = [line([(58, 60), (150, 22)], "axis"), line([(58, 60), (150, 98)], "axis")]
    return [*body, *rays, line([(142, 26), (142, 94)], "without"), line([(154, 18), (166, 84)], "with"),
            arrow((142, 106), (166, 106))]  # fmt: skip


def load() -> list[str]:
    """All forces read too high or too low by as much."""

    def rising(up: float, kind: str) -> str:
        return curved(lambda s: (28 + 144 * s, 96 - up - 50 * s**1.5), kind)

    return [axes(), rising(0, "without"), rising(26, "with"), arrow((56, 88), (56, 66))]


DRAWINGS: dict[str, Callable[[], list[str]]] = {
    "air": air, "wind": wind, "mass": mass, "gravity": gravity, "stretch": stretch, "bending": bending, "grip": grip,
    "clamp": clamp, "clock": clock, "camera": camera, "load": load,
}  # fmt: skip
