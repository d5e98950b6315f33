"""The folder of `clothbench improve`: verdict, page, tables and Rerun files, all of them or none.

OUT/verdict.json            the verdict (schema 1)
OUT/index.html              one self-contained page
OUT/tables/NAME.parquet     what the page is made from (`experiment.improve_schema`)
OUT/rerun/RECORDING.rrd     recording beside the model before and after (not of force-extension curves)
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from clothbench.core.files import whole_files
from clothbench.engine.store import write_table
from clothbench.studies.improve.before_after import Seen, both, pulled
from clothbench.studies.improve.page import document
from clothbench.studies.improve.rerun_file import write_recording_file
from clothbench.studies.improve.rounds import Outcome
from clothbench.studies.improve.schema import IMPROVE_TABLES
from clothbench.studies.improve.tables import MM, all_rows
from clothbench.studies.improve.verdict import standing

OLD = ("tables/*.parquet", "rerun/*.rrd")  # of an earlier run, with other recordings perhaps


def write_folder(out: Path, outcome: Outcome, found: Mapping[str, Any]) -> None:
    """Fill `out`; what an earlier run left there is replaced, other files stay."""
    after = standing(outcome)
    seen = both(outcome, after)
    tables = all_rows(outcome, found, after, seen, pulled(outcome, after))
    with whole_files(out, instead_of=OLD) as part:
        (part / "verdict.json").write_text(json_text(found) + "\n", encoding="utf-8")
        (part / "tables").mkdir()
        for name, rows in tables.items():
            write_table(part / "tables" / f"{name}.parquet", rows, IMPROVE_TABLES[name])
        (part / "rerun").mkdir()
        for name, one in zip(file_names(seen), seen, strict=True):
            write_recording_file(part / "rerun" / f"{name}.rrd", one, label(found), MM * outcome.floor)
        (part / "index.html").write_text(document(found, tables), encoding="utf-8")


def json_text(found: Mapping[str, Any]) -> str:
    return json.dumps(found, indent=1, ensure_ascii=False, allow_nan=False)


def label(found: Mapping[str, Any]) -> str:
    """ "mass_spring, after: + clock_offset" """
    added = "".join(f" + {effect['name']}" for effect in found["effects"])
    return found["model"] + (f", after:{added}" if added else "")


def file_names(seen: Sequence[Seen]) -> list[str]:
    """The recordings' names as file names, each once."""
    out: list[str] = []
    for one in seen:
        name = re.sub(r"[^\w.-]+", "_", one.case.name).lstrip(".") or "recording"
        out.append(name if name not in out else f"{name}-{len(out) + 1}")
    return out
