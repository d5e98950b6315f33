"""What each test simulates on a mesh of `along` nodes, reads off it, and should find there."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from clothbench import Material, Scene
from clothbench.reference import mechanics as references
from clothbench.studies.mechanics import measures, scenes
from clothbench.studies.mechanics.scenes import DENSITY

CLOTH = Material(bending=1e-5, stretch=300.0, shear=150.0)  # a light shirting
VISCOUS = Material(1e-5, 300.0, 150.0, 1e-7, 0.03)  # the shirting, damped: 10 ms of its bending, 0.1 ms of its stretch
CANVAS = Material(bending=1e-4, stretch=1000.0, shear=500.0)
CARD = Material(bending=1e-2, stretch=1000.0, shear=500.0)  # as stiff as thin cardboard
LIMP = Material(bending=1e-7, stretch=1000.0, shear=500.0)  # bends freely, hardly stretches
LOADS = (1.0, 10.0, 100.0, 1000.0)  # Γ of `cantilever` in canvas
LIGHT = 0.01  # Γ in card: a tenth of it would sag by 2 µm, which is what some models' steps come to rest within
HEAVY = 1e4  # Γ in canvas on twice the nodes: below its clamp it hangs straight down but for a hundredth of its length
COARSEST = 1.6  # bends at the clamp, L/√Γ, in a cell: with ⅓, ⅔, 1 and 1.6 H/W is off by 1, 5, 11 and 31 %
SMALL_LOAD = 0.05
HANGING, FALL_TIME = 0.3, 0.5  # m, s
EXTRA, COEFFICIENT = 0.075, 1.0  # kg/m² of air; C_N
FOLDS = (3.5e4, 2.6e3)  # η_b of `fold_table`: the limpest and the stiffest of its fabrics


@dataclass(frozen=True, eq=False)
class Trial:
    """One simulation: its scene, the cloth, what is read off, and what that should be.

    load: what is varied beside the mesh, in the check's `load_name`; still: read off the last frame of a sheet that
    should be at rest from the first; unresolved: why the mesh is too coarse for it, "" where it is not.
    """

    scene: Scene
    material: Material
    measure: Callable[[Scene, np.ndarray], float]
    reference: float
    load: float | None = None
    still: bool = False
    unresolved: str = ""


def free_fall(along: int) -> list[Trial]:
    scene = scenes.level(0.2, along, np.array([0.0, FALL_TIME]))
    return [Trial(scene, CLOTH, measures.drop, references.fall(FALL_TIME))]


def free_fall_damped(along: int) -> list[Trial]:
    """The same with viscosity on, which works between the parts of a sheet and must not brake it as a whole."""
    return [dataclasses.replace(free_fall(along)[0], material=VISCOUS)]


def sag(along: int, load: float) -> Trial:
    length = scenes.tip_length(CANVAS.bending, load)
    reference = length * -float(references.cantilever(load).z[-1])
    return Trial(scenes.clamped(length, along, load), CANVAS, measures.tip_sag, reference, still=True)


def cantilever_small(along: int) -> list[Trial]:
    length = scenes.tip_length(CARD.bending, SMALL_LOAD)
    reference = length * references.small_sag(SMALL_LOAD)
    return [Trial(scenes.clamped(length, along, SMALL_LOAD), CARD, measures.tip_sag, reference, still=True)]


def cantilever(along: int) -> list[Trial]:
    return [
        _hung(LIGHT, CARD, along),
        *(_hung(load, CANVAS, along) for load in LOADS),
        _hung(HEAVY, CANVAS, 2 * along - 1),
    ]


def _hung(load: float, cloth: Material, along: int) -> Trial:
    """A cantilever; the heavier, the shorter the bend at its clamp: where the tension ρgL holds a moment, √(D/ρgL)."""
    scene = scenes.clamped(scenes.tip_length(cloth.bending, load), along, load)
    least = math.ceil(math.sqrt(load) / COARSEST) + 2  # the held cell is no part of the length
    coarse = f"the bend at the clamp is L/√Γ, a mesh of {along} nodes is too coarse for it; it takes {least}"
    return Trial(scene, cloth, measures.sag_over_reach, references.drop_over_reach(load), load, still=True,
                 unresolved=coarse if along < least else "")  # fmt: skip


def fold(bending: float, along: int) -> Trial:
    unit = references.bending_length(bending, DENSITY)
    material = Material(bending, CLOTH.stretch, CLOTH.shear)
    reference = references.fold_coefficients()[0] * unit
    return Trial(scenes.folded(bending, along), material, measures.fold_height, reference, unit, still=True)


def free_fold(along: int) -> list[Trial]:
    # The loop is two thirds of the strip, and turns by more than half a circle: it needs more nodes than the others.
    return [fold(CLOTH.bending, 2 * along - 1)]


def free_fold_length(along: int) -> list[Trial]:
    """The same fold, its loop measured along the cloth: height alone is blind to where it leaves the ground."""
    (folded,) = free_fold(along)
    reference = references.fold_coefficients()[1] * references.bending_length(CLOTH.bending, DENSITY)
    return [dataclasses.replace(folded, measure=measures.fold_length, reference=reference)]


def fold_table(along: int) -> list[Trial]:
    return [fold(DENSITY / eta, 2 * along - 1) for eta in FOLDS]


def swing(along: int, extra: float = 0.0) -> list[Trial]:
    scene = scenes.swinging(along, 0.003, 3.0, 0.01, extra / DENSITY)
    return [Trial(scene, LIMP, measures.period, references.swing_period(scenes.LENGTH, extra / DENSITY))]


def catenary(along: int) -> list[Trial]:
    weight, span = DENSITY * references.G, scenes.SPAN * HANGING
    reference = references.catenary_sag(HANGING, span, weight, LIMP.stretch)
    return [Trial(scenes.strung(HANGING, along), LIMP, measures.middle_sag, reference, still=True)]


def terminal(along: int) -> list[Trial]:
    scene = scenes.level(0.2, along, np.array([0.0, 1.1, 1.2]))
    return [Trial(scene, CLOTH, measures.last_speed, references.terminal_speed(DENSITY, scenes.AIR, COEFFICIENT))]


def drift(along: int) -> list[Trial]:
    seconds = 10.0 + 2 * references.swing_period(scenes.LENGTH)
    return [Trial(scenes.swinging(along, 0.06, seconds, 0.004), LIMP, measures.energy_drift, 0.0)]
