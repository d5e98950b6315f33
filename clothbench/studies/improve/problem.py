"""What the loop is asked: evidence, a model, and how to simulate it with any set of effects."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from clothbench.core.optional import takes_option
from clothbench.core.parameters import ParameterSpace
from clothbench.core.protocols import Effect
from clothbench.engine.cells import digest
from clothbench.engine.checkpoint import Checkpoint
from clothbench.engine.study import Elsewhere
from clothbench.estimation.fixed import holding
from clothbench.estimation.prior import begun
from clothbench.estimation.trials import Trial, over, score_of
from clothbench.plugins.discovery import Catalogue
from clothbench.studies.improve.evidence import Case, Evidence, of_split


@dataclass(frozen=True, eq=False)
class Problem:
    """A model, with what belongs to it in any case, beside evidence.

    model: name of its plugin;
    evidence: the recordings;
    plugins: where model, effects and optimizer come from;
    optimizer: name of the search that fits;
    base: names of the effects that are part of the model from the start;
    options: of plugins, by the plugin's name;
    bounds: of parameters, by name, in place of those that the plugin states;
    seed: of all random draws;
    question: key of the cell, below which all that is kept of an unfinished run is keyed;
    step_scale: times the model's own step, for models that have that option;
    refinement: how often the cells were halved;
    made: effects that are no plugins, by name, some of whose numbers are held (`held`);
    own: by recording, parameters that are held in it alone, by name: amounts that differ from recording to recording;
    corrections: (M,) by recording, see `Case.trial`; halvings: of the cells, that they come from;
    checkpoint: what was computed already;
    elsewhere: workers that do pieces of the work, see `Context`;
    begins: where a search of parameters begins, by name, in place of their defaults.
    """

    model: str
    evidence: Evidence
    plugins: Catalogue
    optimizer: str
    base: tuple[str, ...] = ()
    options: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    seed: int = 0
    question: str = ""
    step_scale: float = 1.0
    refinement: int = 0
    made: Mapping[str, Any] = field(default_factory=dict)
    own: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    corrections: Mapping[str, np.ndarray] = field(default_factory=dict)
    halvings: int = 0
    checkpoint: Checkpoint = field(default_factory=Checkpoint)
    elsewhere: Elsewhere | None = None
    begins: Mapping[str, float] = field(default_factory=dict)

    def of_split(self, split: str) -> list[Case]:
        return of_split(self.evidence, split)

    def restricted(self, case: Case) -> Problem:
        """The same with one recording only."""
        return dataclasses.replace(self, evidence=self.evidence.restricted((case,)))

    def uncorrected(self) -> Problem:
        return dataclasses.replace(self, corrections={})

    def refined(self) -> Problem | None:
        """The same with half the cell size and half the step; None where nothing is discretised."""
        if (evidence := self.evidence.refined()) is None:
            return None
        scale = self.step_scale / 2 if self._takes("step_scale") else 1.0
        return dataclasses.replace(
            self, evidence=evidence, step_scale=scale, refinement=self.refinement + 1, corrections={}
        )

    def relaid(self) -> list[Problem]:
        """The same with each other choice of what chance decides in a simulation."""
        return [dataclasses.replace(self, evidence=evidence) for evidence in self.evidence.relaid()]

    def _takes(self, option: str) -> bool:
        return takes_option(self.plugins.load("models", self.model), option)

    def make(self, kind: str, name: str, *args: Any, **settings: Any) -> Any:
        """A plugin's object with its options, which have the last word; or an effect that was made here."""
        if kind == "effects" and name in self.made:
            return self.made[name]
        return self.plugins.make(kind, name, *args, **settings | dict(self.options.get(name, {})))

    def effects(self, names: Sequence[str]) -> list[Effect]:
        return [self.make("effects", name) for name in (*self.base, *names)]

    @cached_property
    def _model(self) -> Any:
        options = dict(self.options.get(self.model, {}))
        if self.step_scale != 1.0:
            options["step_scale"] = self.step_scale * options.get("step_scale", 1.0)
        return self.plugins.make("models", self.model, **options)

    def trials(self, names: Sequence[str], split: str) -> list[Trial]:
        """One simulation for each recording of a split, with these effects beside the base."""
        effects = self.effects(names)
        held = {f"{name}.{own}": value for name, e in self.made.items() for own, value in e.held.items()}
        found = [(c.name, c.trial(self._model, effects, self.corrections.get(c.name))) for c in self.of_split(split)]
        return [
            dataclasses.replace(trial, simulation=holding(trial.simulation, {**held, **self.own.get(name, {})}))
            for name, trial in found
        ]

    def space(self, names: Sequence[str]) -> ParameterSpace:
        return self.bounded(self.trials(names, "fit")[0].simulation.parameters)

    def bounded(self, space: ParameterSpace) -> ParameterSpace:
        """The space with those of the bounds and beginnings that are of its parameters."""
        return begun(
            space.bounded({name: pair for name, pair in self.bounds.items() if name in space.names}), self.begins
        )

    def space_of(self, effect: str) -> ParameterSpace:
        """The parameters of one effect, by their own names."""
        space, prefix = self.make("effects", effect).parameters, f"{effect}."
        own = {name.removeprefix(prefix): pair for name, pair in self.bounds.items() if name.startswith(prefix)}
        return space.bounded(own) if own else space

    def key(self, *more: Any) -> str:
        """16 hexadecimal digits of everything that a result on the way depends on."""
        corrections = {name: array_digest(c) for name, c in self.corrections.items()}
        cases = [(case.name, case.split) for case in self.evidence.cases]
        made = [sorted(effect.held.items()) for effect in self.made.values()]
        bounds = sorted(self.bounds.items())
        question = [
            self.question, self.model, self.base, cases, self.step_scale, self.refinement, corrections, bounds, more
        ]  # fmt: skip
        own = sorted((name, sorted(values.items())) for name, values in self.own.items())
        return digest([*question, *([made] if made else []), *([own] if own else [])])


def residuals_of_fit(problem: Problem, fitted: Any, split: str) -> list[np.ndarray]:
    """Simulated minus measured (M,) of each recording of a split, at the parameters of a fit."""
    return over(problem.trials(fitted.effects, split), lambda trial: residuals(trial, fitted.theta[None])[0])


def residuals(trial: Trial, theta: np.ndarray) -> np.ndarray:
    """Simulated minus measured (B, M), in the evidence's base unit, for parameter sets (B, P); NaN of a run that
    did not come to its end.
    """
    found = score_of(trial, trial.metric, trial.simulation.run(theta)).residual
    assert found is not None  # every metric of the loop has one
    return found


def array_digest(array: np.ndarray) -> str:
    """16 hexadecimal digits of an array's numbers."""
    return hashlib.sha256(np.ascontiguousarray(array, dtype=float).tobytes()).hexdigest()[:16]
