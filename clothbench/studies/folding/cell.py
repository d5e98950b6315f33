"""The cells of a suite in which a strip is folded and its stiffness estimated on the way: one for each fabric."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any, ClassVar

from clothbench.core.errors import ClothbenchError, known_names
from clothbench.core.parameters import ParameterSpace
from clothbench.core.progress import FileProgress
from clothbench.display.names import settings_word
from clothbench.engine.cells import digest, options_in_use, plugin_versions, seed_of
from clothbench.engine.settings import (
    OF_SUITE,
    known_words,
    mapping,
    number,
    refuse,
    refuse_strays,
    require_plugins,
    some_words,
    whole,
    words,
)
from clothbench.modelling.joined import JoinedParameters
from clothbench.plugins.discovery import Catalogue, PluginBroken
from clothbench.reference.fabrics import Fabric, chosen_fabrics, fabric_named

SUITE_WORDS = frozenset({"fold", "select"})
NOT_RECORDED = ("recording", "recordings", "report", "analysis", "prior")
VERSION = 2  # of the testbed: raised when its numbers change
KNOWN = "eta_b"  # the parameter that fabrics are known by, and estimates are held against


@dataclass(frozen=True)
class FoldSettings:
    """How a strip of `length` m is lifted: in `steps` of `rise` m, beginning with `first` for the parameter `fit[0]`.

    fit: names of the parameters that are estimated, the first of them the fabric's; friction: coefficient of the desk.
    """

    length: float = 1.0
    steps: int = 10
    rise: float = 0.04
    first: float = 100.0
    friction: float = 0.5
    fit: tuple[str, ...] = ("eta_b",)


@dataclass(frozen=True)
class FoldingCell:
    """One fabric folded with one model, tracker, metric and optimizer. Plain data with a key and a label."""

    suite: str
    case: str
    model: str
    effects: tuple[str, ...]
    optimizer: str
    metric: str
    tracker: str
    fold: FoldSettings
    options: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    evaluations: int = 200
    seed: int = 0
    timeout: float | None = None
    testbed: int = VERSION

    study: ClassVar[str] = "folding"
    counts: ClassVar[str] = "steps"
    value_word: ClassVar[str] = "estimate"

    @property
    def fabric(self) -> Fabric:
        return fabric_named(self.case)

    @property
    def row_columns(self) -> Mapping[str, Any]:
        """What is asked beside what rows have columns for: "length=1.0 steps=10 … evaluations=200 …", a word each."""
        told = {**asdict(self.fold), "tracker": self.tracker, "evaluations": self.evaluations}
        told |= {f"bounds.{name}": ends for name, ends in self.bounds.items()}
        for of, options in options_in_use(self.options, (name for _, name in self.uses)).items():
            told |= {f"{of}.{name}": value for name, value in options.items()}
        return {"settings": settings_word(told)}

    @property
    def cases(self) -> tuple[str, ...]:
        return (self.case,)

    @property
    def budget(self) -> int:
        """How many steps there are, for whoever waits; `evaluations` is what the optimizer has for each."""
        return self.fold.steps

    @cached_property
    def key(self) -> str:
        """16 hexadecimal digits, the same on every machine for the same question."""
        return digest({**asdict(self), "options": options_in_use(self.options, (name for _, name in self.uses))})

    @property
    def label(self) -> str:
        return f"{self.case} · {self.model} · {self.optimizer} · {self.metric}"

    @property
    def uses(self) -> list[tuple[str, str]]:
        single = [("models", self.model), ("optimizers", self.optimizer), ("trackers", self.tracker)]
        return [*single, ("metrics", self.metric), *(("effects", name) for name in self.effects)]

    def option(self, name: str) -> dict[str, Any]:
        return dict(self.options.get(name, {}))

    def stream(self, purpose: str) -> int:
        """A seed of its own for each purpose. The sheet is the same for every model and optimizer."""
        return seed_of(self.case, self.fold.length, self.seed, purpose)


def refuse_settings(settings: Mapping[str, Any]) -> None:
    """Refuse what can be no setting of a fold, whatever folds it."""
    made = "the recordings of this suite are made as it runs"
    refuse(settings, NOT_RECORDED, made, "this suite has a strip on a desk")
    require_plugins(settings, ("model", "optimizer", "metric"))
    fold_settings(mapping("suite.fold", settings["suite"].get("fold")))
    chosen_fabrics(selected(settings["suite"]))


def plan(settings: dict[str, Any], plugins: Catalogue, progress: FileProgress | None = None) -> list[FoldingCell]:
    """Every cell of checked settings; an option that a plugin does not have comes to light here."""
    suite, cells = settings["suite"], []
    spaces: list[ParameterSpace] = []
    lifted, fabrics = fold_settings(mapping("suite.fold", suite.get("fold"))), chosen_fabrics(selected(suite))
    product = itertools.product(fabrics, *(settings[key] for key in ("model", "optimizer", "metric")))
    for fabric, model, optimizer, metric in product:
        cell = FoldingCell(
            suite.get("name") or "folding", fabric, model, tuple(settings["effects"]), optimizer, metric,
            str(settings["tracker"]), lifted, settings["options"], settings["bounds"],
            evaluations=settings["budget"], seed=settings["seed"], timeout=settings["timeout"],
        )  # fmt: skip
        for kind, name in cell.uses:
            if kind not in ("optimizers", "effects"):
                plugins.make(kind, name, **cell.option(name))
        spaces += parameters_of(cell, plugins)
        cells.append(dataclasses.replace(cell, versions=plugin_versions(cell.uses, plugins)))
    for space in spaces:
        if strays := [name for name in lifted.fit if name not in space.names]:
            raise ClothbenchError(
                f"setting 'suite.fold.fit': no parameter {strays[0]!r}; {known_names(strays[0], space.names)}"
            )
    if spaces:
        refuse_strays(settings, {name for space in spaces for name in space.names}, plugins)
        refuse_idle_bounds(settings, lifted.fit)
    for space in spaces:
        estimated(space, lifted, settings["bounds"])
    return cells


def refuse_idle_bounds(settings: Mapping[str, Any], fit: tuple[str, ...]) -> None:
    """Refuse bounds of what is not estimated; a suite's own may stand where the command line estimates less."""
    own = settings.get(OF_SUITE, ())
    if idle := [name for name in settings["bounds"] if name not in fit and name not in own]:
        raise ClothbenchError(
            f"setting 'bounds.{idle[0]}': it is not estimated; name it in suite.fold.fit ({', '.join(fit)}), or leave "
            "its bounds out"
        )


def estimated(whole: ParameterSpace, fold: FoldSettings, bounds: Mapping[str, tuple[float, float]]) -> ParameterSpace:
    """What is estimated of all parameters, in the order of `fit`; the first begins at the first guess."""
    fit, first = fold.fit, fold.first
    found = ParameterSpace(tuple(whole[name] for name in fit)).bounded({k: v for k, v in bounds.items() if k in fit})
    low, high = found.parameters[0].bounds
    if not low <= first <= high:
        raise ClothbenchError(f"setting 'suite.fold.first' is {first:g}, expected {low:g} to {high:g}, as {fit[0]}")
    return ParameterSpace((dataclasses.replace(found.parameters[0], default=first), *found.parameters[1:]))


def parameters_of(cell: FoldingCell, plugins: Catalogue) -> list[ParameterSpace]:
    """The parameters of a cell's model and effects, as one of a list; none where they are not known, or where the model
    folds no strips and the cell says so.
    """
    try:
        model = plugins.make("models", cell.model, **cell.option(cell.model))
        effects = tuple(plugins.make("effects", name) for name in cell.effects)
    except PluginBroken:
        return []
    folds = "fold" in model.capabilities
    return [JoinedParameters(model.parameters, effects).parameters] if folds else []


def fold_settings(given: Mapping[str, Any]) -> FoldSettings:
    """The suite's `fold`, checked."""
    known: dict[str, Any] = {f.name: f.default for f in dataclasses.fields(FoldSettings)}
    known_words("setting of 'suite.fold'", given, set(known))
    numbers = {
        n: number(f"suite.fold.{n}", given.get(n, known[n]), 0.0) for n in ("length", "rise", "first", "friction")
    }
    steps = whole("suite.fold.steps", given.get("steps", known["steps"]), 1)
    if steps * numbers["rise"] >= numbers["length"]:
        raise ClothbenchError(
            f"setting 'suite.fold.rise': {steps} steps of {numbers['rise']:g} m reach {steps * numbers['rise']:g} m, "
            f"expected less than the strip's {numbers['length']:g} m"
        )
    fit = tuple(words("suite.fold.fit", given.get("fit", list(known["fit"]))))
    if not fit:
        raise ClothbenchError("setting 'suite.fold.fit' is empty; name the parameters to estimate, the fabric's first")
    if fit[0] != KNOWN:
        raise ClothbenchError(
            f"setting 'suite.fold.fit' begins with {fit[0]!r}, expected {KNOWN!r}: that is what fabrics are known by, "
            "and what suite.fold.first is the first guess of"
        )
    if twice := next((name for name in fit if fit.count(name) > 1), None):
        raise ClothbenchError(f"setting 'suite.fold.fit': {twice!r} is there twice; name each parameter once")
    return FoldSettings(steps=steps, fit=fit, **numbers)


def selected(suite: Mapping[str, Any]) -> list[str]:
    """Patterns of fabrics' names; all if there are none."""
    return some_words("suite.select", suite.get("select"), ["*"])
