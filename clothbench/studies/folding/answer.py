"""What the page on folds begins with: how many fabrics are estimated within their references, and at what cost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clothbench.display.answer import Card, answer
from clothbench.display.html import group, text
from clothbench.display.names import differing, duration
from clothbench.studies.folding.tables import asked, has_interval, inside, last_steps

Rows = Sequence[dict[str, Any]]


@dataclass(frozen=True)
class Way:
    """A model with its optimizer. cells: a row of each fold that was asked of it; steps: of all its folds; last: the
    last steps of those that came to their end.
    """

    name: str
    cells: Rows
    steps: Rows
    last: Rows

    @property
    def within(self) -> int:
        return sum(map(inside, self.last))


def answer_of(suite: str, steps: Rows, rows: Rows = ()) -> str:
    """The answer over the steps of one suite, as HTML: of each model with its optimizer, the best one's in detail.
    rows: of the leaderboard, by which folds that failed count, too.
    """
    ranked = sorted(ways(steps, asked(steps, rows)), key=lambda way: (-way.within / len(way.cells), way.name))
    if not ranked:
        return ""
    return answer(f"{suite}: the answer", " ".join(map(sentence, ranked)), cards(ranked[0]))


def ways(steps: Rows, cells: Mapping[str, dict[str, Any]]) -> list[Way]:
    told = [
        (column, word) for column, word in (("effects", "with {}"), ("objective", "on {}"))
        if len({c.get(column) for c in cells.values()}) > 1
    ]  # fmt: skip

    settings = differing(list(cells.values()))

    def name(c: dict[str, Any]) -> str:
        way = " ".join([f"{c['model']} by {c['optimizer']}", *(w.format(c.get(n)) for n, w in told if c.get(n))])
        return ", ".join(filter(None, (way, settings[c["key"]])))

    out = []
    for way, mine in group(list(cells.values()), name).items():
        own = {c["key"]: c for c in mine}
        out.append(Way(way, mine, [s for s in steps if s["key"] in own], last_steps(steps, own)))
    return out


def off_by(steps: Rows) -> float:
    """%, by which an estimate is off its reference in the middle of all."""
    return 100 * float(np.median([abs(s["value"] / s["reference"] - 1) for s in steps]))


def sentence(way: Way) -> str:
    what = "fabrics" if len({c["case"] for c in way.cells}) == len(way.cells) else "folds"
    if not way.last:
        return f"<b>{text(way.name)}</b> comes to the end of none of {len(way.cells)} {what}."
    lost = len(way.cells) - len(way.last)
    return (
        f"<b>{text(way.name)}</b> ends within the range of the reference for {way.within} of {len(way.cells)} {what}, "
        f"after {max(s['step'] for s in way.last)} steps{f'; {lost} came to no end' if lost else ''}."
    )


def cards(way: Way) -> list[Card]:
    """Of the folds that came to their end; nothing where none did."""
    last, steps = way.last, way.steps
    if not last:
        return []
    ended = {s["key"] for s in last}
    first = [s for s in steps if s["step"] == min(each["step"] for each in steps)]
    missed = [s["case"] for s in last if not inside(s)]
    lost = [c["case"] for c in way.cells if c["key"] not in ended]
    known = [s for s in last if has_interval(s)]
    sure = sum(s["low"] <= s["reference"] <= s["high"] for s in known)
    slips = sum(bool(s["slips"]) for s in steps)
    slowest = max(sum(s["wall_s"] for s in mine) for mine in group(steps, lambda s: s["key"]).values())
    parts = [f"{word}: {', '.join(some)}" for word, some in (("outside", missed), ("no end", lost)) if some]
    outside = "; ".join(parts) or "every fabric, at the last step"
    return [
        Card("Within ± 2σ of the reference", f"{way.within} of {len(way.cells)}", outside, good=not parts),
        Card("Off the reference", f"{off_by(last):.2g} %",
             f"median at the last step; at the first {off_by(first):.2g} %"),
        Card("Reference in the 95 % interval", f"{sure} of {len(known)}" if known else "no interval", "of the last "
             "estimate, of this one strip; the reference is a mean over strips"),
        Card("Friction", f"{max(s['friction'] for s in steps):.2f}",
             f"the most that a step needs; {slips or 'no'} {'steps slip' if slips > 1 else 'step slips'} on the desk",
             good=not slips),
        Card("Time", duration(slowest), "for the estimates of a whole fold, at most"),
    ]  # fmt: skip
