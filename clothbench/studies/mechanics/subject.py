"""A model under test: run through one check, mesh by mesh."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clothbench import ClothbenchError, Effect, Model
from clothbench.core.optional import KnowsMaterials, takes_option, why_skipped
from clothbench.studies.mechanics.checks import HALVES, Check, Level
from clothbench.studies.mechanics.measures import NoMeasure, observed_order
from clothbench.studies.mechanics.trials import Trial

DEFAULTS = "at its default parameters: "


class CannotDo(Exception):
    """The model cannot be tested so; not a fault."""


@dataclass(frozen=True)
class Subject:
    """A model as `make(**options)` gives it, with the effects that stand for what a check wants, by that."""

    make: Callable[..., Model]
    effects: Mapping[str, Effect]
    takes_scale: bool

    @classmethod
    def of(cls, factory: Any, make: Callable[..., Model], effects: Mapping[str, Effect]) -> Subject:
        return cls(make, effects, takes_option(factory, "step_scale"))

    def levels(self, check: Check, meshes: Sequence[int]) -> Iterator[Level]:
        """Each simulation's outcome as it is known, from the coarsest mesh to the finest, then with shorter steps.

        A model that cannot do the first mesh is not asked for the others.
        """
        meshes = check.meshes(meshes)
        for along in meshes:
            for trial in check.trials(along):
                yield self.level(check, trial, along)
        if check.halved and self.takes_scale:
            for scale in HALVES:
                yield self.level(check, check.trials(meshes[0])[0], meshes[0], scale)

    def level(self, check: Check, trial: Trial, along: int, scale: float = 1.0) -> Level:
        """One simulation; what goes wrong in it is its status and reason."""
        along = max(trial.scene.resolution or (along,))
        size = max(trial.scene.width, trial.scene.height) / (along - 1)
        began = time.perf_counter()
        found = Level(along, size, scale, trial.load, trial.reference, None)
        if trial.unresolved:
            return dataclasses.replace(found, status="skipped", reason=trial.unresolved, unresolved=True)
        try:
            found = dataclasses.replace(found, **self._measured(check, trial, scale))
        except CannotDo as fault:
            found = dataclasses.replace(found, status="skipped", reason=str(fault))
        except ClothbenchError as fault:
            found = dataclasses.replace(found, status="error", reason=str(fault))
        return dataclasses.replace(found, wall_s=time.perf_counter() - began)

    def _measured(self, check: Check, trial: Trial, scale: float) -> dict[str, Any]:
        model = self.make() if scale == 1.0 else self.make(step_scale=scale)
        if lacks := [n for n in check.needs if n not in model.capabilities]:
            raise CannotDo(_lacks(lacks[0]))
        if reason := why_skipped(model, trial.scene):
            raise CannotDo(reason)
        own, note = parameters_for(model, check, trial)
        try:
            simulation = model.prepare(trial.scene, tuple(self.effects.values()))
        except ClothbenchError as fault:
            raise CannotDo(str(fault)) from fault
        theta = simulation.parameters.defaults
        theta[: len(own)] = own
        for wanted, values in check.effects.items():
            for name, value in values.items():
                theta[simulation.parameters.names.index(f"{self.effects[wanted].name}.{name}")] = value
        rollout = simulation.run(theta[None])
        about = {"nodes": int(rollout.nodes), "steps": int(rollout.steps[0]), "status": rollout.status[0]}
        if rollout.status[0] != "ok":
            return about | {"reason": rollout.reasons[0] if rollout.reasons else rollout.status[0]}
        value = trial.measure(trial.scene, rollout.position[0])
        if not np.isfinite(value):
            raise NoMeasure("some positions are not known")
        if trial.still:
            note = note or _restless(trial.measure(trial.scene, rollout.position[0, :1]), value)
        return about | {"value": value, "reason": note}


def parameters_for(model: Model, check: Check, trial: Trial) -> tuple[np.ndarray, str]:
    """The model's parameters (P,) for the trial's cloth; its defaults, and why, where those will do as well."""
    reason = "the model does not say which of its parameters make a textbook material (no of_material)"
    cloths = [trial.material] + [dataclasses.replace(trial.material, bending=0.0)] * check.limp
    for cloth in cloths if isinstance(model, KnowsMaterials) else ():
        try:
            theta = np.asarray(model.of_material(cloth, trial.scene), dtype=float)
            dry = dataclasses.replace(cloth, bending_damping=0.0, stretch_damping=0.0)
            if check.viscous and (theta == model.of_material(dry, trial.scene)).all():
                raise CannotDo("the model has no parameter for viscosity of the cloth")
            return theta, ""
        except ClothbenchError as fault:
            reason = str(fault)
    if check.textbook:
        raise CannotDo(reason)
    return model.parameters.defaults, DEFAULTS + reason


def _restless(first: float, last: float) -> str:
    """Word of a sheet that should have hung still from the first frame, and moved by more than a hundredth."""
    moved = abs(last - first) > 0.01 * abs(last)
    return f"not at rest when the run began: {first:.4g}, at its end {last:.4g}" if moved else ""


def with_orders(levels: Sequence[Level]) -> list[Level]:
    """The same levels, each with the order of convergence seen up to it: over meshes, then over the step's halves."""
    out = []
    for n, level in enumerate(levels):
        if level.step_scale == 1.0:
            mine = [v for v in levels[: n + 1] if v.step_scale == 1.0 and v.load == level.load]
            # A fold's load changes with nothing but the cloth; a cantilever's cell with its length.
            sizes = [v.size for v in mine]
        else:
            mine = [v for v in levels[: n + 1] if v.along == level.along]
            sizes = [v.step_scale for v in mine]
        known = [v.value if v.value is not None else float("nan") for v in mine]
        order = observed_order(sizes, known) if level.reference else None  # a drift of 0 is approached from any side
        out.append(dataclasses.replace(level, order=order))
    return out


def _lacks(capability: str) -> str:
    return {
        "dynamic": "the model finds rest only, and this test needs motion",
        "effects": "the model takes no effects, and this test needs one",
        "contact": "the model knows no contact, and this test needs a ground",
    }.get(capability, f"the model lacks {capability!r}")
