"""Run a cell: ask the loop, and make rows, tables and files of what it finds."""

from __future__ import annotations

import dataclasses

import numpy as np

from clothbench.engine.rows import about_cell, no_value
from clothbench.engine.study import Context, Result, Rows
from clothbench.engine.tables import finite
from clothbench.studies.improve.cell import ImproveCell
from clothbench.studies.improve.compiling import compiled_ahead
from clothbench.studies.improve.files import write_files
from clothbench.studies.improve.finding import Finding
from clothbench.studies.improve.fitted import Fitted
from clothbench.studies.improve.loop import improve
from clothbench.studies.improve.prepare import prepare
from clothbench.studies.improve.tables import finding_tables
from clothbench.studies.improve.verdict import pooled


def run(cell: ImproveCell, context: Context) -> Result:
    def told(stage: str, done: int, planned: int) -> None:
        context.stage(stage, done, planned)
        context.progress(done, planned)

    problem = prepare(cell, context.plugins, context.checkpoint, context.kept, context.elsewhere)
    in_loops = () if cell.kind == "curve" else cell.candidates  # a curve is no run in time
    with compiled_ahead(problem, in_loops):
        finding = improve(problem, cell.candidates, told, cell.timeout)
    stated = {
        "bounds": {n: list(ends) for n, ends in cell.bounds.items()}, "resolution": cell.scene.get("resolution"),
        "split_by_seed": cell.split_by_seed,
    }  # fmt: skip
    finding = dataclasses.replace(finding, settings=stated)
    told("page, tables and Rerun files", 0, 1)
    tables = finding_tables(finding)
    rows = leaderboard_rows(cell, finding)
    return Result(
        rows[0]["status"], {"rows": rows, **tables},
        lambda folder: write_files(folder, finding, tables, context.rerun),
    )  # fmt: skip


def leaderboard_rows(cell: ImproveCell, finding: Finding) -> Rows:
    """The error on both splits, in the evidence's base unit: of the calibrated model, and of the model with what was
    named, where anything was.
    """
    about = {**about_cell(cell), **no_value()}
    about |= {
        "unit": finding.evidence.unit.base, "floor": finite(finding.floor), "evaluations": finding.evaluations,
        "wall_s": finding.wall_s, "status": "timeout" if finding.timed_out else "ok", "reason": "",
    }  # fmt: skip
    fits = [(finding.calibrated, pooled([before for _, before, _ in finding.held_out]))]
    if finding.final.effects:
        fits.append((finding.final, pooled([after for _, _, after in finding.held_out])))
    rows: Rows = []
    for fitted, error in fits:
        row = about | {"effects": ",".join((*cell.base, *fitted.effects))}
        rows.append(row | {"split": "fit", "value": finite(fitted.rms)})
        if finding.held_out:
            rows.append(row | {"split": "held_out", "value": finite(error)} | lost(finding, fitted, error))
    return rows


def lost(finding: Finding, fitted: Fitted, error: float | None) -> dict[str, str]:
    """Status and reason of an error on what is held out that is no number; nothing of one that is."""
    if error is not None:
        return {}
    column = 2 if fitted.effects else 1
    name = next(one[0] for one in finding.held_out if not np.isfinite(one[column]))
    return {"status": "diverged", "reason": f"{name}, held out, could not be simulated"}
