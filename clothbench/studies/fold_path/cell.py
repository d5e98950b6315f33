"""The cells of a suite in which cloth is led along folding paths: one for each fabric, path and model."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any, ClassVar

from clothbench.core.errors import ClothbenchError
from clothbench.core.progress import FileProgress
from clothbench.engine.cells import digest, options_in_use, plugin_versions
from clothbench.engine.settings import (
    known_words,
    mapping,
    number,
    one_word,
    refuse,
    refuse_of_searches,
    require_plugins,
    some_words,
    whole,
)
from clothbench.plugins.discovery import Catalogue
from clothbench.reference.fabrics import chosen_fabrics, fabric_named

SUITE_WORDS = frozenset({"path", "select"})
NOT_USED = ("optimizer", "metric", "effects", "report", "recording", "recordings", "bounds", "analysis", "prior",
            "timeout")  # fmt: skip
WAYS = ("computed", "triangular", "circular")
VERSION = 2  # of the testbed: raised when its numbers change
NUMBERS = ("length", "friction", "width", "seconds", "areal_density", "lift")


@dataclass(frozen=True)
class PathSettings:
    """What is folded in half, and on what.

    length, width: m (a strip has no width); friction: coefficient of the desk; planner: model that computes the path;
    layers: how many lie on each other, `bonded` if they cannot slide on each other; seconds: that a sheet is led along
    the path; areal_density: kg/m² of each layer of a sheet; nodes: of its mesh along the length; thickness: m, how far
    apart a sheet's upper and lower half stay (0: they pass through each other); lift: m, height at which a strip's end
    sets out along a geometric path.
    """

    length: float = 1.0
    friction: float = 0.3
    planner: str = "kirchhoff_love"
    layers: int = 1
    bonded: bool = False
    width: float = 0.3
    seconds: float = 4.0
    areal_density: float = 0.2
    nodes: int = 41
    thickness: float = 0.0
    lift: float = 0.02


@dataclass(frozen=True)
class FoldPathCell:
    """One fabric led along one path, as one model has it. Plain data with a key and a label."""

    suite: str
    fabric: str
    way: str
    model: str
    path: PathSettings
    options: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    testbed: int = VERSION

    study: ClassVar[str] = "fold_path"
    counts: ClassVar[str] = "paths"
    value_word: ClassVar[str] = "landing error"
    effects: ClassVar[tuple[str, ...]] = ()
    optimizer: ClassVar[None] = None
    metric: ClassVar[str] = "landing_error"
    seed: ClassVar[None] = None
    budget: ClassVar[int] = 1

    @property
    def case(self) -> str:
        return f"{self.fabric}, {self.way}"

    @property
    def cases(self) -> tuple[str, ...]:
        return (self.case,)

    @property
    def row_columns(self) -> Mapping[str, Any]:
        """What is asked beside fabric, path and model: "length=1.0 friction=0.1 …", a word each."""
        return {"settings": " ".join(f"{name}={value}" for name, value in asdict(self.path).items())}

    @property
    def eta_b(self) -> float:
        """η_b [m⁻⁴·s²] of all layers together: weight grows with their number n, and stiffness as well if they slide on
        each other, with n³ if they cannot.
        """
        return fabric_named(self.fabric).eta / (self.path.layers**2 if self.path.bonded else 1)

    @cached_property
    def key(self) -> str:
        options = options_in_use(self.options, (name for _, name in self.uses))
        return digest([self.study, {**asdict(self), "options": options}])

    @property
    def label(self) -> str:
        return f"{self.fabric} · {self.way} path · {self.model}"

    @property
    def uses(self) -> list[tuple[str, str]]:
        return [("models", name) for name in dict.fromkeys((self.model, self.path.planner))]

    def option(self, name: str) -> dict[str, Any]:
        return dict(self.options.get(name, {}))


def refuse_settings(settings: Mapping[str, Any]) -> None:
    """Refuse what can be no setting of a path, whatever follows it."""
    nothing = "nothing is measured or fitted in this suite"
    refuse(settings, NOT_USED, nothing, "this suite has a desk of its own")
    refuse_of_searches(settings, nothing)
    require_plugins(settings, ("model",))
    _product(settings["suite"])


def _product(suite: Mapping[str, Any]) -> tuple[list[str], list[str], PathSettings]:
    """Fabrics, ways and the fold that a suite is about."""
    given = mapping("suite.path", suite.get("path"))
    ways, about = chosen_ways(given.pop("ways", None)), path_settings(given)
    return chosen_fabrics(some_words("suite.select", suite.get("select"), ["*"])), ways, about


def plan(settings: dict[str, Any], plugins: Catalogue, progress: FileProgress | None = None) -> list[FoldPathCell]:
    """Every cell of checked settings."""
    suite, cells = settings["suite"], []
    fabrics, ways, about = _product(suite)
    for fabric, way, model in itertools.product(fabrics, ways, settings["model"]):
        cell = FoldPathCell(suite.get("name") or "fold_path", fabric, way, model, about, settings["options"])
        for kind, name in cell.uses:
            plugins.make(kind, name, **cell.option(name))
        cells.append(dataclasses.replace(cell, versions=plugin_versions(cell.uses, plugins)))
    return cells


def chosen_ways(given: Any) -> list[str]:
    ways = some_words("suite.path.ways", given, list(WAYS))
    if unknown := [w for w in ways if w not in WAYS]:
        raise ClothbenchError(f"setting 'suite.path.ways': there is no {unknown[0]!r}; there are: {', '.join(WAYS)}")
    return ways


def path_settings(given: Mapping[str, Any]) -> PathSettings:
    """The suite's `path`, checked."""
    known: dict[str, Any] = {f.name: f.default for f in dataclasses.fields(PathSettings)}
    known_words("setting of 'suite.path'", given, {*known, "ways"})
    told = {**known, **given}
    for name in NUMBERS:
        told[name] = number(f"suite.path.{name}", told[name], 0.0)
    told["layers"], told["nodes"] = (
        whole("suite.path.layers", told["layers"], 1),
        whole("suite.path.nodes", told["nodes"], 9),
    )
    told["thickness"] = number("suite.path.thickness", told["thickness"], least=0.0)
    if told["lift"] >= told["length"] / 2:
        raise ClothbenchError(
            f"setting 'suite.path.lift' is {told['lift']:g} m, expected less than half the strip's "
            f"{told['length']:g} m, which is as high as a geometric path goes"
        )
    told["planner"] = one_word("suite.path.planner", told["planner"])
    if not isinstance(told["bonded"], bool):
        raise ClothbenchError(f"setting 'suite.path.bonded' is {told['bonded']!r}, expected true or false")
    if told["layers"] > 1 and "bonded" not in given:
        raise ClothbenchError(
            f"setting 'suite.path.layers' is {told['layers']}: say with 'suite.path.bonded' whether they slide on "
            "each other (false) or cannot (true); what they do when they rub is in between and is not modelled"
        )
    return PathSettings(**told)
