"""The files of a finding: in the folder of its cell, and where the user asked for them.

FOLDER/verdict.json         the verdict (schema 1)
FOLDER/index.html           one self-contained page
FOLDER/rerun/RECORDING.rrd  recording beside the model before and after, where there is something to be seen

The tables (`improve.schema`) lie beside them in a cell, and in FOLDER/tables where they are published.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from clothbench.core.files import file_names, json_text, whole_files
from clothbench.studies.improve.document import VERDICT, verdict_document
from clothbench.studies.improve.evidence import Rows
from clothbench.studies.improve.finding import Finding
from clothbench.studies.improve.page import common_html, page_html
from clothbench.studies.improve.schema import IMPROVE_TABLES

OLD = ("tables/*.parquet", "rerun/*.rrd")  # of an earlier run, with other recordings perhaps


def write_files(folder: Path, finding: Finding, tables: Mapping[str, Rows], rerun: bool = True) -> None:
    """Verdict, page and, if they are wanted, files for Rerun. tables: those of the finding."""
    document = verdict_document(finding)
    (folder / VERDICT).write_text(json_text(document) + "\n", encoding="utf-8")
    (folder / "index.html").write_text(page_html(document, tables), encoding="utf-8")
    if not (rerun and finding.evidence.has_rerun):
        return
    from clothbench.studies.improve.rerun_file import write_recording_file

    (folder / "rerun").mkdir()
    for name, one in zip(file_names([c.case.name for c in finding.comparisons]), finding.comparisons, strict=True):
        path = folder / "rerun" / f"{name}.rrd"
        write_recording_file(path, one, label(finding), finding.floor, finding.evidence.unit)


def publish(cell: Path, out: Path, common: Mapping[str, Any] | None = None) -> None:
    """Copy what lies in a finished cell's folder to `out`, all or nothing; what an earlier run left there is replaced,
    other files stay. common: the verdict on several models, in place of the one on this cell's.
    """
    with whole_files(out, instead_of=OLD) as part:
        if common is None:
            for name in (VERDICT, "index.html"):
                shutil.copy(cell / name, part / name)
        else:
            (part / VERDICT).write_text(json_text(common) + "\n", encoding="utf-8")
            (part / "index.html").write_text(common_html(common), encoding="utf-8")
        (part / "tables").mkdir()
        for name in IMPROVE_TABLES:
            shutil.copy(cell / f"{name}.parquet", part / "tables" / f"{name}.parquet")
        if (cell / "rerun").is_dir():
            shutil.copytree(cell / "rerun", part / "rerun")


def label(finding: Finding) -> str:
    """ "mass_spring, after: + clock_offset" """
    added = "".join(f" + {name}" for name in finding.final.effects)
    return finding.model + (f", after:{added}" if added else "")
