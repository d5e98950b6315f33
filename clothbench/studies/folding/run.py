"""Run a fold: lift the strip step by step, measure, estimate, and lift it further by the estimate.

Petrík et al., Automatic Material Properties Estimation for the Physics-Based Robotic Garment Folding, algorithm 1.
"""

from __future__ import annotations

import dataclasses
import time
from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.folding import Folding, FoldState
from clothbench.core.observation import Observation
from clothbench.core.optional import Renewable, absent
from clothbench.core.parameters import ParameterSpace
from clothbench.core.protocols import Effect, Evaluation, Metric, Optimizer, Tracker
from clothbench.core.rollout import Rollout
from clothbench.engine.cells import Skipped
from clothbench.engine.rows import about_cell, no_value
from clothbench.engine.study import Context, Result
from clothbench.engine.tables import finite
from clothbench.estimation.intervals import beside_held, held_by_bounds, jackknife
from clothbench.estimation.search import drive
from clothbench.modelling.joined import JoinedParameters
from clothbench.plugins.discovery import Catalogue
from clothbench.reference.lifted_strip import Lifted
from clothbench.studies.folding.cell import FoldingCell, estimated
from clothbench.studies.folding.laser_camera import rendered
from clothbench.studies.folding.strip import TestStrip

PROBE = 1e-3  # of the scaled range, step of the differences for the intervals
PIECES = 20  # of a profile, which count as independent of each other
FINE = 20_001  # points of the true profile
NOTHING = 1e-9  # m, by which rounding may move what an effect leaves where it is


@dataclass(frozen=True, eq=False)
class Hand:
    """What a cell needs to estimate: its plugins, and the parameters that are estimated among all others."""

    cell: FoldingCell
    strip: Folding
    own: ParameterSpace
    effects: tuple[Effect, ...]
    metric: Metric
    tracker: Tracker

    @cached_property
    def joined(self) -> JoinedParameters:
        return JoinedParameters(self.own, self.effects)

    @cached_property
    def whole(self) -> ParameterSpace:
        """The model's parameters and those of its effects, an effect's default being its null value."""
        of_effects = self.joined.parameters.parameters[len(self.own) :]
        nulls = (dataclasses.replace(p, default=p.default if p.null is None else p.null) for p in of_effects)
        return ParameterSpace((*self.own, *nulls))

    @cached_property
    def space(self) -> ParameterSpace:
        return estimated(self.whole, self.cell.fold, self.cell.bounds)

    def all_parameters(self, theta: np.ndarray) -> np.ndarray:
        """(B, P) of the model and its effects from (B, F) of what is estimated."""
        out = np.repeat(self.whole.defaults[None], len(theta), axis=0)
        out[:, [self.whole.names.index(name) for name in self.space.names]] = theta
        return out

    def lift(self, height: float, theta: np.ndarray) -> FoldState:
        """Where an estimate (F,) would have the gripper at a height [m]: T = P(S₁(z, η_b))."""
        state = self.strip.lift(height, self.joined.of_model(self.all_parameters(theta[None])))
        if state.status[0] != "ok":
            raise ClothbenchError(f"{self.cell.model}: no state found with the end at {height:g} m")
        return state

    def reference_path(self, height: float) -> dict[str, float | None]:
        """x [m] of the gripper at a height [m] for what the fabric is known by, and for the ends of its range; None
        where no state was found.
        """
        fabric, every = self.cell.fabric, np.repeat(self.whole.defaults[None], 3, axis=0)
        every[:, self.whole.names.index(self.space.names[0])] = fabric.eta, fabric.eta_low, fabric.eta_high
        state = self.strip.lift(height, self.joined.of_model(every))
        x = np.where([status == "ok" for status in state.status], state.pose[:, 0], np.nan)
        return dict(zip(("reference_x", "reference_x_low", "reference_x_high"), map(finite, x), strict=True))

    def hold(self, theta: np.ndarray, near: FoldState) -> FoldState:
        """S(T T_δ, η_b) for estimates (B, F), the gripper being sent to where `near` has it."""
        every = self.all_parameters(theta)
        return self.strip.hold(self.gripped(near.pose, every), self.joined.of_model(every), near)

    def gripped(self, pose: np.ndarray, every: np.ndarray) -> np.ndarray:
        """Poses (B, 3) of the end where the gripper is sent to `pose` (1, 3), for all parameters (B, P)."""
        poses = np.repeat(pose, len(every), axis=0)
        for effect, phis in self.joined.of_effects(every):
            for pose, phi in zip(poses, phis, strict=True):
                held = np.array([[[pose[0], 0.0, pose[1]]]])
                pose[:2] = effect.grips(np.zeros(1), held, phi)[0, 0, [0, 2]]  # type: ignore[attr-defined]
        return poses

    def grip_offset(self, theta: np.ndarray) -> np.ndarray:
        """By how much (2,) m, in x and z, an estimate (F,) has the end away from where the gripper is sent."""
        return self.gripped(np.zeros((1, 3)), self.all_parameters(theta[None]))[0, :2]

    def evaluate(self, theta: np.ndarray, near: FoldState, seen: Observation) -> Evaluation:
        """J (B,) of estimates (B, F), and the residuals [m]."""
        profile = self.hold(theta, near).profile
        position = np.insert(profile, 1, 0.0, axis=-1)[:, None]
        status = tuple("ok" if np.isfinite(p).all() else "diverged" for p in profile)
        score = self.metric(seen, Rollout(seen.time, position, status, np.zeros(len(theta), int), profile.shape[1]))
        return Evaluation(score.value, score.residual)

    def interval(self, best: np.ndarray, near: FoldState, seen: Observation) -> np.ndarray:
        """95 % interval (2, F) of an estimate (F,): the jackknife over pieces of the profile; NaN without residuals."""
        unit = self.space.to_unit(best)
        up, down = np.minimum(unit + PROBE, 1.0), np.maximum(unit - PROBE, 0.0)
        points = np.vstack([unit[None], unit + np.diag(up - unit), unit - np.diag(unit - down)])
        residual = self.evaluate(self.space.from_unit(points), near, seen).residual
        if residual is None or not np.isfinite(residual).all():
            return np.full((2, len(unit)), np.nan)
        count, here = len(unit), self.hold(best[None], near).profile[0]
        jacobian = ((residual[1 : count + 1] - residual[count + 1 :]) / (up - down)[:, None]).T
        pieces, left = _pieces(here, seen, residual.shape[1]), residual[0]
        held = held_by_bounds(self.space, best, jacobian, left)
        half = beside_held(lambda j: jackknife(j, left, pieces), jacobian, held)
        return np.stack([self.space.from_unit(unit - half), self.space.from_unit(unit + half)])


def _pieces(profile: np.ndarray, seen: Observation, rows: int) -> list[np.ndarray]:
    """Row numbers of a residual of `rows` numbers, by pieces of the profile (M, 2) that its points belong to."""
    from scipy.spatial import cKDTree

    points = seen.position[seen.visible][:, [0, 2]]
    order = np.argsort(cKDTree(profile).query(points)[1], kind="stable")
    each = rows // len(points)
    return [(part[:, None] * each + np.arange(each)).ravel() for part in np.array_split(order, PIECES)]


def run(cell: FoldingCell, context: Context) -> Result:
    """Lift and estimate in turn; the progress counts steps, with the estimate after each. After the time limit no step
    is begun.
    """
    plugins, start = context.plugins, time.perf_counter()
    hand = hand_of(cell, plugins)
    sheet = TestStrip.of(cell.fabric, cell.fold.length, cell.stream, cell.fold.friction)
    optimizer, theta, steps = _optimizer(hand, plugins, hand.space), hand.space.defaults, []
    for number in range(1, cell.fold.steps + 1):
        began = time.perf_counter()
        near = hand.lift(number * cell.fold.rise, theta)
        planned = time.perf_counter() - began
        truth = _moved(sheet, near.pose[0])
        seen, error = _measure(hand, sheet, number)
        began = time.perf_counter()
        theta, least, evaluations = _estimate(hand, optimizer, near, seen)
        spent = planned + time.perf_counter() - began
        low, high = hand.interval(theta, near, seen)
        steps.append(_step(cell, sheet, truth, near, number) | hand.reference_path(number * cell.fold.rise) | {
            "estimate": theta, "low": low, "high": high, "profile": least, "tracker_error": error,
            "sigma": seen.sigma, "evaluations": evaluations, "wall_s": spent,
        })  # fmt: skip
        context.progress(number, float(theta[0]))
        if cell.timeout is not None and time.perf_counter() - start > cell.timeout:
            break
        optimizer = _next(hand, plugins, optimizer, theta)
    return _result(hand, sheet, steps)


def hand_of(cell: FoldingCell, plugins: Catalogue) -> Hand:
    """A cell with its plugins made."""
    if reason := absent(plugins.load("models", cell.model)):
        raise Skipped(reason)
    model = plugins.make("models", cell.model, **cell.option(cell.model))
    if "fold" not in model.capabilities:
        raise Skipped("the model folds no strips on a desk")
    effects = tuple(plugins.make("effects", name) for name in cell.effects)
    for effect in effects:
        if effect.place != "boundary":
            raise ClothbenchError(f"effect {effect.name!r} does not act on the gripper; only those take part in a fold")
        if not _moves_the_end(effect):
            raise ClothbenchError(
                f"effect {effect.name!r} moves no single grip at rest, whatever its parameters: a fold cannot tell "
                "them; leave it out of effects and suite.fold.fit"
            )
    strip: Any = model.strip(cell.fold.length)
    metric = plugins.make("metrics", cell.metric, **cell.option(cell.metric))
    tracker = plugins.make("trackers", cell.tracker, **cell.option(cell.tracker))
    return Hand(cell, strip, model.parameters, effects, metric, tracker)


def _moves_the_end(effect: Effect) -> bool:
    """Whether any of several values of its parameters has the end of a strip elsewhere, in the plane of the fold."""
    held = np.array([[[1.0, 0.0, 0.2]]])
    values = effect.parameters.from_unit(np.repeat(np.linspace(0.0, 1.0, 5)[:, None], len(effect.parameters), axis=1))
    moved = [effect.grips(np.zeros(1), held, phi) - held for phi in values]  # type: ignore[attr-defined]
    return bool(np.abs(np.array(moved)[..., [0, 2]]).max() > NOTHING)


def _optimizer(hand: Hand, plugins: Catalogue, space: ParameterSpace) -> Optimizer:
    cell = hand.cell
    return plugins.make(
        "optimizers", cell.optimizer, space, seed=cell.stream("optimizer"), budget=cell.evaluations,
        **cell.option(cell.optimizer),
    )  # fmt: skip


def _next(hand: Hand, plugins: Catalogue, optimizer: Optimizer, theta: np.ndarray) -> Optimizer:
    """The search for the next measurement: the same one told so, or a new one of its kind from the estimate."""
    if isinstance(optimizer, Renewable):
        optimizer.renew()
        return cast("Optimizer", optimizer)
    found = tuple(dataclasses.replace(p, default=float(v)) for p, v in zip(hand.space, theta, strict=True))
    return _optimizer(hand, plugins, ParameterSpace(found))


def _moved(sheet: TestStrip, pose: np.ndarray) -> Lifted:
    try:
        return sheet.move(pose)
    except ArithmeticError as fault:
        raise ClothbenchError(
            f"{fault}: take a longer strip (suite.fold.length), or lift it less (suite.fold.steps, suite.fold.rise)"
        ) from fault


def _measure(hand: Hand, sheet: TestStrip, number: int) -> tuple[Observation, float]:
    """What the tracker makes of an image of the sheet, and how far its points are from it, rms [m]."""
    from scipy.spatial import cKDTree

    cell = hand.cell
    line = sheet.line(np.linspace(0.0, sheet.length, FINE))
    name = f"{cell.case}-{number:02d}"
    images: Any = rendered(name, line[::5], float(number), cell.stream(f"camera {number}"), cell.case)
    seen = hand.tracker.track(images)
    points = seen.position[seen.visible]
    away = cKDTree(np.insert(line, 1, 0.0, axis=1)).query(points)[0]
    return seen, float(np.sqrt((away**2).mean()))


def _estimate(hand: Hand, optimizer: Optimizer, near: FoldState, seen: Observation) -> tuple[np.ndarray, float, int]:
    """argmin of J over what is estimated, J there [m²], and how many evaluations that took."""
    thetas, values = [], []

    def answer(theta: np.ndarray) -> Evaluation:
        return hand.evaluate(theta, near, seen)

    for theta, evaluation in drive(optimizer, hand.space, answer, hand.cell.evaluations):
        thetas.append(theta)
        values.append(evaluation.value)
    value = np.concatenate(values)
    if not np.isfinite(value).any():
        raise ClothbenchError(f"{hand.cell.model}: nothing that was tried at {near.pose[0, 1]:g} m could be simulated")
    best = int(np.nanargmin(value))
    return np.concatenate(thetas)[best], float(value[best]), len(value)


def _step(cell: FoldingCell, sheet: TestStrip, truth: Lifted, near: FoldState, number: int) -> dict[str, Any]:
    x, z, slope = near.pose[0]
    bends = np.linspace(truth.length - truth.off, truth.length, 401)
    moment = np.interp(bends - bends[0], truth.s, truth.moment**2 * sheet.stiffness(bends[0] + truth.s))
    local = float(np.exp(np.average(np.log(sheet.stiffness(bends)), weights=moment + 1e-300)))
    return {
        "step": number, "length": cell.fold.length, "x": float(x), "z": float(z), "slope": float(slope),
        "off": truth.off, "sheet": local,
        "friction": sheet.needed, "slips": bool(sheet.needed > cell.fold.friction),
    }  # fmt: skip


def _result(hand: Hand, sheet: TestStrip, steps: list[dict[str, Any]]) -> Result:
    cell, last = hand.cell, steps[-1]
    late = len(steps) < cell.fold.steps
    reason = f"stopped by the time limit after {len(steps)} of {cell.fold.steps} steps" if late else ""
    about = {**about_cell(cell), **no_value(), "status": "timeout" if late else "ok", "reason": reason}
    about |= {"evaluations": sum(s["evaluations"] for s in steps), "wall_s": sum(s["wall_s"] for s in steps)}
    first = hand.space.parameters[0]
    rows = [_row(about, first.name, first.unit, last["estimate"][0], cell.fabric.eta, last["low"][0], last["high"][0])]
    slips = [str(s["step"]) for s in steps if s["slips"]]
    friction = _row(about, "friction", "1", max(s["friction"] for s in steps), cell.fold.friction)
    rows.append(friction | {"reason": f"slips at step {', '.join(slips)}" if slips else reason})
    rows.append(_row(about, "slip", "mm", 1e3 * sheet.origin, 0.0))
    rows.append(_row(about, hand.metric.name, hand.metric.unit, last["profile"], None))
    rows.append(_row(about, "tracker_error", "mm", 1e3 * max(s["tracker_error"] for s in steps), None))
    offset = hand.grip_offset(last["estimate"]) - sheet.offset
    rows.append(_row(about, "grip_offset_error", "mm", 1e3 * float(np.hypot(*offset)), 0.0))
    table = [_table(hand, s) for s in steps]
    return Result(about["status"], {"rows": rows, "parameters": _parameters(hand, last), "fold": table})


def _row(about: dict[str, Any], metric: str, unit: str, value: float, reference: float | None, low=None, high=None):
    ends = [None if e is None or not np.isfinite(e) else float(e) for e in (low, high)]
    return {**about, "metric": metric, "unit": unit, "value": float(value), "reference": reference,
            "low": ends[0], "high": ends[1]}  # fmt: skip


def _parameters(hand: Hand, last: dict[str, Any]) -> list[dict[str, Any]]:
    bound = hand.space.at_bound(last["estimate"])
    return [
        {"name": p.name, "symbol": p.symbol, "unit": p.unit, "value": float(last["estimate"][i]),
         "low": float(last["low"][i]), "high": float(last["high"][i]), "at_bound": bool(bound[i]), "meaning": p.meaning,
         "key": hand.cell.key}
        for i, p in enumerate(hand.space)
    ]  # fmt: skip


def _table(hand: Hand, step: dict[str, Any]) -> dict[str, Any]:
    cell, fabric = hand.cell, hand.cell.fabric
    single = {k: v for k, v in step.items() if k not in ("estimate", "low", "high")}
    about = {"case": cell.case, "model": cell.model, "optimizer": cell.optimizer, "parameter": hand.space.names[0]}
    ends = {"reference": fabric.eta, "reference_low": fabric.eta_low, "reference_high": fabric.eta_high}
    told = {"value": float(step["estimate"][0]), "low": float(step["low"][0]), "high": float(step["high"][0])}
    return {**about, **ends, **told, **single, "key": cell.key}
