"""`python -m clothbench.submissions.again JOB OUT`: fit once more, and simulate; runs beside a stranger's plugin.

JOB is a JSON document: `question`, the calibration's cell as JSON text, with the path of each recording that it is
fitted to; `simulate`, paths of recordings whose positions are blank. OUT gets a file for each of these, with the
simulated positions. What the plugin does to this process can change them, and nothing else: scores are computed by
whoever asked, and what is to be met never lies where this process is told to look.
"""

from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.engine.checkpoint import Checkpoint
from clothbench.estimation.calibrate import best_rollout
from clothbench.plugins.discovery import catalogue, one_line
from clothbench.recordings.nodes import Recording, grips_at, read_recording, write_recording
from clothbench.recordings.tracked import EYE
from clothbench.studies.calibration.cell import asked_again, set_up
from clothbench.studies.calibration.stages import searched, stages_of
from clothbench.submissions.packing import simulation_of


def untold(recording: Recording) -> Recording:
    """A recording without what its file says beside the measurement, but for where the camera stood, which metrics
    need: a stand-in's notes and declared effects are the truth that is looked for. Its hash is another one.
    """
    notes = {name: said for name, said in recording.notes.items() if name == EYE}
    return dataclasses.replace(recording, notes=notes, declared_effects="")


def blank(recording: Recording) -> Recording:
    """A recording that says how the cloth was driven and neither where it was nor what it is like: of the positions
    only one is left, since there must be one, and it is the grip's.
    """
    position = np.full_like(recording.position, np.nan)
    position[0, 0] = grips_at(recording, recording.time[:1])[0, 0] if len(recording.grip_material) else 0.0
    return dataclasses.replace(untold(recording), position=position, video=None, confidence=None, path="")


def again(job: Path, out: Path) -> None:
    """Do what a job says."""
    asked = json.loads(job.read_text(encoding="utf-8"))
    plugins, cell = catalogue(), asked_again(asked["question"])
    fitted = tuple(source for source in cell.recordings if source.split == "fit")
    bench = set_up(dataclasses.replace(cell, recordings=fitted, rivals=(), report=(), analysis={}), plugins)
    stages = stages_of(bench, plugins)
    # Seeded by all recordings of the cell, those that are not shown here included.
    fits = searched(stages, plugins, Checkpoint(), bench.space, cell.budget, cell.stream("optimizer"), bounded=False)
    bench, fit = stages[len(fits) - 1], fits[-1]
    if fit.status == "diverged":
        raise ClothbenchError("no parameter set that was tried came to a number")
    for path in asked["simulate"]:
        recording = read_recording(path)
        position = best_rollout(bench.remake(recording, None), fit).position[0][:, : len(recording.material)]
        write_recording(simulation_of(recording, position, cell.model), out / Path(path).name)


if __name__ == "__main__":
    try:
        again(Path(sys.argv[1]), Path(sys.argv[2]))
    except Exception as fault:
        print(str(fault) if isinstance(fault, ClothbenchError) else one_line(fault), file=sys.stderr)
        sys.exit(1)
