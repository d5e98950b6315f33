"""Errors at a glance: a line for each case, a column for each way, or for one way alone a column for what it was judged
on; coloured by how far off, with a switch for the metric.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

from clothbench.display.html import group
from clothbench.display.section import Section
from clothbench.display.templates import asset_of, rendered
from clothbench.engine.study import Results
from clothbench.plugins.discovery import catalogue
from clothbench.studies.calibration.answer import leading_metric
from clothbench.studies.calibration.ranking import Standing, alike, best_of, once, seeds_told, standings
from clothbench.studies.calibration.words import case_name, counted, headed, size

Rows = Sequence[dict[str, Any]]
Links = Callable[[str, str], str]  # (suite, case) → where a click on it leads, nothing where there is no more of it
HERE = Path(__file__).parent
HOTTEST = 55  # %, the share of the heat's colour in the hottest square: text on it is still read with ease
NARROW = math.log(4)  # span of a table's errors that is drawn from the coldest to the hottest, at least
FOUR_TIMES = 2.0  # powers of two from the best of a line at which a square is at its hottest
TRIALS = 6  # columns of recordings at most, beside the fitted one


@dataclass(frozen=True)
class Square:
    """text: the error; below: what else is said; heat: %; best: of its line; link: where a click leads;
    title: what the pointer brings up; framed: whether it is what was fitted.
    """

    text: str
    below: str = ""
    heat: float = 0.0
    best: bool = False
    link: str = ""
    title: str = ""
    framed: bool = False


@dataclass(frozen=True)
class Matrix:
    """One metric's table: heads of its columns, and (case, link, squares) for each line."""

    metric: str
    unit: str
    meaning: str
    heads: tuple[str, ...]
    lines: tuple[tuple[str, str, tuple[Square, ...]], ...]


def matrix_section(results: Results, filmed: Collection[tuple[str, str]]) -> Section:
    """A table per suite and metric. filmed: (suite, case) of cases whose cloth can be looked at."""
    drawn, called = {(r["suite"], r["case"]) for r in results.rows if r["recording"]}, case_name(results.rows)

    def links(suite: str, case: str) -> str:
        place = "cloth" if (suite, case) in filmed else "figures" if (suite, case) in drawn else ""
        return f"#{place}?{urlencode({'case': called(suite, case)})}" if place else ""

    parts = []
    for suite, rows in sorted(group(results.rows, lambda r: r["suite"]).items()):
        ways = {way for case in standings(rows, "").values() for way in case}
        make = several_ways if len(ways) > 1 else one_way
        found = [make(suite, metric, rows, links) for metric in metrics_of(rows)]
        title = headed(results.rows)(suite, "models by cases" if len(ways) > 1 else "case by case")
        parts.append(rendered(HERE, "matrix.html", title=title, matrices=found, several=len(ways) > 1))
    return Section("".join(parts), early=asset_of(HERE, "matrix.js"))


def metrics_of(rows: Rows) -> list[str]:
    """By what the answer is given first, then what else was minimised, then what was reported beside it."""
    objectives = {r["objective"] for r in rows if r["objective"]}
    known = [leading_metric(rows), *sorted(objectives), *sorted({r["metric"] for r in rows if r["metric"]})]
    return [name for name in dict.fromkeys(known) if name]


def several_ways(suite: str, metric: str, rows: Rows, links: Links) -> Matrix:
    """A column for each way; ties are in bold together."""
    found = standings(rows, metric)
    ways = sorted({way for case in found.values() for way in case})
    lines = []
    for case, standing in sorted(found.items()):
        best = best_of(standing)
        squares = tuple(_square(standing.get(way), standing, best, links(suite, case)) for way in ways)
        lines.append((case, links(suite, case), squares))
    return Matrix(metric, unit_of(rows, metric), meaning_of(metric), tuple(ways), tuple(lines))


def _square(one: Standing | None, line: Mapping[str, Standing], best: Sequence[str], to: str) -> Square:
    if one is None:
        return Square("")
    if one.value is None:
        status = one.status if one.status != "ok" else "–"
        return Square(status, one.whole or one.reason or one.unjudged, title=one.reason, link=to)
    compared = alike(line)
    least, mine = compared[best[0]].value or 0.0, compared[one.way].value or 0.0
    ratio = mine / least if least else math.inf if mine else 1.0
    behind = f"× {ratio:.2f}" if math.isfinite(ratio) else "best is 0"
    said = "" if one.way == best[0] else "≈ tied" if one.way in best else behind
    about = f"{counted(len(one.errors), 'recording')}" + (f", {one.seeds} seeds each" if one.seeds > 1 else "")
    if others := len(one.errors) - len(compared[one.way].errors):
        about += f"; compared without {counted(others, 'recording')} that not all ways have"
    heat = 0.0 if ratio <= 1 else min(math.log2(ratio) / FOUR_TIMES, 1.0) * HOTTEST
    return Square(size(one.value), said, round(heat, 1), one.way in best, to, about)


def one_way(suite: str, metric: str, rows: Rows, links: Links) -> Matrix:
    """A column for each kind of recording, the fitted one framed; where there are too many, "fitted" and "held out"."""
    lines_of = group(rows, lambda r: r["case"])
    shown = {n: once([r for r in some if r["metric"] == metric and r["recording"]]) for n, some in lines_of.items()}
    mine = [r for some in shown.values() for r in some]
    names = sorted({tail(r) for r in mine})
    few = len(names) <= TRIALS
    name = tail if few else lambda r: "fitted" if r["split"] == "fit" else "held out"
    heads = names if few else [h for h in ("fitted", "held out") if any(name(r) == h for r in mine)]
    known = [r["value"] for r in mine if r["value"] and r["value"] > 0]
    ends = (min(known), max(known)) if known else (1.0, 1.0)
    lines = []
    for case, some in sorted(lines_of.items()):
        bad = next((r for r in some if r["status"] != "ok"), None)
        by_head = group(shown[case], name)
        to = links(suite, case)
        told = seeds_told(some, metric)
        squares = tuple(_judged(by_head.get(head, []), bad, ends, to, told, framed=few) for head in heads or [""])
        lines.append((case, to, squares))
    return Matrix(metric, unit_of(rows, metric), meaning_of(metric), tuple(heads or [""]), tuple(lines))


def tail(row: dict[str, Any]) -> str:
    """What a recording is called within its fabric."""
    return row["recording"].rpartition("/")[2]


def _judged(
    rows: Rows, bad: dict[str, Any] | None, ends: tuple[float, float], to: str, told: str, framed: bool
) -> Square:  # fmt: skip
    """The mean of some errors, the hotter the larger it is among all of the table. told: of how many seeds."""
    values = [r["value"] for r in rows if r["value"] is not None]
    if not values or len(values) < len(rows):
        return Square("") if not bad else Square(bad["status"], bad["reason"] or "", link=to)
    mean, span = sum(values) / len(values), max(math.log(ends[1] / ends[0]), NARROW)
    heat = HOTTEST * max(math.log(mean / ends[0]) / span, 0.0) if span > 0 and mean > 0 else 0.0
    floors, framed = [r["floor"] for r in rows], framed and any(r["split"] == "fit" for r in rows)
    below = f"floor {size(sum(floors) / len(floors))}" if floors and all(floors) else ""
    about = f"mean of {len(values)}, {size(min(values))} … {size(max(values))}" if len(values) > 1 else ""
    about = "; ".join(filter(None, ("fitted" if framed else "", about, below)))
    return Square(size(mean), told, round(heat, 1), False, to, about, framed)


def unit_of(rows: Rows, metric: str) -> str:
    return next((r["unit"] for r in rows if r["metric"] == metric and r["unit"]), "")


def meaning_of(metric: str) -> str:
    """What the plugin says of itself; nothing where it is not installed here."""
    name = metric.partition(" [")[0]  # where fits are in several units, theirs is beside it
    return next((p.summary for p in catalogue().plugins if (p.kind, p.name) == ("metrics", name)), "")
