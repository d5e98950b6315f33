"""What a plugin has to be. Each kind is a small protocol; a plain class that has the members is enough.

What it may offer beyond that is in `clothbench.core.optional`. Options reach every kind through its constructor.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np

from clothbench.core.brief import brief
from clothbench.core.observation import Observation
from clothbench.core.parameters import ParameterSpace
from clothbench.core.rollout import Rollout
from clothbench.core.scene import Scene


@dataclass(frozen=True, eq=False)
class Score:
    """How far a batch of B rollouts is from one observation.

    value: (B,) in `unit`, NaN for a member that could not be scored; per_frame: (B, T) and per_node: (B, N), the
    same quantity's trace and map in that unit, NaN where nothing was seen (None where the metric has none); the value
    is the mean of the trace or the like, as its interval comes from how the trace scatters;
    residual: (B, R), signed differences whose squares sum to what least squares should lower, or None.
    objectives: (B, M), of a metric with several (`HasObjectives`), each in its own unit, lower is better, or None;
    spread: (M,), how far apart recordings of the very same cloth lie in each of them: 1 on a common scale.
    """

    value: np.ndarray
    unit: str
    per_frame: np.ndarray | None = None
    per_node: np.ndarray | None = None
    residual: np.ndarray | None = None
    objectives: np.ndarray | None = None
    spread: np.ndarray | None = None

    __repr__ = brief


@dataclass(frozen=True)
class Objective:
    """One of several things that a metric wants small. unit: as in its scores; meaning: one line."""

    name: str
    unit: str
    meaning: str


@dataclass(frozen=True, eq=False)
class Evaluation:
    """What an optimizer is told: value (B,), lower is better, NaN = could not be computed; residual (B, R) or None;
    objectives: (B, M), of a metric with several, each in units of its spread, NaN where the value is; None of others.
    `value` is the metric's own scalarisation of them, for searches that take one number.
    """

    value: np.ndarray
    residual: np.ndarray | None = None
    objectives: np.ndarray | None = None

    __repr__ = brief


@runtime_checkable
class Simulation(Protocol):
    """A scene made ready: meshes built, kernels compiled.

    parameters: the model's, then those of each effect as `effect.parameter`. Optional: `RunsInThreads`.
    """

    parameters: ParameterSpace

    def run(self, theta: np.ndarray) -> Rollout:
        """Simulate the parameter sets theta (B, P), each in its parameter's unit, all at once."""
        ...


@dataclass(frozen=True)
class Material:
    """An elastic cloth as textbooks state it, for tests that have an analytic answer.

    bending: rigidity D [N·m]; stretch: tensile stiffness [N/m], infinite where nothing stretches; shear: shear
    stiffness [N/m]; bending_damping [N·m·s] and stretch_damping [N·s/m]: viscosity, a moment per rate of curvature and
    a tension per rate of strain. No cross contraction. bending_ratio, stretch_ratio: what the warp, along u, has over
    the weft, along v; of both, bending and stretch are then the geometric means, and damping is in proportion.
    """

    bending: float
    stretch: float
    shear: float
    bending_damping: float = 0.0
    stretch_damping: float = 0.0
    bending_ratio: float = 1.0
    stretch_ratio: float = 1.0

    def along(self, quantity: str) -> tuple[float, float]:
        """The "bending" [N·m] or "stretch" [N/m] along warp and weft."""
        mean, root = getattr(self, quantity), math.sqrt(getattr(self, f"{quantity}_ratio"))
        return mean * root, mean / root

    @property
    def alike(self) -> Material:
        """The cloth that has the means along both."""
        return dataclasses.replace(self, bending_ratio=1.0, stretch_ratio=1.0)


@dataclass(frozen=True)
class Stated:
    """What a simulator's documentation says of its parameters.

    quantity: of `Material`, in its unit; formula: of parameters with the units that are documented; worth: what that
    makes of parameters theta (P,), in SI; source: where it is said.
    """

    quantity: str
    formula: str
    worth: Callable[[np.ndarray], float]
    source: str


@runtime_checkable
class Model(Protocol):
    """A cloth model. Made by calling the registered attribute with its options as keywords.

    Optional: `MayBeAbsent`, `BuiltOn`, `RefusesScenes`, `KnowsMaterials`, `SaysMaterials`, `Refinable`, `HasKind`,
    `Repeatable`, `HasBenchOptions`, `HasEqualErrorOptions`, `StatesItsWork`; by capability `AnswersCurves`,
    `FoldsStrips`.
    capabilities: "dynamic" (moves), "static" (finds rest), "effects" (takes them), "contact" (keeps out of the
    scene's obstacles), "self_contact" (keeps the scene's `thickness` between its own layers), "curve" (answers
    force-extension curves; with that alone, `prepare` refuses every scene), "fold" (folds strips on a desk, and says
    with which forces), "moving_start" (goes on from the motion that a scene states, instead of from rest),
    "outline" (cuts its mesh along the scene's outline, and holds what a disc clamps), "carried_contact" (keeps out of
    obstacles that the grips carry along, too).
    """

    name: ClassVar[str]
    version: ClassVar[int]
    parameters: ParameterSpace
    capabilities: ClassVar[frozenset[str]]  # of the ten above

    def prepare(self, scene: Scene, effects: Sequence[Effect] = ()) -> Simulation: ...


@runtime_checkable
class Effect(Protocol):
    """Physics a model may lack, in one of three places. At least one parameter has a null value, and where all
    that have one are at it, the effect vanishes to the bit, whatever the others are.

    place "dynamics": has `force` and/or `inertia`, compiled with `clothbench.effect_kernel`:
        force(t, dt, x, v, f, sheet, p, state)       adds nodal forces [N] to f (3, n)
        inertia(t, dt, x, v, mass, sheet, p, state)  adds to each node's mass tensor [kg], mass (6, n) as
                                                     xx, yy, zz, yz, xz, xy; what it weighs is for `force` to add
      with x (3, n) m, v (3, n) m/s, `sheet` (clothbench.Sheet), p this effect's parameters in order, and
      state (S,) kept from step to step. Optional: `Remembers` (else S = 0), `Stiffens`, `Lightens`, `Restrains`,
      `SaysNormals`; and in any place `VariesByRecording`.
    place "boundary": has `grips(time (K,), position (K, G, 3), phi (P,)) -> position`.
    place "sensor": is `ShiftsTimes` and/or `ShiftsPositions`.
    An effect that takes part in force-extension curves, there only or there too, has one method more, by its place:
    `curve(stretch (M,), phi) -> tension (M,)` N/m, `clamped(stretch, phi) -> stretch`, or
    `weighed(stretch, force (M,) N, phi) -> force`; `clothbench.modelling.curves` says what becomes of it.
    """

    name: ClassVar[str]
    version: ClassVar[int]
    place: ClassVar[str]
    summary: ClassVar[str]
    parameters: ParameterSpace


@runtime_checkable
class Metric(Protocol):
    """Compares an observation with a batch of rollouts; lower is better."""

    name: ClassVar[str]
    version: ClassVar[int]
    unit: str

    def __call__(self, observation: Observation, rollout: Rollout) -> Score: ...

    def floor(self, observation: Observation) -> float:
        """The value that noise alone would give a perfect model, in `unit`; NaN if the noise is not known."""
        ...


@runtime_checkable
class Optimizer(Protocol):
    """A search. Made by `factory(space, seed=…, budget=…, **settings)`; it never owns the loop.

    The caller alternates `ask` and `tell` until `done`; `stopped` then says why. All points asked lie within the
    space's bounds, and all together they are no more than the budget: there the caller stops, too. `needs_residual`
    says that `Evaluation.residual` is wanted. Optional: `HasStart`, `Renewable`, and the option `start="defaults"`,
    which repeated fits need.
    """

    name: ClassVar[str]
    version: ClassVar[int]
    needs_residual: ClassVar[bool]
    done: bool
    stopped: str

    def ask(self) -> np.ndarray:
        """The next parameter sets (B, P), each in its parameter's unit."""
        ...

    def tell(self, theta: np.ndarray, evaluation: Evaluation) -> None: ...


@runtime_checkable
class Tracker(Protocol):
    """Turns raw sensor data into an observation. Made by calling the registered attribute with its options."""

    name: ClassVar[str]
    version: ClassVar[int]

    def track(self, source: Any) -> Observation:
        """What is seen in `source`: a recording, or the path of a file that the tracker knows how to read.

        A noise that the recording states (`noise_sigma`) goes before one that the tracker judges, and an option of the
        tracker's own before both; where `sigma` is NaN, the stated one is taken.
        """
        ...
