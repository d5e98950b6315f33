"""What every row of the leaderboard carries whatever was run: what it is about, on which machine, or why it failed."""

from __future__ import annotations

from typing import Any

from clothbench.core.parallel import thread_count
from clothbench.engine.store import Store, now, system_info
from clothbench.studies.calibration.cell import Cell
from clothbench.studies.folding.cell import FoldCell
from clothbench.studies.mechanics.cell import ValidationCell

AnyCell = Cell | ValidationCell | FoldCell


def keep_failure(
    store: Store, cell: AnyCell, status: str, reason: str, detail: str = "", evaluations: int = 0, wall_s: float = 0.0
) -> str:
    """Store a cell that has no result: one row for each of its cases, with the reason in place of a number."""
    row = {**about_cell(cell), **no_value(), "status": status, "reason": reason, "unit": None}
    row |= {"evaluations": evaluations, "wall_s": wall_s}
    extra = (lambda folder: (folder / "traceback.txt").write_text(detail)) if detail else None
    store.put(cell.key, {"rows": [{**row, "case": case} for case in cell.cases]}, extra)
    return status


def about_cell(cell: AnyCell) -> dict[str, Any]:
    plugins = "; ".join(f"{k} ({v})" for k, v in sorted(cell.versions.items()))
    return {
        "suite": cell.suite,
        "case": cell.case,
        "model": cell.model,
        "effects": ",".join(cell.effects),
        "optimizer": cell.optimizer,
        "metric": cell.metric,
        "seed": cell.seed,
        "key": cell.key,
        "plugins": plugins,
        "objective": cell.metric,
        "budget": cell.budget if isinstance(cell, Cell) else None,
        "settings": cell.settings if isinstance(cell, Cell) else None,
        "threads": thread_count(),
        "finished": now(),
        **system_info(),
    }


def no_value() -> dict[str, Any]:
    return dict.fromkeys(("value", "low", "high", "floor", "reference", "recording", "split"))
