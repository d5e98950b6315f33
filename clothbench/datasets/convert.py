"""A public data set as a folder of recordings: found or fetched, converted once, put in place whole."""

from __future__ import annotations

import os
from pathlib import Path

from clothbench.core.errors import ClothbenchError
from clothbench.core.files import whole_folder
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

    What is there already is used, unless `again`. Originals come from `data_dir`, else from the folder in
    CLOTHBENCH_DATA, else they are fetched. `progress(done, planned, file)` is called while files are fetched and read.
    """
    known = dataset(name)
    folder = Path(out) if out is not None else Path("recordings") / name
    if not again and (folder / REPORT).is_file() and any(folder.rglob("*.nc")):
        return folder
    if folder.exists() and any(folder.iterdir()) and not (folder / REPORT).is_file():
        raise ClothbenchError(f"{folder}: found files that no import made, expected an empty folder; give out=FOLDER")
    source = local_copy(name, data_dir) or fetch(name, progress)
    with whole_folder(folder) as part:
        import_target(known.importer)(source, part, progress)
    return folder
