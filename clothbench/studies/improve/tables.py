"""Rows of the tables that `clothbench improve` writes (columns: `improve.schema`), from a finding."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from clothbench.core.statistics import repeated, standing_out
from clothbench.engine.tables import finite
from clothbench.studies.improve.document import why_not
from clothbench.studies.improve.evidence import Rows, of_split
from clothbench.studies.improve.finding import Finding
from clothbench.studies.improve.fitted import Fitted
from clothbench.studies.improve.schema import IMPROVE_TABLES

DRIFT_LEVEL = 0.05  # probability that by chance any parameter of any recording is told to stand out


def finding_tables(finding: Finding) -> Mapping[str, Rows]:
    """Every table by name; one that this kind of evidence has not is empty."""
    own: dict[str, Rows] = {
        "candidates": candidate_rows(finding),
        "parameters": parameter_rows("before", finding.calibrated) + parameter_rows("after", finding.final),
        "errors": error_rows(finding),
        "stages": stage_rows(finding),
        "drift": drift_rows(finding),
        "whereabouts": [dict(row) for row in finding.whereabouts],
        "kernel": kernel_rows(finding),
    }
    shown = finding.evidence.tables(finding.comparisons)
    return {name: [] for name in IMPROVE_TABLES} | own | dict(shown)


def candidate_rows(finding: Finding) -> Rows:
    """Every candidate of every round, the most promising first."""
    rows: Rows = []
    unit = finding.evidence.unit
    for turn, one in enumerate(finding.rounds, 1):
        for c in one.candidates:
            note, why = finding.notes[c.name], why_not(c, one, finding.dropped)
            rows.append({
                "round": turn, "name": c.name, "place": note.place, "summary": note.summary, "share": c.share,
                "p_value": c.p_value, "gain": finite(unit.scale**2 * c.gain), "unit": f"{unit.reported}²",
                "selected": c.selected, "of": len(one.before.residual), "why_not": why,
                "named": not why,
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


def error_rows(finding: Finding) -> Rows:
    """Each recording's error before and after, the same numbers as in the verdict."""
    unit = finding.evidence.unit
    names = [case.name for case in of_split(finding.evidence, "fit")]
    squares = zip(names, finding.calibrated.mean_squares, finding.final.mean_squares, strict=True)
    rows: list[tuple[str, str, float, float]] = [
        (name, "fit", float(a) ** 0.5, float(b) ** 0.5) for name, a, b in squares
    ]
    rows += [(name, "held_out", a, b) for name, a, b in finding.held_out]
    return [
        {"recording": name, "split": split, "unit": unit.reported, "before": finite(unit.scale * a),
         "after": finite(unit.scale * b), "floor": unit.scale * finding.floor}
        for name, split, a, b in rows
    ]  # fmt: skip


def kernel_rows(finding: Finding) -> Rows:
    """The kernel of the missing force over lag."""
    if finding.balance is None:
        return []
    past = finding.balance.past
    return [
        {"lag": lag, "value": value, "low": low, "high": high}
        for lag, value, low, high in zip(past.lag, past.value, past.low, past.high, strict=True)
    ]


def stage_rows(finding: Finding) -> Rows:
    """What each stage took."""
    return [{"stage": name, "wall_s": wall_s, "evaluations": count} for name, wall_s, count in finding.stages]


def drift_rows(finding: Finding) -> Rows:
    """Each recording's own fit beside the joint one, whose interval is that of a mean: a single recording drifts where
    it stands out of the spread of single ones. All parameters are asked about at once, so that each pays for all.
    """
    joint = finding.calibrated
    rows: list[dict[str, Any]] = []
    theta = np.array([fitted.theta for fitted in finding.alone.values()])
    drifts = np.zeros(theta.shape, dtype=bool)
    for i, column in enumerate(theta.T):
        moved = ~repeated(column, float(joint.theta[i]))
        alone = np.array([joint.space.to_unit(one)[i] for one in theta[moved]])
        drifts[moved, i] = standing_out(alone, DRIFT_LEVEL / theta.shape[1])
    for (recording, fitted), drifting in zip(finding.alone.items(), drifts, strict=True):
        at_bound = fitted.at_bound
        for i, p in enumerate(joint.space):
            value, low, high = float(fitted.theta[i]), finite(joint.low[i]), finite(joint.high[i])
            rows.append({
                "recording": recording, "name": p.name, "symbol": p.symbol, "unit": p.unit, "scale": p.scale,
                "value": value, "at_bound": bool(at_bound[i]), "joint": float(joint.theta[i]), "low": low,
                "high": high, "outside": bool(drifting[i]),
            })  # fmt: skip
    return rows
