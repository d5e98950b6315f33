"""Tables of sheets: the residual by frame, node, direction and motion, before and after."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clothbench.core.observation import Observation
from clothbench.engine.tables import finite
from clothbench.studies.improve.evidence import Comparison, Rows, Unit

BINS = 8  # of speed, acceleration and height, with equal numbers of coordinates


@dataclass(frozen=True)
class ResidualSummary:
    """One recording's residual, in its base unit.

    rms: over coordinates;
    normal, warp, weft: rms of its component along each, over nodes of which all three are known; NaN without any;
    next_frame: correlation of one frame with the next, 0 for noise.
    """

    rms: float
    normal: float
    warp: float
    weft: float
    next_frame: float


def sheet_tables(comparisons: Sequence[Comparison], unit: Unit) -> Mapping[str, Rows]:
    return {
        "portrait": portrait_rows(comparisons, unit),
        "against": bin_rows(comparisons, unit),
        "frames": frame_rows(comparisons, unit),
        "nodes": node_rows(comparisons, unit),
    }


def summary(case: Any, residual: np.ndarray) -> ResidualSummary:
    """Of a case's residual (M,)."""
    field, seen = case.field(residual), case.observation.visible
    frames = directions(case.observation)
    known = seen & frames[0].any(axis=-1)
    squares = [np.square(np.sum(field * d, axis=-1)[known]) for d in frames]
    normal, warp, weft = (float(np.sqrt(s.mean())) if s.size else np.nan for s in squares)
    both = seen[1:] & seen[:-1]
    product = float(np.mean(np.sum((field[1:] * field[:-1])[both], axis=-1))) / case.observation.coordinates
    square = float(np.mean(residual**2))
    return ResidualSummary(square**0.5, normal, warp, weft, product / square)


def directions(observation: Observation) -> list[np.ndarray]:
    """Unit vectors (T, N, 3) along the sheet's normal, along warp, and in the sheet across warp, which is along weft
    where the sheet is not sheared; from the nodes nearest in u and in v, 0 where these were not seen.
    """
    material, position = observation.material, observation.position
    out = []
    for axis in range(2):
        along = material[:, axis][None] - material[:, axis][:, None]
        beside = np.abs(material[:, 1 - axis][None] - material[:, 1 - axis][:, None])
        cost = np.where(along > 1e-9, along + 10 * beside, np.inf)
        after = np.where(np.isfinite(cost.min(axis=1)), cost.argmin(axis=1), np.arange(len(material)))
        cost = np.where(along < -1e-9, -along + 10 * beside, np.inf)
        before = np.where(np.isfinite(cost.min(axis=1)), cost.argmin(axis=1), np.arange(len(material)))
        out.append(_unit_vectors(np.nan_to_num(position[:, after] - position[:, before])))
    warp, weft = out
    normal = _unit_vectors(np.cross(warp, weft))
    return [normal, warp, np.cross(normal, warp)]


def _unit_vectors(vectors: np.ndarray) -> np.ndarray:
    size = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.divide(vectors, size, out=np.zeros_like(vectors), where=size > 0)


def portrait_rows(comparisons: Sequence[Comparison], unit: Unit) -> Rows:
    rows: Rows = []
    for one in comparisons:
        for fit, residual in (("before", one.residual_before), ("after", one.residual_after)):
            s = summary(one.case, residual)
            sizes = {name: finite(unit.scale * getattr(s, name)) for name in ("rms", "normal", "warp", "weft")}
            rows.append({**about(one, unit), "fit": fit, **sizes, "next_frame": finite(s.next_frame)})
    return rows


def frame_rows(comparisons: Sequence[Comparison], unit: Unit) -> Rows:
    return [
        {**about(one, unit), "time": float(one.case.observation.time[k]), **error}
        for one in comparisons
        for k, error in enumerate(errors_along(one, 1, unit))
    ]


def node_rows(comparisons: Sequence[Comparison], unit: Unit) -> Rows:
    return [
        {**about(one, unit), "u": float(u), "v": float(v), **error}
        for one in comparisons
        for (u, v), error in zip(one.case.observation.material, errors_along(one, 0, unit), strict=True)
    ]


def bin_rows(comparisons: Sequence[Comparison], unit: Unit) -> Rows:
    """Error against how fast a node moves, how hard it is accelerated and how high it is, by the rollout after."""
    motions = [motion(one) for one in comparisons]
    rows: Rows = []
    for name, of in (("speed", "m/s"), ("acceleration", "m/s²"), ("height", "m")):
        values = [m[name][one.case.observation.visible] for m, one in zip(motions, comparisons, strict=True)]
        edges = edges_of(values)
        for one, value in zip(comparisons, values, strict=True):
            measured = one.case.observation.coordinates
            squares = [
                np.square(r).reshape(-1, measured).sum(axis=1) for r in (one.residual_before, one.residual_after)
            ]
            place = np.clip(np.searchsorted(edges, value, side="right") - 1, 0, len(edges) - 2)
            place[~np.isfinite(value)] = -1
            for k in range(len(edges) - 1):
                inside = place == k
                rows.append({
                    **about(one, unit), "against": name, "against_unit": of, "low": float(edges[k]),
                    "high": float(edges[k + 1]), **errors([s[inside] for s in squares], measured, unit),
                })  # fmt: skip
    return rows


def motion(one: Comparison) -> dict[str, np.ndarray]:
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


def about(one: Comparison, unit: Unit) -> dict[str, Any]:
    return {"recording": one.case.name, "split": one.case.split, "unit": unit.reported}


def errors_along(one: Comparison, axis: int, unit: Unit) -> Iterator[dict[str, Any]]:
    """Errors of each frame (axis 1: over its nodes) or of each node (axis 0: over the frames)."""
    seen = one.case.observation.visible
    squares = [np.square(one.case.field(r)).sum(axis=2) for r in (one.residual_before, one.residual_after)]
    for k in range(seen.shape[1 - axis]):
        inside = seen.take(k, 1 - axis)
        yield errors([s.take(k, 1 - axis)[inside] for s in squares], one.case.observation.coordinates, unit)


def errors(squares: Sequence[np.ndarray], measured: int, unit: Unit) -> dict[str, Any]:
    """Errors before and after from squared distances (n,) m² of n nodes, of which so many coordinates were measured;
    None of no nodes.
    """
    count = measured * len(squares[0])
    before, after = (finite(unit.scale * float(np.sqrt(s.sum() / count))) if count else None for s in squares)
    return {"coordinates": count, "before": before, "after": after}
