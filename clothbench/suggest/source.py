"""What is asked about, from settings, from a verdict, or from a cell of a run."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from clothbench.core.errors import ClothbenchError
from clothbench.engine.checkpoint import Checkpoint
from clothbench.engine.run import TRACKED
from clothbench.engine.store import Store
from clothbench.engine.suite import plan
from clothbench.plugins.discovery import Catalogue
from clothbench.recordings.nodes import Recording
from clothbench.recordings.scenes import scenes_of
from clothbench.studies.calibration.cell import asked_and_fitted, set_up
from clothbench.studies.calibration.moved import found_again
from clothbench.studies.improve.cell import ImproveCell
from clothbench.studies.improve.document import VERDICT, document_in
from clothbench.studies.improve.prepare import prepare
from clothbench.studies.improve.problem import Problem
from clothbench.studies.improve.sheets import SheetCase, SheetEvidence

FITS = "fits"  # folder below `out`: what was fitted, so that the same question is not searched again


def problem_of_settings(settings: dict[str, Any], plugins: Catalogue, out: Path) -> Problem:
    """Recordings and a model, as `improve` reads them."""
    cells: list[ImproveCell] = plan(settings, plugins)  # type: ignore[assignment]
    if len(cells) > 1:
        raise ClothbenchError("found several models or optimizers, expected one; ask about each by itself")
    return prepare(cells[0], plugins, Checkpoint(out / FITS / cells[0].key), kept=out / TRACKED)


def verdict_in(folder: Path) -> dict[str, Any]:
    """The verdict of `clothbench improve` in a folder."""
    if (document := document_in(folder)) is None:
        raise ClothbenchError(f"verdict={folder}: found no {VERDICT}, expected the folder of a `clothbench improve`")
    if "parameters" not in document or "effects" not in document:
        raise ClothbenchError(f"{folder / VERDICT}: found no parameters and effects in it; run improve again")
    try:
        _read(document)
    except (KeyError, TypeError, ValueError, AttributeError) as fault:
        said = f"{type(fault).__name__}: {fault}"
        raise ClothbenchError(
            f"{folder / VERDICT}: is no verdict of this version ({said}); run improve again"
        ) from None
    for effect in document["effects"]:
        if effect.get("by_recording"):
            raise ClothbenchError(
                f"{folder / VERDICT}: effect {effect['name']!r} has amounts of its own in each recording, which no new "
                "one has yet; name the effects with effects= and tied= instead of verdict="
            )
    return document


def _read(document: Mapping[str, Any]) -> None:
    """Read all of a verdict that is used here: what is damaged raises now, and not in the middle of the work."""
    settings_in(document)
    sorted(document["recordings"]["fit"])
    for effect in document["effects"]:
        "".join([effect["name"], *effect["tied_with"]])
    for parameter in document["parameters"].values():
        float(parameter["value"])
    "".join([document["model"], *document["base"]])


def settings_in(document: Mapping[str, Any]) -> dict[str, str]:
    """Words for the ranges and the mesh that a verdict was found with; none of one that was written without them."""
    stated = document.get("settings", {})
    out = {f"bounds.{name}": f"[{low!r},{high!r}]" for name, (low, high) in stated.get("bounds", {}).items()}
    if stated.get("resolution") is not None:
        out["resolution"] = str(stated["resolution"])
    return out


def require_same(problem: Problem, document: Mapping[str, Any], folder: Path) -> None:
    """Refuse a verdict on other recordings."""
    judged, found = sorted(document["recordings"]["fit"]), sorted(c.name for c in problem.of_split("fit"))
    if judged != found:
        raise ClothbenchError(
            f"{folder / VERDICT}: found a verdict on {', '.join(judged)}, expected one on {', '.join(found)}"
        )


def problem_of_cell(
    runs: Path, key: str, plugins: Catalogue, named: Mapping[str, str]
) -> tuple[Problem, dict[str, float]]:
    """The fitted recordings of a calibration with its model, and the values that were found. named: where recordings
    lie that have moved, by hash.
    """
    cell, fitted = asked_and_fitted(Store(runs), key)
    fitted_to = [source for source in cell.recordings if source.split == "fit"]
    mine = found_again(fitted_to, key, runs, named, "recordings=PATH")
    bench = set_up(dataclasses.replace(cell, recordings=mine, rivals=()), plugins, runs / TRACKED)
    cases = []
    for source, recording, trial in zip(mine, bench.recordings, bench.trials, strict=True):
        if not isinstance(recording, Recording):
            raise ClothbenchError(f"{source.path}: found a drape, expected a sheet that grips hold")
        (scene,) = scenes_of(recording, **cell.judged)
        cases.append(SheetCase(recording.name, "fit", recording, trial.observation, scene, switches=True))
    problem = Problem(
        cell.model, SheetEvidence(tuple(cases)), plugins, cell.optimizer, cell.effects, cell.options, cell.bounds,
        cell.seed, own={case.name: dict(cell.fixed) for case in cases},
    )  # fmt: skip
    return problem, {row["name"]: row["value"] for row in fitted}
