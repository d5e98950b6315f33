"""A public data set as a folder of recordings: found or fetched, converted once, put in place whole."""

from __future__ import annotations

import json
import os
from pathlib import Path

from clothbench.core.errors import ClothbenchError
from clothbench.core.files import read_json, whole_file, whole_folder
from clothbench.core.progress import FileProgress
from clothbench.datasets.registry import dataset, fetch, local_copy
from clothbench.plugins.discovery import import_target

REPORT = "import-report.json"


def converted(
    name: str,
    *,
    data_dir: str | os.PathLike[str] | None = None,
    out: str | os.PathLike[str] | None = None,
    again: bool = False,
    progress: FileProgress | None = None,
) -> Path:
    """The folder with the recordings of a data set; by default `recordings/NAME` below the working directory.

    What is there already is used, unless `again`; it is refused where `data_dir` is another copy than it was made of.
    Originals come from `data_dir`, else from the folder in CLOTHBENCH_DATA, else they are fetched. `progress(done,
    planned, file)` is called while files are fetched and read.
    """
    known = dataset(name)
    folder = Path(out) if out is not None else Path("recordings") / name
    if not again and (folder / REPORT).is_file() and any(folder.rglob("*.nc")):
        _require_made_of(name, folder, data_dir)
        return folder
    if folder.exists() and any(folder.iterdir()) and not (folder / REPORT).is_file():
        raise ClothbenchError(f"{folder}: found files that no import made, expected an empty folder; give out=FOLDER")
    source = local_copy(name, data_dir) or fetch(name, progress)
    with whole_folder(folder) as part:
        import_target(known.importer)(source, part, progress)
        _note_copy(part / REPORT, source)
    return folder


def _require_made_of(name: str, folder: Path, data_dir: str | os.PathLike[str] | None) -> None:
    """Refuse recordings that are known to be made of another copy than the one that is stated."""
    if data_dir is None:
        return
    stated = local_copy(name, data_dir)
    made_of = read_json(folder / REPORT, "an import's report").get("copy")
    if stated is not None and made_of is not None and made_of != str(stated.resolve()):
        raise ClothbenchError(
            f"{folder}: found recordings made of {made_of}, expected of {stated} (data_dir); make them again with "
            f"clothbench import {name} data_dir=…, or leave data_dir out"
        )


def _note_copy(report: Path, source: Path) -> None:
    """State in the report which copy its recordings were made of."""
    document = read_json(report, "an import's report")
    with whole_file(report) as part:
        part.write_text(json.dumps({**document, "copy": str(source.resolve())}, indent=1) + "\n", encoding="utf-8")
