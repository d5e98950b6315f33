"""From a cell to its problem: recordings as evidence, beside a model."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from clothbench.core.errors import ClothbenchError
from clothbench.engine.cells import Source
from clothbench.engine.checkpoint import Checkpoint
from clothbench.estimation.watched import watched
from clothbench.plugins.discovery import Catalogue
from clothbench.recordings.curve import Curve
from clothbench.recordings.kinds import read_any
from clothbench.recordings.nodes import Recording
from clothbench.recordings.scenes import scene_of
from clothbench.studies.improve.cell import ImproveCell
from clothbench.studies.improve.curves import CurveEvidence, curve_evidence
from clothbench.studies.improve.evidence import Evidence
from clothbench.studies.improve.problem import Problem
from clothbench.studies.improve.sheets import SheetCase, SheetEvidence


def prepare(
    cell: ImproveCell, plugins: Catalogue, checkpoint: Checkpoint | None = None, kept: Path | None = None
) -> Problem:
    """The recordings read as evidence, beside the model; nothing is simulated yet.

    kept: folder for what trackers make of images, None: nothing is kept.
    """
    recordings = [read_any(source.path) for source in cell.recordings]
    for source, recording in zip(cell.recordings, recordings, strict=True):
        if recording.hash != source.hash:
            raise ClothbenchError(f"{source.path}: changed on disk since the run was planned; run it again")
    return Problem(
        model=cell.model, evidence=evidence_of(cell, recordings, plugins, kept), plugins=plugins,
        optimizer=cell.optimizer,
        base=cell.base, options=cell.options, bounds=cell.bounds, seed=cell.seed, question=cell.key,
        checkpoint=checkpoint or Checkpoint(),
    )  # fmt: skip


def evidence_of(cell: ImproveCell, recordings: Sequence[Any], plugins: Catalogue, kept: Path | None = None) -> Evidence:
    """The recordings as the kind of evidence that they are."""
    return EVIDENCE[cell.kind](cell, recordings, plugins, kept)


def evidence_of_curves(
    cell: ImproveCell, recordings: Sequence[Curve], plugins: Catalogue, kept: Path | None = None
) -> CurveEvidence:
    return curve_evidence(recordings, [source.split for source in cell.recordings])


def evidence_of_sheets(
    cell: ImproveCell, recordings: Sequence[Any], plugins: Catalogue, kept: Path | None = None
) -> SheetEvidence:
    assert cell.tracker is not None  # every cell of sheets has one
    tracker = plugins.make("trackers", cell.tracker, **cell.option(cell.tracker))
    start = cell.scene.get("start", "rest")
    density, air, nodes = (cell.scene[name] for name in ("areal_density", "air_density", "resolution"))

    def case(source: Source, raw: Any) -> SheetCase:
        recording, seen = watched(raw, tracker, cell.option(tracker.name), plugins, kept)
        scene = scene_of(
            recording, areal_density=density, air_density=air, resolution=shape_of(recording, nodes), start=start
        )
        return SheetCase(recording.name, source.split, recording, seen, scene)

    return SheetEvidence(tuple(map(case, cell.recordings, recordings)))


def shape_of(recording: Recording, nodes: int) -> tuple[int, int]:
    """Nodes along (u, v) of cells as nearly square as may be, so many along the longer side."""
    cell = max(recording.cloth_width, recording.cloth_height) / (nodes - 1)
    return max(3, round(recording.cloth_width / cell) + 1), max(3, round(recording.cloth_height / cell) + 1)


EVIDENCE: Mapping[str, Callable[..., Evidence]] = {"nodes": evidence_of_sheets, "curve": evidence_of_curves}
