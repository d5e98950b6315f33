"""What every sheet must do with its weight: as mechanics has it, whatever its mesh and its solver.

Nothing in mechanics depends on what a kilogram or a second is. Where all that holds a kilogram is so many times as
large, the motion is the same; and a shape at rest is, where all that holds a second is. Of the parameters their units
say what they hold. So the scene's density or gravity has to undo what these parameters alone have changed; a solver
that ends early, or has constants of its own, may miss that by something. What does not answer at all takes its density
or its gravity from elsewhere.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.optional import KnowsMaterials, repeatability_of
from clothbench.core.parameters import ParameterSpace
from clothbench.core.protocols import Material
from clothbench.core.scene import Scene
from clothbench.testing import scenes
from clothbench.testing.model_case import ModelCase, apart, finished, millimetres
from clothbench.testing.rules import require

FACTOR = 1.5  # by which the kilogram is smaller, and the square of the second
ANSWERS = 0.5  # of what the parameters alone change, which density and gravity undo where all is exact
TOLD = 1e-4  # m: what the parameters must change for that to be a comparison
ONE_REST = (scenes.overhanging, scenes.curtain, scenes.hanging)  # what hangs slack may come to rest in several shapes
WEAKER = 0.4  # of the earth's gravity
HOLDS = {"N": (1, -2), "Pa": (1, -2), "J": (1, -2), "W": (1, -3), "kg": (1, 0), "g": (1, 0), "s": (0, 1), "Hz": (0, -1)}
HOLDS |= {"m": (0, 0), "rad": (0, 0), "1": (0, 0), "%": (0, 0), "°": (0, 0)}  # kilograms and seconds
POWERS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")
PREFIXES = "fpnuµμmcdkMG"
SOFT = [Material(bending, stretch=20.0, shear=10.0) for bending in (1e-6, 0.0)]  # hangs by 1.8 mm
NEAR_MATERIAL = 0.3  # of how far it hangs
INEXTENSIBLE = 0.05


def heeds_density_and_gravity(case: ModelCase) -> str | None:
    """With a smaller kilogram all is as it was; so is a rest with a smaller second. Under weaker gravity what moves
    moves otherwise, and falls less.
    """
    told = case.is_dynamic and _weaker_gravity(case)
    theta, mass, time = _units(case)
    hung = next((scene for scene in map(_held_still, ONE_REST) if case.can(scene)), None)
    if theta is not None and hung is not None:
        if mass.any():
            density, air = FACTOR * hung.areal_density, FACTOR * hung.air_density
            heavy = dataclasses.replace(hung, areal_density=density, air_density=air)
            told |= _answers(case, "areal density", hung, heavy, theta, mass)
        if time.any() and "static" in case.model.capabilities:
            told |= _answers(case, "gravity", hung, _under_gravity(hung, FACTOR), theta, time / -2)
    return None if told else "moves not, and no parameter of which its unit says what it holds changes where it rests"


def _held_still(make: Callable[[], Scene]) -> Scene:
    return scenes.still(make())


def _answers(case: ModelCase, what: str, scene: Scene, other: Scene, theta: np.ndarray, powers: np.ndarray) -> bool:
    """Whether it can be said: theta (B, P) that goes along changes what is seen, and `other` changes it back."""
    along = theta * FACTOR**powers
    base, alone, both = case.run(scene, theta), case.run(scene, along), case.run(other, along)
    ended = finished(base) & finished(alone) & finished(both)
    changed = apart(alone.position[ended], base.position[ended])
    undone = apart(both.position[ended], alone.position[ended])
    told = changed > max(TOLD, 2 * repeatability_of(case.model))
    for change, answer in zip(changed[told], undone[told], strict=True):
        found = f"a change of {millimetres(answer)} by {FACTOR} times the {what}"
        expected = f"about the {millimetres(change)} that the parameters change which hold as much"
        require(answer >= ANSWERS * change, found, expected)
    return bool(told.any())


def _units(case: ModelCase) -> tuple[np.ndarray | None, np.ndarray, np.ndarray]:
    """Parameter sets (B, P) with room to go along, and the powers (P,) of kilogram and second in each."""
    space: ParameterSpace = case.model.parameters
    powers = [holds(parameter.unit) for parameter in space]
    if any(p is None for p in powers):
        return None, np.zeros(len(space)), np.zeros(len(space))
    mass, time = np.array(powers, dtype=float).T
    theta = case.theta(0.4)
    room = np.array([
        all(((t * FACTOR**p >= space.low) & (t * FACTOR**p <= space.high)).all() for p in (mass, time / -2))
        for t in theta
    ])  # fmt: skip
    return (theta[room] if room.any() else None), mass, time


def _weaker_gravity(case: ModelCase) -> bool:
    """Whether it can be said: in the liveliest scene, and where nothing holds the sheet."""
    theta, largest, tried = case.model.parameters.defaults[None], 0.0, []
    for name, scene in case.scenes.items():
        if scene.obstacles or (len(scene.grip_material) and scene is not case.liveliest):  # what lies there stays
            continue
        usual, other = (case.run(s, theta) for s in (scene, _under_gravity(scene, WEAKER)))
        if usual.status[0] != "ok" or other.status[0] != "ok":
            continue
        tried.append(name)
        largest = max(largest, float(apart(usual.position, other.position)[0]))
        if len(scene.grip_material) == 0 and scene.velocity is None:
            seconds, down = scene.times[-1] - scene.start_time, np.array(scene.gravity) / np.linalg.norm(scene.gravity)
            first, last = other.position[0, [0, -1]].mean(axis=1) @ down
            share = float(last - first) / (WEAKER * np.linalg.norm(scene.gravity) / 2 * seconds**2)
            found = f"a fall of {share:.3g} × ½ g t² under {WEAKER} of the gravity of scene {name}"
            require(0.4 < share < 1.02, found, "1, or less by the air's drag")
    found = f"a change of {millimetres(largest)} under {WEAKER} of the gravity of {', '.join(tried)}"
    require(not tried or largest > TOLD, found, "another motion")
    return bool(tried)


def _under_gravity(scene: Scene, factor: float) -> Scene:
    x, y, z = scene.gravity
    return dataclasses.replace(scene, gravity=(factor * x, factor * y, factor * z))


def hangs_as_its_material_says(case: ModelCase) -> str | None:
    """A curtain is longer by ρ g h²/2 over the stiffness of the material that the model was given parameters for.

    A model that does not stretch has no say in that, nor has one that has no parameters for such a material.
    """
    model, scene = case.model, scenes.curtain()
    if not isinstance(model, KnowsMaterials) or "static" not in model.capabilities or not case.can(scene):
        return "has no parameters for a textbook material, or does not find a curtain's rest"
    refused = ""
    for material in SOFT:
        try:
            theta = np.asarray(model.of_material(material, scene), dtype=float)
            rollout = case.run(scene, theta[None])
        except ClothbenchError as refusal:
            refused = str(refusal)
            continue
        if rollout.status[0] == "ok":
            return _require_stretched(rollout.position[0, -1], scene, material)
    return f"has no parameters for a soft material, or finds no rest with them: {refused}"


def _require_stretched(position: np.ndarray, scene: Scene, material: Material) -> str | None:
    below = position @ np.array(scene.gravity) / np.linalg.norm(scene.gravity)
    upper, lower = scene.points[:, 1] == 0, scene.points[:, 1] == scene.height
    longer = float(below[lower].mean() - below[upper].mean()) - scene.height
    weight = scene.areal_density * float(np.linalg.norm(scene.gravity))
    expected = weight * scene.height**2 / 2 / material.stretch
    if abs(longer) < INEXTENSIBLE * expected:
        return "does not stretch"
    found = f"a curtain that its weight lengthens by {millimetres(longer)}"
    within = f"{millimetres(expected)} of {material.stretch:g} N/m, within {100 * NEAR_MATERIAL:.0f} %"
    require(abs(longer - expected) <= NEAR_MATERIAL * expected, found, within)
    return None


def holds(unit: str) -> tuple[int, int] | None:
    """Powers of kilogram and second in a unit ("N·m·s", "kg/(m²·s)", "m^-4 s^2"), None where it is not of these."""
    flat = re.sub(r"/\s*\(([^()]*)\)", lambda below: "/" + re.sub(r"[\s·*]+", "/", below[1].strip()), unit)
    flat = flat.replace("**", "^").translate(POWERS)
    mass = time = 0
    for token in re.findall(r"/?[^/·*\s]+", re.sub(r"/\s+", "/", flat)):
        found = re.fullmatch(r"(/?)([^\d^+-]+|1)\^?([+-]?\d+)?", token)
        kind = found and HOLDS.get(found[2], HOLDS.get(found[2][1:]) if found[2][0] in PREFIXES else None)
        if not found or kind is None:
            return None
        power = int(found[3] or 1) * (-1 if found[1] else 1)
        mass, time = mass + power * kind[0], time + power * kind[1]
    return mass, time


RULES = (heeds_density_and_gravity, hangs_as_its_material_says)
