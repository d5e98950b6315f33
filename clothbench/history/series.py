"""The series of a history: error of every model, case and metric, and speed of every model, from commit to commit."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from clothbench.engine.judgement import (
    IDENTITY,
    RERUN,
    SLACK,
    cells_in,
    error,
    failed_whole,
    half,
    has_number,
    named,
    slack_at,
    spread,
)
from clothbench.history.entries import Entry
from clothbench.history.speed import speeds
from clothbench.history.steps import FEWEST, freedom_of, noise_of, steps_of


@dataclass(frozen=True)
class Point:
    """A value at an entry. entry: its number; value: None where there is none, with the reason; half: of its 95 %
    interval, None where there is none.
    """

    entry: int
    value: float | None
    half: float | None = None
    reason: str = ""


@dataclass(frozen=True)
class Change:
    """What changed at an entry. before, after: levels, None where there was no number; half: of the 95 % interval of
    their difference; verdict: "worse" or "better"; reason: why there is no number any more.
    """

    entry: int
    before: float | None
    after: float | None
    half: float | None
    verdict: str
    reason: str = ""

    @property
    def percent(self) -> float | None:
        if self.before is None or self.after is None or not self.before:
            return None
        return 100 * (self.after / self.before - 1)


@dataclass(frozen=True)
class Series:
    """kind: "error" (less is better) or "speed" (more is); about: what it is of; reference: that errors are distances
    from; noise: σ of a value, of a speed relative to it, None: not known.
    """

    kind: str
    about: Mapping[str, Any]
    unit: str
    points: tuple[Point, ...]
    reference: float | None = None
    noise: float | None = None
    changes: tuple[Change, ...] = field(default=())

    @property
    def label(self) -> str:
        return " · ".join(str(v) for k, v in self.about.items() if v not in (None, "", 0) and k != "machine")


def all_series(entries: Sequence[Entry]) -> list[Series]:
    """Every series with its changes: errors, then speeds; of each those first that the newest entry still has."""
    found = [*_errors(entries), *_speeds(entries)]
    return sorted(found, key=lambda one: (one.kind, -one.points[-1].entry))


def _errors(entries: Sequence[Entry]) -> list[Series]:
    """Of every question, in every unit, the mean over its recordings; single recordings where there is no mean."""
    points: dict[tuple[tuple[Any, ...], str], list[Point]] = {}
    last: dict[tuple[tuple[Any, ...], str], Mapping[str, Any]] = {}
    # A series keeps to the cell that most entries have, if some have others about the same beside it.
    cells = Counter(cell for entry in entries for cell in cells_in(entry.rows))
    by_entry = [named(entry.rows, cells) for entry in entries]
    rows_known = [(key, row) for rows in by_entry for key, row in rows.items() if not failed_whole(row)]
    known, numbers = dict(rows_known), {key: row for key, row in rows_known if has_number(row)}
    for number, given in enumerate(by_entry):
        rows = spread(given, known.items())
        means = {_of_all(key) for key, row in rows.items() if not row.get("recording")}
        for key, row in rows.items():
            if row.get("recording") and _of_all(key) in means:
                continue
            told = row if has_number(row) else numbers.get(key, row)  # what failed may tell no unit and no reference
            question = key, told.get("unit") or ""
            points.setdefault(question, []).append(_point(number, row))
            last[question] = told
    return [_error_series(key, last[key, unit], tuple(mine)) for (key, unit), mine in points.items()]


def _of_all(key: tuple[Any, ...]) -> tuple[Any, ...]:
    """A row's identity without its recording."""
    place = IDENTITY.index("recording")
    return (*key[:place], *key[place + 1 :])


def _point(number: int, row: Mapping[str, Any]) -> Point:
    if not has_number(row):
        return Point(number, None, reason=f"{row['status']}: {row.get('reason') or 'no reason given'}")
    return Point(number, error(row), half(row) or None)


def _error_series(key: tuple[Any, ...], row: Mapping[str, Any], points: tuple[Point, ...]) -> Series:
    reference = row.get("reference")
    found = [p for p in points if p.value is not None]
    values = [p.value for p in found if p.value is not None]
    halves = [math.nan if p.half is None else RERUN * p.half for p in found]
    noise, freedom = noise_of(values, halves), freedom_of(values, halves)
    # What has no interval is computed, not measured: it is the same each time, but for what the slack allows.
    changes = [
        Change(found[s.at].entry, s.before, s.after, s.half, "worse" if s.after > s.before else "better")
        for s in steps_of(values, noise or 0.0, SLACK, slack_at(reference), freedom)
    ]
    about = dict(zip(IDENTITY, key, strict=True))
    shown = tuple(sorted([*changes, *_lost(points)], key=lambda c: c.entry))
    return Series("error", about, row.get("unit") or "", points, reference, noise, shown)


def _lost(points: Sequence[Point]) -> list[Change]:
    """Where a number was lost, or came back."""
    out = []
    for a, b in pairwise(points):
        if (a.value is None) != (b.value is None):
            verdict = "worse" if b.value is None else "better"
            out.append(Change(b.entry, a.value, b.value, None, verdict, b.reason))
    return out


def _speeds(entries: Sequence[Entry]) -> list[Series]:
    """Of every suite and model on one machine; steps are looked for in the logarithm, where they are shares."""
    out = []
    for about, found in speeds(entries):
        values = [math.log(one.value) for one in found]
        # All cells of a run are slow together where the machine was busy: only runs tell how runs differ.
        halves = [one.half for one in found]
        noise = noise_of(values, halves) if len(found) >= FEWEST else None
        changes = []
        freedom = freedom_of(values, halves)
        for s in steps_of(values, noise, 0.0, math.log1p(SLACK), freedom) if noise is not None else []:
            before, after = math.exp(s.before), math.exp(s.after)
            verdict = "better" if after > before else "worse"
            changes.append(Change(found[s.at].entry, before, after, after * math.expm1(s.half), verdict))
        points = tuple(
            Point(one.entry, one.value, one.value * math.expm1(one.half) if math.isfinite(one.half) else None)
            for one in found
        )
        out.append(Series("speed", about, "evaluations/s", points, None, noise, tuple(changes)))
    return out
