"""Force-extension curves as models and effects answer them: which do, and a model with effects made ready.

A model that answers curves has the capability "curve" and a method `curve(stretch (M,), theta (P,)) -> tension (M,)`
in N/m, per width of the sample. An effect takes part through one optional method, by its place:

| place | method | what it is |
|---|---|---|
| dynamics | `curve(stretch (M,), phi (P,)) -> tension (M,)` N/m | a tension beside the model's, added to it |
| boundary | `clamped(stretch (M,), phi) -> stretch (M,)` | the cloth's own, where the clamps say `stretch` |
| sensor | `weighed(stretch (M,), force (M,) N, phi) -> force (M,)` | what the load cell shows |

Effects of the clamps act in the order of their `rank` (0 where they say none), in whatever order they are named. The
cloth's stretch is never below 1: a slack sample hangs, it does not push. Tension times the sample's width is the
force. Where the width is not known it is taken for 1: every parameter in N/m is then the whole sample's, in N.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.optional import ShiftsSight
from clothbench.core.parameters import ParameterSpace
from clothbench.core.protocols import Effect
from clothbench.modelling.joined import JoinedParameters

CURVE_HOOKS = {"dynamics": "curve", "boundary": "clamped", "sensor": "weighed"}
SHEET_HOOKS = {"dynamics": ("force", "inertia"), "boundary": ("grips",), "sensor": ("times", "positions", "sights")}


def acts_on_curves(effect: Any) -> bool:
    return callable(getattr(effect, CURVE_HOOKS.get(effect.place, ""), None))


def acts_on_sheets(effect: Any) -> bool:
    """True also for an effect with no method at all, which is for others to refuse."""
    hooks = SHEET_HOOKS.get(effect.place, ())
    return not acts_on_curves(effect) or any(callable(getattr(effect, hook, None)) for hook in hooks)


def needs_a_picture(effect: Any) -> bool:
    """Whether it acts on points that were seen in a camera's picture, and on nothing else."""
    others = ("positions", CURVE_HOOKS["sensor"])
    return isinstance(effect, ShiftsSight) and not any(callable(getattr(effect, hook, None)) for hook in others)


def answers_curves(model: Any) -> bool:
    return "curve" in getattr(model, "capabilities", ())


def answers_sheets(model: Any) -> bool:
    return not answers_curves(model) or bool({"dynamic", "static"} & set(model.capabilities))


@dataclass(frozen=True, eq=False)
class CurveRollout:
    """Forces (B, M) N at the wanted stretches for a batch of B parameter sets; status: "ok" or "diverged"."""

    force: np.ndarray
    status: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class CurveSimulation:
    """A model that answers curves, with effects, on one sample. stretch: (M,); width: m, NaN = not known."""

    model: Any
    effects: tuple[Effect, ...]
    stretch: np.ndarray
    width: float = math.nan

    def __post_init__(self) -> None:
        if not answers_curves(self.model):
            raise ClothbenchError(f"model {self.model.name!r} answers no force-extension curves")
        for effect in self.effects:
            if not acts_on_curves(effect):
                raise ClothbenchError(f"effect {effect.name!r} does not act on force-extension curves")

    @cached_property
    def joined(self) -> JoinedParameters:
        return JoinedParameters(self.model.parameters, self.effects)

    @property
    def parameters(self) -> ParameterSpace:
        """The model's, then those of each effect as `effect.parameter`; of the whole sample if its width is unknown."""
        space = self.joined.parameters
        if math.isfinite(self.width):
            return space
        return ParameterSpace(tuple(dataclasses.replace(p, unit="N") if p.unit == "N/m" else p for p in space))

    def run(self, theta: np.ndarray) -> CurveRollout:
        """Forces for the parameter sets theta (B, P)."""
        theta = self.parameters.check(theta)
        with np.errstate(over="ignore", invalid="ignore"):
            force = np.array([self._force(row) for row in theta])
        fine = np.isfinite(force).all(axis=1)
        return CurveRollout(force, tuple("ok" if f else "diverged" for f in fine))

    def _force(self, theta: np.ndarray) -> np.ndarray:
        own, parts = self.joined.of_model(theta), list(self.joined.of_effects(theta))
        stretch = self.stretch
        for effect, phi in sorted(parts, key=lambda part: getattr(part[0], "rank", 0)):
            if effect.place == "boundary":
                stretch = effect.clamped(stretch, phi)  # type: ignore[attr-defined]
        stretch = np.maximum(stretch, 1.0)
        tension = self.model.curve(stretch, own)
        for effect, phi in parts:
            if effect.place == "dynamics":
                tension = tension + effect.curve(stretch, phi)  # type: ignore[attr-defined]
        force = tension * (self.width if math.isfinite(self.width) else 1.0)
        for effect, phi in parts:
            if effect.place == "sensor":
                force = effect.weighed(self.stretch, force, phi)  # type: ignore[attr-defined]
        return force


def curve_of(model: Any, effects: Sequence[Effect], stretch: np.ndarray, width: float = math.nan) -> CurveSimulation:
    """The model with effects, made ready for the stretches (M,) of a sample `width` m wide (NaN = not known)."""
    return CurveSimulation(model, tuple(effects), np.asarray(stretch, dtype=float), width)
