"""The loop on force-extension curves: what it needs in the place of scenes, meshes and nodes.

Every run is reduced to the median force in equal steps of stretch, over the range that all fit recordings share, on
the way up to its largest stretch. One run says little about the next: the floor is the spread between the fit
recordings at equal stretch, wherever there are two of them; else what one of them states or shows as noise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.protocols import Score
from clothbench.estimation.trials import Trial
from clothbench.modelling.curves import CurveRollout, answers_curves, curve_of
from clothbench.plugins.discovery import Catalogue
from clothbench.recordings.curve import Curve
from clothbench.studies.improve.problem import Case, Problem

STEPS = 60  # of the common range of stretch, where the recordings have samples enough
MILLI = 1e-3  # the loop counts in thousandths of what residuals are in: mm for nodes, mN for curves


@dataclass(frozen=True, eq=False)
class CurveObservation:
    """Medians over steps of stretch: stretch (S,) and force (S,) N, NaN where a step has no sample; visible (S,) bool;
    sigma: N, what a perfect model would be off by.
    """

    stretch: np.ndarray
    force: np.ndarray
    visible: np.ndarray
    sigma: float


class ForceError:
    """Root-mean-square over steps of stretch [mN]: the loop's own yardstick for curves. Residuals (B, S) in N."""

    name: ClassVar[str] = "force_error"
    version: ClassVar[int] = 1
    unit = "mN"

    def __call__(self, observation: CurveObservation, rollout: CurveRollout) -> Score:
        away = rollout.force - observation.force[observation.visible]
        return Score(np.sqrt(np.mean(away**2, axis=1)) / MILLI, self.unit, residual=away)

    def floor(self, observation: CurveObservation) -> float:
        return observation.sigma / MILLI


@dataclass(frozen=True, eq=False)
class CurveCase(Case):
    """One curve ready for the loop; it has no scene."""

    recording: Curve  # type: ignore[assignment]
    observation: CurveObservation  # type: ignore[assignment]
    duration: ClassVar[float] = math.inf  # no time is known of a curve

    def scrambled(self, residual: np.ndarray, random: np.random.Generator) -> np.ndarray:
        """The residual (M,) out of step: moved round a circle of the curve and its reverse, and turned over or not."""
        count = len(residual)
        at = (np.arange(count) + random.integers(2 * count)) % (2 * count)
        return residual[np.minimum(at, 2 * count - 1 - at)] * random.choice([-1.0, 1.0])


@dataclass(frozen=True, eq=False)
class CurveProblem(Problem):
    """A model that answers curves beside curves of one fabric, pulled in one direction."""

    search: ClassVar[dict[str, Any]] = {
        "starts": 127, "walks": 6, "difference": 1e-4, "tolerance": 1e-5,
    }  # fmt: skip
    patience: ClassVar[int] = 20
    probe: ClassVar[float] = 1e-4
    rounds: ClassVar[int] = 1  # a smooth curve has few features: of two or three effects one can make nearly any
    contest: ClassVar[float] = math.inf  # a fit that ended early is soon made again
    carried: ClassVar[float] = math.inf  # the floor is the spread between runs, of which a run held out is one draw

    def finer(self) -> CurveProblem:
        """A curve has no mesh."""
        return self

    def trials(self, names: Sequence[str], split: str) -> list[Trial]:
        model, effects = self.plugins.make("models", self.model, **self.options), self.effects(names)
        out = []
        for case in self.of_split(split):
            assert isinstance(case, CurveCase)
            seen, width = case.observation, case.recording.sample_width
            simulation: Any = curve_of(model, effects, seen.stretch[seen.visible], width)
            metric: Any = ForceError()
            out.append(Trial(case.name, seen, simulation, metric))  # type: ignore[arg-type]
        return out


def curve_problem(
    model: str, curves: Sequence[Curve], splits: Sequence[str], plugins: Catalogue, seed: int
) -> CurveProblem:
    """Everything checked before anything is fitted. splits: "fit" or "held_out" for each curve."""
    if not answers_curves(plugins.load("models", model)):
        able = [name for name in plugins.names("models") if answers_curves(plugins.load("models", name))]
        raise ClothbenchError(
            f"model {model!r} answers no force-extension curves, and the recordings are such; "
            f"those that do: {', '.join(able)}"
        )
    _require_one_of_a_kind(curves)
    fitting = [curve for curve, split in zip(curves, splits, strict=True) if split == "fit"]
    edges = common_steps(fitting or curves)
    floor = floor_of([observed(curve, edges, math.nan) for curve in fitting], fitting)
    cases = tuple(
        CurveCase(c.name, split, c, observed(c, edges, floor), None)  # type: ignore[arg-type]
        for c, split in zip(curves, splits, strict=True)
    )
    for case in cases:
        if case.observation.visible.sum() < 3:
            raise ClothbenchError(
                f"{case.recording.path or case.name}: found next to nothing in the range of stretch "
                f"{edges[0]:.3g} to {edges[-1]:.3g} that the fit recordings share; leave this recording out"
            )
    return CurveProblem(model, cases, plugins, seed=seed)


def _require_one_of_a_kind(curves: Sequence[Curve]) -> None:
    for what in ("fabric", "direction"):
        found = sorted({getattr(curve, what) for curve in curves})
        if len(found) > 1:
            raise ClothbenchError(
                f"{curves[0].path or curves[0].name}: attribute {what!r}: found {', '.join(map(repr, found))} among "
                f"{len(curves)} recordings, expected one {what} in a folder; put each into a folder of its own"
            )


def loading(curve: Curve) -> tuple[np.ndarray, np.ndarray]:
    """Stretch and force (M,) of the samples up to the largest stretch: the way back is another curve."""
    last = int(np.argmax(curve.stretch)) + 1
    return curve.stretch[:last], curve.force[:last]


def common_steps(curves: Sequence[Curve]) -> np.ndarray:
    """Edges (S + 1,) of equal steps over the range of stretch that all these curves have."""
    ways = [loading(curve)[0] for curve in curves]
    low, high = max(float(way.min()) for way in ways), min(float(way.max()) for way in ways)
    if not high - low > 1e-3:
        raise ClothbenchError(
            f"{curves[0].path or curves[0].name}: found {low:.4g} to {high:.4g} as the range of stretch that all "
            f"{len(curves)} fit recordings share, expected some; leave the recordings out that break off early"
        )
    count = int(np.clip(min(len(way) for way in ways) // 3, 6, STEPS))
    return np.linspace(low, high, count + 1)


def observed(curve: Curve, edges: np.ndarray, sigma: float) -> CurveObservation:
    """Medians of stretch and of force in each step, on the way up."""
    stretch, force = loading(curve)
    inside = (stretch >= edges[0]) & (stretch <= edges[-1])
    step = np.clip(np.searchsorted(edges, stretch, side="right") - 1, 0, len(edges) - 2)
    out = np.full((2, len(edges) - 1), np.nan)
    for k in range(len(edges) - 1):
        mine = inside & (step == k)
        if mine.any():
            out[:, k] = np.median(stretch[mine]), np.median(force[mine])
    return CurveObservation(out[0], out[1], np.isfinite(out[1]), sigma)


def floor_of(seen: Sequence[CurveObservation], curves: Sequence[Curve]) -> float:
    """What a perfect model would be off by [N]: the spread between runs, or the noise of the only one."""
    if len(seen) > 1:
        return spread(seen)
    stated = [curve.noise_sigma for curve in curves if math.isfinite(curve.noise_sigma)]
    if stated:
        return stated[0]
    jumps = [np.diff(one.force[one.visible], n=3) for one in seen]
    return float(1.4826 * np.median(np.abs(np.concatenate(jumps))) / math.sqrt(20)) if jumps else math.nan


def spread(seen: Sequence[CurveObservation]) -> float:
    """Standard deviation [N] between runs at equal stretch, root-mean-square over stretch."""
    centres = np.nanmean([one.stretch for one in seen], axis=0)
    forces = [np.interp(centres, one.stretch[one.visible], one.force[one.visible]) for one in seen]
    return float(np.sqrt(np.mean(np.var(forces, axis=0, ddof=1))))


def in_newtons(found: Mapping[str, Any]) -> dict[str, Any]:
    """The document of `verdict.json` for curves: the same keys, nulls in `error_mm`, and `error` in N beside it."""
    error = _scaled(found["error_mm"], MILLI)
    out = {
        **found,
        "kind": "curve",
        "error_mm": _nothing(found["error_mm"]),
        "error": {"unit": "N", **error},
        "unexplained_mm": None,
        "unexplained": found["unexplained_mm"] * MILLI,
    }
    out["candidates"] = [{**c, "gain": None if c["gain"] is None else c["gain"] * MILLI**2} for c in out["candidates"]]
    return out


def _scaled(value: Any, factor: float) -> Any:
    if isinstance(value, Mapping):
        return {key: _scaled(inner, factor) for key, inner in value.items()}
    if isinstance(value, list):
        return [_scaled(inner, factor) for inner in value]
    return value * factor if isinstance(value, int | float) else value


def _nothing(value: Any) -> Any:
    """The same shape with null for every number."""
    if isinstance(value, Mapping):
        return {key: _nothing(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_nothing(inner) for inner in value]
    return value if isinstance(value, str) else None
