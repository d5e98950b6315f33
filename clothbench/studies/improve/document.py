"""`verdict.json` (schema 1), from a finding. Here numbers get the unit that errors are reported in."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.files import read_json
from clothbench.engine.tables import finite
from clothbench.studies.improve.evidence import of_split
from clothbench.studies.improve.finding import Finding
from clothbench.studies.improve.fitted import Fitted
from clothbench.studies.improve.selection import Candidate, parameters_of
from clothbench.studies.improve.settings import LOOP
from clothbench.studies.improve.state import Round
from clothbench.studies.improve.verdict import fall_interval, pooled

SCHEMA = 1
VERDICT = "verdict.json"
MILLIMETRES = "mm"  # what `error_mm` and `unexplained_mm` are in; evidence in another unit has nulls there


def verdict_document(finding: Finding) -> dict[str, Any]:
    """The document. Errors are rms over what was measured, pooled over recordings."""
    final, unit = finding.final, finding.evidence.unit
    in_mm = unit.reported == MILLIMETRES
    error, unexplained = error_entry(finding), unit.scale * finding.unexplained
    document = {
        "schema": SCHEMA, "model": finding.model, "base": list(finding.base), "verdict": finding.verdict,
        "effects": effect_entries(finding),
        "error_mm": error if in_mm else nulls(error), "unexplained_mm": unexplained if in_mm else None,
        "hint": finding.hint,
        "description": description_entry(finding, in_mm), "balance": balance_entry(finding),
        "whereabouts": [dict(row) for row in finding.whereabouts],
        "candidates": candidate_entries(finding),
        "condition": finite(np.linalg.cond(final.weighted_jacobian)),
        "evaluations": finding.evaluations, "wall_s": finding.wall_s, "seed": finding.seed,
        "recordings": {split: [c.name for c in of_split(finding.evidence, split)] for split in ("fit", "held_out")},
        "parameters": {name: amount(final, i) for i, name in enumerate(final.space.names)},
        "settings": dict(finding.settings), "key": finding.key,
    }  # fmt: skip
    if in_mm:
        return document
    return document | {
        "kind": finding.evidence.kind, "error": {"unit": unit.reported, **error}, "unexplained": unexplained,
    }  # fmt: skip


def document_in(folder: Path) -> dict[str, Any] | None:
    """The verdict that lies in a folder; None if there is none that can be read."""
    try:
        found = read_json(folder / VERDICT, "a verdict")
    except ClothbenchError:
        return None
    return found if isinstance(found, dict) else None


def error_entry(finding: Finding) -> dict[str, Any]:
    """Errors before and after on both splits, in the reported unit."""
    scale, placebo = finding.evidence.unit.scale, finding.placebo
    before = [scale * error for _, error, _ in finding.held_out]
    after = [scale * error for _, _, error in finding.held_out]
    # Amounts that were fitted to what is held out lower its error whatever they stand for.
    fall = (None, None) if finding.own else fall_interval(before, after)
    return {
        "fit": {"before": scale * finding.calibrated.rms, "after": scale * finding.final.rms},
        "held_out": {
            "before": pooled(before), "after": pooled(after), "ci95": list(fall),
            "per_recording": [
                {"recording": name, "before": finite(b), "after": finite(a)}
                for (name, _, _), b, a in zip(finding.held_out, before, after, strict=True)
            ],
            "placebo": placebo and {"name": placebo.name, "after": pooled([scale * e for e in placebo.errors])},
        },
        "noise": scale * finding.noise, "noise_stated": noise_stated(finding), "mesh": scale * finding.mesh,
        "noise_floor": scale * finding.floor,
    }  # fmt: skip


def noise_stated(finding: Finding) -> bool | None:
    """Whether every fitted recording, or its tracker, states the noise; False where it was told from how neighbouring
    frames jump. None where it is the spread between repeats, runs or specimens.
    """
    evidence = finding.evidence
    return evidence.noise_stated if finding.noise <= evidence.noise() else None


def description_entry(finding: Finding, in_mm: bool) -> dict[str, Any] | None:
    """The law of a force that no effect has a name for; torques are about the grips, rms over recordings left out."""
    if (found := finding.description) is None:
        return None
    law, scale = found.law, finding.evidence.unit.scale
    error = {"held_out": {"before": scale * found.before, "after": scale * found.after}}
    return {
        "formula": law.formula,
        "terms": [
            {"term": a.term.name, "value": a.value, "low": a.low, "high": a.high, "unit": a.term.unit}
            for a in law.amounts
        ],
        "p_value": law.p_value, "error_mm": error if in_mm else nulls(error),
        "torque": {"before": law.before, "after": law.after, "noise": law.noise, "unit": "N·m"},
    }  # fmt: skip


def balance_entry(finding: Finding) -> dict[str, Any] | None:
    """What the torque about the grips goes with, without any model: shares of its mean square that are predicted on
    recordings left out, the kernel over lag, the law, if there is one and the verdict is not that nothing is missing,
    other terms that alone predict as much as its first, and on how many of the fitted recordings it rests: of the
    others a balance would say nothing (`motion_of`).
    """
    if (found := finding.balance) is None:
        return None
    past, law = found.past, None if finding.verdict == "complete" else found.law
    return {
        "shares": dict(past.shares),
        "kernel": {"lag_s": list(past.lag), "value": list(past.value), "low": list(past.low), "high": list(past.high),
                   "unit": "kg/(m²·s)"},
        "formula": law and law.formula, "p_value": law and law.p_value,
        "alike": [term.name for term in law.alike] if law else [],
        "recordings": {"used": found.recordings[0], "of": found.recordings[1]},
    }  # fmt: skip


def nulls(value: Any) -> Any:
    """The same shape with null for every number."""
    if isinstance(value, dict):
        return {key: nulls(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [nulls(inner) for inner in value]
    return value if isinstance(value, str) else None


def amount(fitted: Fitted, i: int) -> dict[str, Any]:
    """Parameter i with its interval, in its unit."""
    return {
        "value": float(fitted.theta[i]), "low": finite(fitted.low[i]), "high": finite(fitted.high[i]),
        "unit": fitted.space.parameters[i].unit, "meaning": fitted.space.parameters[i].meaning,
    }  # fmt: skip


def effect_entries(finding: Finding) -> list[dict[str, Any]]:
    """What was named in each round, with its amounts as the last fit has them."""
    if not finding.final.effects:
        return []
    return [effect_entry(finding, found) for found in finding.rounds if found.named]


def effect_entry(finding: Finding, found: Round) -> dict[str, Any]:
    final, name = finding.final, found.named[0]
    candidate = next(c for c in found.candidates if c.name == name)
    note = finding.notes[name]
    return {
        "name": name, "place": note.place, "summary": note.summary, "family": note.family,
        "parameters": {own: amount(final, i) for own, i in parameters_of(final.space, name).items()},
        "by_recording": own_entries(finding, name),
        "tied_with": list(found.named[1:]), "p_value": candidate.p_value,
        "selected_in": f"{candidate.selected}/{len(final.residual)}",
    }  # fmt: skip


def own_entries(finding: Finding, name: str) -> list[dict[str, Any]] | None:
    """What is each recording's own of an effect; None where one amount holds for all. That of a recording held out was
    fitted to it, with everything that is shared as the others have it.
    """
    if name not in finding.own:
        return None
    split = {case.name: case.split for case in finding.evidence.cases}
    return [
        {
            "recording": recording, "split": split[recording],
            "parameters": {own: amount(fitted, i) for own, i in parameters_of(fitted.space, name).items()},
        }
        for recording, fitted in finding.own[name].items()
    ]  # fmt: skip


def candidate_entries(finding: Finding) -> list[dict[str, Any]]:
    """Every candidate as the round that named it saw it, else the last that tried it; gain: by which the mean square
    fell, squared unit.
    """
    latest: dict[str, dict[str, Any]] = {}
    square, named = finding.evidence.unit.scale**2, set()
    for found in finding.rounds:
        for c in found.candidates:
            if c.name in named:  # what one is tied with is tried again beside it
                continue
            latest[c.name] = {
                "name": c.name, "share": c.share, "gain": finite(square * c.gain), "p_value": c.p_value,
                "why_not": why_not(c, found, finding.dropped),
            }  # fmt: skip
        named |= set(found.named)
    return sorted(latest.values(), key=lambda c: (-(c["gain"] or 0.0), -c["share"]))


def why_not(candidate: Candidate, of: Round, dropped: str) -> str:
    """Why a candidate was not named in a round, or why what was named is no finding after all, `dropped`; "" of what
    the verdict names.
    """
    if candidate.name in of.named:
        return dropped
    if candidate.why_not:
        return candidate.why_not
    if candidate.fitted is None:
        return f"promises too little to first order, or is not among the {LOOP.refitted} that promise most"
    return "another explains more, or as much with as few parameters"
