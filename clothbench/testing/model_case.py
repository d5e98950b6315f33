"""A model under test: how it is made, the scenes it can do, and the parameter sets it is tried with."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.protocols import Effect, Model
from clothbench.core.rollout import Rollout
from clothbench.core.scene import Scene
from clothbench.modelling.curves import answers_sheets
from clothbench.testing import probe, scenes
from clothbench.testing.rules import NotApplicable, require


@dataclass(frozen=True, eq=False)
class ModelCase:
    """make: what is registered; wanted: scenes, None: the kit's own; given: effects, None: all installed."""

    make: Callable[..., Model]
    model: Model
    wanted: Mapping[str, Scene] | None = None
    given: Sequence[Effect] | None = None

    @property
    def is_dynamic(self) -> bool:
        return "dynamic" in self.model.capabilities

    @cached_property
    def scenes(self) -> dict[str, Scene]:
        """The scenes that the model can simulate, by name; it refuses others with a ClothbenchError."""
        if not answers_sheets(self.model):
            raise NotApplicable("answers force-extension curves only")
        wanted = dict(scenes.standard() if self.wanted is None else self.wanted)
        if not self.is_dynamic:
            wanted = {name: scenes.still(scene) for name, scene in wanted.items() if len(scene.grip_material)}
        found = {name: scene for name, scene in wanted.items() if self.can(scene)}
        require(found, f"none of the scenes {', '.join(wanted)} can be prepared", "at least one")
        return found

    @cached_property
    def held(self) -> dict[str, Scene]:
        """The scenes in which something holds the sheet."""
        return {name: scene for name, scene in self.scenes.items() if len(scene.grip_material)}

    @cached_property
    def liveliest(self) -> Scene:
        """The scene in which most happens: swinging where the model can do it."""
        return self.scenes.get("swinging", next(iter(self.scenes.values())))

    @cached_property
    def effects(self) -> tuple[Effect, ...]:
        """The effects to try; none where the model does not claim to take any."""
        if "effects" not in self.model.capabilities:
            return ()
        return probe.installed_effects() if self.given is None else tuple(self.given)

    def theta(self, *units: float) -> np.ndarray:
        """Parameter sets (1 + U, P): the defaults, then all at each share of their scaled ranges."""
        space = self.model.parameters
        return np.vstack([space.defaults, *(space.from_unit(np.full(len(space), unit)) for unit in units)])

    @cached_property
    def batch(self) -> np.ndarray:
        """Ten parameter sets (10, P) amid the bounds: more than a vector register has lanes."""
        unit = np.random.default_rng(20).uniform(0.3, 0.7, (9, len(self.model.parameters)))
        return np.vstack([self.model.parameters.defaults, self.model.parameters.from_unit(unit)])

    def run(self, scene: Scene, theta: np.ndarray, effects: Sequence[Effect] = (), **options: Any) -> Rollout:
        """Simulate theta (B, P), prepared anew; the effects' columns stand behind the model's."""
        model = self.make(**options) if options else self.model
        return model.prepare(scene, tuple(effects)).run(theta)

    def run_with(self, scene: Scene, theta: np.ndarray, *pairs: tuple[Effect, np.ndarray]) -> Rollout:
        """Simulate theta (B, P) with effects, each given with its values (P_e,)."""
        columns = [theta, *(np.tile(values, (len(theta), 1)) for _, values in pairs)]
        return self.run(scene, np.hstack(columns), [effect for effect, _ in pairs])

    def can(self, scene: Scene) -> bool:
        """Whether the model takes the scene."""
        try:
            self.model.prepare(scene)
        except ClothbenchError:
            return False
        return True


def finished(rollout: Rollout) -> np.ndarray:
    """Which members (B,) ran to their end."""
    return np.array([status == "ok" for status in rollout.status])


def same_bits(one: Rollout, other: Rollout) -> bool:
    """Equal positions to the last bit (not a number equals itself), and equal statuses."""
    return one.status == other.status and np.array_equal(one.position, other.position, equal_nan=True)


def apart(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Largest difference of a coordinate per member (B,) m, between positions (B, T, N, 3) m."""
    return np.abs(one - other).max(axis=(1, 2, 3))


def millimetres(metres: float) -> str:
    return f"{1e3 * metres:.3g} mm"
