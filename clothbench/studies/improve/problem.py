"""What the loop is asked: recordings, a model, and how to fit it with any set of effects."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from clothbench import __version__
from clothbench.core.observation import Observation
from clothbench.core.parameters import ParameterSpace
from clothbench.core.protocols import Effect, Score, Simulation
from clothbench.core.rollout import Rollout
from clothbench.core.scene import Scene
from clothbench.engine.checkpoint import Checkpoint as Memory
from clothbench.estimation.fixed import holding
from clothbench.estimation.trials import Trial
from clothbench.plugins.discovery import Catalogue
from clothbench.recordings.nodes import Recording

Told = Callable[[int, float], None]


class CoordinateError:
    """Root-mean-square over visible node coordinates [mm]: the loop's own yardstick, a metric like any other.

    correction: (M,) m, added to the residual at the M visible coordinates: what is known of the mesh's own error.
    """

    name: ClassVar[str] = "coordinate_error"
    version: ClassVar[int] = 1

    def __init__(self, correction: np.ndarray | float = 0.0):
        self.correction, self.unit = correction, "mm"

    def __call__(self, observation: Observation, rollout: Rollout) -> Score:
        seen = observation.visible
        away = (rollout.position - np.nan_to_num(observation.position))[:, seen].reshape(len(rollout.position), -1)
        away = away + self.correction
        return Score(1e3 * np.sqrt(np.mean(away**2, axis=1)), self.unit, residual=away)

    def floor(self, observation: Observation) -> float:
        return 1e3 * observation.sigma


@dataclass(frozen=True, eq=False)
class Case:
    """One recording ready for the loop: what was seen of it, and its scene."""

    name: str
    split: str
    recording: Recording
    observation: Observation
    scene: Scene

    @property
    def duration(self) -> float:
        """s, from the first frame to the last."""
        return float(np.ptp(self.observation.time))


def without_switches(simulation: Simulation, own: int) -> Simulation:
    """Physics of the first `own` parameters, the model's, that can be switched off, is: it is for the loop to find."""
    return holding(simulation, {p.name: p.null for p in simulation.parameters.parameters[:own] if p.null is not None})


def residuals(trial: Trial, theta: np.ndarray) -> np.ndarray:
    """Simulated minus seen (B, M) m at the M visible coordinates, for parameter sets (B, P)."""
    found = trial.metric(trial.observation, trial.simulation.run(theta)).residual
    assert found is not None  # CoordinateError has one
    return found


@dataclass(frozen=True, eq=False)
class Problem:
    """A model, with what belongs to it in any case (`base`), beside recordings.

    base: effects that are part of the model from the start; step_scale: of the model's own step, for models that have
    that option; corrections: by recording, see `CoordinateError`; memory: of what was computed already.
    """

    model: str
    cases: tuple[Case, ...]
    plugins: Catalogue
    base: tuple[str, ...] = ()
    options: Mapping[str, Any] = field(default_factory=dict)
    step_scale: float = 1.0
    seed: int = 0
    corrections: Mapping[str, np.ndarray] = field(default_factory=dict)
    memory: Memory = field(default_factory=Memory)

    # What a fit does otherwise where a rollout costs next to nothing and has no ripples: settings of the search, times
    # the budget, and the step of differences (0: the usual). rounds: how many effects may be named (0: the usual).
    search: ClassVar[dict[str, Any]] = {}
    patience: ClassVar[int] = 1
    probe: ClassVar[float] = 0.0
    rounds: ClassVar[int] = 0
    # Times the least that any leaves (mean squares): a candidate that leaves more after its first fit is given up.
    contest: ClassVar[float] = 1.5
    # Times the floor: a model that leaves more on held-out recordings lacks something, whatever the fit says.
    carried: ClassVar[float] = 1.5

    def finer(self) -> Problem:
        """The same with half the cell size and half the step."""
        scale = self.step_scale / 2 if self.takes_scale else 1.0
        cases = tuple(dataclasses.replace(case, scene=refined(case.scene)) for case in self.cases)
        return dataclasses.replace(self, cases=cases, step_scale=scale, corrections={})

    @cached_property
    def takes_scale(self) -> bool:
        import inspect

        try:
            return "step_scale" in inspect.signature(self.plugins.load("models", self.model)).parameters
        except (TypeError, ValueError):
            return False

    @cached_property
    def versions(self) -> dict[str, int]:
        """Of every installed effect that can be used."""
        return {name: effect.version for name, effect in self.plugins.made("effects")[0].items()}

    def effects(self, names: Sequence[str]) -> list[Effect]:
        return [self.plugins.make("effects", name) for name in (*self.base, *names)]

    def of_split(self, split: str) -> list[Case]:
        return [case for case in self.cases if case.split == split]

    def trials(self, names: Sequence[str], split: str) -> list[Trial]:
        """One simulation for each recording of a split, with these effects beside the base."""
        options = dict(self.options) | ({"step_scale": self.step_scale} if self.takes_scale else {})
        model, effects = self.plugins.make("models", self.model, **options), self.effects(names)
        out = []
        for case in self.of_split(split):
            simulation = without_switches(model.prepare(case.scene, effects), len(model.parameters))
            metric = CoordinateError(self.corrections.get(case.name, 0.0))
            out.append(Trial(case.name, case.observation, simulation, metric))
        return out

    def space(self, names: Sequence[str]) -> ParameterSpace:
        return self.trials(names, "fit")[0].simulation.parameters

    def key(self, *more: Any) -> str:
        """16 hexadecimal digits of everything that a result depends on."""
        about = {
            "model": self.model, "base": self.base, "options": dict(self.options),
            "step": self.step_scale, "seed": self.seed, "recordings": [c.recording.hash for c in self.cases],
            "splits": [c.split for c in self.cases], "more": more, "clothbench": __version__,
            "scenes": [c.scene and (c.scene.areal_density, c.scene.resolution) for c in self.cases],
            "versions": [getattr(self.plugins.load("models", self.model), "version", 0)],
            "corrections": {name: digest(c) for name, c in self.corrections.items()},
            "effects": self.versions,
        }  # fmt: skip
        return hashlib.sha256(json.dumps(about, sort_keys=True, default=str).encode()).hexdigest()[:16]


def refined(scene: Scene) -> Scene:
    """The scene with cells of half the size."""
    assert scene.resolution is not None  # the command has set it
    nu, nv = scene.resolution
    return dataclasses.replace(scene, resolution=(2 * nu - 1, 2 * nv - 1))


def digest(array: np.ndarray) -> str:
    """16 hexadecimal digits of an array's numbers."""
    return hashlib.sha256(np.ascontiguousarray(array, dtype=float).tobytes()).hexdigest()[:16]
