"""The tests of the suite: what each simulates, reads off and compares with; and the rows that come of it."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from clothbench import ClothbenchError
from clothbench.reference import mechanics as references
from clothbench.reference.fabrics import FABRICS
from clothbench.studies.mechanics import trials
from clothbench.studies.mechanics.scenes import DENSITY

HALVES = (0.5, 0.25)


@dataclass(frozen=True)
class Level:
    """What came of one simulation: nodes `along` the strip, its cell `size` m, the step's scale, and the number.

    unresolved: not asked, since the mesh is too coarse for this load; others are.
    """

    along: int
    size: float
    step_scale: float
    load: float | None
    reference: float
    value: float | None
    status: str = "ok"
    reason: str = ""
    nodes: int = 0
    steps: int = 0
    wall_s: float = 0.0
    order: float | None = None
    unresolved: bool = False


@dataclass(frozen=True)
class Answer:
    """One row of the leaderboard."""

    case: str
    value: float | None
    reference: float | None
    status: str
    reason: str


@dataclass(frozen=True)
class Check:
    """A test: name, what is measured in which unit, what the model must be able to do, and how to make its trials.

    effects: what else acts → parameter → value, where the suite says which effect stands for it;
    limp: bending takes no part, and a model that knows none may do without;
    textbook: needs the model's parameters for a textbook material, else its defaults will do; headline: the load
    whose value stands in the leaderboard; halved: also run on the coarsest mesh with half and a quarter of the step;
    order: what stands in the leaderboard is the observed order of convergence, which shows best on a mesh finer than
    the others: it is added; finest: run on the finest mesh alone; viscous: the model must heed the cloth's viscosity.
    """

    name: str
    metric: str
    unit: str
    summary: str
    trials: Callable[[int], Sequence[trials.Trial]]
    needs: tuple[str, ...] = ()
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    textbook: bool = True
    limp: bool = False
    load_name: str = ""
    headline: float | None = None
    halved: bool = False
    order: bool = False
    finest: bool = False
    viscous: bool = False

    def meshes(self, given: Sequence[int]) -> list[int]:
        """On which meshes it is run where a suite gives these, from the coarsest on."""
        known = sorted(given)
        return known[-1:] if self.finest else known + [2 * known[-1] - 1] * self.order

    def count(self, given: Sequence[int], halves: bool = True) -> int:
        """How many simulations there are on these meshes, with a shorter step where `halves` says that it can be."""
        return len(self.trials(5)) * len(self.meshes(given)) + (len(HALVES) if self.halved and halves else 0)

    @property
    def cases(self) -> tuple[str, ...]:
        """The cases of its rows."""
        return tuple(f"{self.name}:{f.name}" for f in FABRICS) if self.name == "fold_table" else (self.name,)

    @property
    def measured(self) -> str:
        """What the row's value is called."""
        return "order" if self.order else "eta_b" if self.name == "fold_table" else self.metric

    @property
    def row_unit(self) -> str:
        return "1" if self.order else "m^-4 s^2" if self.name == "fold_table" else self.unit

    def answers(self, levels: Sequence[Level]) -> list[Answer]:
        """The rows, from the finest mesh that was reached."""
        if self.name == "fold_table":
            return _fabrics(self, levels)
        if self.order:
            return [_order(self, levels)]
        plain = [v for v in levels if v.step_scale == 1.0 and v.load == self.headline]
        if not plain:  # a mesh that was not reached, or skipped at another load
            return [Answer(self.name, None, None, levels[-1].status, levels[-1].reason)]
        last = plain[-1]
        return [Answer(self.name, last.value, last.reference, last.status, last.reason)]


def _order(check: Check, levels: Sequence[Level]) -> Answer:
    plain = [v for v in levels if v.step_scale == 1.0]
    if plain[-1].status != "ok":
        return Answer(check.name, None, 2.0, plain[-1].status, plain[-1].reason)
    if plain[-1].order is not None:
        return Answer(check.name, plain[-1].order, 2.0, "ok", "")
    reason = f"no order to see: {check.metric} does not approach a limit steadily over three meshes"
    if len(plain) < 3:
        reason = f"an order of convergence shows on three meshes, here are {len(plain)}; see suite.meshes"
    return Answer(check.name, None, 2.0, "skipped", reason)


def _fabrics(check: Check, levels: Sequence[Level]) -> list[Answer]:
    """η_b of each fabric from its measured height and the model's own h (ρg/D)^⅓, interpolated between two folds."""
    if bad := [v for v in levels if v.value is None]:
        return [Answer(case, None, f.eta, bad[0].status, bad[0].reason)
                for case, f in zip(check.cases, FABRICS, strict=True)]  # fmt: skip
    known = sorted((float(v.load or 0.0), float(v.value or 0.0)) for v in levels)
    units, heights = np.array(known).T
    etas = [references.eta_of_fold(f.height, np.interp(f.height, heights, heights / units)) for f in FABRICS]
    return [Answer(case, eta, f.eta, "ok", "") for case, f, eta in zip(check.cases, FABRICS, etas, strict=True)]


ELASTICA = "heavy elastica (Bickley 1934)"
FREE: dict[str, Any] = {"textbook": False, "limp": True}  # what needs no bending and can do with a model's defaults
MOVES, TAKES = ("dynamic",), ("dynamic", "effects")
CHECKS = (
    Check("free_fall", "drop", "m", "½gt² in vacuum, after 0.5 s", trials.free_fall, MOVES, **FREE),
    Check("free_fall_damped", "drop", "m", "the same with viscosity of the cloth on, which must not brake a fall",
          trials.free_fall_damped, MOVES, textbook=True, limp=True, viscous=True),
    Check("cantilever_small", "tip_sag", "m", "tip sag LΓ/8 of a strip held level, Γ = ρgL³/D = 0.05",
          trials.cantilever_small),
    Check("cantilever", "sag_over_reach", "1", f"H/W of a strip held level, Γ from 0.01 to 1e4, here 100: {ELASTICA}",
          trials.cantilever, load_name="Γ", headline=100.0),
    Check("free_fold", "fold_height", "m", "height of a strip folded back on itself, 0.9066 (D/ρg)^⅓",
          trials.free_fold, ("contact",), load_name="(D/ρg)^⅓ [m]",
          headline=references.bending_length(trials.CLOTH.bending, DENSITY)),
    Check("free_fold_length", "fold_length", "m", "length of cloth in that fold's loop, 4.683 (D/ρg)^⅓",
          trials.free_fold_length, ("contact",), load_name="(D/ρg)^⅓ [m]",
          headline=references.bending_length(trials.CLOTH.bending, DENSITY)),
    Check("fold_table", "fold_height", "m", "η_b of ten fabrics from their measured fold height, beside the paper's",
          trials.fold_table, ("contact",), load_name="(D/ρg)^⅓ [m]", finest=True),
    Check("swing_period", "period", "s", "hanging sheet, small swing in vacuum, ω₁ = (2.4048/2) √(g/L)",
          trials.swing, MOVES, **FREE),
    Check("added_mass", "period", "s", "the same with air carried along, ω₁/√(1 + m_a/ρ)",
          functools.partial(trials.swing, extra=trials.EXTRA), TAKES,
          {"added_mass": {"areal_density": trials.EXTRA}}, **FREE),
    Check("catenary", "middle_sag", "m", "strip between two supports: elastic catenary (Irvine 1981)",
          trials.catenary, limp=True),
    Check("terminal_speed", "speed", "m/s", "sheet falling flat with quadratic drag, √(2ρg/(ρ_air C_N))",
          trials.terminal, TAKES, {"drag": {"normal": trials.COEFFICIENT, "tangential": 0.0}}, **FREE),
    Check("energy_drift", "energy_drift", "%", "undamped swing: energy gone within 10 s", trials.drift, MOVES, **FREE),
    Check("convergence_sag", "tip_sag", "m", "observed order of convergence of a cantilever's sag, Γ = 10",
          lambda along: [trials.sag(along, 10.0)], halved=True, order=True),
    Check("convergence_period", "period", "s", "observed order of convergence of the swing's period",
          trials.swing, MOVES, **FREE, halved=True, order=True),
)  # fmt: skip
NAMES = tuple(check.name for check in CHECKS)


def check_named(name: str) -> Check:
    for check in CHECKS:
        if check.name == name:
            return check
    raise ClothbenchError(f"no test named {name!r}; there are: {', '.join(NAMES)}")
