"""From a cell to its problem, and from there to what the loop finds."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from clothbench.core.errors import ClothbenchError
from clothbench.engine.checkpoint import Checkpoint
from clothbench.plugins.discovery import Catalogue
from clothbench.recordings.curve import Curve
from clothbench.recordings.kinds import read_any
from clothbench.recordings.nodes import Recording
from clothbench.recordings.scenes import scene_of
from clothbench.studies.improve.account import StageProgress
from clothbench.studies.improve.cell import ImproveCell
from clothbench.studies.improve.curves import CurveEvidence, curve_evidence
from clothbench.studies.improve.evidence import Evidence
from clothbench.studies.improve.finding import Finding
from clothbench.studies.improve.loop import improve
from clothbench.studies.improve.problem import Problem
from clothbench.studies.improve.sheets import SheetCase, SheetEvidence


def find(
    cell: ImproveCell,
    plugins: Catalogue,
    checkpoint: Checkpoint | None = None,
    progress: StageProgress = lambda *_: None,
) -> Finding:
    """Ask the loop. checkpoint: what an earlier run that was stopped has left."""
    return improve(prepare(cell, plugins, checkpoint), cell.candidates, progress, cell.timeout)


def prepare(cell: ImproveCell, plugins: Catalogue, checkpoint: Checkpoint | None = None) -> Problem:
    """The recordings read as evidence, beside the model; nothing is simulated yet."""
    recordings = [read_any(source.path) for source in cell.recordings]
    for source, recording in zip(cell.recordings, recordings, strict=True):
        if recording.hash != source.hash:
            raise ClothbenchError(f"{source.path}: changed on disk since the run was planned; run it again")
    return Problem(
        model=cell.model, evidence=evidence_of(cell, recordings, plugins), plugins=plugins, optimizer=cell.optimizer,
        base=cell.base, options=cell.options, bounds=cell.bounds, seed=cell.seed, question=cell.key,
        checkpoint=checkpoint or Checkpoint(),
    )  # fmt: skip


def evidence_of(cell: ImproveCell, recordings: Sequence[Any], plugins: Catalogue) -> Evidence:
    """The recordings as the kind of evidence that they are."""
    return EVIDENCE[cell.kind](cell, recordings, plugins)


def evidence_of_curves(cell: ImproveCell, recordings: Sequence[Curve], plugins: Catalogue) -> CurveEvidence:
    return curve_evidence(recordings, [source.split for source in cell.recordings])


def evidence_of_sheets(cell: ImproveCell, recordings: Sequence[Recording], plugins: Catalogue) -> SheetEvidence:
    assert cell.tracker is not None  # every cell of sheets has one
    tracker = plugins.make("trackers", cell.tracker, **cell.option(cell.tracker))
    density, nodes = cell.scene["areal_density"], cell.scene["resolution"]
    return SheetEvidence(
        tuple(
            SheetCase(
                r.name, s.split, r, tracker.track(r), scene_of(r, areal_density=density, resolution=shape_of(r, nodes))
            )
            for r, s in zip(recordings, cell.recordings, strict=True)
        )
    )


def shape_of(recording: Recording, nodes: int) -> tuple[int, int]:
    """Nodes along (u, v) of cells as nearly square as may be, so many along the longer side."""
    cell = max(recording.cloth_width, recording.cloth_height) / (nodes - 1)
    return max(3, round(recording.cloth_width / cell) + 1), max(3, round(recording.cloth_height / cell) + 1)


EVIDENCE: Mapping[str, Callable[..., Evidence]] = {"nodes": evidence_of_sheets, "curve": evidence_of_curves}
