"""Run one cell of a validation suite: a model in one test, mesh by mesh, beside what mechanics says."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Sequence
from typing import Any

from clothbench.engine.cells import Skipped
from clothbench.engine.rows import about_cell, no_value
from clothbench.engine.store import Store
from clothbench.plugins.discovery import absent, catalogue
from clothbench.studies.mechanics.cell import ValidationCell
from clothbench.studies.mechanics.checks import Answer, Check, Level
from clothbench.studies.mechanics.subject import Subject, with_orders

Told = Callable[[int, float], None]


def validate(store: Store, cell: ValidationCell, told: Told | None = None) -> str:
    """Simulate, measure and store; `told(simulations, value)` after each. Returns the cell's status."""
    plugins, check, began = catalogue(), cell.check, time.perf_counter()
    factory = plugins.load("models", cell.model)
    if reason := absent(factory):
        raise Skipped(reason)
    make = functools.partial(plugins.make, "models", cell.model, **cell.options)
    subject = Subject.of(factory, make, [plugins.make("effects", name) for name in cell.effects])
    levels: list[Level] = []
    late = False
    for level in subject.levels(check, cell.meshes):
        levels.append(level)
        if told is not None:
            told(len(levels), level.value if level.value is not None else float("nan"))
        late = cell.timeout is not None and time.perf_counter() - began > cell.timeout
        if late or level.status == "skipped":
            break
    levels = with_orders(levels)
    answers = check.answers(levels)
    if late and len(levels) < check.count(cell.meshes, subject.takes_scale):
        answers = [_late(a, levels) for a in answers]
    return _keep(store, cell, levels, answers, time.perf_counter() - began)


def _late(answer: Answer, levels: Sequence[Level]) -> Answer:
    reason = f"stopped by the time limit after {len(levels)} simulations, on {levels[-1].along} nodes along the strip"
    return Answer(answer.case, answer.value, answer.reference, "timeout", reason)


def _keep(store: Store, cell: ValidationCell, levels: Sequence[Level], answers: Sequence[Answer], wall: float) -> str:
    shared = {**about_cell(cell), **no_value(), "evaluations": len(levels), "wall_s": wall, "unit": cell.check.row_unit}
    rows = [
        {**shared, "case": a.case, "value": _number(a.value), "reference": a.reference, "status": a.status,
         "reason": a.reason}
        for a in answers
    ]  # fmt: skip
    store.put(cell.key, {"rows": rows, "validation": [_level(cell, cell.check, v) for v in levels]})
    return answers[0].status


def _level(cell: ValidationCell, check: Check, v: Level) -> dict[str, Any]:
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
