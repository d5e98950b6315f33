"""Run a calibration: fit the parameters, score them on every recording, and ask what else is asked of the fit."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from clothbench.core.errors import ClothbenchError, one_line
from clothbench.core.observation import Observation
from clothbench.core.optional import ShowsSteps, objectives_of
from clothbench.core.protocols import Metric, Score
from clothbench.core.rollout import Rollout
from clothbench.engine.rows import about_cell, failure, no_value
from clothbench.engine.study import Context, Result
from clothbench.engine.tables import finite
from clothbench.estimation.calibrate import Fit, best_rollout
from clothbench.estimation.intervals import interval_of, mean_of_split
from clothbench.estimation.trials import Trial, checked_score, evaluate, score_of
from clothbench.recordings.colour_video import ColourVideo
from clothbench.recordings.kinds import read_sheet
from clothbench.recordings.nodes import Recording
from clothbench.recordings.silhouette import Silhouettes
from clothbench.recordings.tracked import Images
from clothbench.studies.calibration.analysis import analyse, starts_of, truth_of
from clothbench.studies.calibration.cell import Bench, CalibrationCell, asked, options_for, set_up
from clothbench.studies.calibration.cloth import films_of, write_films
from clothbench.studies.calibration.drapes import write_drapes
from clothbench.studies.calibration.frames import at_most, write_frames
from clothbench.studies.calibration.schema import DRAPES, FILMS, FRAMES, PICTURES
from clothbench.studies.calibration.stages import searched, stages_of, with_mesh


def run(cell: CalibrationCell, context: Context) -> Result:
    """Search, on the fit recordings together, and score what was found on all of them."""
    bench = set_up(cell, context.plugins, context.kept)
    stages = stages_of(bench, context.plugins, context.kept)
    fits = searched(
        stages, context.plugins, context.checkpoint, bench.space, cell.budget, cell.stream("optimizer"),
        progress=context.progress,
    )  # fmt: skip
    # A search that was stopped on the coarse mesh is judged there; it is this cell's result all the same.
    bench = dataclasses.replace(stages[len(fits) - 1], cell=cell)
    fit, spent = fits[-1], sum(fit.evaluations for fit in fits)
    if fit.status == "diverged":
        status, reason = _why_lost(bench, fit)
        return failure(cell, status, reason, evaluations=spent, wall_s=fit.wall_s)
    if len(fits) > 1:
        fit = with_mesh(fits[0], fit, cell)
    return _scored(bench, fit, fits[:-1], context)


def _scored(bench: Bench, fit: Fit, before: Sequence[Fit], context: Context) -> Result:
    """All tables of the best parameters; before: fits of coarser meshes that the search began on."""
    rollouts = [best_rollout(t, fit) for t in bench.trials]
    rows, trace = [], []
    fitted: list[Score] = []
    spent = fit.evaluations + sum(one.evaluations for one in before)
    for metric in [bench.trials[0].metric, *bench.others]:
        refused: dict[str, str] = {}
        scores = [_score(bench, t, metric, r, refused) for t, r in zip(bench.trials, rollouts, strict=True)]
        fitted = fitted or scores
        rows += _rows_of(bench, fit, spent, metric, scores, rollouts, refused)
        trace += _trace_of(bench, metric, scores)
    tables = {
        "rows": rows,
        "parameters": _parameters_of(bench, fit),
        "question": [{"question": asked(bench.cell), "key": bench.cell.key}],
        "history": _history_of(bench, fit),
        "trace": trace,
    }
    if before:
        tables["coarse_history"] = _history_of(bench, before[0])
    if fit.objectives is not None:
        tables["front"] = _front_of(bench, fit, fitted)
    if bench.cell.published:
        tables["published"] = _published_of(bench)
    tables |= {"starts": starts_of(bench, fit)} | analyse(bench, fit, context.plugins, context.checkpoint)
    films = films_of(bench, fit, rollouts)

    def attach(folder: Path) -> None:
        from clothbench.studies.calibration.rerun_file import write_rerun

        raw, seen = read_sheet(bench.cell.recordings[0].file), bench.trials[0].observation
        if not isinstance(raw, Recording):
            write_pictures(folder / PICTURES, raw, seen, bench.cell, context)
        if isinstance(raw, ColourVideo) and seen.sight is not None:
            write_frames(folder / FRAMES, raw.frames(), seen, rollouts[0])
        if isinstance(raw, Silhouettes):
            write_drapes(folder / DRAPES, bench.cell.recordings, bench.trials, rollouts)
        if films:
            write_films(folder / FILMS, films)
        if context.rerun:
            write_rerun(folder / "fit.rrd", bench, rollouts)

    return Result(fit.status, tables, attach)


def _score(bench: Bench, trial: Trial, metric: Metric, rollout: Rollout, refused: dict[str, str]) -> Score:
    """The metric on this trial; no number, with the reason in `refused` by the trial's name, where one that is only
    reported refuses it: what was searched for is known, and stays.
    """
    if metric is bench.trials[0].metric:
        return score_of(trial, metric, rollout)
    try:
        given = metric(trial.observation, rollout)
    except ClothbenchError as fault:
        refused[trial.name] = one_line(str(fault))
        return Score(np.full(len(rollout.status), np.nan), metric.unit)
    return checked_score(given, metric, rollout)


def write_pictures(
    folder: Path, raw: Images | Silhouettes, seen: Observation, cell: CalibrationCell, context: Context
) -> None:
    """What the tracker's steps make of the middle frame of a recording of images, where it shows them."""
    import cv2

    options = options_for(cell, context.plugins, "trackers", cell.tracker)
    tracker = context.plugins.make("trackers", cell.tracker, **options)
    if not isinstance(tracker, ShowsSteps):
        return
    folder.mkdir()
    middle = len(raw.image if isinstance(raw, Silhouettes) else raw.time) // 2
    for number, (name, picture) in enumerate(tracker.pictures(raw, middle, seen).items()):
        cv2.imwrite(str(folder / f"{number} {name}.png"), cv2.cvtColor(at_most(picture), cv2.COLOR_RGB2BGR))


LOOKED_AT = 8  # parameter sets that are simulated again, where none came to a number


def _why_lost(bench: Bench, fit: Fit) -> tuple[str, str]:
    """Status and reason of a cell in which no parameters that were tried came to a number: what the model says of its
    own default parameters, unless some of those that were tried can be simulated, so that it was the metric.
    """
    some = fit.theta[:: -(-len(fit.theta) // LOOKED_AT)]
    runs = [trial.simulation.run(np.vstack([bench.space.defaults, some])) for trial in bench.of_split("fit")]
    for number in range(1, len(some) + 1):
        if all(rollout.status[number] == "ok" for rollout in runs):
            if not all(np.isfinite(rollout.position[number]).all() for rollout in runs):
                model = bench.cell.model
                return "error", f"model {model!r} says 'ok' of positions that are not finite, expected 'diverged'"
            metric = bench.trials[0].metric.name
            return "error", (
                f"metric {metric!r} gave no finite number for any parameter set, also where the cloth was simulated to "
                "the end; choose another, or mend it"
            )
    for rollout in runs:
        if rollout.status[0] != "ok":
            return "diverged", rollout.reasons[0] if rollout.reasons else rollout.status[0]
    return "diverged", "no parameter set that was tried could be simulated"


def _rows_of(
    bench: Bench, fit: Fit, spent: int, metric: Metric, scores: Sequence[Score], rollouts: Sequence[Rollout],
    refused: Mapping[str, str],
) -> list[dict[str, Any]]:  # fmt: skip
    """One row per recording, then one per split over its recordings. spent: evaluations on all meshes; refused: why the
    metric cannot be computed on a trial, by its name.
    """
    cell = bench.cell
    about = {**about_cell(cell), **no_value(), "metric": metric.name, "unit": metric.unit}
    about |= {"evaluations": spent, "wall_s": fit.wall_s}
    rows = []
    for source, trial, score, rollout in zip(cell.recordings, bench.trials, scores, rollouts, strict=True):
        low, high, floor = np.nan, np.nan, np.nan
        if trial.name not in refused:
            low, high = interval_of(metric, score, trial.observation, rollout, cell.stream(source.hash))
            floor = metric.floor(trial.observation)
        status, reason = _status(fit, score, rollout, metric is bench.trials[0].metric, refused.get(trial.name))
        rows.append(
            {
                **about,
                "recording": source.name,
                "split": source.split,
                "value": finite(score.value[0]),
                "low": finite(low),
                "high": finite(high),
                "floor": finite(floor),
                "status": status,
                "reason": reason,
            }
        )
    return rows + [
        _total(about, [r for r in rows if r["split"] == split])
        for split in ("fit", "held_out")
        if bench.of_split(split)
    ]


def _status(fit: Fit, score: Score, rollout: Rollout, searched: bool, refused: str | None) -> tuple[str, str]:
    """What came of one recording, and why; where all went well, why the search ended: at its budget it might have gone
    on. searched: by this metric; another that has nothing to say of a recording, as fold lines of cloth that no camera
    saw, is no fault for which the cell would have to be run again. refused: why, where it said so itself.
    """
    if rollout.status[0] != "ok":
        return rollout.status[0], rollout.reasons[0] if rollout.reasons else ""
    if not np.isfinite(score.value[0]):
        return "error" if searched else "skipped", refused or "the metric could not be computed on this recording"
    return fit.status, one_line(str(fit.stopped))  # of anybody's optimizer


def _total(about: dict[str, Any], rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The mean over the recordings of one split; without a number if one of them has none."""
    total = {**about, "recording": None, "split": rows[0]["split"]}
    bad = [r for r in rows if r["value"] is None]
    if bad:
        return {**total, "status": bad[0]["status"], "reason": f"{bad[0]['recording']}: {bad[0]['reason']}"}
    return {**total, **mean_of_split(rows), "status": rows[0]["status"], "reason": rows[0]["reason"]}


def _trace_of(bench: Bench, metric: Metric, scores: Sequence[Score]) -> list[dict[str, Any]]:
    return [
        {
            "recording": s.name,
            "split": s.split,
            "metric": metric.name,
            "time": float(t),
            "value": finite(v),
            "unit": metric.unit,
        }
        for s, trial, score in zip(bench.cell.recordings, bench.trials, scores, strict=True)
        if score.per_frame is not None
        for t, v in zip(trial.observation.time, score.per_frame[0], strict=True)
    ]


def _parameters_of(bench: Bench, fit: Fit) -> list[dict[str, Any]]:
    return [
        {
            "name": p.name,
            "symbol": p.symbol,
            "unit": p.unit,
            "value": finite(fit.best[i]),
            "low": finite(fit.low[i]),
            "high": finite(fit.high[i]),
            "at_bound": bool(fit.at_bound[i]),
            "start": None if fit.start is None else finite(fit.start[i]),
            "truth": truth_of(bench, p.name),
            "lower": p.bounds[0],
            "upper": p.bounds[1],
            "scale": p.scale,
            "meaning": p.meaning,
            "condition": None if np.isnan(fit.condition) else fit.condition,  # infinite where nothing is determined
            "key": bench.cell.key,
        }
        for i, p in enumerate(fit.space)
    ]


def _published_of(bench: Bench) -> list[dict[str, Any]]:
    """The paper's figures of those metrics that were asked for, each in the unit that the suite states."""
    metrics = {m.name: m for m in (bench.trials[0].metric, *bench.others)}
    rows = []
    for metric, figures in bench.cell.published.items():
        for name, told in figures.items() if metric in metrics else ():
            value, _, unit = str(told).partition(" ")
            figure = {"value": float(value), "unit": unit or metrics[metric].unit}
            rows.append({"metric": metric, "name": name, **figure, "key": bench.cell.key})
    return rows


def _history_of(bench: Bench, fit: Fit):
    import pandas as pd

    names = [o.name for o in objectives_of(bench.trials[0].metric)]
    several = {} if fit.objectives is None else dict(zip(names, fit.objectives.T, strict=True))
    cooling = {} if fit.temperature is None else {"temperature": fit.temperature}
    return pd.DataFrame(
        {
            "evaluation": np.arange(1, fit.evaluations + 1),
            "value": fit.value,
            **cooling,
            **{f"objective:{name}": column for name, column in several.items()},
            **dict(zip(fit.space.names, fit.theta.T, strict=True)),
        }
    )


def _front_of(bench: Bench, fit: Fit, scores: Sequence[Score]) -> list[dict[str, Any]]:
    """Every objective of every evaluation on the front, in units of the spread and in its own.

    scores: of the metric that was fitted, one for each recording.
    """
    assert fit.objectives is not None
    distance = _distances(bench, fit, scores)
    return [
        {
            "evaluation": int(k) + 1,
            "value": finite(fit.value[k]),
            "chosen": bool((fit.theta[k] == fit.best).all()),
            "objective": objective.name,
            "unit": objective.unit,
            "distance": finite(distance[n, m]),
            "spreads": finite(fit.objectives[k, m]),
            "key": bench.cell.key,
        }
        for n, k in enumerate(fit.front)
        for m, objective in enumerate(objectives_of(bench.trials[0].metric))
    ]


def _distances(bench: Bench, fit: Fit, scores: Sequence[Score]) -> np.ndarray:
    """Every objective (K, M) on the front in its own unit: the mean of the recordings' own distances. An objective of
    several recordings is the mean over them in units of each one's spread, of which no spread makes that again.
    """
    assert fit.objectives is not None
    if len(trials := bench.of_split("fit")) > 1:
        own = [s.objectives for s in evaluate(trials, fit.theta[fit.front])[1] if s.objectives is not None]
        return np.mean(own, axis=0)
    spread = next(s.spread for source, s in zip(bench.cell.recordings, scores, strict=True) if source.split == "fit")
    assert spread is not None
    return fit.objectives[fit.front] * spread
