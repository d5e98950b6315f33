"""The two grades that take running the plugin of a submission: reproduced, and verified."""

from __future__ import annotations

import dataclasses
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.files import sha256
from clothbench.engine.cells import seed_of
from clothbench.engine.judgement import half, judge
from clothbench.plugins.discovery import Catalogue
from clothbench.studies.calibration.cell import CalibrationCell, asked
from clothbench.submissions.again import untold
from clothbench.submissions.packing import metrics_of, require_checkable
from clothbench.submissions.reading import questions_of
from clothbench.submissions.sandbox import Sandbox
from clothbench.submissions.submission import FILE, Compared, Submission, compared
from clothbench.submissions.unpublished import Fabric


@dataclass(frozen=True)
class Chosen:
    """Cells that were chosen to be run again. seed: of the choice, drawn when the submission was already there."""

    seed: int
    keys: tuple[str, ...]


def choose(folder: Path, submission: Submission, count: int, seed: int | None) -> Chosen:
    """So many cells at random, by a seed from the operating system, or a given one, and by what was handed in: whoever
    hands in cannot know the choice, and whoever checks cannot steer it by the seed alone.
    """
    seed = secrets.randbits(63) if seed is None else seed
    keys = sorted(asked.key for asked in submission.cells)
    random = np.random.default_rng(seed_of(seed, sha256(folder / FILE)))
    drawn = random.choice(len(keys), size=min(count, len(keys)), replace=False)
    return Chosen(seed, tuple(keys[k] for k in sorted(drawn)))


def cells_of(folder: Path, submission: Submission) -> dict[str, CalibrationCell]:
    """The fits that are handed in, by key. They come from a stranger: what is no cell is one line."""
    if not submission.cells:
        raise ClothbenchError(
            f"{folder}: holds no fits that could be run again; pack them with `clothbench submit FOLDER --name "
            "NAME --runs RUNS --wheel FILE`"
        )
    cells, faults = questions_of(folder, submission)
    if faults:
        raise ClothbenchError(faults[0])
    return cells


def reproduce(
    folder: Path, submission: Submission, found: Sequence[Compared], chosen: Chosen, place: Sandbox, plugins: Catalogue
) -> dict[str, list[str]]:
    """Run the chosen cells again and hold what comes of them against what was handed in: by the keys of those that do
    not pass, a fault for each score that differs by more than the noise. found: what was handed in, scored here.
    """
    cells, faults = cells_of(folder, submission), {}
    for key in chosen.keys:
        stated = {one.measured.hash: one for one in found if one.cell == key}
        try:
            faults[key] = _again(key, cells[key], stated, place, plugins)
        except ClothbenchError as fault:
            faults[key] = [f"cell {key}: {fault}".replace(f"{place.folder}/", "")]
    return {key: said for key, said in faults.items() if said}


def _again(
    key: str, cell: CalibrationCell, stated: Mapping[str, Compared], place: Sandbox, plugins: Catalogue
) -> list[str]:
    if missing := [source.name for source in cell.recordings if source.hash not in stated]:
        raise ClothbenchError(f"has no simulation of {missing[0]!r}, which it is about; expected one of each recording")
    shown = {of: one.measured for of, one in stated.items()}
    simulated = place.fitted(cell, shown, list(shown.values()))
    faults = []
    for one in stated.values():
        path, recording = simulated[one.measured.name]
        now = compared(path, recording, one.measured, one.scores, plugins, key)
        for metric in one.scores:
            if judge(one.row(metric), now.row(metric)) is not None:
                faults.append(
                    f"cell {key}: {one.measured.name}: {metric} is {now.scores[metric]:.6g} {now.units[metric]} when "
                    f"run again, handed in were {one.scores[metric]:.6g} ± {half(one.row(metric)):.2g}"
                )
    return faults


def held_out(
    folder: Path,
    submission: Submission,
    fabrics: Mapping[str, Fabric],
    place: Sandbox,
    plugins: Catalogue,
) -> list[Compared]:
    """Fit the submitted plugin, with the submitted settings, to recordings that nobody else has, and score it on others
    of them, whose positions it is never told.
    """
    found = []
    for key, cell in _setups(cells_of(folder, submission)).items():
        for name, fabric in fabrics.items():
            found += _scored(key, cell, name, fabric, place, plugins)
    return found


def require_new(folder: Path, submission: Submission, fabrics: Mapping[str, Fabric]) -> None:
    """Refuse recordings that the submission knows, and fits that could not be scored on others."""
    cells = cells_of(folder, submission)
    known = {source.hash for cell in cells.values() for source in (*cell.recordings, *cell.rivals)}
    for fabric in fabrics.values():
        for recording in (*fabric.shown.values(), *fabric.wanted):
            if recording.hash in known:
                raise ClothbenchError(f"{recording.path}: the submission was fitted to it; expected one that is not")
    for key, cell in _setups(cells).items():
        require_checkable(cell, key)


def _setups(cells: Mapping[str, CalibrationCell]) -> dict[str, CalibrationCell]:
    """One cell for each way in which models were fitted, whatever to."""
    out: dict[str, tuple[str, CalibrationCell]] = {}
    for key, cell in sorted(cells.items()):
        bare = dataclasses.replace(cell, case="", recordings=(), rivals=(), analysis={}, published={})
        out.setdefault(asked(bare), (key, bare))
    return dict(out.values())


def _scored(
    key: str, cell: CalibrationCell, name: str, fabric: Fabric, place: Sandbox, plugins: Catalogue
) -> list[Compared]:
    shown = {of: untold(recording) for of, recording in fabric.shown.items()}
    sources = tuple(
        dataclasses.replace(source, hash=shown[source.hash].hash) if source.hash in shown else source
        for source in fabric.sources
    )
    asked_for = dataclasses.replace(cell, case=name, recordings=sources)
    wanted = [dataclasses.replace(recording, split="held_out") for recording in fabric.wanted]
    simulated = place.fitted(asked_for, {one.hash: one for one in shown.values()}, wanted)
    return [compared(*simulated[r.name], r, metrics_of(cell), plugins, key) for r in wanted]
