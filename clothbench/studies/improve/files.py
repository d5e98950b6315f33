"""The files of a finding: in the folder of its cell, and where the user asked for them.

FOLDER/verdict.json         the verdict (schema 1)
FOLDER/index.html           one self-contained page
FOLDER/rerun/RECORDING.rrd  recording beside the model before and after, where there is something to be seen

The tables (`improve.schema`) lie beside them in a cell, and in FOLDER/tables where they are published.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from glob import escape
from pathlib import Path
from typing import Any

from clothbench.core.errors import ClothbenchError
from clothbench.core.files import file_names, json_text, whole_files
from clothbench.engine.store import Store
from clothbench.studies.improve.document import VERDICT, document_in, verdict_document
from clothbench.studies.improve.evidence import Rows
from clothbench.studies.improve.finding import Finding
from clothbench.studies.improve.page import common_html, page_html
from clothbench.studies.improve.schema import IMPROVE_TABLES

PAGE = "index.html"
OWN, HEAD = b"<title>clothbench: improve ", 4096  # what our page says within so many bytes


def write_files(folder: Path, finding: Finding, tables: Mapping[str, Rows], rerun: bool = True) -> None:
    """Verdict, page and, if they are wanted, files for Rerun. tables: those of the finding."""
    document = verdict_document(finding)
    (folder / VERDICT).write_text(json_text(document) + "\n", encoding="utf-8")
    (folder / PAGE).write_text(page_html(document, tables), encoding="utf-8")
    if not (rerun and finding.evidence.has_rerun):
        return
    from clothbench.studies.improve.rerun_file import write_recording_file

    (folder / "rerun").mkdir()
    for name, one in zip(file_names([c.case.name for c in finding.comparisons]), finding.comparisons, strict=True):
        path = folder / "rerun" / f"{name}.rrd"
        write_recording_file(path, one, label(finding), finding.floor, finding.evidence.unit)


def publish(cell: Path, out: Path, common: Mapping[str, Any] | None = None) -> None:
    """Copy what lies in a finished cell's folder to `out`, all or nothing; what an earlier verdict left there is
    replaced, other files stay. common: the verdict on several models, in place of the one on this cell's.
    """
    with whole_files(out, instead_of=laid_before(out)) as part:
        if common is None:
            for name in (VERDICT, PAGE):
                shutil.copy(cell / name, part / name)
        else:
            (part / VERDICT).write_text(json_text(common) + "\n", encoding="utf-8")
            (part / PAGE).write_text(common_html(common), encoding="utf-8")
        (part / "tables").mkdir()
        for name in IMPROVE_TABLES:
            shutil.copy(cell / f"{name}.parquet", part / "tables" / f"{name}.parquet")
        if (cell / "rerun").is_dir():
            shutil.copytree(cell / "rerun", part / "rerun")


def laid_before(out: Path) -> list[str]:
    """The files below `out` that an earlier verdict came with, other recordings' perhaps: those of the cells that it is
    on. Of a verdict whose cells have gone none are known: they stay, as what other commands left does.
    """
    earlier, store = document_in(out) or {}, Store(out)
    models = earlier.get("models") or []
    keys = [one.get("key") for one in (earlier, *models) if isinstance(one, dict)]
    cells = [store.cell(key) for key in keys if isinstance(key, str)]
    rerun = {f"rerun/{path.name}" for cell in cells for path in cell.glob("rerun/*.rrd")}
    tables = {f"tables/{path.name}" for cell in cells for path in cell.glob("*.parquet")} - {"tables/rows.parquet"}
    return [escape(name) for name in sorted(rerun | tables)]


def require_own_page(out: Path) -> None:
    """Refuse a folder with a page that is none of `improve`: the verdict's would take its place."""
    page = out / PAGE
    if page.is_file() and document_in(out) is None and OWN not in page.read_bytes()[:HEAD]:
        raise ClothbenchError(f"{page}: found a page that improve did not make, and would replace; give another out=")


def rerun_files(out: Path) -> dict[str, Path]:
    """Where the Rerun file of each recording lies that the verdict in a folder is on; of those that have one."""
    split = (document_in(out) or {}).get("recordings")
    names = [*split.get("fit", ()), *split.get("held_out", ())] if isinstance(split, dict) else []
    files = zip(names, file_names(names), strict=True)
    return {name: path for name, file in files if (path := out / "rerun" / f"{file}.rrd").is_file()}


def label(finding: Finding) -> str:
    """ "mass_spring, after: + clock_offset" """
    added = "".join(f" + {name}" for name in finding.final.effects)
    return finding.model + (f", after:{added}" if added else "")
