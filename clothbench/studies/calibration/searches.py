"""Searches beside each other: several optimizers on one question, each with several seeds, at equal evaluations."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.engine.cells import digest, options_in_use
from clothbench.engine.study import Results
from clothbench.engine.tables import read_table
from clothbench.estimation.front import on_front
from clothbench.estimation.intervals import mean_interval
from clothbench.studies.calibration.ranking import set_otherwise
from clothbench.studies.calibration.schema import HISTORY
from clothbench.studies.calibration.schema import QUESTION as ASKED

LEAST_SEEDS = 3  # of each search, from which on they are compared
WORST = 3.0  # spreads between recordings of the same cloth: the corner that hypervolumes are counted from
GOAL = 0.75  # share of all runs that come to the error that searches are timed to
QUESTION = ("suite", "case", "model", "effects", "metric", "unit", "budget")  # columns of a row
# What of a cell says what was asked, beside those: how it was searched, judged and shown is left out.
MEANT = ("bounds", "scene", "fixed", "tracker", "finer", "start")
Interval = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Search:
    """What one optimizer came to, over its seeds.

    optimizer: with its settings where one was run with several; seeds: of R runs; best: (R, E) least error so far
    after each of E evaluations, NaN where none was known, as on a coarser mesh that the search
    began on; error: mean of the last, with its 95 % interval (Student's t
    over seeds); volume: the same of the hypervolume, None for a metric of one objective; reached, evaluations: in how
    many runs the goal was reached, and the median of how many evaluations that took (infinite where most did not);
    lost: share of evaluations that could not be simulated.
    """

    optimizer: str
    best: np.ndarray
    error: Interval
    volume: Interval | None
    reached: int
    evaluations: float
    lost: float

    @property
    def seeds(self) -> int:
        return len(self.best)


@dataclass(frozen=True)
class Contest:
    """Searches that answered one question with one budget of evaluations.

    goal: the error that three quarters of all their runs came to, in `unit`; budget: "" where it is not known; finer:
    whether searches began on a coarser mesh, whose errors are not compared and whose evaluations count; left_out:
    searches of which a run failed or ended by the clock, so that they are not beside the others: of the seeds that
    happened to come to an end nothing follows for all, and fewer evaluations are another budget.
    """

    case: str
    model: str
    metric: str
    unit: str
    goal: float
    searches: tuple[Search, ...]
    budget: str = ""
    finer: bool = False
    left_out: tuple[str, ...] = ()


def contests(results: Results) -> list[Contest]:
    """Every question that two searches or more were asked with `LEAST_SEEDS` seeds or more, alike in all else: two
    optimizers, or one that was run with several settings. Of one seed one cell counts.
    """
    questions: dict[tuple[str, ...], list[dict[str, Any]]] = {}
    failed: dict[tuple[str, ...], list[dict[str, Any]]] = {}  # which have no unit, and did not keep their question
    for row in results.rows:
        if row["recording"] is None and row["metric"] == row["objective"]:
            about = tuple(str(row.get(name) or "") for name in QUESTION)
            if row["split"] == "fit":
                questions.setdefault((*about, _meant(results, row)), []).append(row)
            elif row["split"] is None:
                failed.setdefault(about, []).append(row)
    out = []
    for (suite, case, model, effects, metric, unit, budget, _), asked in sorted(questions.items()):
        lost = failed.get((suite, case, model, effects, metric, "", budget), [])
        unfinished = {row["key"] for row in lost} | {row["key"] for row in asked if row.get("status", "ok") != "ok"}
        by_optimizer = _by_search([*asked, *lost])
        enough = {name: keys for name, keys in by_optimizer.items() if len(keys) >= LEAST_SEEDS}
        kept = {name: keys for name, keys in enough.items() if not unfinished & set(keys.values())}
        if len(kept) < 2:
            continue
        runs = {name: [_history(results, key) for key in sorted(keys.values())] for name, keys in sorted(kept.items())}
        least = [np.fmin.reduce(r.value) for some in runs.values() for r in some]
        goal = float(np.quantile(least, GOAL, method="inverted_cdf"))  # one that a run did come to, none in between
        found = tuple(_search(name, some, goal) for name, some in runs.items())
        whole = " + ".join([model, *filter(None, effects.split(","))])
        out.append(Contest(case, whole, metric, unit, goal, found, budget,
                           any(r.coarse for some in runs.values() for r in some),
                           tuple(sorted(enough.keys() - kept.keys()))))  # fmt: skip
    return out


def _meant(results: Results, row: dict[str, Any]) -> str:
    """A digest of what its cell was asked, whatever searched for the answer; "" where that was not kept.

    Of plugins those count that make the question: a cell keeps the options of all that its run had, other optimizers
    among them, and the versions of metrics that it only reports.
    """
    path = results.store.cell(row["key"]) / "question.parquet"
    if not path.is_file():
        return ""
    asked = read_table(path, ASKED)["question"].to_pylist()
    try:
        cell = json.loads(asked[0])
        used = [("models", cell["model"]), ("metrics", cell["metric"]), ("trackers", cell["tracker"])]
        used += [("effects", name) for name in cell["effects"]]
        return digest([
            [cell.get(name) for name in MEANT],
            sorted((source["hash"], source["split"]) for source in cell["recordings"]),
            options_in_use(cell["options"], {name for _, name in used}),
            [cell["versions"].get(f"{kind}/{name}") for kind, name in used],
        ])  # fmt: skip
    except (ValueError, LookupError, TypeError, AttributeError):
        raise ClothbenchError(
            f"{path}: 'question' is no calibration as JSON text; remove the cell's folder and run its command again"
        ) from None


def _by_search(rows: Sequence[dict[str, Any]]) -> dict[str, dict[Any, str]]:
    """The cell of each seed of each search: an optimizer, with its settings where it has several."""
    settings: dict[str, set[Any]] = {}
    for row in rows:
        settings.setdefault(row["optimizer"], set()).add(row.get("settings"))
    out: dict[str, dict[Any, str]] = {}
    for row in rows:
        name = row["optimizer"]
        told = f"{name} · {set_otherwise(row)}".removesuffix(" · ") if len(settings[name]) > 1 else name
        out.setdefault(told, {})[row["seed"]] = row["key"]
    return out


def hypervolume(objectives: np.ndarray) -> float:
    """Share of the box from 0 to `WORST` in every objective that some row (E, M) is at least as good as (Zitzler and
    Thiele 1998, Multiobjective optimization using evolutionary algorithms).
    """
    from pymoo.indicators.hv import HV

    count = objectives.shape[1]
    inside = objectives[np.isfinite(objectives).all(axis=1) & (objectives < WORST).all(axis=1)]
    if not len(inside):
        return 0.0
    return float(HV(ref_point=np.full(count, WORST))(inside[on_front(inside)])) / WORST**count


@dataclass(frozen=True, eq=False)
class Run:
    """One cell's search: the error of every evaluation (E,), NaN where it was lost or on a coarser mesh; objectives
    (E, M) on the last mesh, if it has some; coarse: how many evaluations were on the coarser one; lost: their share.
    """

    value: np.ndarray
    objectives: np.ndarray | None
    coarse: int
    lost: float


def _history(results: Results, key: str) -> Run:
    folder = results.store.cell(key)
    table = read_table(folder / "history.parquet", HISTORY)
    names = [name for name in table.column_names if name.startswith("objective:")]
    value, *columns = (table[name].to_numpy().astype(float) for name in ["value", *names])
    before = np.empty(0)
    if (path := folder / "coarse_history.parquet").is_file():
        before = read_table(path, HISTORY)["value"].to_numpy().astype(float)
    lost = float((~np.isfinite(np.concatenate([before, value]))).mean())
    whole = np.concatenate([np.full(len(before), np.nan), np.where(np.isfinite(value), value, np.nan)])
    return Run(whole, np.stack(columns, axis=1) if names else None, len(before), lost)


def _search(name: str, runs: Sequence[Run], goal: float) -> Search:
    length = max(len(r.value) for r in runs)
    best = np.stack([np.pad(np.fmin.accumulate(r.value), (0, length - len(r.value)), mode="edge") for r in runs])
    until = [float(1 + np.argmax(row <= goal)) if (row <= goal).any() else np.inf for row in best]
    volumes = [hypervolume(objectives) for r in runs if (objectives := r.objectives) is not None]
    return Search(
        name, best, _mean(best[:, -1]), _mean(np.array(volumes)) if len(volumes) == len(runs) else None,
        int(np.isfinite(until).sum()), float(np.median(until)), float(np.mean([r.lost for r in runs])),
    )  # fmt: skip


def _mean(values: np.ndarray) -> Interval:
    """A mean with its 95 % interval; nothing is known of it where one of the values is not."""
    if not np.isfinite(values).all():
        return np.nan, np.nan, np.nan
    return float(values.mean()), *mean_interval(list(values), [0.0] * len(values))
