"""The cells of a suite that holds models against mechanics: one for each model and test."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any, ClassVar

from clothbench.core.errors import ClothbenchError
from clothbench.engine.cells import digest, plugin_versions
from clothbench.modelling.curves import answers_sheets
from clothbench.plugins.discovery import OWN, Catalogue, PluginBroken
from clothbench.studies.mechanics import VERSION
from clothbench.studies.mechanics.checks import NAMES, Check, check_named

MESHES = (9, 17, 33)


@dataclass(frozen=True)
class ValidationCell:
    """One model in one test, on several meshes. Plain data with a key, a label and a count of its simulations.

    As no search takes part, optimizer and seed are None; what is counted as its budget are simulations.
    """

    suite: str
    case: str
    model: str
    meshes: tuple[int, ...] = MESHES
    options: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    timeout: float | None = None
    validation: int = VERSION

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
        return tuple(self.check.effects)

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
        return digest(asdict(self))

    @property
    def label(self) -> str:
        return f"{self.case} · {self.model}"

    @property
    def uses(self) -> list[tuple[str, str]]:
        return [("models", self.model), *(("effects", name) for name in self.effects)]


def plan_validation(config: Mapping[str, Any], plugins: Catalogue) -> list[ValidationCell]:
    """Every cell of checked settings; what the user got wrong in a model's options comes to light here."""
    suite = config["suite"]
    cells = []
    for model in dict.fromkeys(config["model"] or _of_sheets(plugins)):
        options = config["options"].get(model, {})
        _rehearse(model, options, plugins)
        for test in suite["tests"]:
            cell = ValidationCell(
                suite.get("name") or "physical_validation", test, model, tuple(suite["meshes"]), options,
                timeout=config["timeout"],
            )  # fmt: skip
            cells.append(dataclasses.replace(cell, versions=plugin_versions(cell.uses, plugins)))
    return cells


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
    if given == ["all"]:
        return list(NAMES)
    for name in given:
        check_named(name)
    return [name for name in NAMES if name in given]
