"""The speed of a model from commit to commit, on one machine, whichever of its cells each of them ran.

Cells differ in how long an evaluation takes, and not every commit has all of them. So log(evaluations per second) of a
cell at a commit is taken as a number of the cell plus a number of the commit (an additive model of two factors, by
least squares), and what is shown is the commit's number, counted from a typical cell. Its interval is that of the mean
over cells, from how badly the model fits (Student's t).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clothbench.core.statistics import student
from clothbench.engine.judgement import of_cells
from clothbench.history.entries import Entry

GROUP = ("suite", "model", "effects")
CELL = (*GROUP, "case", "optimizer", "seed")  # what tells cells apart, in most suites


@dataclass(frozen=True)
class Speed:
    """entry: its number; value: evaluations per second of a typical cell; half: of the 95 % interval of its logarithm,
    NaN where cells are too few to tell.
    """

    entry: int
    value: float
    half: float


def speeds(entries: Sequence[Entry]) -> list[tuple[Mapping[str, Any], list[Speed]]]:
    """What each is of (suite, model, effects, machine), and its speeds; entries of unknown machines have none."""
    found: dict[tuple[Any, ...], dict[tuple[int, tuple[Any, ...]], list[float]]] = {}
    for number, (entry, cells) in enumerate(zip(entries, _cells(entries), strict=True)):
        if entry.machine is None:
            continue
        # A cell ended well if any row says so: a further metric may have had nothing to say.
        for row in {row.get("key"): row for row in sorted(entry.rows, key=lambda r: r["status"] == "ok")}.values():
            if (value := _speed(row)) is not None:
                group = (row["suite"], row.get("model"), row.get("effects") or "", entry.machine)
                found.setdefault(group, {}).setdefault((number, cells[row.get("key")]), []).append(value)
    names = (*GROUP, "machine")
    return [(dict(zip(names, group, strict=True)), _fitted(cells)) for group, cells in found.items()]


def _cells(entries: Sequence[Entry]) -> list[dict[Any, tuple[Any, ...]]]:
    """For each entry, by key, what a cell is in all entries, whose plugins may be of other versions. Where several of
    one entry would be the same, as cells are that minimise other metrics, they are told apart by what their rows are
    about; where that is the same, too (other options or budgets), by their keys.
    """
    about = [of_cells(entry.rows) for entry in entries]
    names = [{row.get("key"): tuple(row.get(name) or "" for name in CELL) for row in e.rows} for e in entries]
    for further in (lambda number, key: about[number][key], lambda number, key: key):
        several = {name for mine in names for name, count in Counter(mine.values()).items() if count > 1}
        for number, mine in enumerate(names):
            mine.update({key: (*n, further(number, key)) for key, n in mine.items() if n in several})
    return names


def _speed(row: Mapping[str, Any]) -> float | None:
    """log(evaluations per second) of a cell that ended well; None where that is not known."""
    evaluations, wall = row.get("evaluations"), row.get("wall_s")
    if row["status"] != "ok" or not evaluations or not wall or not math.isfinite(wall):
        return None
    return math.log(evaluations / wall)


def _fitted(cells: Mapping[tuple[int, tuple[Any, ...]], Sequence[float]]) -> list[Speed]:
    """The commits' numbers of the additive model, of those that share cells with the newest, directly or by others."""
    connected = _connected(list(cells))
    places = [place for place in cells if place[0] in connected]
    numbers = sorted({entry for entry, _ in places})
    names = list(dict.fromkeys(cell for _, cell in places))
    y = np.array([np.mean(cells[place]) for place in places])
    design = np.zeros((len(places), len(numbers) + len(names)))
    for line, (entry, cell) in enumerate(places):
        design[line, numbers.index(entry)] = design[line, len(numbers) + names.index(cell)] = 1.0
    solution = np.linalg.lstsq(design, y, rcond=None)[0]
    typical = float(solution[len(numbers) :].mean())
    free = len(y) - (len(numbers) + len(names) - 1)
    rest = y - design @ solution
    spread = math.sqrt(float(rest @ rest) / free) if free > 0 else math.nan
    counts = [sum(entry == number for entry, _ in places) for number in numbers]
    return [
        Speed(number, math.exp(float(level) + typical), _half(spread, count, free))
        for number, level, count in zip(numbers, solution, counts, strict=False)
    ]


def _half(spread: float, count: int, free: int) -> float:
    return student(free) * spread / math.sqrt(count) if free > 0 else math.nan


def _connected(places: Sequence[tuple[int, tuple[Any, ...]]]) -> set[int]:
    """Entries that can be compared with the newest one: by cells of theirs that others have, too."""
    known = {max(entry for entry, _ in places)}
    while True:
        cells = {cell for entry, cell in places if entry in known}
        more = {entry for entry, cell in places if cell in cells}
        if more == known:
            return known
        known = more
