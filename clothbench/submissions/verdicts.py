"""What a verifier has found, kept apart from the submissions: a folder with a JSON document for each of them.

A grade that takes running somebody's code is given once and looked up afterwards. It counts for the very submission
that it was given to, known by the SHA-256 of its `submission.json`, which holds those of all its files, and for the
version that gave it. A submission brings no verdict with it: what lies in its own folder is never read as one.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import clothbench
from clothbench.core.errors import ClothbenchError
from clothbench.core.files import read_json, sha256, whole_file
from clothbench.engine.system import now, system_info
from clothbench.submissions.submission import FILE
from clothbench.submissions.verification import GRADE, REFUSED, REPRODUCED, VERIFIED

SCHEMA = 1
WHEELS, HELD_OUT = "wheels", "held-out"  # what else than a fit can fail


@dataclass(frozen=True)
class Verdict:
    """seed: of the last choice; cells: fits that were run again, and passed; unpublished: rows of the means over
    recordings that were never published, as the leaderboard has them, without the recordings' names; faults: why it
    does not stand, by what was run: a fit's key, WHEELS or HELD_OUT.
    """

    submission: str
    sha256: str
    seed: int | None = None
    cells: Sequence[str] = ()
    unpublished: Sequence[dict[str, Any]] = ()
    faults: Mapping[str, Sequence[str]] = field(default_factory=dict)
    network: str = ""
    clothbench: str = clothbench.__version__
    machine: str = ""
    date: str = ""

    @property
    def grade(self) -> str:
        """Of the submission as a whole: unpublished recordings say nothing about the scores that were handed in, so
        that it takes both to be verified. Each row has a grade of its own.
        """
        if self.faults:
            return REFUSED
        if not self.cells:
            return GRADE
        return VERIFIED if self.unpublished else REPRODUCED

    def grade_of(self, cells: Iterable[str]) -> str:
        """Of a row about these fits, on recordings that are published."""
        return REPRODUCED if set(cells) <= set(self.cells) else GRADE

    def after(self, earlier: Verdict | None) -> Verdict:
        """With what was found earlier. A fault stays until the same is run again without one."""
        if earlier is None:
            return self
        passed = {*self.cells, *([WHEELS] if self.network else []), *([HELD_OUT] if self.unpublished else [])}
        stay = {what: why for what, why in earlier.faults.items() if what not in passed}
        cells = {*self.cells, *earlier.cells} - self.faults.keys()
        return dataclasses.replace(
            self,
            seed=earlier.seed if self.seed is None else self.seed,
            cells=sorted(cells),
            unpublished=self.unpublished or earlier.unpublished,
            faults={**stay, **self.faults},
        )


def verdict_on(folder: Path, name: str, **more: Any) -> Verdict:
    """A verdict on the submission in a folder, as it is now."""
    where = system_info()
    machine = f"{where['cpu']}, {where['cores']} cores"
    return Verdict(name, sha256(folder / FILE), machine=machine, date=now(), **more)


def write_verdict(verdicts: Path, verdict: Verdict, folder: Path) -> Path:
    """Keep a verdict on the submission in a folder, beside what an earlier one found about it."""
    verdict = verdict.after(find_verdict(verdicts, folder))
    told = {"schema": SCHEMA, "grade": verdict.grade, **asdict(verdict)}
    path = verdicts / f"{verdict.sha256[:16]}.json"
    with whole_file(path) as part:
        part.write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")
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
        stated.pop("grade")  # for readers: it follows from the rest
        verdict = Verdict(**stated)
    except (ValueError, KeyError, TypeError, AttributeError) as fault:
        raise ClothbenchError(f"{path}: is no verdict ({fault}); remove it and verify the submission again") from None
    return verdict if (verdict.sha256, verdict.clothbench) == (digest, clothbench.__version__) else None
