"""The cell of `improve`: one question to the loop, with a key that says all that its answer depends on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any, ClassVar

from clothbench import __version__
from clothbench.engine.cells import Source, digest, options_in_use
from clothbench.studies.improve.settings import LOOP


@dataclass(frozen=True)
class ImproveCell:
    """What does this model lack beside these recordings? Plain data; its key is the hash of everything here except
    where files lie.

    recordings: all of one kind, with their splits;
    kind: of them, "nodes", "curve" or "silhouette";
    model: name of its plugin;
    base: effects that belong to it from the start;
    candidates: effects that it may lack, in the order of trying;
    tracker: what makes observations of the recordings; None where there is nothing to track;
    optimizer: what fits;
    options: of these plugins, by the plugin's name;
    scene: areal_density, kg/m², where a recording does not know it (None: each has to), air_density, kg/m³, and
        resolution, nodes along the longer side of the mesh; empty where nothing is simulated on a mesh;
    bounds: of parameters, by name, in place of those that the plugins state;
    begins: where a search begins, by parameter, in place of the defaults;
    fixed: values of parameters that are not searched for, by name;
    seed: of all random draws;
    timeout: s after which no further round is begun; None: no limit;
    versions: "kind/name" → distribution and version of every plugin that it uses;
    split_by_seed: whether no recording states a split;
    suite: as the settings call it; case: the fabric, or the folder in which the recordings lie.
    """

    recordings: tuple[Source, ...]
    kind: str
    model: str
    base: tuple[str, ...]
    candidates: tuple[str, ...]
    tracker: str | None
    optimizer: str
    options: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    scene: Mapping[str, Any] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    begins: Mapping[str, float] = field(default_factory=dict)
    fixed: Mapping[str, float] = field(default_factory=dict)
    seed: int = 0
    timeout: float | None = None
    versions: Mapping[str, str] = field(default_factory=dict)
    split_by_seed: bool = False
    suite: str = "improve"
    case: str = ""

    study: ClassVar[str] = "improve"
    metric: ClassVar[str] = "rms_error"
    row_columns: ClassVar[Mapping[str, Any]] = {}
    budget: ClassVar[None] = None  # how many steps there are is known from stage to stage only
    counts: ClassVar[str] = "steps of its stage"
    value_word: ClassVar[str] = "of"

    @cached_property
    def key(self) -> str:
        """16 hexadecimal digits, the same on every machine for the same question."""
        question = asdict(self)
        question["recordings"] = [(s.name, s.hash, s.split) for s in self.recordings]
        question["options"] = options_in_use(question["options"], (name for _, name in self.plugins))
        for name in ("split_by_seed", "suite", "case"):  # the splits say it; a name changes no answer
            del question[name]
        for name in ("begins", "fixed"):
            if not question[name]:  # as cells were asked before there were any
                del question[name]
        return digest([question, asdict(LOOP), __version__])

    @property
    def plugins(self) -> list[tuple[str, str]]:
        """Every plugin that it uses, as (kind, name)."""
        single = [("models", self.model), ("optimizers", self.optimizer)]
        trackers = [("trackers", self.tracker)] if self.tracker else []
        return single + trackers + [("effects", name) for name in (*self.base, *self.candidates)]

    @property
    def effects(self) -> tuple[str, ...]:
        return self.base

    @property
    def cases(self) -> tuple[str, ...]:
        return (self.case,)

    @property
    def label(self) -> str:
        return " · ".join((self.case, "+".join((self.model, *self.base)), self.optimizer))

    def option(self, name: str) -> dict[str, Any]:
        return dict(self.options.get(name, {}))

    def of_split(self, split: str) -> list[Source]:
        return [source for source in self.recordings if source.split == split]
