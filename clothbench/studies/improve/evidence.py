"""Evidence: recordings as residuals with a unit. All that the loop has to know of what was measured.

The loop's arithmetic works on residual vectors (M,), simulated minus measured, in the SI unit that the evidence states.
What they are of (node positions, forces over stretch), how chance would scramble them, whether a finer mesh changes
them, and which tables show them is said here, once for each kind: `sheets`, `curves` and `drapes`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, Self

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.optional import why_skipped
from clothbench.core.protocols import Effect, Model, Simulation
from clothbench.core.scene import Scene
from clothbench.estimation.fixed import holding
from clothbench.estimation.trials import Trial
from clothbench.studies.improve.settings import SearchSettings
from clothbench.studies.improve.torque import Balance

Rows = list[dict[str, Any]]
Surrogate = Callable[[np.random.Generator], np.ndarray]  # draws one residual (M,) that chance could have made


@dataclass(frozen=True)
class Unit:
    """Of residuals and errors.

    base: SI, what residuals are in;
    reported: what errors are reported in;
    scale: how many of the latter one of the former is.
    """

    base: str
    reported: str
    scale: float


@dataclass(frozen=True, eq=False)
class Comparison:
    """One recording beside the model before the loop and after.

    case: the recording;
    before, after: what the sensor would see of the model, positions (T, N, 3) m or forces (M,) N, NaN from where on a
        run was stopped;
    residual_before, residual_after: (M,) simulated minus measured, in the base unit, the mesh's own error taken away.
    """

    case: Any
    before: np.ndarray
    after: np.ndarray
    residual_before: np.ndarray
    residual_after: np.ndarray


class Case(Protocol):
    """One recording, ready to be compared with a model."""

    @property
    def name(self) -> str: ...

    @property
    def split(self) -> str:
        """ "fit" or "held_out"."""
        ...

    @property
    def duration(self) -> float:
        """s, of what was seen; infinite where no time is known of it."""
        ...

    @property
    def last_moment(self) -> float:
        """s, as effects count, at which what was seen ends; infinite where no time is known of it."""
        ...

    def trial(self, model: Model, effects: Sequence[Effect], correction: np.ndarray | None) -> Trial:
        """The recording with its simulation, whose metric has residuals (B, M) in the base unit.

        correction: (M,), added to the residual: what is known of the error of the mesh.
        """
        ...

    def simulated(self, rollout: Any) -> np.ndarray:
        """What the sensor would see of the first member of a rollout of that simulation."""
        ...

    def moved(self, way: float, speed: float) -> Self | None:
        """The same with its motion so many times as far and as fast; None where nothing moves it."""
        ...

    def surrogates(self, residual: np.ndarray, spread: bool = False) -> Surrogate:
        """Draws of the residual (M,) out of step with the model but with its own correlation (surrogate data).

        spread: for effects whose amounts are each recording's own; what stays then has no say in where on the cloth it
        is.
        """
        ...

    def peak(self, residual: np.ndarray) -> str:
        """Where along the recording most of a residual (M,) is: "2.5 s", "a stretch of 1.20"."""
        ...


class Evidence(Protocol):
    """The recordings of a run, all of one kind."""

    @property
    def kind(self) -> str:
        """As recording files state it: "nodes", "curve" or "silhouette"."""
        ...

    @property
    def unit(self) -> Unit: ...

    @property
    def search(self) -> SearchSettings: ...

    @property
    def cases(self) -> Sequence[Case]: ...

    @property
    def in_pictures(self) -> bool:
        """Whether points were seen in a camera's picture, which effects of the camera act on."""
        ...

    @property
    def has_rerun(self) -> bool:
        """Whether there is something to be seen in Rerun."""
        ...

    @property
    def noise_stated(self) -> bool | None:
        """Whether all fit recordings state the noise; None where it is the spread between runs or specimens."""
        ...

    @property
    def textile(self) -> str | None:
        """The type of textile, by which a model says what is to be searched for; None: all its parameters."""
        ...

    def restricted(self, cases: Sequence[Any]) -> Self:
        """The same with some of the cases only."""
        ...

    def refined(self) -> Self | None:
        """The same with cells of half the size; None where nothing is discretised."""
        ...

    def relaid(self) -> Sequence[Self]:
        """The same with other choices of what chance decides in a simulation, as of first shapes; none where nothing
        is left to chance.
        """
        ...

    def noise(self) -> float:
        """σ of one element of a residual, base unit, over the fit recordings."""
        ...

    def repeat_spread(self, residual: Sequence[np.ndarray]) -> float:
        """σ by which fit recordings that repeat each other differ, base unit, from what a fit leaves of each, (M,);
        0 where none repeats another, or the noise is that spread already.
        """
        ...

    def objection(self, before: Sequence[np.ndarray], after: Sequence[np.ndarray], least: float = 0.0) -> str:
        """Why no effect can be concluded from what a fit with it leaves of the fit recordings (M,) beside what the fit
        before left, by identities that no model's fault can touch; "" if there is nothing against it. least: share of
        their squares that it has to explain, if more than usual.
        """
        ...

    def balance(self, seed: int) -> Balance | None:
        """What acts on what was measured from outside, beside damping, told from the fit recordings without any model;
        None where nothing can be told.
        """
        ...

    def whereabouts(self, residual: Sequence[np.ndarray], seed: int) -> Rows:
        """Where and when there is more than elsewhere of what a fit leaves of the fit recordings, beside chance: rows
        of the table `whereabouts`; none where there is no where.
        """
        ...

    def location(self, residual: Sequence[np.ndarray]) -> str:
        """Where most of what a fit leaves of the fit recordings is, as a clause; "" where there is no where."""
        ...

    def tables(self, comparisons: Sequence[Comparison]) -> Mapping[str, Rows]:
        """Rows of the tables that only this kind of evidence has."""
        ...


def of_split(evidence: Evidence, split: str) -> list[Case]:
    return [case for case in evidence.cases if case.split == split]


def prepared(model: Model, scene: Scene, effects: Sequence[Effect], where: str) -> Simulation:
    """The scene, ready to be simulated; one that the model says it cannot simulate is refused. where: its recording."""
    if reason := why_skipped(model, scene):
        raise ClothbenchError(f"{where}: model {model.name!r}: {reason}; leave it out, or take another model")
    return model.prepare(scene, effects)


def without_switches(simulation: Simulation, own: int) -> Simulation:
    """Physics of the first `own` parameters, the model's, that can be switched off, is: it is for the loop to find."""
    return holding(simulation, {p.name: p.null for p in simulation.parameters.parameters[:own] if p.null is not None})
