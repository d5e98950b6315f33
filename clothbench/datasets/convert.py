"""A public data set as a folder of recordings: found or fetched, converted once, put in place whole."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from clothbench.core.errors import ClothbenchError
from clothbench.core.files import read_json, whole_file, whole_folder
from clothbench.core.progress import FileProgress
from clothbench.datasets.registry import Dataset, dataset, fetch, local_copy
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

    What is there already is used, unless `again` or it was made by another version of the importer, or of other
    originals; it is refused where it is of another data set, and where `data_dir` is another copy than it was made of.
    Files that no import made are never replaced. A data set without recordings is refused. Originals come from
    `data_dir`, else from the folder in CLOTHBENCH_DATA, else they are fetched. `progress(done, planned, file)` is
    called while files are fetched and read.
    """
    known = dataset(name)
    if not known.importer:
        raise ClothbenchError(
            f"data set {name!r} holds no recordings ({known.title}), and nothing can be run on it; clothbench import "
            f"{name} fetches its originals"
        )
    folder = Path(out) if out is not None else Path("recordings") / name
    if (folder / REPORT).is_file():
        report = _report(folder)
        _require_of(name, folder, report)
        if not again and _is_as_made_now(known, report) and any(folder.rglob("*.nc")):
            _require_made_of(name, folder, report, data_dir)
            return folder
        _require_nothing_else(folder, report)
    elif folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ClothbenchError(f"{folder}: found files that no import made, expected an empty folder; give out=FOLDER")
    source = local_copy(name, data_dir) or fetch(name, progress)
    with whole_folder(folder) as part:
        import_target(known.importer)(source, part, progress)
        _note(part, known, source)
    return folder


def _report(folder: Path) -> dict[str, Any]:
    found = read_json(folder / REPORT, "an import's report")
    if not isinstance(found, dict):
        raise ClothbenchError(
            f"{folder / REPORT}: found {type(found).__name__}, expected an import's report; remove it"
        )
    return found


def _is_as_made_now(known: Dataset, report: Mapping[str, Any]) -> bool:
    """Whether recordings are of the registry's commit and by this importer; what states no version is of the first."""
    return report.get("commit", known.commit) == known.commit and report.get("importer", 1) == known.version


def _require_of(name: str, folder: Path, report: Mapping[str, Any]) -> None:
    """Refuse the folder of another data set."""
    if (of := report.get("dataset", name)) != name:
        raise ClothbenchError(
            f"{folder}: {REPORT}: dataset is {of!r}, expected {name!r}; give another folder with out=FOLDER, or remove "
            "this one"
        )


def _require_nothing_else(folder: Path, report: Mapping[str, Any]) -> None:
    """Refuse to take the place of files that the last import did not make. An earlier version's report lists none: its
    imports made recordings only.
    """
    listed = report.get("files")
    for path in sorted(p for p in folder.rglob("*") if not p.is_dir()):
        name = path.relative_to(folder).as_posix()
        if name != REPORT and (name not in listed if isinstance(listed, list) else path.suffix != ".nc"):
            raise ClothbenchError(
                f"{folder}: found {name}, which the last import did not make, expected only its files; move it "
                "elsewhere, or give another folder with out=FOLDER"
            )


def _require_made_of(
    name: str, folder: Path, report: Mapping[str, Any], data_dir: str | os.PathLike[str] | None
) -> None:
    """Refuse recordings that are known to be made of another copy than the one that is stated."""
    if data_dir is None:
        return
    stated = local_copy(name, data_dir)
    made_of = report.get("copy")
    if stated is not None and made_of is not None and made_of != str(stated.resolve()):
        raise ClothbenchError(
            f"{folder}: found recordings made of {made_of}, expected of {stated} (data_dir); make them again with "
            f"clothbench import {name} data_dir=…, or leave data_dir out"
        )


def _note(folder: Path, known: Dataset, source: Path) -> None:
    """State in the report of which data set, commit and copy its recordings were made, by which version of the
    importer, and which files the import wrote.
    """
    files = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if not path.is_dir())
    made_of = {"dataset": known.name, "commit": known.commit, "importer": known.version, "copy": str(source.resolve())}
    document = {**_report(folder), **made_of, "files": files}
    with whole_file(folder / REPORT) as part:
        part.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
