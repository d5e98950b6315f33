"""Evidence of force-extension curves: forces in newtons over stretch.

Every run is reduced to the median force in equal steps of stretch, over the range that all fit recordings share, on
the last way up to its largest stretch. One run says little about the next: the noise is the spread between the fit
recordings at equal stretch, wherever there are two of them; else what one of them states or shows as noise.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, cast

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.protocols import Effect, Score
from clothbench.engine.tables import finite
from clothbench.estimation.trials import Trial
from clothbench.modelling.curves import CurveRollout, curve_of
from clothbench.recordings.curve import Curve
from clothbench.studies.improve.curve_steps import CurveObservation, common_steps, floor_of, observed
from clothbench.studies.improve.evidence import Comparison, Rows, Surrogate, Unit
from clothbench.studies.improve.law import moved_round
from clothbench.studies.improve.settings import SearchSettings

LEAST_STEPS = 3  # with samples, that a recording needs
# A rollout costs next to nothing and has no ripples. A smooth curve has few features: of two or three effects one can
# make nearly any, so that one may be named. A fit that ended early is soon made again, and none is given up; the noise
# is the spread between runs, of which a run held out is one draw. Chance is told of two runs: a single smooth residual
# moved round looks less like any effect than it does itself (of chance alone, one in four was named).
SEARCH = SearchSettings(
    difference=1e-4, tolerance=1e-5, contest_tolerance=0.0, starts=127, walks=6, restart_starts=127,
    restart_walks=6, budget_factor=20, rounds=1, contention=math.inf, generalisation=math.inf, chance_recordings=2,
)  # fmt: skip


class ForceError:
    """Root-mean-square over steps of stretch [N]: the loop's own yardstick for curves. Residuals (B, M) in N."""

    name: ClassVar[str] = "force_error"
    version: ClassVar[int] = 1
    unit = "N"

    def __call__(self, observation: CurveObservation, rollout: CurveRollout) -> Score:
        away = rollout.force - observation.force[observation.visible]
        return Score(np.sqrt(np.mean(away**2, axis=1)), self.unit, residual=away)

    def floor(self, observation: CurveObservation) -> float:
        return observation.sigma


@dataclass(frozen=True, eq=False)
class CurveCase:
    """One curve.

    name, split: as the recording has them, or the seed;
    recording: as it was read;
    observation: its medians over steps of stretch.
    """

    name: str
    split: str
    recording: Curve
    observation: CurveObservation

    duration: ClassVar[float] = math.inf  # no time is known of a curve
    last_moment: ClassVar[float] = math.inf

    def trial(self, model: Any, effects: Sequence[Effect], correction: np.ndarray | None) -> Trial:
        """A curve has no mesh, and nothing to correct."""
        seen = self.observation
        simulation = curve_of(model, effects, seen.stretch[seen.visible], self.recording.sample_width)
        # A trial is written for nodes; nothing that the loop does with one looks inside its parts.
        return Trial(self.name, cast(Any, seen), cast(Any, simulation), cast(Any, ForceError()))

    def simulated(self, rollout: CurveRollout) -> np.ndarray:
        """Forces (M,) N."""
        return rollout.force[0]

    def moved(self, way: float, speed: float) -> None:
        """Nothing moves it."""
        return None

    def surrogates(self, residual: np.ndarray, spread: bool = False) -> Surrogate:
        """Moved round a circle of the curve and its reverse, and turned over or not."""
        return lambda random: moved_round(residual, random) * random.choice([-1.0, 1.0])

    def peak(self, residual: np.ndarray) -> str:
        """The stretch at which it is largest."""
        return f"a stretch of {self.observation.stretch[self.observation.visible][np.argmax(np.abs(residual))]:.2f}"


@dataclass(frozen=True, eq=False)
class CurveEvidence:
    """Curves of one fabric, pulled in one direction. cases: one for each recording."""

    cases: tuple[CurveCase, ...]

    kind: ClassVar[str] = "curve"
    unit: ClassVar[Unit] = Unit("N", "N", 1.0)
    search: ClassVar[SearchSettings] = SEARCH
    has_rerun: ClassVar[bool] = False
    textile: ClassVar[None] = None
    in_pictures: ClassVar[bool] = False
    noise_stated: ClassVar[None] = None

    def restricted(self, cases: Sequence[CurveCase]) -> CurveEvidence:
        return dataclasses.replace(self, cases=tuple(cases))

    def refined(self) -> None:
        """A curve has no mesh."""
        return

    def relaid(self) -> tuple[()]:
        """Nothing is left to chance."""
        return ()

    def noise(self) -> float:
        """σ of one step [N]: the spread between the fit recordings."""
        sigma = [case.observation.sigma for case in self.cases if case.split == "fit"]
        return float(np.sqrt(np.mean(np.square(sigma))))

    def repeat_spread(self, residual: Sequence[np.ndarray]) -> float:
        """It is the noise already."""
        return 0.0

    def objection(self, before: Sequence[np.ndarray], after: Sequence[np.ndarray], least: float = 0.0) -> str:
        """No identity is known of such recordings."""
        return ""

    def balance(self, seed: int) -> None:
        """Nothing moves."""
        return

    def whereabouts(self, residual: Sequence[np.ndarray], seed: int) -> Rows:
        """Nothing moves."""
        return []

    def location(self, residual: Sequence[np.ndarray]) -> str:
        """A curve has no sheet on which to say where."""
        return ""

    def tables(self, comparisons: Sequence[Comparison]) -> Mapping[str, Rows]:
        """Force over stretch, as measured and as the model has it."""
        rows: Rows = []
        for one in comparisons:
            seen = one.case.observation
            points = zip(seen.stretch[seen.visible], seen.force[seen.visible], one.before, one.after, strict=True)
            rows += [
                {"recording": one.case.name, "split": one.case.split, "stretch": float(s), "force": float(f),
                 "before": finite(a), "after": finite(b), "unit": self.unit.reported}
                for s, f, a, b in points
            ]  # fmt: skip
        return {"curves": rows}


def curve_evidence(curves: Sequence[Curve], splits: Sequence[str]) -> CurveEvidence:
    """Everything checked before anything is fitted. splits: "fit" or "held_out" for each curve."""
    _require_one_of_a_kind(curves)
    fitting = [curve for curve, split in zip(curves, splits, strict=True) if split == "fit"]
    edges = common_steps(fitting or curves)
    seen = [observed(curve, edges, math.nan) for curve in curves]
    for curve, one in zip(curves, seen, strict=True):
        if one.visible.sum() < LEAST_STEPS:
            raise ClothbenchError(
                f"{curve.path or curve.name}: found next to nothing in the range of stretch "
                f"{edges[0]:.3g} to {edges[-1]:.3g} that the fit recordings share; leave this recording out"
            )
    floor = floor_of([one for one, split in zip(seen, splits, strict=True) if split == "fit"], fitting)
    return CurveEvidence(
        tuple(
            CurveCase(curve.name, split, curve, dataclasses.replace(one, sigma=floor))
            for curve, split, one in zip(curves, splits, seen, strict=True)
        )
    )


def _require_one_of_a_kind(curves: Sequence[Curve]) -> None:
    for what in ("fabric", "direction"):
        found = sorted({getattr(curve, what) for curve in curves})
        if len(found) > 1:
            raise ClothbenchError(
                f"{curves[0].path or curves[0].name}: attribute {what!r}: found {', '.join(map(repr, found))} among "
                f"{len(curves)} recordings, expected one {what} in a folder; put each into a folder of its own"
            )
    unknown = [curve for curve in curves if math.isnan(curve.sample_width)]
    if unknown and len(unknown) < len(curves):
        raise ClothbenchError(
            f"{unknown[0].path or unknown[0].name}: attribute 'sample_width': found none, expected metres, as "
            f"others of the {len(curves)} recordings have; state it in all of them or in none"
        )
