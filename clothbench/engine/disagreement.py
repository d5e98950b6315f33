"""Cells that were computed twice: whether they came to the same, why they may not have, and the record of it."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from clothbench.core.errors import ClothbenchError
from clothbench.core.files import read_json
from clothbench.engine.tables import finite

RECORD = "the record of a disagreement, as a run writes it"
SEEDLESS = "something in this cell does not go by its seed: a model, a tracker, or a library's threads"
# What the last bits of a result depend on beside its cell, as its rows have it, and how it is called.
MACHINE = {"cpu": "processor", "numpy": "numpy", "numba": "numba"}
ROUNDING = 1e-9  # of a value: what another machine may make of the last bits


def outcome(rows: Sequence[Mapping[str, Any]]) -> list[float | str]:
    """What came of a cell, the same whenever and wherever it is computed: of each row its value, or why it has none."""
    return [row["status"] if (value := finite(row["value"])) is None else value for row in rows]


def other_machine(rows: Sequence[Mapping[str, Any]], others: Sequence[Mapping[str, Any]]) -> list[str]:
    """What of `MACHINE` two results of one cell were computed with another one of, as far as both say."""

    def said(name: str, of: Sequence[Mapping[str, Any]]) -> set[str]:
        return {str(value) for row in of if (value := row.get(name)) is not None}

    return [n for n in MACHINE if said(n, rows) and said(n, others) and said(n, rows) != said(n, others)]


def agree(first: Sequence[float | str], second: Sequence[float | str], other: Collection[str]) -> bool:
    """Whether two outcomes of one cell are the same: to the bit, on an `other` machine to within rounding."""

    def alike(one: float | str, again: float | str) -> bool:
        if isinstance(one, str) or isinstance(again, str) or not other:
            return one == again
        return math.isclose(one, again, rel_tol=ROUNDING)

    return len(first) == len(second) and all(map(alike, first, second))


def why_apart(other: Collection[str]) -> str:
    """Why a cell may not have come to the same twice."""
    if not other:
        return SEEDLESS
    machine = " and ".join(word for name, word in MACHINE.items() if name in other)
    return f"the two were computed with another {machine}, which may be why: bits depend on it (docs/cluster.md)"


def recorded(path: Path) -> tuple[list[float | str], list[float | str], list[str]]:
    """What a record of a disagreement holds: the outcome that stays, the other, and of `MACHINE` what the second was
    computed with another one of, which records of earlier versions do not say; a ClothbenchError if it is none.
    """
    found = read_json(path, RECORD)
    both = [found.get(name) if isinstance(found, dict) else None for name in ("first", "second")]
    if not all(isinstance(one, list) and all(isinstance(value, str | int | float) for value in one) for one in both):
        raise ClothbenchError(f"{path}: found something else, expected {RECORD}")
    other = found.get("other")
    return both[0], both[1], [name for name in MACHINE if isinstance(other, list) and name in other]  # type: ignore[return-value]
