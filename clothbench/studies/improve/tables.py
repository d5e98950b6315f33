"""Rows of the tables that `clothbench improve` writes (columns: `experiment.improve_schema`).

Errors in mm, of force-extension curves in N.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from clothbench.engine.store import finite
from clothbench.studies.improve.before_after import Pulled, Seen
from clothbench.studies.improve.fitting import Fitted
from clothbench.studies.improve.guard import field_of
from clothbench.studies.improve.residual import portrait
from clothbench.studies.improve.rounds import Outcome
from clothbench.studies.improve.verdict import why_not

MM = 1e3
BINS = 8  # of speed, acceleration and height, with equal numbers of coordinates
Rows = list[dict[str, Any]]


def all_rows(
    outcome: Outcome, found: Mapping[str, Any], after: Fitted, seen: Sequence[Seen], curves: Sequence[Pulled] = ()
) -> dict[str, Rows]:
    """Every table by name. found: the document of `verdict.json`; after: the fit that it stands by."""
    return {
        "candidates": candidate_rows(outcome, found),
        "parameters": parameter_rows("before", outcome.base) + parameter_rows("after", after),
        "errors": error_rows(found, outcome, after),
        "portrait": portrait_rows(seen),
        "against": bin_rows(seen),
        "frames": frame_rows(seen),
        "nodes": node_rows(seen),
        "curves": curve_rows(curves),
        "stages": stage_rows(outcome),
        "drift": drift_rows(outcome),
    }


def unit_of(found: Mapping[str, Any]) -> tuple[str, float]:
    """The unit of errors, and how many of it one of the residuals' (m or N) are."""
    return ("N", 1.0) if found.get("kind") == "curve" else ("mm", MM)


def candidate_rows(outcome: Outcome, found: Mapping[str, Any]) -> Rows:
    """Every candidate of every round, the most promising first."""
    rows: Rows = []
    unit, scale = unit_of(found)
    for turn, one in enumerate(outcome.rounds, 1):
        for c in one.candidates:
            effect = outcome.problem.plugins.make("effects", c.name)
            rows.append({
                "round": turn, "name": c.name, "place": effect.place, "summary": effect.summary, "share": c.share,
                "p_value": c.p_value, "gain": finite(scale**2 * c.gain), "unit": f"{unit}²",
                "selected": c.selected, "of": len(one.before.squares), "why_not": why_not(c, one),
                "named": c.name in one.named,
            })  # fmt: skip
    return sorted(rows, key=lambda r: (r["round"], not r["named"], -(r["gain"] or 0.0), -r["share"]))


def parameter_rows(fit: str, fitted: Fitted) -> Rows:
    values = zip(fitted.space, fitted.theta, fitted.low, fitted.high, fitted.at_bound, strict=True)
    return [
        {
            "fit": fit, "name": p.name, "symbol": p.symbol, "unit": p.unit, "value": float(value),
            "low": finite(low), "high": finite(high), "at_bound": bool(bound), "meaning": p.meaning,
        }
        for p, value, low, high, bound in values
    ]  # fmt: skip


def error_rows(found: Mapping[str, Any], outcome: Outcome, after: Fitted) -> Rows:
    """Each recording's error before and after, the same numbers as in the verdict."""
    unit, scale = unit_of(found)
    names = [case.name for case in outcome.problem.of_split("fit")]
    fitted = zip(names, outcome.base.squares, after.squares, strict=True)
    rows = [(name, "fit", scale * float(a) ** 0.5, scale * float(b) ** 0.5) for name, a, b in fitted]
    held = (found["error"] if unit == "N" else found["error_mm"])["held_out"]["per_recording"]
    rows += [(r["recording"], "held_out", r["before"], r["after"]) for r in held]
    floor = scale * outcome.floor
    return [
        {"recording": name, "split": split, "unit": unit, "before": finite(a), "after": finite(b), "floor": floor}
        for name, split, a, b in rows
    ]


def portrait_rows(seen: Sequence[Seen]) -> Rows:
    rows: Rows = []
    for one in seen:
        for fit, left in (("before", one.left_before), ("after", one.left_after)):
            p = portrait(one.case, left)
            rows.append({
                "recording": p.recording, "split": one.case.split, "fit": fit, "rms": finite(p.rms_mm),
                "normal": finite(p.normal_mm), "warp": finite(p.warp_mm), "weft": finite(p.weft_mm),
                "next_frame": finite(p.next_frame), "unit": "mm",
            })  # fmt: skip
    return rows


def frame_rows(seen: Sequence[Seen]) -> Rows:
    return [
        {**about(one), "time": float(one.case.observation.time[k]), **error}
        for one in seen
        for k, error in enumerate(errors_along(one, axis=1))
    ]


def node_rows(seen: Sequence[Seen]) -> Rows:
    return [
        {**about(one), "u": float(one.case.observation.material[k, 0]), "v": float(one.case.observation.material[k, 1]),
         **error}
        for one in seen
        for k, error in enumerate(errors_along(one, axis=0))
    ]  # fmt: skip


def bin_rows(seen: Sequence[Seen]) -> Rows:
    """Error against how fast a node moves, how hard it is accelerated and how high it is, by the rollout after."""
    motions = [motion(one) for one in seen]
    rows: Rows = []
    for name, unit in (("speed", "m/s"), ("acceleration", "m/s²"), ("height", "m")):
        values = [m[name][one.case.observation.visible] for m, one in zip(motions, seen, strict=True)]
        edges = edges_of(values)
        for one, value in zip(seen, values, strict=True):
            squares = [np.square(left).reshape(-1, 3).sum(axis=1) for left in (one.left_before, one.left_after)]
            place = np.clip(np.searchsorted(edges, value, side="right") - 1, 0, len(edges) - 2)
            place[~np.isfinite(value)] = -1
            for k in range(len(edges) - 1):
                inside = place == k
                rows.append({
                    **about(one), "against": name, "against_unit": unit, "low": float(edges[k]),
                    "high": float(edges[k + 1]), **rms(*(s[inside] for s in squares)),
                })  # fmt: skip
    return rows


def motion(one: Seen) -> dict[str, np.ndarray]:
    """Speed m/s, acceleration m/s² and height m above the lowest point reached (T, N), of the rollout after."""
    time, position = one.case.observation.time, one.after
    nothing = np.full(position.shape[:2], np.nan)
    up = -np.asarray(one.case.scene.gravity, dtype=float)
    height = position @ (up / (np.linalg.norm(up) or 1.0))
    if not np.isfinite(height).any():
        return {"speed": nothing, "acceleration": nothing, "height": nothing}
    out = {"speed": nothing, "acceleration": nothing, "height": height - np.nanmin(height)}
    if len(time) > 2:
        velocity = np.gradient(position, time, axis=0)
        out["speed"] = np.linalg.norm(velocity, axis=-1)
        out["acceleration"] = np.linalg.norm(np.gradient(velocity, time, axis=0), axis=-1)
    return out


def edges_of(values: Sequence[np.ndarray]) -> np.ndarray:
    """Bounds of bins that hold about as many values each; none if there is nothing to sort."""
    known = np.concatenate([v[np.isfinite(v)] for v in values]) if values else np.zeros(0)
    return np.unique(np.quantile(known, np.linspace(0, 1, BINS + 1))) if known.size else np.zeros(1)


def curve_rows(curves: Sequence[Pulled]) -> Rows:
    """Force over stretch, as measured and as the model has it."""
    return [
        {"recording": one.case.name, "split": one.case.split, "stretch": float(s), "force": float(f),
         "before": finite(a), "after": finite(b), "unit": "N"}
        for one in curves
        for s, f, a, b in zip(one.stretch, one.force, one.before, one.after, strict=True)
    ]  # fmt: skip


def stage_rows(outcome: Outcome) -> Rows:
    """The budget by stage."""
    return [{"stage": name, "wall_s": wall_s, "evaluations": count} for name, wall_s, count in outcome.stages]


def drift_rows(outcome: Outcome) -> Rows:
    """Each recording's own fit beside the joint one: what lies outside the joint interval drifts."""
    joint, rows = outcome.base, []
    for recording, fitted in outcome.alone.items():
        at_bound = fitted.at_bound
        for i, p in enumerate(joint.space):
            value, low, high = float(fitted.theta[i]), finite(joint.low[i]), finite(joint.high[i])
            outside = low is not None and high is not None and not low <= value <= high
            rows.append({
                "recording": recording, "name": p.name, "symbol": p.symbol, "unit": p.unit, "scale": p.scale,
                "value": value, "at_bound": bool(at_bound[i]), "joint": float(joint.theta[i]), "low": low,
                "high": high, "outside": outside,
            })  # fmt: skip
    return rows


def about(one: Seen) -> dict[str, Any]:
    return {"recording": one.case.name, "split": one.case.split, "unit": "mm"}


def errors_along(one: Seen, axis: int) -> Iterator[dict[str, Any]]:
    """Errors of each frame (axis 1: over its nodes) or of each node (axis 0: over the frames)."""
    seen = one.case.observation.visible
    squares = [np.square(field_of(one.case, left)).sum(axis=2) for left in (one.left_before, one.left_after)]
    for k in range(seen.shape[1 - axis]):
        inside = seen.take(k, 1 - axis)
        yield rms(*(s.take(k, 1 - axis)[inside] for s in squares))


def rms(before: np.ndarray, after: np.ndarray) -> dict[str, Any]:
    """Errors [mm] from squared distances (n,) m² of n nodes, three coordinates each; None of no nodes."""
    count = 3 * len(before)
    value = [finite(MM * float(np.sqrt(s.sum() / count))) if count else None for s in (before, after)]
    return {"coordinates": count, "before": value[0], "after": value[1]}
