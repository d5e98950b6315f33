"""Where the loop stands, from round to round."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from clothbench.studies.improve.attribution import Probe
from clothbench.studies.improve.fitted import Fitted
from clothbench.studies.improve.problem import Problem
from clothbench.studies.improve.selection import Candidate


@dataclass(frozen=True, eq=False)
class Round:
    """One turn of the loop.

    before: the fit it began with;
    floor: of noise and mesh then, base unit;
    candidates: with what was tried of them;
    probes: of the candidates, for the next round; none in a finding;
    named: the effect that was named, and one that is tied with it, if any;
    after: the fit with the first of them.
    """

    before: Fitted
    floor: float
    candidates: tuple[Candidate, ...]
    probes: tuple[Probe, ...]
    named: tuple[str, ...]
    after: Fitted | None = None


@dataclass(frozen=True, eq=False)
class State:
    """Where the loop stands.

    problem: with the mesh's error taken away, where that is known;
    base: the calibrated model;
    final: the same with all that was named so far;
    noise, floor: of the noise, and of noise and mesh, base unit;
    rounds: so far;
    alone: the base fitted to each recording by itself, by its name.
    """

    problem: Problem
    base: Fitted
    final: Fitted
    noise: float
    floor: float
    rounds: tuple[Round, ...] = ()
    alone: Mapping[str, Fitted] = field(default_factory=dict)
