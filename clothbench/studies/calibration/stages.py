"""A search in stages: on the mesh of the suite, and, where the cell asks for it, on from there on a finer one.

Cloth that folds more finely than its mesh can is too stiff there, and a fit makes up for that with its parameters.
What the step to the finer mesh still moves is what the mesh has to do with them; their intervals are told of it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from clothbench.core.parameters import ParameterSpace
from clothbench.core.progress import Progress
from clothbench.engine.checkpoint import Checkpoint
from clothbench.estimation.calibrate import Fit, calibrate
from clothbench.plugins.discovery import Catalogue
from clothbench.studies.calibration.cell import Bench, CalibrationCell, set_up
from clothbench.studies.calibration.variability import moved


def stages_of(bench: Bench, plugins: Catalogue, kept: Path | None = None) -> list[Bench]:
    """The benches that a cell is searched on, from coarse to fine; it is judged on the last, which is `bench`."""
    if not bench.cell.finer:
        return [bench]
    return [set_up(dataclasses.replace(bench.cell, finer={}), plugins, kept), bench]


def searched(
    stages: Sequence[Bench],
    plugins: Catalogue,
    checkpoint: Checkpoint,
    space: ParameterSpace,
    budget: int,
    seed: int,
    *,
    begin: bool = False,
    looked: int = 0,
    progress: Progress | None = None,
    bounded: bool = True,
    since: float = 0.0,
) -> list[Fit]:
    """The fit of each stage that was begun; the next begins where the one before it ended, if that one came to an end.

    begin: at the space's defaults, without a look around first; looked: what this look took of the budget of another
    search, whose walks are to be as long as these. Only the last has intervals, if `bounded`. since: s on the
    checkpoint's clock from which the cell's timeout counts: other searches of the cell have had time of their own.
    """
    fits: list[Fit] = []
    for bench, evaluations in zip(stages, shared_out(budget, stages[-1].cell, looked), strict=True):
        cell, last = bench.cell, bench is stages[-1]
        told = cell.option(cell.optimizer) | ({"start": "defaults"} if begin or fits else {})
        optimizer = plugins.make("optimizers", cell.optimizer, space, seed=seed, budget=evaluations, **told)
        before = sum(fit.evaluations for fit in fits)
        timeout = None if cell.timeout is None else since + cell.timeout
        fits.append(calibrate(
            bench.of_split("fit"), optimizer, space, timeout=timeout, progress=_after(before, progress),
            checkpoint=checkpoint if last else checkpoint.part("coarse"), choice=cell.choice,
            bounded=bounded and last, budget=evaluations, seed=seed,
        ))  # fmt: skip
        if fits[-1].status != "ok":
            break
        space = moved(space, fits[-1].best)
    return fits


def shared_out(budget: int, cell: CalibrationCell, looked: int = 0) -> list[int]:
    """Evaluations of each stage; the first goes without those that another search looked around with."""
    fine = [min(max(1, round(cell.finer["share"] * budget)), budget - 1)] if cell.finer else []
    return [max(1, budget - sum(fine) - looked), *fine]


def _after(before: int, progress: Progress | None) -> Progress | None:
    """Told of all evaluations, those of earlier stages too."""
    if progress is None or not before:
        return progress
    return lambda done, best: progress(before + done, best)


def with_mesh(coarse: Fit, fine: Fit, cell: CalibrationCell) -> Fit:
    """The finer mesh's fit, with intervals (P,) that reach as much further as the mesh may still move its parameters:
    to first order in the spacing, |fine − coarse| / (h_coarse / h_fine − 1) in the scaled parameter (Richardson).

    Folds near the size of a cell are no place for a higher order.
    """
    space = fine.space
    moved_by = np.abs(space.to_unit(fine.best) - space.to_unit(coarse.best))
    more = moved_by / (cell.scene["spacing"] / cell.finer["spacing"] - 1)
    low, high = (space.from_unit(space.to_unit(end) + side * more) for end, side in ((fine.low, -1), (fine.high, 1)))
    return dataclasses.replace(fine, low=low, high=high, start=coarse.start, looked=coarse.looked)
