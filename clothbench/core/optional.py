"""What a plugin may offer beyond what it must (`clothbench.core.protocols`): each optional part is a small protocol.

A part is there or it is not; what that means where it is not is said here too, in a function, so that nobody who asks
needs a default of his own. The conformance kit (`clothbench.testing`) looks at the parts that a plugin offers.

Options are no parts: they reach a plugin through its constructor. Those that the frame knows of, and sets where a
factory takes them (`takes_option`), are:

    dt          of a model: its time step [s]
    step_scale  of a model: multiplies the time step that it would choose
    resolution  of a model: nodes along (u, v), where the scene does not say
    start       of an optimizer: "defaults" leaves the first look around out and begins at the space's defaults
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np

from clothbench.core.camera import Camera
from clothbench.core.errors import ClothbenchError
from clothbench.core.folding import Folding
from clothbench.core.observation import Observation
from clothbench.core.protocols import Material, Model, Objective, Stated
from clothbench.core.rollout import Rollout
from clothbench.core.scene import Scene

# Of recordings that a tracker can read; in all but "laser" it finds a sheet, there a line on a strip.
TRACKED_KINDS = frozenset({"nodes", "points", "depth", "video", "silhouette", "laser"})
MODEL_KINDS = ("explicit", "implicit", "static", "")
FORCE_LAWS = ("normal velocity squared", "normal acceleration", "past normal velocity", "mass along the lower edge")
EFFECT_FAMILIES = (
    "air", "wind", "mass", "gravity", "stretch", "bending", "grip", "clamp", "clock", "camera", "load",
)  # fmt: skip

# --- of any plugin --------------------------------------------------------------------------------------------------


@runtime_checkable
class MayBeAbsent(Protocol):
    """A plugin that needs something else installed before it can do anything. Without it: it needs nothing."""

    @staticmethod
    def skip_reason() -> str | None:
        """What has to be installed, as a line for the user; None if all is there."""
        ...


@runtime_checkable
class BuiltOn(Protocol):
    """A plugin whose results depend on a library's version, which then is part of a cell's key.

    built_on: names of distributions; the first that is installed counts. Without it: on clothbench alone.
    """

    built_on: Sequence[str]


def absent(plugin: Any) -> str | None:
    """Why a plugin that loads cannot be used on this machine, if it says so: no fault of anybody."""
    return plugin.skip_reason() if isinstance(plugin, MayBeAbsent) else None


def libraries(plugin: Any) -> tuple[str, ...]:
    """The distributions that a plugin is built on, () if it names none."""
    if not isinstance(plugin, BuiltOn):
        return ()
    names = plugin.built_on
    if isinstance(names, str) or not isinstance(names, Sequence) or not all(isinstance(name, str) for name in names):
        raise ClothbenchError(f"built_on: found {names!r}, expected a tuple of distributions' names")
    return tuple(names)


def options_of(factory: Any) -> frozenset[str]:
    """Names of the options that a class or factory takes; none where it does not say, as some compiled ones do not."""
    try:
        return frozenset(inspect.signature(factory).parameters)
    except (TypeError, ValueError):
        return frozenset()


def defaults_of(factory: Any) -> dict[str, Any]:
    """The options of a class or factory that may be left out, with what they are then; none where it does not say."""
    try:
        stated = inspect.signature(factory).parameters.values()
    except (TypeError, ValueError):
        return {}
    return {p.name: p.default for p in stated if p.default is not p.empty and p.kind is not p.POSITIONAL_ONLY}


def takes_option(factory: Any, name: str) -> bool:
    """Whether a class or factory has an option of that name."""
    return name in options_of(factory)


# --- of a model -----------------------------------------------------------------------------------------------------


@runtime_checkable
class RefusesScenes(Protocol):
    """A model that cannot simulate every scene. Without it: it tries all, and `prepare` refuses what it cannot."""

    def skip(self, scene: Scene) -> str | None:
        """Why it cannot simulate this scene; None if it can. A cell is then skipped, which is no fault."""
        ...


@runtime_checkable
class KnowsMaterials(Protocol):
    """A model whose parameters can be said from textbook stiffnesses. Without it: most tests of mechanics skip it."""

    def of_material(self, material: Material, scene: Scene) -> np.ndarray:
        """Its parameters (P,) for a cloth of this material in this scene, damping that the material does not state as
        low as they go; or a ClothbenchError that says what it has no parameter for.
        """
        ...


@runtime_checkable
class SaysMaterials(Protocol):
    """A model that says which textbook material its parameters make. Without it: its fits cannot be exported."""

    def material_of(self, theta: np.ndarray, scene: Scene) -> Material:
        """The material that parameters theta (P,) make of a cloth in this scene; what a material has no place for, as
        the drag of the air, is left out.
        """
        ...


@runtime_checkable
class DocumentsUnits(Protocol):
    """A model whose parameters are another program's. Without it: they are worth what `material_of` says.

    documented: what that program's documentation makes of them, for `clothbench units` to hold against mechanics.
    """

    documented: Sequence[Stated]


@runtime_checkable
class StatesUnits(Protocol):
    """An exporter to what does not run here. Without it: `clothbench units` measures the model of the same name.

    units: by quantity, as of a `Stated`, what in the file stands for it, in the documented unit; documentation: where
    that is said; unmeasured: why it is not held against mechanics.
    """

    units: Mapping[str, str]
    documentation: str
    unmeasured: str


@runtime_checkable
class KnowsTextiles(Protocol):
    """A model that says what is to be searched for in a type of textile. Without it: all its parameters, everywhere.

    textiles: for each type ("soft", "medium", "stiff"), by parameter, a pair of bounds within which it is free, or the
    one value at which it is held; what is not named stays as the model has it.
    """

    textiles: Mapping[str, Mapping[str, float | tuple[float, float]]]


@runtime_checkable
class AnswersCurves(Protocol):
    """A model that answers force-extension curves, which it says with the capability "curve"."""

    def curve(self, stretch: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Tension (M,) N/m of width at stretches (M,), 1 = unstretched, for parameters theta (P,)."""
        ...


@runtime_checkable
class FoldsStrips(Protocol):
    """A model that folds strips on a desk, which it says with the capability "fold"."""

    def strip(self, length: float) -> Folding:
        """A strip `length` m long, ready to be lifted by one end."""
        ...


@runtime_checkable
class Refinable(Protocol):
    """A model with finer steps of its own making, beside or instead of the option `step_scale`."""

    def refined(self, factor: float) -> Model:
        """The same model with time steps `factor` times shorter."""
        ...


@runtime_checkable
class HasKind(Protocol):
    """How a model steps: kind is "explicit", "implicit" or "static". Without it: "", nobody knows.

    `improve` chooses the mesh by it, since implicit steps are dearer, and tables of speed show it.
    """

    kind: str


@runtime_checkable
class Repeatable(Protocol):
    """A model in which rounding, or a solver's tolerance, alone carries a sheet some way.

    repeatability: m; two motions are the same within it. Without it: 0.
    """

    repeatability: float


@runtime_checkable
class SaysWhatItLacks(Protocol):
    """lacks: by family of effects, what textbook mechanics has and the model has not, a line that ends a sentence.
    Where `improve` names an effect of that family, it says so: the model's own fault may look so. Without it: nothing.
    """

    lacks: Mapping[str, str]


@runtime_checkable
class HasBenchOptions(Protocol):
    """bench_options: sets of options that the speed is measured with. Without it: one set, empty; (): not measured."""

    bench_options: Sequence[Mapping[str, Any]]


@runtime_checkable
class StatesItsWork(Protocol):
    """work_per_node_step: what one node of one step takes, as "operations" (a multiplication and an addition are two),
    "roots" (and divisions) and "numbers" that are loaded or stored. Without it: its speed is held against no ceiling.
    """

    work_per_node_step: Mapping[str, float]


@runtime_checkable
class HasEqualErrorOptions(Protocol):
    """equal_error_options: sets of options that are tried for speed at equal error. Without it: one set, empty."""

    equal_error_options: Sequence[Mapping[str, Any]]


def why_skipped(model: Any, scene: Scene) -> str | None:
    """Why a model cannot simulate a scene, by its capabilities or if it says so."""
    if scene.velocity is not None and "moving_start" not in model.capabilities:
        return "the model starts from rest only, and the scene (scene.start=measured) from a motion that was seen"
    clamped = any(o.clamps for o in scene.obstacles)
    if (scene.outline is not None or clamped) and "outline" not in model.capabilities:
        return "the model simulates whole rectangles held by grips, and the scene has a cut or a clamped cloth"
    if scene.grips_carry and "carried_contact" not in model.capabilities:
        return "the model knows no obstacle that moves, and the grips of the scene carry one"
    if isinstance(model, RefusesScenes) and (reason := model.skip(scene)):
        return reason
    if any(not o.clamps for o in scene.obstacles) and "contact" not in model.capabilities:
        return "the model knows no contact, and the scene has an obstacle that the cloth cannot enter"
    if scene.thickness > 0 and "self_contact" not in model.capabilities:
        return "the model's layers pass through each other, and the scene gives them a thickness"
    return None


def textile_of(model: Any, textile: str | None) -> tuple[dict[str, tuple[float, float]], dict[str, float]]:
    """Bounds of the parameters that a type of textile leaves free, and values of those that it holds; nothing of a
    model that does not say, or where no type is stated.
    """
    told = model.textiles.get(textile, {}) if isinstance(model, KnowsTextiles) and textile else {}
    free = {name: (float(v[0]), float(v[1])) for name, v in told.items() if isinstance(v, tuple)}
    return free, {name: float(v) for name, v in told.items() if not isinstance(v, tuple)}


def kind_of_model(model: Any) -> str:
    """How it steps, one of `MODEL_KINDS`."""
    return model.kind if isinstance(model, HasKind) else ""


def repeatability_of(model: Any) -> float:
    """How far rounding and tolerances alone may carry a sheet [m]."""
    return model.repeatability if isinstance(model, Repeatable) else 0.0


def lacks_of(model: Any) -> Mapping[str, str]:
    """What a model is known to lack beside textbook mechanics, by family of effects."""
    return model.lacks if isinstance(model, SaysWhatItLacks) else {}


def bench_options_of(factory: Any) -> list[dict[str, Any]]:
    """Sets of options that the speed of a model is measured with."""
    return [dict(one) for one in factory.bench_options] if isinstance(factory, HasBenchOptions) else [{}]


def work_of(model: Any) -> Mapping[str, float] | None:
    """What one node of one step takes; None if the model does not say."""
    return model.work_per_node_step if isinstance(model, StatesItsWork) else None


def equal_error_options_of(factory: Any) -> list[dict[str, Any]]:
    """Sets of options that are tried for the speed of a model at equal error."""
    return [dict(one) for one in factory.equal_error_options] if isinstance(factory, HasEqualErrorOptions) else [{}]


# --- of a simulation ------------------------------------------------------------------------------------------------


@runtime_checkable
class RunsInThreads(Protocol):
    """threads: whether several simulations may run at the same time in threads of one process. Without it: no."""

    threads: bool


def runs_in_threads(simulation: Any) -> bool:
    return simulation.threads if isinstance(simulation, RunsInThreads) else False


# --- of an effect ---------------------------------------------------------------------------------------------------


@runtime_checkable
class Remembers(Protocol):
    """A dynamics effect whose kernels carry something from step to step. Without it: nothing."""

    def state_size(self, sheet: Any) -> int:
        """How many numbers it keeps for this sheet (`clothbench.Sheet`); they are 0 when a run begins."""
        ...


@runtime_checkable
class Stiffens(Protocol):
    """A dynamics effect that makes the cloth stiffer: models whose step depends on that then take a shorter one."""

    def stiffness(self, phi: np.ndarray) -> tuple[float, float]:
        """What it adds at most, for its parameters phi (P,): in-plane stiffness N/m and bending rigidity N·m."""
        ...


@runtime_checkable
class Lightens(Protocol):
    """A dynamics effect that may make the cloth lighter: models whose step depends on that then take a shorter one."""

    def lightest(self, phi: np.ndarray) -> float:
        """Least share of any node's stated mass that it leaves, for its parameters phi (P,); 1 if it takes none."""
        ...


@runtime_checkable
class Restrains(Protocol):
    """A dynamics effect that holds nodes, each by itself: explicit models then take steps that are short enough."""

    def restraint(self, phi: np.ndarray) -> tuple[float, float]:
        """What it adds at most, for its parameters phi (P,), to a node of the stated mass: to its squared angular
        frequency 1/s² and to its rate of damping 1/s.
        """
        ...


@runtime_checkable
class SaysNormals(Protocol):
    """normals: whether its kernels read `sheet.normal`, which nobody computes (NaN) if none does. Without it: yes."""

    normals: bool


@runtime_checkable
class SaysAtRest(Protocol):
    """at_rest: whether a dynamics effect has a say in where a sheet comes to rest, or remembers how it did. Without it:
    yes. Of one that says no, the same rest serves for all its amounts.
    """

    at_rest: bool


@runtime_checkable
class VariesByRecording(Protocol):
    """by_recording: names of its parameters that may well differ from one recording to the next, since each time
    something is set up, gripped or started anew. Without it: what is true of one recording is true of all.
    """

    by_recording: tuple[str, ...]


@runtime_checkable
class HasFamily(Protocol):
    """family: one of `EFFECT_FAMILIES`, which says what the effect is about: pages draw a small picture by it, and
    `improve` takes a force about "grip" for one of the boundary. Without it: "", and there is no picture.
    """

    family: str


@runtime_checkable
class FollowsLaw(Protocol):
    """law: one of `FORCE_LAWS`, what the effect's force goes with. Where the torques that recordings leave go with the
    same, without any model, `improve` asks no more of the effect than that it pays for its parameters, and keeps its
    name though much else is missing. Without it: "".
    """

    law: str


@runtime_checkable
class HasLimits(Protocol):
    """An effect that turns into something that models have of their own where its amounts leave their range: friction
    of yarns that never slip is stiffness. `improve` does not name it where that does nearly as well. Without it: never.
    """

    def limits(self, phi: np.ndarray) -> Mapping[str, np.ndarray]:
        """What it turns into, and its parameters (P,) there, the nearest to phi (P,); they may lie out of bounds."""
        ...


@runtime_checkable
class ShiftsTimes(Protocol):
    """A sensor effect that shifts when the simulation is looked at. One without it and `positions` does nothing."""

    def times(self, time: np.ndarray, phi: np.ndarray) -> np.ndarray:
        """When the simulation is looked at (T,) s for each stamp (T,) s; in their order; with `sights`, of pictures."""
        ...


@runtime_checkable
class ShiftsPositions(Protocol):
    """A sensor effect that shifts where points are seen."""

    def positions(self, time: np.ndarray, position: np.ndarray, points: np.ndarray, phi: np.ndarray) -> np.ndarray:
        """Where points (N, 2) m, truly at position (T, N, 3) m, are seen at the stamps (T,) s."""
        ...


@runtime_checkable
class ShiftsSight(Protocol):
    """A sensor effect of the camera in whose picture points are seen; of points in space it changes nothing."""

    def sights(self, time: np.ndarray, position: np.ndarray, camera: Camera, phi: np.ndarray) -> np.ndarray:
        """Where the camera takes points, truly at position (T, N, 3) m, to be at the stamps (T,) s."""
        ...


def varying_of(effect: Any) -> tuple[str, ...]:
    """Names of an effect's parameters that may differ from recording to recording, () if none may."""
    return tuple(effect.by_recording) if isinstance(effect, VariesByRecording) else ()


def family_of(effect: Any) -> str:
    """What an effect is about, one of `EFFECT_FAMILIES`; "" if it does not say."""
    return effect.family if isinstance(effect, HasFamily) else ""


def law_of_force(effect: Any) -> str:
    """What an effect's force goes with, one of `FORCE_LAWS`; "" if it does not say."""
    return effect.law if isinstance(effect, FollowsLaw) else ""


def limits_of(effect: Any, phi: np.ndarray) -> Mapping[str, np.ndarray]:
    """What an effect of parameters phi (P,) turns into that models have of their own, with its parameters there."""
    return effect.limits(phi) if isinstance(effect, HasLimits) else {}


def reads_normals(effect: Any) -> bool:
    return effect.normals if isinstance(effect, SaysNormals) else True


def acts_at_rest(effect: Any) -> bool:
    return effect.at_rest if isinstance(effect, SaysAtRest) else True


# --- of a tracker ---------------------------------------------------------------------------------------------------


@runtime_checkable
class ShowsSteps(Protocol):
    """A tracker that shows what its steps make of an image. Without it: a page has no pictures of them."""

    def pictures(self, source: Any, frame: int, seen: Observation) -> Mapping[str, np.ndarray]:
        """Pictures (H, W, 3) uint8, RGB, of one frame by the step's name, in order; seen: what `track` made of it."""
        ...


@runtime_checkable
class ReadsKinds(Protocol):
    """kinds: of recordings that a tracker reads, or that a metric compares with, where they are not sheets of points
    that are known again: "nodes", "points", "depth", "video", "silhouette", "laser". Without it: "nodes".
    """

    kinds: frozenset[str]


def kinds_read(plugin: Any) -> frozenset[str]:
    """The kinds of recordings that a tracker reads, or a metric compares with."""
    return frozenset(plugin.kinds) if isinstance(plugin, ReadsKinds) else frozenset({"nodes"})


# --- of a metric ----------------------------------------------------------------------------------------------------


@runtime_checkable
class HasObjectives(Protocol):
    """A metric that wants several things small at once. Without it: its value alone.

    objectives: what they are, in the order of `Score.objectives`; scalarisation: how its value is made of them, a line.
    """

    objectives: Sequence[Objective]
    scalarisation: str


@runtime_checkable
class HasInterval(Protocol):
    """A metric that knows how sure its value is. Without it: from blocks of the frames, as of a film."""

    def interval(self, observation: Observation, rollout: Rollout, seed: int) -> tuple[float, float]:
        """95 % interval of the value of the rollout's first member, in the metric's unit, or NaN and NaN."""
        ...


def objectives_of(metric: Any) -> tuple[Objective, ...]:
    """What a metric wants small beside its value; () where that is all."""
    return tuple(metric.objectives) if isinstance(metric, HasObjectives) else ()


# --- of an optimizer ------------------------------------------------------------------------------------------------


@runtime_checkable
class HasStart(Protocol):
    """start: (P,), where the walk set out from once a first look around was over, or None until then."""

    start: np.ndarray | None


@runtime_checkable
class Renewable(Protocol):
    """An optimizer that goes on when a new measurement has come. Without it: a new one begins at the estimate."""

    def renew(self) -> None:
        """Search again, from where it is."""
        ...


@runtime_checkable
class HasTemperature(Protocol):
    """An annealing optimizer. temperature_now: in the score's unit, by which what it asks for will be judged; NaN until
    it begins to cool.
    """

    temperature_now: float


def temperature_of(optimizer: Any) -> float | None:
    """How hot a search is; None for one that does not cool."""
    return float(optimizer.temperature_now) if isinstance(optimizer, HasTemperature) else None


def start_of(optimizer: Any) -> np.ndarray | None:
    """Where a walk set out from (P,); None before it has, and for optimizers that do not say."""
    return optimizer.start if isinstance(optimizer, HasStart) else None
