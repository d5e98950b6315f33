"""Run a model in one test, mesh by mesh, beside what mechanics says."""

from __future__ import annotations

import functools
import time
from collections.abc import Sequence
from typing import Any

from clothbench.core.optional import absent
from clothbench.engine.cells import Skipped
from clothbench.engine.rows import about_cell, no_value
from clothbench.engine.study import Context, Result
from clothbench.studies.mechanics.cell import MechanicsCell
from clothbench.studies.mechanics.checks import Answer, Check, Level
from clothbench.studies.mechanics.subject import Subject, with_orders


def run(cell: MechanicsCell, context: Context) -> Result:
    """Simulate and measure; the progress counts simulations, with the last value."""
    plugins, check, began = context.plugins, cell.check, time.perf_counter()
    factory = plugins.load("models", cell.model)
    if reason := absent(factory):
        raise Skipped(reason)
    make = functools.partial(plugins.make, "models", cell.model, **cell.options)
    subject = Subject.of(
        factory, make, {wanted: plugins.make("effects", name) for wanted, name in cell.stand_for.items()}
    )
    levels: list[Level] = []
    late = False
    for level in subject.levels(check, cell.meshes):
        levels.append(level)
        context.progress(len(levels), level.value if level.value is not None else float("nan"))
        late = cell.timeout is not None and time.perf_counter() - began > cell.timeout
        if late or (level.status == "skipped" and not level.unresolved):
            break
    levels = with_orders(levels)
    answers = check.answers(levels)
    if late and len(levels) < check.count(cell.meshes, subject.takes_scale):
        answers = [_late(a, levels) for a in answers]
    return _result(cell, levels, answers, time.perf_counter() - began)


def _late(answer: Answer, levels: Sequence[Level]) -> Answer:
    reason = f"stopped by the time limit after {len(levels)} simulations, on {levels[-1].along} nodes along the strip"
    return Answer(answer.case, answer.value, answer.reference, "timeout", reason)


def _result(cell: MechanicsCell, levels: Sequence[Level], answers: Sequence[Answer], wall: float) -> Result:
    shared = {**about_cell(cell), **no_value(), "evaluations": len(levels), "wall_s": wall, "unit": cell.check.row_unit}
    rows = [
        {**shared, "case": a.case, "value": _number(a.value), "reference": a.reference, "status": a.status,
         "reason": a.reason}
        for a in answers
    ]  # fmt: skip
    return Result(answers[0].status, {"rows": rows, "validation": [_level(cell, cell.check, v) for v in levels]})


def _level(cell: MechanicsCell, check: Check, v: Level) -> dict[str, Any]:
    error = v.value - v.reference if v.value is not None else None
    return {
        "case": cell.case, "model": cell.model, "metric": check.metric, "unit": check.unit, "along": v.along,
        "nodes": v.nodes or None, "size": v.size, "step_scale": v.step_scale, "load": v.load,
        "load_name": check.load_name, "value": _number(v.value), "reference": v.reference, "error": _number(error),
        "relative": error / v.reference if error is not None and v.reference else None, "order": v.order,
        "status": v.status, "reason": v.reason, "steps": v.steps, "wall_s": v.wall_s, "key": cell.key,
    }  # fmt: skip


def _number(value: float | None) -> float | None:
    return None if value is None else float(value)
