"""Rows for the leaderboard of what stands, with the grade in each of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence
from dataclasses import asdict
from typing import Any

from clothbench.core.files import remove_folder
from clothbench.display.html import group
from clothbench.engine.cells import digest, listed, plugin_versions
from clothbench.engine.store import Store
from clothbench.engine.system import now, system_info
from clothbench.estimation.intervals import mean_of_split
from clothbench.plugins.discovery import Catalogue
from clothbench.studies.calibration.cell import asked_again
from clothbench.submissions.submission import Compared, Submission
from clothbench.submissions.verification import GRADE, REPRODUCED, VERIFIED


def keep(
    submission: Submission,
    found: Sequence[Compared],
    store: Store,
    plugins: Catalogue,
    reproduced: Collection[str] = (),
    named: bool = True,
) -> list[str]:
    """A cell of the store for each fit, or for each fabric where the fits are not known or never saw it, with a row for
    each score and for the mean of each split; gives their keys. Rows show the grade beside the optimizer, or in its
    place. A cell that is there already makes way for one of the same grade or a better one, so that a submission is
    there once.

    reproduced: keys of the fits that were run again; named: whether rows may say of which recordings they are; else
    these were never published, and there are means only.
    """
    cells = {asked.key: asked_again(asked.question) for asked in submission.cells}
    versions = plugin_versions([("metrics", metric) for metric in submission.metrics], plugins)
    groups: dict[tuple[str, str | None], list[Compared]] = {}
    for one in found:  # a fit that is known is one cell, as in the run, also where it is of several fabrics
        of_fit = named and one.cell in cells
        groups.setdefault((one.cell, None if of_fit else one.measured.fabric), []).append(one)
    keys = []
    for (of, _), mine in groups.items():
        cell, fabrics = cells.get(of), sorted({one.measured.fabric for one in mine})
        fabric = ", ".join(fabrics)
        grade = VERIFIED if not named else REPRODUCED if of in reproduced else GRADE
        key = content_of(submission) + digest([of, fabric, named], 8)
        case = cell.case if cell is not None and named else fabric
        about = {
            "study": "calibration", "suite": submission.suite, "case": case, "model": submission.name,
            "effects": ",".join(cell.effects) if cell else "", "seed": cell.seed if cell else 0,
            "optimizer": f"{cell.optimizer}, submitted, {grade}" if cell else f"submitted, {grade}",
            "key": key, "status": "ok", "reason": None, "evaluations": None, "wall_s": None, "reference": None,
            "budget": None, "settings": None, "plugins": listed(versions), "threads": None,
            "finished": now(), **system_info(),
        }  # fmt: skip
        rows = [{**about, **row} for row in rows_of(mine) if named or row["recording"] is None]
        if _makes_way(store, key, grade):
            store.put(key, {"rows": rows})
        keys.append(key)
        if len(fabrics) > 1:
            _remove_parts(store, [content_of(submission) + digest([of, part, named], 8) for part in fabrics])
    return keys


def content_of(submission: Submission) -> str:
    """Hexadecimal digits of what was handed in, whoever did, whenever, and whatever was said about it."""
    return digest(asdict(dataclasses.replace(submission, by="", about="")))


def _makes_way(store: Store, key: str, grade: str) -> bool:
    """Remove a cell, unless its grade is better than this one; whether its place is free now."""
    order = (GRADE, REPRODUCED, VERIFIED)
    for row in store.rows([key]):
        if order.index(row["optimizer"].rpartition(", ")[2]) > order.index(grade):
            return False
    if store.cell(key).exists():
        remove_folder(store.cell(key))
    return True


def _remove_parts(store: Store, keys: Sequence[str]) -> None:
    """Remove the cells by fabric that an older version made of one fit, each with the mean of a part under its name."""
    for key in keys:
        if store.cell(key).exists():
            remove_folder(store.cell(key))


def drop(submission: Submission, store: Store) -> None:
    """Remove what the store has of a submission."""
    for cell in store.folder.glob(f"cells/{content_of(submission)}*"):
        remove_folder(cell)


def rows_of(compared: Sequence[Compared]) -> list[dict[str, Any]]:
    """What differs from row to row: of each recording and metric, and the means of each split, in which every
    recording counts once.
    """
    out = []
    for metric in dict.fromkeys(metric for one in compared for metric in one.scores):
        for split in dict.fromkeys(one.split for one in compared):
            if not (mine := [one for one in compared if one.split == split and metric in one.scores]):
                continue  # this metric is not handed in for the recordings of this split
            about = {"metric": metric, "objective": metric, "split": split, "unit": mine[0].units[metric]}
            single = [{**about, "recording": one.measured.name, **one.row(metric)} for one in mine]
            out += [{**about, "recording": None, **mean_of_split(_each_once(single))}, *single]
    return out


def _each_once(rows: Sequence[dict[str, Any]]) -> list[dict[str, float | None]]:
    """A row for each recording, the mean of those of all fits: by how many fits it was simulated is not to decide how
    much it counts, and fits of one recording are not independent of each other.
    """
    of = group(rows, lambda row: row["recording"])
    return [
        {name: _mean([row[name] for row in some]) for name in ("value", "floor", "low", "high")} for some in of.values()
    ]


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if len(known) == len(values) else None
