"""The twin: a calibrated cloth on its way into another simulator, and the file that comes of it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

from clothbench.core.errors import one_line
from clothbench.core.protocols import Material
from clothbench.core.scene import Scene

UNITS = {
    "areal_density": "kg/m²", "bending": "N·m", "stretch": "N/m", "shear": "N/m", "bending_damping": "N·m·s",
    "stretch_damping": "N·s/m", "bending_ratio": "1", "stretch_ratio": "1",
}  # fmt: skip
STIFFEST = 5000.0  # N/m, what stands for a cloth that does not stretch at all
LIMPEST = 1e-8  # N·m, what stands for one that does not resist bending
CLOSE = 0.02  # share by which a value may be off before a file says so


@dataclass(frozen=True, eq=False)
class Twin:
    """A cloth, how it is held and begins, and how sure its numbers are.

    name: one line for people; scene: size, mass, grips and their path, gravity, what is around; material: SI; others:
    what belongs to the fit and is no material, as drag, by "plugin.parameter", with its unit; spread: low and high of
    the quantities of `UNITS` and of the others that have an interval, each in its unit, "what" says of which kind it
    is; determined: whether the data say what they are, of those of which that is known; provenance: plain data; nulls:
    of the others, the values at which they do nothing (0 where none is stated); places: of those that belong to an
    effect, its place ("dynamics", "boundary" or "sensor").
    """

    name: str
    scene: Scene
    material: Material
    spread: Mapping[str, tuple[float, float]]
    what: str
    others: Mapping[str, tuple[float, str]] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    determined: Mapping[str, bool] = field(default_factory=dict)
    nulls: Mapping[str, float] = field(default_factory=dict)
    places: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "name", one_line(self.name))

    @property
    def units(self) -> dict[str, str]:
        """The unit of each of `values`."""
        return dict(UNITS)

    @property
    def values(self) -> dict[str, float]:
        """The quantities of `UNITS`, each in its unit."""
        return {"areal_density": self.scene.areal_density, **dataclasses.asdict(self.material)}

    def about(self) -> list[str]:
        """Lines for the head of a file, none of them broken: values with intervals, where they come from."""
        lines = [f"clothbench export: {self.name}"]
        for name, value in self.values.items():
            interval = f" ({self.interval(name)})"
            if not name.endswith("_ratio"):
                lines.append(f"{name.replace('_', ' ')}: {value:.4g} {UNITS[name]}{interval if value else ''}")
            elif value != 1.0:
                lines.append(f"{name.replace('_', ' ')}: {value:.4g}, warp over weft{interval}")
        return [one_line(line) for line in (*lines, *(f"{name}: {value}" for name, value in self.provenance.items()))]

    def interval(self, name: str) -> str:
        """Low and high of a quantity and of which kind they are, in words."""
        low, high = self.spread.get(name, (math.nan, math.nan))
        if not self.determined.get(name, True):
            return "not determined by what was fitted"
        return f"{low:.3g} … {high:.3g}, {self.what}" if math.isfinite(low) else "no interval"

    def isotropic(self, target: str, shears: bool = False) -> tuple[Material, list[str]]:
        """The nearest material with shear = stretch/2, finite stretch and some bending, alike along warp and weft: all
        that an isotropic sheet without cross contraction can be; and a line on each thing that this changes.

        shears: the target has a shear stiffness of its own; it is the material's, where that is finite.
        """
        m, lines = self.material, []
        stretch, bending = min(m.stretch, STIFFEST), max(m.bending, LIMPEST)
        if stretch < m.stretch:
            lines.append(f"stretch: {target} holds a finite one: {stretch:g} N/m stands for {m.stretch:g}")
        if bending > m.bending:
            lines.append(f"bending: {target} holds some: {bending:g} N·m stands for {m.bending:g}")
        shear = m.shear if shears and math.isfinite(m.shear) else stretch / 2
        if math.isinf(m.shear):
            lines.append(f"shear: {target} holds a finite one: {shear:g} N/m stands for {m.shear:g}")
        elif abs(m.shear - shear) > CLOSE * shear:
            lines.append(
                f"shear: {target} has no parameter of its own for it: {shear:.4g} N/m stands for {m.shear:.4g}"
                f"{factors(shear, m.shear)}"
            )
        for quantity, mean in (("bending", bending), ("stretch", stretch)):
            warp, weft = m.along(quantity)
            if abs(getattr(m, f"{quantity}_ratio") - 1) > CLOSE:
                lines.append(
                    f"{quantity}: {target} has one for warp and weft: {mean:.4g} {UNITS[quantity]} stands for "
                    f"{warp:.4g} along the warp and {weft:.4g} along the weft{factors(mean, warp, weft)}"
                )
        return dataclasses.replace(m.alike, bending=bending, stretch=stretch, shear=shear), lines

    def unheld(self, target: str, holds: Collection[str] = ()) -> list[str]:
        """A line on each part of the fit that is no material and does something, and on each thing of the scene beside
        the sheet and its grips. holds: those of the scene's that the target has a place for: "obstacles", "thickness",
        "outline".
        """
        lines = [
            f"{name}: {amount(value, unit)} belongs to the camera and not to the cloth; it is left out"
            if self.places.get(name) == "sensor"
            else f"{name}: {target} has no place for it; {amount(value, unit)} is left out"
            for name, (value, unit) in self.others.items()
            if value != self.nulls.get(name, 0.0)
        ]
        scene = self.scene
        if "obstacles" not in holds:
            lines += [
                f"obstacle {k}: the {'carried ' * o.carried}{o.shape} is left out, and nothing stops the cloth there"
                for k, o in enumerate(scene.obstacles)
            ]
        if "thickness" not in holds and scene.thickness > 0:
            lines.append(f"thickness: {target} is not told that layers stay {scene.thickness:g} m apart")
        if "outline" not in holds and scene.outline is not None:
            lines.append(f"outline: the cut along {len(scene.outline)} corners is left out")
        if scene.velocity is not None:
            lines.append("velocity: how the cloth moved when it was first seen is left out; here it begins at rest")
        return lines


def amount(value: float, unit: str) -> str:
    """A value with its unit, which a number without one has not."""
    return f"{value:.4g}" if unit in ("", "1") else f"{value:.4g} {unit}"


def factors(mean: float, *parts: float) -> str:
    """What stands for each of the parts, over it, in words; nothing where one of them is 0."""
    if not all(parts):
        return ""
    return f" (factor{'s' * (len(parts) > 1)} {' and '.join(f'{mean / part:.3g}' for part in parts)})"


@dataclass(frozen=True)
class Export:
    """The text of a file, and one line on each thing that the target cannot hold, with the change that this brings.

    material: what the file does hold, where that is not what `Twin.isotropic` makes of the twin.
    """

    text: str
    cannot: tuple[str, ...]
    material: Material | None = None
