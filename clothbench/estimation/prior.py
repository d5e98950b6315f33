"""What a class of fabrics says of a model's parameters before anything is fitted: where to look, and where to begin."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.optional import KnowsMaterials
from clothbench.core.parameters import ParameterSpace
from clothbench.core.protocols import Material
from clothbench.core.scene import Scene
from clothbench.reference.presets import Preset


@dataclass(frozen=True)
class Prior:
    """bounds and start by parameter's name, in its unit; parameters of which the class says nothing are not there."""

    bounds: dict[str, tuple[float, float]] = field(default_factory=dict)
    start: dict[str, float] = field(default_factory=dict)


def prior_of(preset: Preset, model: Any, scene: Scene) -> Prior:
    """The parameters that the corners of a class's ranges make in a scene, and those of its middle.

    Raises a ClothbenchError where the model does not say how it is told a material.
    """
    if not isinstance(model, KnowsMaterials):
        raise ClothbenchError(
            f"setting 'prior': model {model.name!r} does not say which of its parameters make a material (of_material)"
        )
    stretch, shear = preset.numbers["stretch"], preset.numbers["shear"]
    corners = [
        told(model, Material(*values), scene)
        for values in itertools.product(*((r.low, r.high) for r in (preset.bending, stretch, shear)))
    ]
    middle, alike = (told(model, material, scene) for material in (preset.material, preset.material.alike))
    low, high = np.min(corners, axis=0), np.max(corners, axis=0)
    prior, space = Prior(), getattr(model, "parameters")  # noqa: B009  every model has them
    for k, p in enumerate(space):
        least, most = max(low[k], p.bounds[0]), min(high[k], p.bounds[1])
        if high[k] > low[k] and most > least:
            prior.bounds[p.name] = (float(least), float(most))
            prior.start[p.name] = float(np.clip(middle[k], least, most))
        elif middle[k] != alike[k]:  # warp over weft, of which only the middle is known
            prior.start[p.name] = float(np.clip(middle[k], *p.bounds))
    return prior


def told(model: Any, material: Material, scene: Scene) -> np.ndarray:
    """The model's parameters (P,) for a material, or for what of it it can be: alike along warp and weft, isotropic, or
    else without bending.
    """
    isotropic = Material(material.bending, material.stretch, material.stretch / 2)
    reason = ClothbenchError("")
    for one in (material, material.alike, isotropic, Material(0.0, material.stretch, material.shear)):
        try:
            return np.asarray(model.of_material(one, scene), dtype=float)
        except ClothbenchError as fault:
            reason = fault
    raise reason


def begun(space: ParameterSpace, start: Mapping[str, float]) -> ParameterSpace:
    """The space with other defaults for some of its parameters, moved inside its bounds."""
    mine = [
        dataclasses.replace(p, default=min(max(start[p.name], p.bounds[0]), p.bounds[1])) if p.name in start else p
        for p in space
    ]
    return ParameterSpace(tuple(mine))


def hanging(width: float, height: float, areal_density: float) -> Scene:
    """A sheet that hangs from its two upper corners: what stands for a class of fabrics where nothing else is said."""
    held = np.array([[0.0, 0.0], [width, 0.0]])
    at = np.stack([held[:, 0], 0 * held[:, 0], 0 * held[:, 0]], axis=1)
    return Scene(
        width=width, height=height, areal_density=areal_density, grip_time=np.array([0.0, 1.0]), grip_material=held,
        grip_position=np.stack([at, at]), times=np.array([0.0, 1.0]), points=np.array([[width / 2, height]]),
    )  # fmt: skip


def density_of(recording: Any, preset: Preset) -> float:
    """The recording's areal density [kg/m²], else the middle of the class."""
    known = getattr(recording, "areal_density", math.nan)
    return float(known) if known is not None and math.isfinite(known) else preset.numbers["areal_density"].value
