"""What every row of the leaderboard carries whatever was run: what it is about, on which machine, or why it failed."""

from __future__ import annotations

from typing import Any

from clothbench.core.parallel import thread_count
from clothbench.engine.cells import listed
from clothbench.engine.study import Cell, Result
from clothbench.engine.system import now, system_info


def failure(cell: Cell, status: str, reason: str, evaluations: int = 0, wall_s: float = 0.0) -> Result:
    """A cell that has no result: one row for each of its cases, with the reason in place of a number."""
    row = {**about_cell(cell), **no_value(), "status": status, "reason": reason, "unit": None}
    row |= {"evaluations": evaluations, "wall_s": wall_s}
    return Result(status, {"rows": [{**row, "case": case} for case in cell.cases]})


def about_cell(cell: Cell) -> dict[str, Any]:
    return {
        "study": cell.study,
        "suite": cell.suite,
        "case": cell.case,
        "model": cell.model,
        "effects": ",".join(cell.effects),
        "optimizer": cell.optimizer,
        "metric": cell.metric,
        "seed": cell.seed,
        "key": cell.key,
        "plugins": listed(cell.versions),
        "objective": cell.metric,
        "budget": None,
        "settings": None,
        **cell.row_columns,
        "threads": thread_count(),
        "finished": now(),
        **system_info(),
    }


def no_value() -> dict[str, Any]:
    return dict.fromkeys(("value", "low", "high", "floor", "reference", "recording", "split"))
