"""Measure, and keep every measurement as a row."""

from __future__ import annotations

import itertools
import time
from typing import Any

from clothbench.engine.rows import about_cell, no_value
from clothbench.engine.study import Context, Result
from clothbench.studies.speed.bench import ASIDE, Row, run_bench
from clothbench.studies.speed.cell import SpeedCell


def run(cell: SpeedCell, context: Context) -> Result:
    began, begun = time.perf_counter(), itertools.count()

    def told(_: str) -> None:
        done = next(begun)
        context.progress(done, float(done))

    rows = run_bench(cell.sides, told, cell.models)
    about = {**about_cell(cell), **no_value(), "wall_s": time.perf_counter() - began}
    measured = {_case(row): row for row in rows if row["peer"] not in ASIDE}
    if not measured:
        return Result("skipped", {"rows": [_row(about, cell.case, None)]})
    found = [_row(about, case, row) for case, row in measured.items()]
    return Result("ok", {"rows": found, "speeds": [_measurement(cell, row) for row in rows]})


def _measurement(cell: SpeedCell, row: Row) -> Row:
    """A row of the table; a model's version is a number, a peer's a text."""
    return {**row, "version": None if row["version"] is None else str(row["version"]), "key": cell.key}


def _case(row: Row) -> str:
    """ "441 nodes, 64 at once, 2 threads, single, integrator=implicit_euler" """
    words = [f"{row['nodes']} nodes", f"{row['batch']} at once", f"{row['threads']} threads", row["precision"]]
    words += [row["options"], row["note"], "at equal error" if row["error_m"] else ""]
    return ", ".join([row["model"], *filter(None, dict.fromkeys(words))])  # at equal error, the note are the options


def _row(about: dict[str, Any], case: str, row: Row | None) -> dict[str, Any]:
    """A row of the leaderboard, where lower is better: the time that a million node-steps take."""
    if row is None:
        return {**about, "unit": None, "status": "skipped", "reason": "no model of sheets is installed",
                "evaluations": 0}  # fmt: skip
    return {
        **about, "case": case.partition(", ")[2], "model": row["model"], "unit": "s", "status": "ok", "reason": "",
        "value": 1e6 / row["node_steps_per_s"], "evaluations": 1,
    }  # fmt: skip
