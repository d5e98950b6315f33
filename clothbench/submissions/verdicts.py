"""What a verifier has found, kept apart from the submissions: a folder with a JSON document for each of them.

A grade that takes running somebody's code is given once and looked up afterwards. It counts for the very submission
that it was given to, known by the SHA-256 of its `submission.json`, which holds those of all its files, and for the
version that gave it. A submission brings no verdict with it: what lies in its own folder is never read as one.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import clothbench
from clothbench.core.errors import ClothbenchError
from clothbench.core.files import read_json, sha256, whole_file
from clothbench.engine.store import now, system_info
from clothbench.submissions.submission import FILE

SCHEMA = 1


@dataclass(frozen=True)
class Verdict:
    """grade: the highest that was given; seed and cells: what was chosen to be run again, and passed; unpublished: rows
    of the means over recordings that were never published, as the leaderboard has them, without the recordings' names.
    """

    submission: str
    sha256: str
    grade: str
    seed: int | None = None
    cells: Sequence[str] = ()
    unpublished: Sequence[dict[str, Any]] = ()
    network: str = ""
    clothbench: str = clothbench.__version__
    machine: str = ""
    date: str = ""


def verdict_on(folder: Path, name: str, grade: str, **more: Any) -> Verdict:
    """A verdict on the submission in a folder, as it is now."""
    where = system_info()
    machine = f"{where['cpu']}, {where['cores']} cores"
    return Verdict(name, sha256(folder / FILE), grade, machine=machine, date=now(), **more)


def write_verdict(verdicts: Path, verdict: Verdict, folder: Path) -> Path:
    """Keep a verdict on the submission in a folder; what an earlier one found about it beside that, stays."""
    earlier = find_verdict(verdicts, folder)
    if earlier is not None and not verdict.unpublished and earlier.unpublished:
        verdict = dataclasses.replace(verdict, grade=earlier.grade, unpublished=earlier.unpublished)
    if earlier is not None and verdict.seed is None:
        verdict = dataclasses.replace(verdict, seed=earlier.seed, cells=earlier.cells)
    path = verdicts / f"{verdict.sha256[:16]}.json"
    with whole_file(path) as part:
        part.write_text(json.dumps({"schema": SCHEMA, **asdict(verdict)}, indent=1) + "\n", encoding="utf-8")
    return path


def find_verdict(verdicts: Path | None, folder: Path) -> Verdict | None:
    """What was found about the submission in a folder as it is now, by this version; None if nothing was."""
    if verdicts is None:
        return None
    digest = sha256(folder / FILE)
    path = verdicts / f"{digest[:16]}.json"
    if not path.is_file():
        return None
    stated = read_json(path, "a verdict of `clothbench verify`")
    try:
        if stated.pop("schema") != SCHEMA:
            raise ValueError(f"its schema is not {SCHEMA}")
        verdict = Verdict(**stated)
    except (ValueError, KeyError, TypeError, AttributeError) as fault:
        raise ClothbenchError(f"{path}: is no verdict ({fault}); remove it and verify the submission again") from None
    return verdict if (verdict.sha256, verdict.clothbench) == (digest, clothbench.__version__) else None
