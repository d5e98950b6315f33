"""The one cell of a study of speed: all is measured in one run, or ratios would mean nothing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any, ClassVar

from clothbench.core.errors import ClothbenchError
from clothbench.core.parallel import thread_count
from clothbench.core.progress import FileProgress
from clothbench.engine.cells import digest, plugin_versions
from clothbench.engine.settings import refuse, refuse_of_searches, whole
from clothbench.engine.system import system_info
from clothbench.plugins.discovery import Catalogue
from clothbench.studies.speed.bench import SIDES, peers_in

SUITE_WORDS = frozenset({"sides"})
NOT_TIMED = ("optimizer", "metric", "effects", "report", "recording", "recordings", "bounds", "analysis", "prior",
             "options", "timeout")  # fmt: skip
VERSION = 3  # of what is timed and how: raised when that changes


@dataclass(frozen=True)
class SpeedCell:
    """These models, or all if there are none, beside all installed peers, on sheets of so many nodes a side.

    peers: those that can run here; machine: what all of it is measured on, since speeds of another one are no answer.
    """

    suite: str
    models: tuple[str, ...]
    sides: tuple[int, ...]
    versions: Mapping[str, str] = field(default_factory=dict)
    peers: tuple[str, ...] = ()
    machine: Mapping[str, str | int] = field(default_factory=dict)
    testbed: int = VERSION

    study: ClassVar[str] = "speed"
    case: ClassVar[str] = "swaying sheet"
    cases: ClassVar[tuple[str, ...]] = ("swaying sheet",)
    effects: ClassVar[tuple[str, ...]] = ()
    optimizer: ClassVar[None] = None
    seed: ClassVar[None] = None
    metric: ClassVar[str] = "time_per_million_node_steps"
    row_columns: ClassVar[Mapping[str, Any]] = {}
    counts: ClassVar[str] = "measurements"
    value_word: ClassVar[str] = "measured"
    budget: ClassVar[None] = None  # how many measurements there are is known only as they go

    @property
    def model(self) -> str:
        return ",".join(self.models) or "all"

    @cached_property
    def key(self) -> str:
        return digest([self.study, asdict(self)])

    @property
    def label(self) -> str:
        return f"speed of {self.model}"


def refuse_settings(settings: Mapping[str, Any]) -> None:
    """Refuse what can be no setting of a measurement, whatever is measured."""
    refuse(settings, NOT_TIMED, "speed is measured on a scene of its own, with options of each model's own",
           "speed is measured on a scene of its own")  # fmt: skip
    refuse_of_searches(settings, "speed is measured on a scene of its own, and nothing is fitted")
    mesh_sides(settings["suite"].get("sides"))


def plan(settings: dict[str, Any], plugins: Catalogue, progress: FileProgress | None = None) -> list[SpeedCell]:
    """One cell, whatever there is to measure."""
    sides = mesh_sides(settings["suite"].get("sides"))
    models = tuple(dict.fromkeys(settings["model"]))
    peers = tuple(peer.name for peer, reason in peers_in(plugins) if reason is None)
    used = [("models", name) for name in models or plugins.names("models")] + [("peers", name) for name in peers]
    versions = plugin_versions(used, plugins)
    return [SpeedCell(settings["suite"].get("name") or "speed", models, sides, versions, peers, this_machine())]


def mesh_sides(given: Any) -> tuple[int, ...]:
    """Nodes along each side of the sheets, each once."""
    if given is None:
        return SIDES
    sides = given if isinstance(given, list | tuple) else [given]
    if not sides:
        raise ClothbenchError("setting 'suite.sides' is empty; give numbers of nodes, for example [9,21]")
    return tuple(dict.fromkeys(whole("suite.sides", n, 5) for n in sides))


def this_machine() -> dict[str, str | int]:
    """What speed depends on beside versions: processor, cores, and how many threads a batch may use."""
    system = system_info()
    return {"cpu": system["cpu"], "cores": system["cores"], "threads": thread_count()}
