"""All that the loop found out: document, tables, page and Rerun files are made from this alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from clothbench.studies.improve.evidence import Comparison, Evidence
from clothbench.studies.improve.fitted import Fitted
from clothbench.studies.improve.law import Law
from clothbench.studies.improve.state import Round
from clothbench.studies.improve.torque import Balance


@dataclass(frozen=True)
class Note:
    """What an effect says of itself: where it acts, a summary, and what it is about ("" if it does not say)."""

    place: str
    summary: str
    family: str = ""


@dataclass(frozen=True)
class Placebo:
    """An effect that nothing speaks for, fitted all the same: it must not help on held-out recordings.

    name: of the effect;
    errors: rms of each held-out recording with it, base unit.
    """

    name: str
    errors: tuple[float, ...]


@dataclass(frozen=True)
class Description:
    """The law of a force that no effect has a name for. before, after: error without and with it, on the recordings
    held out, base unit; where there are none, nothing is described.
    """

    law: Law
    before: float
    after: float


@dataclass(frozen=True, eq=False)
class Finding:
    """What a run of the loop came to. Errors are rms in the evidence's base unit; NaN is a run that was stopped.

    key: of the cell that asked;
    model, base, seed: what was asked about: the model's name, the effects that belong to it, the seed of the draws;
    evidence: the recordings as they were compared;
    verdict: "complete", "attributed", "tied" or "unexplained";
    hint: what the reader may want to know or do next;
    noise: of the recordings;
    mesh: what the model's mesh may still be wrong by;
    unexplained: what is left above the floor; 0 of what is no more than noise and mesh account for;
    calibrated: the fit of the base;
    final: the fit that the verdict stands by, with what was named, or the calibrated one;
    rounds: of the loop, in turn;
    dropped: why what was named in the rounds is no finding after all, or "";
    notes: of every candidate, by name;
    alone: the base fitted to each recording by itself, by its name;
    held_out: (recording, error before, error after) of every held-out recording;
    placebo: one more effect, or None where there was nothing to hold against it;
    comparisons: every recording beside both fits, those that were fitted first;
    evaluations: parameter sets that the searches took, on all fit recordings each;
    wall_s: s, those of stopped runs included, without compiling;
    stages: (stage, s, evaluations), where both went;
    balance: what the recordings say without any model, None where they say nothing so;
    whereabouts: rows of that table: where and when more is left than elsewhere;
    description: of what is missing, where it has no name; None where it has one, or nothing could be told;
    own: by effect and recording, those held out included, the amounts that are each recording's own;
    timed_out: whether a further round was not begun for want of time;
    settings: `bounds` of the search by parameter, `resolution` of the mesh, None where there is none, and
        `split_by_seed`, whether no recording stated a split.
    """

    key: str
    model: str
    base: tuple[str, ...]
    seed: int
    evidence: Evidence
    verdict: str
    hint: str
    noise: float
    mesh: float
    unexplained: float
    calibrated: Fitted
    final: Fitted
    rounds: tuple[Round, ...]
    dropped: str
    notes: Mapping[str, Note]
    alone: Mapping[str, Fitted]
    held_out: tuple[tuple[str, float, float], ...]
    placebo: Placebo | None
    comparisons: tuple[Comparison, ...]
    evaluations: int
    wall_s: float
    stages: tuple[tuple[str, float, int], ...]
    balance: Balance | None = None
    description: Description | None = None
    whereabouts: tuple[Mapping[str, Any], ...] = ()
    own: Mapping[str, Mapping[str, Fitted]] = field(default_factory=dict)
    timed_out: bool = False
    settings: Mapping[str, Any] = field(default_factory=dict)

    @property
    def floor(self) -> float:
        """Of noise and mesh together."""
        return float(np.hypot(self.noise, self.mesh))
