"""What is asked of a finished fit beside its errors; every analysis gives a table of the cell."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from clothbench.core.optional import takes_option
from clothbench.core.parameters import ParameterSpace
from clothbench.engine.checkpoint import Checkpoint
from clothbench.engine.tables import finite
from clothbench.estimation.calibrate import Fit
from clothbench.estimation.trials import evaluate
from clothbench.plugins.discovery import Catalogue, one_line
from clothbench.recordings.nodes import read_recording
from clothbench.studies.calibration.cell import Bench
from clothbench.studies.calibration.sensitivity import error_map, morris, sobol
from clothbench.studies.calibration.stages import searched, stages_of
from clothbench.studies.calibration.variability import repeats, variability

Tables = dict[str, list[dict[str, Any]]]
Options = Mapping[str, Any]


def analyse(bench: Bench, fit: Fit, plugins: Catalogue, checkpoint: Checkpoint) -> Tables:
    """Every analysis that the cell asks for, as tables of the store; one that fails leaves its reason there."""
    tables: Tables = {}
    for name, options in bench.cell.analysis.items():
        try:
            found = ANALYSES[name](bench, fit, options, plugins, checkpoint)
        except Exception as fault:
            found = {TABLE_OF.get(name, name): [{"reason": one_line(fault), "unit": None}]}
        for table, rows in found.items():
            tables.setdefault(table, []).extend(_whole(bench, row) for row in rows)
    return tables


def starts_of(bench: Bench, fit: Fit) -> list[dict[str, Any]]:
    """Error of each fitted recording where the search set out from, beside that of its result."""
    if fit.start is None:
        return []
    trials = bench.of_split("fit")
    theta = np.stack([fit.start, fit.best])
    _, scores = evaluate(trials, theta)
    pairs = zip(trials, scores, strict=True)
    return [
        _whole(bench, {"recording": t.name, "start": finite(s.value[0]), "value": finite(s.value[1])}) for t, s in pairs
    ]


def truth_of(bench: Bench, name: str) -> float | None:
    """What the fitted recordings state as `truth_NAME`, where stand-ins do and agree; a note that is no number states
    nothing.
    """
    fitted = [r for r, s in zip(bench.recordings, bench.cell.recordings, strict=True) if s.split == "fit"]
    stated = {r.notes.get(f"truth_{name}") for r in fitted}
    if len(stated) > 1 or None in stated:
        return None
    try:
        return finite(float(stated.pop() or "nan"))
    except ValueError:
        return None


def _whole(bench: Bench, row: dict[str, Any]) -> dict[str, Any]:
    metric = bench.trials[0].metric
    about = {"case": bench.cell.case, "key": bench.cell.key, "metric": metric.name}
    return {**about, **row, **{k: metric.unit for k in ("unit", "error_unit") if k not in row}}


def _variability(bench: Bench, fit: Fit, options: Options, plugins: Catalogue, checkpoint: Checkpoint) -> Tables:
    found, behind = variability(bench.of_split("fit"), bench.space, fit.best, options["points"], checkpoint)
    return {"variability": found, "perturbations": behind}


def _repeats(bench: Bench, fit: Fit, options: Options, plugins: Catalogue, checkpoint: Checkpoint) -> Tables:
    cell = bench.cell
    if not takes_option(plugins.load("optimizers", cell.optimizer), "start"):
        reason = f"optimizer {cell.optimizer!r} cannot begin at a given start"
        return {"repeats": [{"repeat": 0, "reason": reason, "unit": None}]}
    stages = stages_of(bench, plugins)

    def search(space: ParameterSpace, seed: int) -> Fit:
        # As long a walk as the fit's own, which looked around first, also where the clock stopped it; and of the same
        # time again where the run was stopped and goes on.
        since = float(checkpoint.once(f"since-{seed}", lambda: {"seconds": np.array(checkpoint.seconds)})["seconds"])
        return searched(
            stages, plugins, checkpoint, space, cell.budget, seed, begin=True, looked=fit.looked, bounded=False,
            since=since,
        )[-1]  # fmt: skip

    seed = cell.stream("repeats") % 2**32
    return {"repeats": repeats(bench.of_split("fit"), bench.space, fit, options["count"], seed, search, checkpoint)}


def _sensitivity(method: Callable[..., list[dict[str, Any]]], size: str) -> Callable[..., Tables]:
    def work(bench: Bench, fit: Fit, options: Options, plugins: Catalogue, checkpoint: Checkpoint) -> Tables:
        seed = bench.cell.stream("sensitivity", search=False)  # asked of the whole range, whoever searches it
        return {"sensitivity": method(bench.of_split("fit"), bench.space, options[size], seed, checkpoint)}

    return work


def _map(bench: Bench, fit: Fit, options: Options, plugins: Catalogue, checkpoint: Checkpoint) -> Tables:
    names = options["parameters"]
    if len(names) != 2 or not set(names) <= set(bench.space.names):
        reason = f"needs two of the parameters {', '.join(bench.space.names)}; asked for {', '.join(names)}"
        return {"map": [{"reason": reason}]}
    return {"map": error_map(bench.of_split("fit"), bench.space, fit.best, names, options["points"], checkpoint)}


def _confusion(bench: Bench, fit: Fit, options: Options, plugins: Catalogue, checkpoint: Checkpoint) -> Tables:
    """The same parameters, and the mass of their own fabric, in the other fabrics' trials; and in its own."""
    if not bench.cell.rivals:
        return {"confusion": [{"reason": "found no other fabric in the same trial, expected one that is fitted, too"}]}
    mine = bench.recordings[0]
    density = bench.cell.scene.get("areal_density") if np.isnan(mine.areal_density) else mine.areal_density
    fabric, rows = mine.fabric, []
    wanted = {s.name.partition("/")[2] for s in bench.cell.rivals}
    # Of a trial the cell's own names tell, in which recordings of one name in several cases have the case before it.
    both = zip(bench.trials, bench.recordings, strict=True)
    own = [(t.name, t, r) for t, r in both if t.name.partition("/")[2] in wanted]
    others = [(s.name, read_recording(s.file)) for s in bench.cell.rivals]
    for name, trial, recording in own + [(name, bench.remake(r, density), r) for name, r in others]:
        value = evaluate([trial], fit.best[None])[0].value[0]
        rows.append({
            "fabric": fabric, "recording": name, "recorded_fabric": recording.fabric,
            "trial": name.partition("/")[2], "value": finite(value),
        })  # fmt: skip
    return {"confusion": rows}


TABLE_OF = {"morris": "sensitivity", "sobol": "sensitivity"}  # the others fill tables of their own names
ANALYSES: dict[str, Callable[[Bench, Fit, Options, Catalogue, Checkpoint], Tables]] = {
    "variability": _variability,
    "repeats": _repeats,
    "morris": _sensitivity(morris, "trajectories"),
    "sobol": _sensitivity(sobol, "samples"),
    "map": _map,
    "confusion": _confusion,
}
