"""The cell: one point of a suite's product, with a key that says all that its result depends on."""

from __future__ import annotations

import dataclasses
import itertools
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from clothbench.core.errors import ClothbenchError, known_names
from clothbench.core.observation import Observation
from clothbench.core.optional import absent, options_of, takes_option, why_skipped
from clothbench.core.parameters import ParameterSpace
from clothbench.core.protocols import Effect, Metric
from clothbench.engine.cells import Skipped, Source, digest, options_in_use, seed_of
from clothbench.engine.settings import parameters_of_all
from clothbench.engine.store import Store
from clothbench.estimation.fixed import holding
from clothbench.estimation.placements import joined
from clothbench.estimation.prior import begun
from clothbench.estimation.trials import Trial
from clothbench.estimation.watched import require_comparable, require_readable, watched
from clothbench.modelling.curves import needs_a_picture
from clothbench.modelling.joined import JoinedParameters
from clothbench.plugins.discovery import OWN, Catalogue, PluginBroken
from clothbench.recordings.kinds import read_sheet
from clothbench.recordings.nodes import Recording
from clothbench.recordings.points import PointCloud
from clothbench.recordings.scenes import areal_density_of, scenes_of
from clothbench.recordings.silhouette import Silhouettes
from clothbench.studies.calibration.schema import PARAMETER, QUESTION


@dataclass(frozen=True)
class CalibrationCell:
    """One calibration to do: these recordings, this model with these effects, this optimizer, this metric.

    Plain data: it travels to worker processes, and its key is the hash of everything here except where files lie.
    fixed: parameters that are not searched for, with their values; analysis: what else is asked of the fit, by name;
    rivals: other fabrics' recordings of the same trials, which these parameters are held against; published: figures
    of a paper by metric and name, in the metric's unit, to stand beside the results; choice: which of the front is
    the fit, where the metric has several objectives; start: where a search that begins somewhere begins, by parameter;
    finer: {"spacing" [m], "share"}, the mesh that the last share of the search goes on with, and is judged on.
    """

    suite: str
    case: str
    recordings: tuple[Source, ...]
    model: str
    effects: tuple[str, ...]
    optimizer: str
    metric: str
    tracker: str
    report: tuple[str, ...] = ()
    options: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    scene: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    budget: int = 400
    seed: int = 0
    timeout: float | None = None
    fixed: Mapping[str, float] = field(default_factory=dict)
    analysis: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    rivals: tuple[Source, ...] = ()
    published: Mapping[str, Mapping[str, float | str]] = field(default_factory=dict)
    choice: str = "nearest"
    start: Mapping[str, float] = field(default_factory=dict)
    finer: Mapping[str, float] = field(default_factory=dict)

    study: ClassVar[str] = "calibration"
    counts: ClassVar[str] = "evaluations"
    value_word: ClassVar[str] = "best"

    @cached_property
    def key(self) -> str:
        """16 hexadecimal digits, the same on every machine for the same question."""
        question = asdict(self)
        question["recordings"] = sorted((s["hash"], s["split"]) for s in question["recordings"])
        question["options"] = options_in_use(question["options"], self._plugins())
        question["rivals"] = sorted(s["hash"] for s in question["rivals"])
        if question["choice"] == "nearest":
            del question["choice"]
        for name in (
            "fixed",
            "analysis",
            "rivals",
            "published",
            "start",
            "finer",
        ):  # cells that have none keep the key they had before there were any
            if not question[name]:
                del question[name]
        return digest(question)

    @cached_property
    def settings(self) -> str:
        """6 hexadecimal digits of how it is run, whatever it is run on and with whatever versions."""
        how = {name: getattr(self, name) for name in ("bounds", "scene", "budget", "tracker")}
        how["options"] = options_in_use(self.options, self._plugins())
        later: dict[str, Any] = {name: dict(getattr(self, name)) for name in ("fixed", "start", "finer")}
        later["timeout"] = self.timeout
        how |= {name: value for name, value in later.items() if value}  # digests without them are as they were
        if self.choice != "nearest":
            how["choice"] = self.choice
        return digest(how, 6)

    @property
    def judged(self) -> Mapping[str, Any]:
        """Settings of the scene that the result is judged in: with the finer mesh, where the search ends on one."""
        return {**self.scene, "spacing": self.finer["spacing"]} if self.finer else self.scene

    @property
    def row_columns(self) -> Mapping[str, Any]:
        return {"budget": self.budget, "settings": self.settings}

    def _plugins(self) -> set[str]:
        return {self.model, self.optimizer, self.metric, self.tracker, *self.effects, *self.report}

    @property
    def cases(self) -> tuple[str, ...]:
        """The cases of its rows."""
        return (self.case,)

    @property
    def label(self) -> str:
        effects = "".join(f"+{e}" for e in self.effects)
        return f"{self.case} · {self.model}{effects} · {self.optimizer} · {self.metric}"

    def stream(self, purpose: str, search: bool = True) -> int:
        """A seed of its own for each purpose, hashed from the problem: no generator is shared.

        Versions and further metrics do not count, so that a new release searches the same way as the one before.
        search: whether the cell's search counts; without, cells that differ in optimizer, seed or budget draw alike.
        """
        names = ("case", "model", "effects", "metric", "bounds", *(("optimizer", "seed", "budget") if search else ()))
        problem = {name: getattr(self, name) for name in names}
        problem["recordings"] = sorted((s.hash, s.split) for s in self.recordings)
        return seed_of(problem, purpose)

    def option(self, name: str) -> dict[str, Any]:
        return dict(self.options.get(name, {}))


def asked(cell: CalibrationCell) -> str:
    """The cell as JSON text, of which `asked_again` makes it anew."""
    return json.dumps(asdict(cell), sort_keys=True)


def asked_again(text: str) -> CalibrationCell:
    """The cell that `asked` wrote; a text that is none raises a ClothbenchError, one line."""
    try:
        told = json.loads(text)
        for name in ("recordings", "rivals"):
            told[name] = tuple(Source(**source) for source in told[name])
        for name in ("effects", "report"):
            told[name] = tuple(told[name])
        told["bounds"] = {name: (pair[0], pair[1]) for name, pair in told["bounds"].items()}
        if told["scene"].get("resolution") is not None:
            told["scene"]["resolution"] = tuple(told["scene"]["resolution"])
        return CalibrationCell(**told)
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, RecursionError) as fault:
        raise ClothbenchError(
            f"found no question of a calibration ({type(fault).__name__} {fault}); {AGAIN}"
        ) from fault


AGAIN = "run it again with this version"


def asked_and_fitted(store: Store, key: str) -> tuple[CalibrationCell, list[dict[str, Any]]]:
    """What a finished cell was asked, and the rows of the parameters that were found.

    Raises a ClothbenchError, one line, where there is no fit.
    """
    questions, fitted = (
        store.table(name, [key], of) for name, of in (("question", QUESTION), ("parameters", PARAMETER))
    )
    if not questions or not fitted:
        why = next((row["reason"] for row in store.rows([key]) if row["reason"]), "it is of another kind, or older")
        raise ClothbenchError(f"cell {key}: found no fit ({why}); {AGAIN}")
    if any(row["name"] is None or row["value"] is None for row in fitted):
        raise ClothbenchError(f"cell {key}: found a parameter without name or value, expected both; {AGAIN}")
    return asked_again(questions[0]["question"]), fitted


def uses(cell: CalibrationCell) -> list[tuple[str, str]]:
    """Every plugin a cell uses, as (kind, name)."""
    single = [("models", cell.model), ("optimizers", cell.optimizer), ("trackers", cell.tracker)]
    metrics = [("metrics", name) for name in (cell.metric, *cell.report)]
    return single + metrics + [("effects", name) for name in cell.effects]


def options_for(cell: CalibrationCell, plugins: Catalogue, kind: str, name: str) -> dict[str, Any]:
    """What the settings say to one plugin of a cell. Two of different kinds may bear one name, as the metric and the
    tracker `drape` do: each gets what it knows. What neither knows goes to both, which refuse it.
    """
    given = cell.option(name)
    others = {k for k, n in uses(cell) if n == name and k != kind}
    if not given or not others:
        return given
    own = options_of(plugins.load(kind, name))
    theirs = {option for other in others for option in options_of(plugins.load(other, name))}
    return {option: value for option, value in given.items() if option in own or option not in theirs}


@dataclass(frozen=True, eq=False)
class Bench:
    """A cell with its plugins made and its recordings read: all that is needed to calibrate and to score."""

    cell: CalibrationCell
    space: ParameterSpace
    recordings: tuple[Recording | PointCloud | Silhouettes, ...]
    trials: tuple[Trial, ...]
    others: tuple[Metric, ...]
    remake: Callable[[Any, float | None], Trial]  # (recording, kg/m²) as another trial of this bench

    def of_split(self, split: str) -> list[Trial]:
        return [t for t, s in zip(self.trials, self.cell.recordings, strict=True) if s.split == split]


class Names(NamedTuple):
    """Names of a cell's parameters: of those that it searches, and of all."""

    free: set[str]
    all: set[str]


def rehearse(cell: CalibrationCell, plugins: Catalogue, recordings: Mapping[str, Any]) -> Names | None:
    """Make everything once without simulating: what the user got wrong in the settings comes to light before a run.

    `recordings` by path. A plugin that is broken, or fails in a way that is not the user's, is left to its own cell's
    error row; so is every stranger's plugin, whose code may take this process down with it, and then all other cells.
    Returns the names of the cell's parameters; None where they are not known.
    """
    try:
        mine = [recordings[s.path] for s in cell.recordings]
        for recording, name in itertools.product(mine, (cell.metric, *cell.report)):
            require_comparable(recording, name, plugins)
        for recording in mine:
            require_readable(recording, cell.tracker, plugins)
            if not isinstance(recording, Recording):
                areal_density_of(recording, cell.scene.get("areal_density"))
        # Other images have to be tracked first.
        simulated = [r for r in mine if isinstance(r, Recording | PointCloud | Silhouettes)]
        scenes = [scene for recording in simulated for scene in scenes_of(recording, **cell.scene)]
        strangers = {pair for pair in uses(cell) if plugins.find(*pair).distribution != OWN}
        if ("trackers", cell.tracker) not in strangers:
            tracker = plugins.make("trackers", cell.tracker, **options_for(cell, plugins, "trackers", cell.tracker))
            if isinstance(mine[0], Recording | PointCloud):  # images are tracked when the cell is run
                tracker.track(mine[0])
        for name in (cell.metric, *cell.report):
            if ("metrics", name) not in strangers:
                plugins.make("metrics", name, **options_for(cell, plugins, "metrics", name))
        if any(kind in ("models", "effects") for kind, _ in strangers):
            return None
        effects = [plugins.make("effects", name) for name in cell.effects]
        if simulated:
            refuse_unseen(effects, [scene.camera is not None for scene in scenes])
        model = plugins.make("models", cell.model, **cell.option(cell.model))
        try:
            simulation: Any = (
                model.prepare(scenes[0], effects) if scenes else JoinedParameters(model.parameters, tuple(effects))
            )
            everything = set(simulation.parameters.names)
        except Exception:  # a model may refuse a scene; in a product of several that is its own cell's affair
            return None
        space = begun(bounded(holding(simulation, cell.fixed).parameters, cell.bounds), cell.start)
        if ("optimizers", cell.optimizer) not in strangers:
            options = cell.option(cell.optimizer)
            plugins.make("optimizers", cell.optimizer, space, seed=0, budget=cell.budget, **options)
            refuse_without_start(cell, plugins)
        return Names(set(space.names), everything)
    except PluginBroken:
        return None
    except ClothbenchError:
        raise
    except Exception:
        return None


def refuse_unseen(effects: Sequence[Effect], pictures: Sequence[bool]) -> None:
    """An effect of a camera's picture where no recording was seen in one: whatever is found for it means nothing.

    pictures: of each scene, whether its points were seen in a picture.
    """
    if not any(pictures) and (blind := next((e.name for e in effects if needs_a_picture(e)), None)):
        raise ClothbenchError(
            f"setting 'effects': {blind!r} acts on points that were seen in a camera's picture, and these recordings "
            "have places in space; take it out"
        )


def refuse_without_start(cell: CalibrationCell, plugins: Catalogue) -> None:
    """A search that cannot begin where another ended cannot go on on a finer mesh, nor without an evaluation there."""
    if cell.finer and cell.budget < 2:
        raise ClothbenchError(
            f"setting 'budget' is {cell.budget}, expected at least 2 evaluations, one on each mesh; or leave finer out"
        )
    if cell.finer and not takes_option(plugins.load("optimizers", cell.optimizer), "start"):
        raise ClothbenchError(
            f"setting 'finer': optimizer {cell.optimizer!r} cannot begin at a given start; choose one that has the "
            "option start (see `clothbench plugins`), or leave finer out"
        )


def bounded(space: ParameterSpace, bounds: Mapping[str, tuple[float, float]]) -> ParameterSpace:
    """The space with those of the bounds that are of its parameters: others are of other models of the same product."""
    return space.bounded({name: pair for name, pair in bounds.items() if name in space.names})


def refuse_misspelled(
    cell: CalibrationCell, model: Any, effects: Sequence[Effect], free: ParameterSpace, plugins: Catalogue
) -> None:
    """Effects without their parameters in the simulation, which would be named in vain; and bounds or fixed values of
    parameters that no installed plugin has, where the plan could not tell.
    """
    of_effects = {name for effect in effects for name in effect.parameters.prefixed(effect.name).names}
    if lost := sorted(of_effects - {*free.names, *cell.fixed}):
        raise ClothbenchError(
            f"model {cell.model!r}: its simulation has no parameter {lost[0]!r}, expected those of every effect that "
            "it is given"
        )
    here = {*free.names, *model.parameters.names, *of_effects}
    asked = [*(("bounds", name) for name in cell.bounds), *(("suite.fixed", name) for name in cell.fixed)]
    if not here.issuperset(name for _, name in asked):  # those of other models are made, to see whether they are meant
        here |= parameters_of_all(plugins)
    for key, name in asked:
        if name not in here:
            raise ClothbenchError(f"setting '{key}': no parameter {name!r}; {known_names(name, free.names)}")


def set_up(cell: CalibrationCell, plugins: Catalogue, kept: Path | None = None) -> Bench:
    """Make the plugins, read and track the recordings, and prepare one simulation for each.

    kept: folder for what trackers make of images, None: nothing is kept.
    """
    if reason := absent(plugins.load("models", cell.model)):
        raise Skipped(reason)
    model = plugins.make("models", cell.model, **cell.option(cell.model))
    if cell.effects and "effects" not in model.capabilities:
        raise Skipped(f"the model takes no effects, and the cell is to have {', '.join(cell.effects)}")
    effects: list[Effect] = [plugins.make("effects", name) for name in cell.effects]
    metric = plugins.make("metrics", cell.metric, **options_for(cell, plugins, "metrics", cell.metric))
    tracker = plugins.make("trackers", cell.tracker, **options_for(cell, plugins, "trackers", cell.tracker))
    names = {source.hash: source.name for source in cell.recordings}

    def make(recording: Recording | PointCloud | Silhouettes, areal_density: float | None = None) -> Trial:
        if recording.hash not in seen:  # of another case, which the fit is held against
            recording = looked_at(recording)
        scenes = scenes_of(recording, **cell.judged)
        pictures.extend(scene.camera is not None for scene in scenes)
        if areal_density is not None:
            scenes = [dataclasses.replace(scene, areal_density=areal_density) for scene in scenes]
        if reason := next(filter(None, (why_skipped(model, scene) for scene in scenes)), None):
            raise Skipped(reason)
        simulation = joined([holding(model.prepare(scene, effects), cell.fixed) for scene in scenes])
        return Trial(names.get(recording.hash, recording.name), seen[recording.hash], simulation, metric)

    def looked_at(raw: Any) -> Recording | PointCloud | Silhouettes:
        if isinstance(raw, Silhouettes):
            require_readable(raw, cell.tracker, plugins)
            seen[raw.hash] = tracker.track(raw)
            return raw
        recording, observation = watched(raw, tracker, cell.option(cell.tracker), plugins, kept)
        seen[recording.hash] = observation
        return recording

    recordings: list[Recording | PointCloud | Silhouettes] = []
    pictures: list[bool] = []
    seen: dict[str, Observation] = {}
    trials = []
    for source in cell.recordings:
        raw = read_sheet(source.file)
        if raw.hash != source.hash:
            raise ClothbenchError(f"{source.path}: changed on disk since the suite was planned; run it again")
        recordings.append(recording := looked_at(raw))
        trials.append(make(recording))
    refuse_unseen(effects, pictures)
    refuse_misspelled(cell, model, effects, trials[0].simulation.parameters, plugins)
    space = begun(bounded(trials[0].simulation.parameters, cell.bounds), cell.start)
    others = tuple(
        plugins.make("metrics", name, **options_for(cell, plugins, "metrics", name))
        for name in cell.report
        if name != cell.metric
    )
    return Bench(cell, space, tuple(recordings), tuple(trials), others, make)
