"""What sheets must do where something is in their way: a model that says so keeps out of it, and out of itself."""

from __future__ import annotations

import dataclasses

import numpy as np

from clothbench.core.scene import Scene
from clothbench.testing import scenes
from clothbench.testing.model_case import ModelCase, millimetres
from clothbench.testing.rules import require

SINKS = 5e-3  # m: penalties give way, and points between nodes lie a little lower than these
IN_ITS_WAY = 2e-2  # m: so far the sheet goes without the plane
NEAR_LAYERS = 0.2  # of the thickness, which models may take between nodes, or press a little


def keeps_out_of_a_plane(case: ModelCase) -> str | None:
    """A table below a sheet that bends down, and a slope that a hanging sheet leans on."""
    if "contact" not in case.model.capabilities:
        return "does not claim to keep out of obstacles"
    told = [_kept_out(case, make()) for make in (scenes.over_a_table, scenes.on_a_slope)]
    return None if any(told) else "does neither of the kit's scenes with a plane, or does not come near it"


def _kept_out(case: ModelCase, scene: Scene) -> bool:
    """Whether it can be said: the plane is in the way of the sheet."""
    free, (plane,) = dataclasses.replace(scene, obstacles=()), scene.obstacles
    if not (case.can(scene) and case.can(free)):
        return False
    theta, normal = case.model.parameters.defaults[None], np.array(plane.normal)
    fallen, stopped = (case.run(one, theta) for one in (free, scene))
    if fallen.status[0] != "ok" or stopped.status[0] != "ok":
        return False
    through, sunk = (float(-((r.position[0] - plane.centre) @ normal).min()) for r in (fallen, stopped))
    if through < IN_ITS_WAY:
        return False
    found = f"a sheet {millimetres(sunk)} deep in a plane, {millimetres(through)} where there is none"
    require(sunk <= SINKS, found, "at most 5 mm")
    return True


def keeps_its_layers_apart(case: ModelCase) -> str | None:
    """A strip laid back over itself, its lower half held, comes to lie on that half."""
    if "self_contact" not in case.model.capabilities:
        return "does not claim to keep its own layers apart"
    thick = scenes.folded_over()
    if "moving_start" not in case.model.capabilities:
        thick = dataclasses.replace(thick, velocity=None)
    thin = dataclasses.replace(thick, thickness=0.0)
    if not (case.can(thick) and case.can(thin)):
        return "cannot do the kit's strip that is folded over"
    theta = case.model.parameters.defaults[None]
    kept, through = (case.run(scene, theta) for scene in (thick, thin))
    upper = thick.points[:, 0] > 0.18
    if kept.status[0] != "ok" or through.status[0] != "ok":
        return "does not bring the kit's folded strip to its end"
    height, low = (float(r.position[0, -1, upper, 2].min()) for r in (kept, through))
    if low > 0:
        return "is too stiff for the layers of the kit's folded strip to meet"
    found = f"an upper layer {millimetres(height)} above the lower, {millimetres(low)} without a thickness"
    require(height >= NEAR_LAYERS * thick.thickness, found, f"about the thickness, {millimetres(thick.thickness)}")
    return None


RULES = (keeps_out_of_a_plane, keeps_its_layers_apart)
