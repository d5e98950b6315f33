"""Evidence of drapes: what tells the two faces and the two threads of a cloth apart, in spreads between specimens.

A disc whose faces and threads are alike drapes alike face up and face down, and is on average as long one way as the
other, whatever it weighs, however stiff it is and on whatever square mesh it is simulated. So what is compared is, for
each side that was up, the drape coefficient and how much longer the outline is along one line of the picture than
across it. Number and depth of folds are not: which of several drapes a cloth falls into is chance, and meshes err
there.

Every specimen is a case. The spread between specimens is the noise: a model is one cloth, and they are many.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, cast

import numpy as np

from clothbench.core.drape import RINGS, SPOKES, drape_coefficient, outlines_of_points
from clothbench.core.parameters import ParameterSpace
from clothbench.core.protocols import Effect, Model, Score, Simulation
from clothbench.core.rollout import Rollout
from clothbench.core.scene import Scene
from clothbench.engine.tables import finite
from clothbench.estimation.fixed import holding
from clothbench.estimation.placements import joined
from clothbench.estimation.trials import Trial
from clothbench.recordings.silhouette import LAYOUT, SIDES
from clothbench.studies.improve.drape_quantities import (
    CONTRASTS,
    QUANTITIES,
    Specimen,
    asymmetries,
    contrast_means,
    elongation,
)
from clothbench.studies.improve.evidence import Comparison, Rows, Surrogate, Unit, prepared, without_switches
from clothbench.studies.improve.settings import LOOP, SearchSettings

FACE_DOWN = 2
SURE = 0.01  # p below which a contrast is told, and may be explained
DRAPES_AS = (("soft", 0.4), ("medium", 0.7))  # types of textile below these drape coefficients, in this order
# Amounts of bending are small beside their ranges, and beyond them a disc stands out flat: differences must be short.
SEARCH = SearchSettings(
    difference=0.02,
    tolerance=0.01,
    contest_tolerance=0.0,
    starts=15,
    walks=2,
    rounds=2,
    least_own=0.02,
    together=True,
    steps=True,
)


@dataclass(frozen=True, eq=False)
class DrapeRollout:
    """Drapes of B parameter sets: quantity (B, S, Q) of each of S sides, means over first shapes, SI; status (B,)."""

    quantity: np.ndarray
    status: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class DrapeSimulation:
    """The drapes of one fabric, each side up. All specimens of a fabric are compared with the same ones, so that what
    was simulated last is kept.
    """

    sides: tuple[Simulation, ...]
    plate: float
    disc: float
    kept: dict[bytes, DrapeRollout] = field(default_factory=dict)

    @property
    def parameters(self) -> ParameterSpace:
        return self.sides[0].parameters

    def run(self, theta: np.ndarray) -> DrapeRollout:
        """Drapes of theta (B, P)."""
        key = np.ascontiguousarray(theta, dtype=float).tobytes()
        if key not in self.kept:
            runs = [side.run(theta) for side in self.sides]
            self.kept.clear()
            self.kept[key] = DrapeRollout(np.stack([self._read(run) for run in runs], axis=1), _worst(runs))
        return self.kept[key]

    def _read(self, run: Rollout) -> np.ndarray:
        """(B, Q) of the drapes from all first shapes (B, S, N, 3), NaN where one of them is not known."""
        radius = outlines_of_points(run.position, (0.0, 0.0, 0.0), self.plate)
        return np.stack(
            [drape_coefficient(radius, self.plate, self.disc).mean(axis=1), elongation(radius).real.mean(axis=1)],
            axis=1,
        )


def _worst(runs: Sequence[Rollout]) -> tuple[str, ...]:
    members = zip(*(run.status for run in runs), strict=True)
    return tuple(next((s for s in each if s != "ok"), "ok") for each in members)


class DrapeError:
    """Root-mean-square over sides and quantities, in spreads between specimens: the loop's own yardstick for drapes.

    correction: (M,), added to the residual: what is known of the mesh's own error.
    """

    name: ClassVar[str] = "drape_error"
    version: ClassVar[int] = 1
    unit = "sd"

    def __init__(self, specimen: Specimen, correction: np.ndarray | float = 0.0):
        self.specimen, self.correction = specimen, correction

    def __call__(self, observation: Specimen, rollout: DrapeRollout) -> Score:
        seen = self.specimen
        away = (rollout.quantity[:, seen.known] - seen.mean[seen.known]) / seen.spread + self.correction
        return Score(np.sqrt(np.mean(away**2, axis=1)), self.unit, residual=away)

    def floor(self, observation: Specimen) -> float:
        return 1.0


@dataclass(frozen=True, eq=False)
class Drapemeter:
    """What all specimens of a fabric share. scenes: one for each first shape, face up; sides: which were up, of
    `SIDES`; plate, disc: m; held: values of parameters that are not searched for; others: scenes of other first shapes,
    which nothing is fitted with; made: the simulation that was prepared last.
    """

    scenes: tuple[Scene, ...]
    sides: tuple[int, ...]
    plate: float
    disc: float
    held: Mapping[str, float] = field(default_factory=dict)
    others: tuple[tuple[Scene, ...], ...] = ()
    made: dict[tuple[Any, ...], tuple[Any, DrapeSimulation]] = field(default_factory=dict)

    def simulation(self, model: Model, effects: Sequence[Effect]) -> DrapeSimulation:
        key = (id(model), *(effect.name for effect in effects))
        if key not in self.made:
            sides = tuple(self._side(side, model, effects) for side in self.sides)
            self.made.clear()
            self.made[key] = model, DrapeSimulation(sides, self.plate, self.disc)
        return self.made[key][1]

    def _side(self, side: int, model: Model, effects: Sequence[Effect]) -> Simulation:
        """The drapes from all first shapes with one side up; only what is searched for is free."""
        scenes = [turned(scene) if side == FACE_DOWN else scene for scene in self.scenes]
        drapes = joined([prepared(model, scene, effects, "drapes") for scene in scenes])
        return holding(without_switches(drapes, len(model.parameters)), self.held)


def turned(scene: Scene) -> Scene:
    """The scene of a sheet that is turned over: its own frame stays, and up and down change places."""
    assert scene.start is not None  # a drape begins with a shape
    mirrored = scene.start * [1.0, 1.0, -1.0]
    x, y, z = scene.gravity
    return dataclasses.replace(scene, gravity=(-x, -y, -z), start=mirrored)


def quartered(scene: Scene) -> Scene:
    """The scene of a sheet whose first shape is turned by a quarter: of both together, a cloth that is alike along both
    threads is no longer one way than the other.
    """
    assert scene.start is not None
    start = scene.start.copy()
    start[:, 2] = np.roll(start[:, 2].reshape(RINGS, SPOKES), SPOKES // 4, axis=1).ravel()
    return dataclasses.replace(scene, start=start)


@dataclass(frozen=True, eq=False)
class DrapeCase:
    """One specimen. name, split: as the recording has them, or the seed."""

    name: str
    split: str
    specimen: Specimen
    meter: Drapemeter

    duration: ClassVar[float] = float("inf")  # cloth at rest knows no time
    last_moment: ClassVar[float] = float("inf")

    def trial(self, model: Model, effects: Sequence[Effect], correction: np.ndarray | None) -> Trial:
        metric = DrapeError(self.specimen, 0.0 if correction is None else correction)
        simulation = self.meter.simulation(model, effects)
        # A trial is written for nodes; nothing that the loop does with one looks inside its parts.
        return Trial(self.name, cast(Any, self.specimen), cast(Any, simulation), cast(Any, metric))

    def simulated(self, rollout: DrapeRollout) -> np.ndarray:
        """Quantities (M,) of the sides that were seen, SI."""
        return rollout.quantity[0][self.specimen.known]

    def moved(self, way: float, speed: float) -> None:
        """Nothing moves it."""
        return None

    def surrogates(self, residual: np.ndarray, spread: bool = False) -> Surrogate:
        """Turned over or not, and turned by a quarter or not: where faces and threads are alike, a specimen might as
        well have been laid on so.
        """
        known = self.specimen.known
        field = np.zeros(known.shape)
        field[known] = residual

        def draw(random: np.random.Generator) -> np.ndarray:
            over = field[::-1] if len(field) == 2 and known.all() and random.random() < 0.5 else field
            return (over * [1.0, random.choice([-1.0, 1.0])])[known]

        return draw

    def peak(self, residual: np.ndarray) -> str:
        """The side and the quantity that it is largest in."""
        return self.specimen.labels[int(np.argmax(np.abs(residual)))]


@dataclass(frozen=True, eq=False)
class DrapeEvidence:
    """Drapes of one fabric. cases: one for each specimen; captures: how much they look alike, from `alike`."""

    cases: tuple[DrapeCase, ...]
    captures: Rows = field(default_factory=list)

    kind: ClassVar[str] = LAYOUT.kind
    unit: ClassVar[Unit] = Unit("sd", "sd", 1.0)
    search: ClassVar[SearchSettings] = SEARCH
    has_rerun: ClassVar[bool] = False
    in_pictures: ClassVar[bool] = False
    noise_stated: ClassVar[None] = None

    def restricted(self, cases: Sequence[DrapeCase]) -> DrapeEvidence:
        return dataclasses.replace(self, cases=tuple(cases))

    @property
    def textile(self) -> str:
        """The type of the textile by its drape coefficient, mean over the fitted specimens."""
        mean = np.nanmean([case.specimen.mean[:, 0] for case in self.cases if case.split == "fit"])
        return next((name for name, most in DRAPES_AS if mean < most), "stiff")

    def refined(self) -> None:
        """A mesh that is alike along both threads and on both faces has no part in what tells them apart. (How stiff
        the cloth is depends on it, and so do amounts: they are those of this mesh.)
        """
        return

    def relaid(self) -> list[DrapeEvidence]:
        """The same with each of the meter's other first shapes. What looks like two faces may be the folds of one: a
        sheet next to instability falls from mirrored shapes into drapes that are no mirrored ones.
        """
        meter = self.cases[0].meter
        meters = [dataclasses.replace(meter, scenes=scenes, others=(), made={}) for scenes in meter.others]
        return [self.restricted([dataclasses.replace(c, meter=other) for c in self.cases]) for other in meters]

    def noise(self) -> float:
        """1: the spread between specimens is the unit."""
        return 1.0

    def repeat_spread(self, residual: Sequence[np.ndarray]) -> float:
        """It is the noise already."""
        return 0.0

    def balance(self, seed: int) -> None:
        """Nothing moves."""
        return

    def whereabouts(self, residual: Sequence[np.ndarray], seed: int) -> Rows:
        """Nothing moves."""
        return []

    def location(self, residual: Sequence[np.ndarray]) -> str:
        """What the drapes themselves say of faces and threads."""
        sure = [r for r in asymmetries(self._of("fit")) if r["p_value"] < SURE]
        each = (f"{r['contrast']}: {r['mean']:.1f} ({r['low']:.1f} … {r['high']:.1f}) {r['unit']}" for r in sure)
        return "without any model, faces or threads are not alike: " + "; ".join(each) if sure else ""

    def objection(self, before: Sequence[np.ndarray], after: Sequence[np.ndarray], least: float = 0.0) -> str:
        """A contrast between faces or threads that the fit gets wrong and the one before did not; or that there is none
        to be explained, or that it is not explained: the rest, stiffness or weight would do as well.
        """
        seen = self._of("fit")
        across = [s.across for s in seen]  # a model's threads lie along the line, so that it is not long across
        was, now = (
            contrast_means([_field(r, s) for r, s in zip(each, seen, strict=True)], seen[0].sides, across)
            for each in (before, after)
        )
        worse = (np.abs(now.mean) - np.abs(was.mean) - now.half_width(0.05)) / now.error
        worst = int(np.argmax(worse))
        if worse[worst] > 0:
            return f"it contradicts the drapes themselves: {CONTRASTS[worst][0]}"
        if not (was.p_value < SURE).any():
            return (
                "faces and threads are as alike as chance leaves them; the rest, stiffness or weight would do as well"
            )
        left = np.sum((now.mean / was.error) ** 2) / np.sum((was.mean / was.error) ** 2)
        if left > 1 - max(LOOP.least_explained, least):
            return "faces and threads stay as unlike as they were; the rest, stiffness or weight would do as well"
        return ""

    def _of(self, split: str) -> list[Specimen]:
        return [case.specimen for case in self.cases if case.split == split]

    def tables(self, comparisons: Sequence[Comparison]) -> Mapping[str, Rows]:
        """Each quantity of each specimen as measured and as the model has it, in the unit that it is shown in; and how
        much captures look like each other.
        """
        rows: Rows = []
        for one in comparisons:
            seen = one.case.specimen
            points = zip(seen.mean[seen.known], seen.spread, one.before, one.after, strict=True)
            for values, (side, q) in zip(points, np.argwhere(seen.known), strict=True):
                measured, spread, before, after = (finite(QUANTITIES[q].scale * v) for v in values)
                rows.append(
                    {"recording": one.case.name, "split": one.case.split, "side": SIDES[one.case.meter.sides[side]],
                     "quantity": QUANTITIES[q].name, "measured": measured, "spread": spread, "before": before,
                     "after": after, "unit": QUANTITIES[q].unit}
                )  # fmt: skip
        said = [{"split": split, **row} for split in ("fit", "held_out")
                for row in asymmetries(self._of(split), split == "fit")]  # fmt: skip
        return {"drapes": rows, "captures": self.captures, "asymmetries": said}


def _field(residual: np.ndarray, seen: Specimen) -> np.ndarray:
    """A residual (M,) back on its sides and quantities (S, Q), SI, NaN where nothing was seen."""
    out = np.full(seen.known.shape, np.nan)
    out[seen.known] = residual * seen.spread
    return out
