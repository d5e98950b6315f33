"""A submission from a results folder: its calibrations, what they simulated, and the wheels of their plugins."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

import clothbench
from clothbench.core.errors import ClothbenchError
from clothbench.core.files import file_names, placing, sha256
from clothbench.engine.cells import Source, plugin_versions
from clothbench.engine.store import Store
from clothbench.plugins.discovery import Catalogue
from clothbench.recordings.codec import write
from clothbench.recordings.nodes import LAYOUT, Recording, read_recording
from clothbench.studies.calibration.cell import CalibrationCell, asked, asked_and_fitted, set_up, uses
from clothbench.submissions.submission import (
    WHEEL,
    Asked,
    Entry,
    Submission,
    Wheel,
    compared,
    require_all,
    require_held,
    require_same_metrics,
    written,
)

TRACKER = "markers"  # the one that scores are computed with
ROLLOUTS, WHEELS = "rollouts", "wheels"  # what is packed beside `submission.json`


def pack_results(
    folder: Path,
    results: Store,
    wheels: Sequence[Path],
    measured: Sequence[Recording],
    plugins: Catalogue,
    **about: Any,
) -> Submission:
    """Simulate what every calibration in a results folder found, score it, and write all that others need to check it,
    or to do it again, into an empty folder. about: name, by, about and suite.
    """
    if folder.exists() and any(folder.iterdir()):
        raise ClothbenchError(f"{folder}: found a folder with something in it, expected an empty one to pack into")
    keys = list(dict.fromkeys(row["key"] for row in results.rows() if row["study"] == CalibrationCell.study))
    if not keys:
        raise ClothbenchError(f"{results.folder}: found no calibrations, expected some of `clothbench run`")
    by_hash = {recording.hash: recording for recording in measured}
    cells, entries = [], []
    with _whole(folder):
        for key in keys:
            cell, fitted = asked_and_fitted(results, key)
            require_checkable(cell, key)
            require_ended(results, key)
            require_installed(cell, key, plugins)
            values = {row["name"]: row["value"] for row in fitted}
            entries += _simulated(folder, cell, key, values, by_hash, plugins)
            cells.append(Asked(key, asked(without_paths(cell))))
        require_all(folder, [entry.recording for entry in entries], measured)
        require_same_metrics(folder, entries)
        packed = tuple(_packed(folder, wheel) for wheel in wheels)
        return written(folder, Submission(
            clothbench=clothbench.__version__, entries=tuple(entries), cells=tuple(cells), wheels=packed, **about
        ))  # fmt: skip


@contextmanager
def _whole(folder: Path) -> Iterator[None]:
    """Takes out again what was packed if not all of it can be: the same command expects the folder to be empty."""
    try:
        yield
    except BaseException:
        for part in (ROLLOUTS, WHEELS):
            shutil.rmtree(folder / part, ignore_errors=True)
        raise


def require_checkable(cell: CalibrationCell, key: str) -> None:
    """Refuse what could not be scored, or not be done again, without the one who hands it in."""
    if cell.tracker != TRACKER:
        raise ClothbenchError(
            f"cell {key}: is tracked by {cell.tracker!r}, expected {TRACKER!r}: submissions are scored at material "
            f"points; run it with tracker={TRACKER} and a metric of nodes"
        )
    if cell.scene.get("start") == "measured":
        raise ClothbenchError(
            f"cell {key}: begins as was measured, which whoever checks it does not tell the plugin; run it with "
            "scene.start=rest"
        )


def require_ended(results: Store, key: str) -> None:
    """Refuse a fit that the clock stopped: how far it came is a matter of the machine."""
    if any(row["status"] == "timeout" for row in results.table("rows", [key])):
        raise ClothbenchError(
            f"cell {key}: was stopped by the clock, which no other machine does at the same place; run it with "
            "timeout=null and a budget that it can use up"
        )


def require_installed(cell: CalibrationCell, key: str, plugins: Catalogue) -> None:
    """Refuse a cell that other versions computed than those which would simulate it now."""
    installed = plugin_versions(uses(cell), plugins)
    for name, version in cell.versions.items():
        if installed.get(name) != version:
            raise ClothbenchError(
                f"cell {key}: was computed with {name} {version}, installed is {installed.get(name)}; run it again"
            )


def without_paths(cell: CalibrationCell) -> CalibrationCell:
    """The cell without where its files lie on this machine."""

    def bare(sources: Sequence[Source]) -> tuple[Source, ...]:
        return tuple(dataclasses.replace(source, path="") for source in sources)

    return dataclasses.replace(cell, recordings=bare(cell.recordings), rivals=bare(cell.rivals))


def _simulated(
    folder: Path,
    cell: CalibrationCell,
    key: str,
    values: Mapping[str, float],
    measured: Mapping[str, Recording],
    plugins: Catalogue,
) -> list[Entry]:
    """What the parameters that were found make of every recording of a cell, in FOLDER/rollouts/KEY."""
    if unknown := next((source.name for source in cell.recordings if source.hash not in measured), None):
        raise ClothbenchError(f"cell {key}: recording {unknown!r} is not among those of --recordings; name it")
    here = tuple(dataclasses.replace(source, path=measured[source.hash].path) for source in cell.recordings)
    bench = set_up(dataclasses.replace(cell, recordings=here), plugins)
    best = np.array([[values[name] for name in bench.space.names]])
    moving = [name for name in cell.effects if plugins.load("effects", name).place in ("boundary", "sensor")]
    entries = []
    names = file_names([source.name for source in cell.recordings])
    for name, source, trial in zip(names, here, bench.trials, strict=True):
        of = read_recording(source.path)
        path = folder / ROLLOUTS / key / f"{name}.nc"
        position = trial.simulation.run(best).position[0][:, : len(of.material)]
        simulated = simulation_of(of, position, cell.model)
        if moving:
            remedy = f"run it without {', '.join(moving)}, which moves grips, or how they are seen"
            require_held(f"cell {key}: {source.name}", simulated, of, remedy)
        write(simulated, path, LAYOUT)
        found = compared(path, read_recording(path), of, metrics_of(cell), plugins, key)
        place = path.relative_to(folder).as_posix()
        entries.append(Entry(source.name, source.hash, place, sha256(path), found.scores, key))
    return entries


def metrics_of(cell: CalibrationCell) -> list[str]:
    return list(dict.fromkeys((cell.metric, *cell.report)))


def simulation_of(recording: Recording, position: np.ndarray, model: str) -> Recording:
    """A recording's file with simulated positions (T, N, 3) m in place of the measured ones."""
    return dataclasses.replace(recording, position=position, video=None, confidence=None, source=model, path="")


def require_wheel(wheel: Path) -> None:
    """Refuse what is no file of a wheel."""
    if not WHEEL.fullmatch(wheel.name) or not wheel.is_file():
        raise ClothbenchError(f"{wheel}: found no wheel, expected a .whl file; make one with `python -m build --wheel`")


def _packed(folder: Path, wheel: Path) -> Wheel:
    require_wheel(wheel)
    place = folder / WHEELS / wheel.name
    with placing(place):
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(wheel, place)
    return Wheel(place.relative_to(folder).as_posix(), sha256(place))
