"""Where the loop stands, from round to round."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from clothbench.studies.improve.attribution import Probe
from clothbench.studies.improve.fitted import Fitted
from clothbench.studies.improve.law import Law
from clothbench.studies.improve.problem import Problem
from clothbench.studies.improve.selection import Candidate
from clothbench.studies.improve.torque import Balance


@dataclass(frozen=True, eq=False)
class Round:
    """One turn of the loop.

    before: the fit it began with;
    floor: of noise and mesh then, base unit;
    candidates: with what was tried of them;
    probes: of the candidates, for the next round; none in a finding;
    named: the effect that was named, and one that is tied with it, if any;
    after: the fit with the first of them;
    own: what is each recording's own of those that were named, by effect and recording; empty where amounts are shared;
    witnessed: whether it was named since the recordings say the same without any model.
    """

    before: Fitted
    floor: float
    candidates: tuple[Candidate, ...]
    probes: tuple[Probe, ...]
    named: tuple[str, ...]
    after: Fitted | None = None
    own: Mapping[str, Mapping[str, Fitted]] = field(default_factory=dict)
    witnessed: bool = False


@dataclass(frozen=True, eq=False)
class State:
    """Where the loop stands.

    problem: with the mesh's error taken away, where that is known;
    base: the calibrated model;
    final: the same with all that was named so far;
    noise: of the recordings, base unit;
    mesh: what the model's mesh changes that a refit does not take up, as far as first order tells, base unit: what
        decisions are made by;
    rounds: so far;
    alone: the base fitted to each recording by itself, by its name;
    earlier: where the loop stood before the last effect that was named with amounts for all recordings;
    balance: what the recordings say without any model, None where they say nothing so.
    """

    problem: Problem
    base: Fitted
    final: Fitted
    noise: float
    mesh: float
    rounds: tuple[Round, ...] = ()
    alone: Mapping[str, Fitted] = field(default_factory=dict)
    earlier: State | None = None
    balance: Balance | None = None

    @property
    def law(self) -> Law | None:
        """Of what acts on the sheet beside damping, told without any model."""
        return None if self.balance is None else self.balance.law

    @property
    def own(self) -> dict[str, Mapping[str, Fitted]]:
        """By effect and recording, the amounts in `final` that are each recording's own."""
        return {r.named[0]: r.own[r.named[0]] for r in self.rounds if r.own}

    @property
    def floor(self) -> float:
        """Of noise and mesh together, base unit."""
        return float(np.hypot(self.noise, self.mesh))

    @property
    def fine_enough(self) -> bool:
        """Whether what the mesh may be wrong by is less than the noise, so that a small residual says something."""
        return self.mesh_left(self.final) <= self.noise

    def mesh_left(self, fitted: Fitted) -> float:
        """What the mesh may be wrong by in a fit, base unit: no more than is left of it above the noise."""
        return min(self.mesh, float(np.sqrt(max(fitted.rms**2 - self.noise**2, 0.0))))
