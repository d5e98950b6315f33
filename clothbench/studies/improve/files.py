"""The folder of `clothbench improve`: verdict, page, tables and Rerun files, all of them or none.

OUT/verdict.json            the verdict (schema 1)
OUT/index.html              one self-contained page
OUT/tables/NAME.parquet     what the page is made from (`improve.schema`)
OUT/rerun/RECORDING.rrd     recording beside the model before and after, where there is something to be seen
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from clothbench.core.files import whole_files
from clothbench.engine.store import write_table
from clothbench.studies.improve.document import verdict_document
from clothbench.studies.improve.evidence import Comparison
from clothbench.studies.improve.finding import Finding
from clothbench.studies.improve.page import page_html
from clothbench.studies.improve.rerun_file import write_recording_file
from clothbench.studies.improve.schema import IMPROVE_TABLES
from clothbench.studies.improve.tables import finding_tables

OLD = ("tables/*.parquet", "rerun/*.rrd")  # of an earlier run, with other recordings perhaps


def write_folder(out: Path, finding: Finding) -> dict[str, Any]:
    """Fill `out`; what an earlier run left there is replaced, other files stay. Returns the document."""
    document, tables = verdict_document(finding), finding_tables(finding)
    with whole_files(out, instead_of=OLD) as part:
        (part / "verdict.json").write_text(json_text(document) + "\n", encoding="utf-8")
        (part / "tables").mkdir()
        for name, rows in tables.items():
            write_table(part / "tables" / f"{name}.parquet", rows, IMPROVE_TABLES[name])
        (part / "rerun").mkdir()
        if finding.evidence.has_rerun:
            for name, one in zip(file_names(finding.comparisons), finding.comparisons, strict=True):
                path = part / "rerun" / f"{name}.rrd"
                write_recording_file(path, one, label(finding), finding.floor, finding.evidence.unit)
        (part / "index.html").write_text(page_html(document, tables), encoding="utf-8")
    return document


def json_text(document: Mapping[str, Any]) -> str:
    return json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False)


def label(finding: Finding) -> str:
    """ "mass_spring, after: + clock_offset" """
    added = "".join(f" + {name}" for name in finding.final.effects)
    return finding.model + (f", after:{added}" if added else "")


def file_names(comparisons: Sequence[Comparison]) -> list[str]:
    """The recordings' names as file names, each once."""
    out: list[str] = []
    for one in comparisons:
        name = re.sub(r"[^\w.-]+", "_", one.case.name).lstrip(".") or "recording"
        out.append(name if name not in out else f"{name}-{len(out) + 1}")
    return out
