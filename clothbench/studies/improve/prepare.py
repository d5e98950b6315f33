"""From a cell to its problem: recordings as evidence, beside a model."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from clothbench.core.errors import ClothbenchError
from clothbench.engine.cells import Source
from clothbench.engine.checkpoint import Checkpoint
from clothbench.engine.study import Elsewhere
from clothbench.estimation.watched import require_readable, watched
from clothbench.plugins.discovery import Catalogue
from clothbench.recordings.curve import Curve
from clothbench.recordings.kinds import read_any
from clothbench.recordings.nodes import Recording
from clothbench.recordings.scenes import drapes_of, scene_of
from clothbench.recordings.silhouette import LAYOUT as DRAPES
from clothbench.recordings.silhouette import Silhouettes
from clothbench.studies.improve.cell import ImproveCell
from clothbench.studies.improve.curves import CurveEvidence, curve_evidence
from clothbench.studies.improve.drape_quantities import alike, specimens_of
from clothbench.studies.improve.drapes import DrapeCase, DrapeEvidence, Drapemeter, quartered
from clothbench.studies.improve.evidence import Evidence
from clothbench.studies.improve.problem import Problem
from clothbench.studies.improve.sheets import SheetCase, SheetEvidence


def prepare(
    cell: ImproveCell, plugins: Catalogue, checkpoint: Checkpoint | None = None, kept: Path | None = None,
    elsewhere: Elsewhere | None = None,
) -> Problem:  # fmt: skip
    """The recordings read as evidence, beside the model; nothing is simulated yet.

    kept: folder for what trackers make of images, None: nothing is kept; elsewhere: workers, see `Context`.
    """
    recordings = [read_any(source.file) for source in cell.recordings]
    for source, recording in zip(cell.recordings, recordings, strict=True):
        if recording.hash != source.hash:
            raise ClothbenchError(f"{source.path}: changed on disk since the run was planned; run it again")
    return Problem(
        model=cell.model, evidence=evidence_of(cell, recordings, plugins, kept), plugins=plugins,
        optimizer=cell.optimizer,
        base=cell.base, options=cell.options, bounds=cell.bounds, begins=cell.begins, seed=cell.seed,
        question=cell.key, checkpoint=checkpoint or Checkpoint(), elsewhere=elsewhere,
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
    require_one_cloth(recordings)
    tracker = plugins.make("trackers", cell.tracker, **cell.option(cell.tracker))
    start = cell.scene.get("start", "rest")
    density, air, nodes = (cell.scene[name] for name in ("areal_density", "air_density", "resolution"))

    def case(source: Source, raw: Any) -> SheetCase:
        recording, seen = watched(raw, tracker, cell.option(tracker.name), plugins, kept)
        assert isinstance(recording, Recording)  # clouds are refused where cells are planned
        scene = scene_of(
            recording, areal_density=density, air_density=air, resolution=shape_of(recording, nodes), start=start
        )
        return SheetCase(recording.name, source.split, recording, seen, scene)

    return SheetEvidence(tuple(map(case, cell.recordings, recordings)))


def evidence_of_drapes(
    cell: ImproveCell, recordings: Sequence[Silhouettes], plugins: Catalogue, kept: Path | None = None
) -> DrapeEvidence:
    assert cell.tracker is not None  # as of sheets
    for recording in recordings:
        require_readable(recording, cell.tracker, plugins)
    require_one_drapemeter(recordings)
    tracker = plugins.make("trackers", cell.tracker, **cell.option(cell.tracker))
    seen = [tracker.track(recording).outlines for recording in recordings]
    found, sides = specimens_of(seen, [r.side for r in recordings], [s.split == "fit" for s in cell.recordings])
    nodes = cell.scene["resolution"]
    scenes = drapes_of(
        recordings[0], areal_density=cell.scene["areal_density"], air_density=cell.scene["air_density"],
        resolution=(nodes, nodes), starts=FIRST_SHAPES + OTHER_SHAPES,
    )  # fmt: skip
    first, *others = ((scene, quartered(scene)) for scene in scenes)
    meter = Drapemeter(
        first, sides, recordings[0].plate_radius, recordings[0].disc_radius, cell.fixed, tuple(others)
    )  # fmt: skip
    return DrapeEvidence(
        tuple(
            DrapeCase(f"{source.name}, specimen {number}", source.split, specimen, meter)
            for source, some in zip(cell.recordings, found, strict=True)
            for number, specimen in some
        ),
        alike(seen, [r.side for r in recordings], cell.seed),
    )


def require_one_cloth(recordings: Sequence[Recording]) -> None:
    """Refuse recordings that state several weights: one model is one cloth. What states none may be any, and one cloth
    may be called otherwise in each session.
    """
    weights = {f"{r.areal_density:g}": r for r in recordings if not math.isnan(r.areal_density)}
    if len(weights) > 1:
        raise ClothbenchError(
            f"{next(iter(weights.values())).path}: attribute 'areal_density': found {', '.join(sorted(weights))} among "
            f"{len(recordings)} recordings, expected one cloth's; give these with recordings=FOLDER, or with "
            "run +suite=improve suite.select=PATTERN (suite.case=fabric asks about each)"
        )


def require_one_drapemeter(recordings: Sequence[Silhouettes]) -> None:
    """Refuse recordings of several fabrics or instruments: one model is one cloth."""
    for what in ("fabric", "disc_radius", "plate_radius", "areal_density"):
        found = sorted({str(getattr(r, what)) for r in recordings})
        if len(found) > 1:
            raise ClothbenchError(
                f"{recordings[0].path}: attribute {what!r}: found {', '.join(found)} among {len(recordings)} "
                f"recordings, expected one {what}; give one fabric's with recordings=FOLDER, or suite.case=fabric"
            )


def shape_of(recording: Recording, nodes: int) -> tuple[int, int]:
    """Nodes along (u, v) of cells as nearly square as may be, so many along the longer side."""
    cell = max(recording.cloth_width, recording.cloth_height) / (nodes - 1)
    return max(3, round(recording.cloth_width / cell) + 1), max(3, round(recording.cloth_height / cell) + 1)


# Beside it the same turned by a quarter, of each side: neither a drape coefficient nor an elongation hangs much on
# which folds there are.
FIRST_SHAPES = 1
OTHER_SHAPES = 4  # from which, on average, what is named has to explain the same
EVIDENCE: Mapping[str, Callable[..., Evidence]] = {
    "nodes": evidence_of_sheets, "curve": evidence_of_curves, DRAPES.kind: evidence_of_drapes,
}  # fmt: skip
