"""The cells of a suite that holds models against mechanics: one for each model and test."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any, ClassVar

from clothbench.core.errors import ClothbenchError
from clothbench.core.progress import FileProgress
from clothbench.display.names import settings_word
from clothbench.engine.cells import digest, plugin_versions
from clothbench.engine.settings import mapping, refuse, refuse_of_searches, whole, words
from clothbench.modelling.curves import answers_sheets
from clothbench.plugins.discovery import OWN, Catalogue, PluginBroken
from clothbench.studies.mechanics import VERSION
from clothbench.studies.mechanics.checks import NAMES, Check, check_named

MESHES = (9, 17, 33)
MESHES_WORD = "meshes"  # of a row's settings, what the numbers of nodes are called
SUITE_WORDS = frozenset({"tests", "meshes", "effects"})
NOT_FITTED = ("optimizer", "metric", "effects", "report", "recording", "recordings", "bounds", "analysis", "prior")


@dataclass(frozen=True)
class MechanicsCell:
    """One model in one test, on several meshes. Plain data with a key, a label and a count of its simulations.

    As no search takes part, optimizer and seed are None; what is counted as its budget are simulations. stand_for: the
    effects by name that stand for what the test asks for.
    """

    suite: str
    case: str
    model: str
    meshes: tuple[int, ...] = MESHES
    options: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    timeout: float | None = None
    validation: int = VERSION
    stand_for: Mapping[str, str] = field(default_factory=dict)

    study: ClassVar[str] = "mechanics"
    optimizer: ClassVar[None] = None
    seed: ClassVar[None] = None
    counts: ClassVar[str] = "simulations"
    value_word: ClassVar[str] = "value"

    @property
    def check(self) -> Check:
        return check_named(self.case)

    @property
    def cases(self) -> tuple[str, ...]:
        return self.check.cases

    @property
    def effects(self) -> tuple[str, ...]:
        return tuple(self.stand_for[wanted] for wanted in self.check.effects)

    @property
    def row_columns(self) -> Mapping[str, Any]:
        """What is asked beside model and test: "meshes=9,17 integrator=bdf2 …", a word each."""
        return {"settings": settings_word({MESHES_WORD: self.meshes, **self.options})}

    @property
    def metric(self) -> str:
        return self.check.measured

    @cached_property
    def budget(self) -> int:
        """How many simulations there are at most."""
        return self.check.count(self.meshes)

    @cached_property
    def key(self) -> str:
        """16 hexadecimal digits, the same on every machine for the same question."""
        question = asdict(self)
        if not self.stand_for:  # tests that ask for no effect keep the key they had before there were any
            del question["stand_for"]
        return digest(question)

    @property
    def label(self) -> str:
        return f"{self.case} · {self.model}"

    @property
    def uses(self) -> list[tuple[str, str]]:
        return [("models", self.model), *(("effects", name) for name in self.effects)]


def refuse_settings(settings: Mapping[str, Any]) -> None:
    """Refuse what can be no setting of the tests, whatever models they are of."""
    fitted = "the tests of this suite are not fitted to anything"
    refuse(settings, NOT_FITTED, fitted, "the tests of this suite bring their own scenes")
    refuse_of_searches(settings, fitted)
    mesh_sizes(settings["suite"].get("meshes"))
    effects = mapping("suite.effects", settings["suite"].get("effects"))
    for test in chosen_tests(words("suite.tests", settings["suite"].get("tests"))):
        _standing_for(test, effects)


def plan(settings: dict[str, Any], plugins: Catalogue, progress: FileProgress | None = None) -> list[MechanicsCell]:
    """Every cell of checked settings; what the user got wrong in a model's options comes to light here."""
    suite, cells = settings["suite"], []
    tests, meshes = chosen_tests(words("suite.tests", suite.get("tests"))), mesh_sizes(suite.get("meshes"))
    effects = mapping("suite.effects", suite.get("effects"))
    for model in dict.fromkeys(settings["model"] or _of_sheets(plugins)):
        options = settings["options"].get(model, {})
        _rehearse(model, options, plugins)
        for test in tests:
            cell = MechanicsCell(
                suite.get("name") or "mechanics", test, model, tuple(meshes), options,
                timeout=settings["timeout"], stand_for=_standing_for(test, effects),
            )  # fmt: skip
            require_parameters(cell, plugins)
            cells.append(dataclasses.replace(cell, versions=plugin_versions(cell.uses, plugins)))
    return cells


def require_parameters(cell: MechanicsCell, plugins: Catalogue) -> None:
    """Refuse an effect that cannot stand for what a test asks for; a broken one is left to its own cells."""
    for wanted, values in cell.check.effects.items():
        name = cell.stand_for[wanted]
        try:
            known = plugins.make("effects", name).parameters.names
        except PluginBroken:
            continue
        if lacks := [parameter for parameter in values if parameter not in known]:
            raise ClothbenchError(
                f"setting 'suite.effects.{wanted}': effect {name!r} has no parameter {lacks[0]!r}, which the test "
                f"{cell.case!r} sets; it has {', '.join(known)}; name another effect"
            )


def _standing_for(test: str, effects: Mapping[str, Any]) -> dict[str, str]:
    """The effects by name that stand for what a test asks for."""
    for wanted in check_named(test).effects:
        if effects.get(wanted) is None:
            raise ClothbenchError(
                f"setting 'suite.effects' has no {wanted!r}, which the test {test!r} asks for; name an effect for it"
            )
    return {wanted: str(effects[wanted]) for wanted in check_named(test).effects}


def mesh_sizes(value: Any) -> list[int]:
    """Nodes along a strip, from the coarsest mesh to the finest."""
    if value is None:
        return list(MESHES)
    sizes = value if isinstance(value, list | tuple) else [value]
    if not sizes:
        raise ClothbenchError("setting 'suite.meshes' is empty; give numbers of nodes, for example [9,17,33]")
    return sorted({whole("suite.meshes", n, 5) for n in sizes})


def _of_sheets(plugins: Catalogue) -> list[str]:
    """All models but those that answer curves only; one that is broken is left to its own cells."""
    found = []
    for name in plugins.names("models"):
        with contextlib.suppress(PluginBroken):
            if not answers_sheets(plugins.load("models", name)):
                continue
        found.append(name)
    return found


def _rehearse(model: str, options: Mapping[str, Any], plugins: Catalogue) -> None:
    """Make the model once; a broken one, or a stranger's, is left to its own cells."""
    if plugins.find("models", model).distribution != OWN:
        return
    try:
        plugins.make("models", model, **options)
    except PluginBroken:
        return
    except ClothbenchError:
        raise
    except Exception:
        return


def chosen_tests(given: list[str]) -> list[str]:
    """Names of tests, in the order of the suite; "all" means every one."""
    if not given:
        raise ClothbenchError(f"setting 'suite.tests' is empty; give all, or some of {', '.join(NAMES)}")
    if given == ["all"]:
        return list(NAMES)
    for name in given:
        check_named(name)
    return [name for name in NAMES if name in given]
