"""What the page on folds begins with: how many fabrics are estimated within their references, and at what cost."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from clothbench.display.answer import Card, answer
from clothbench.display.html import group, text
from clothbench.display.names import duration
from clothbench.studies.folding.tables import inside

Rows = Sequence[dict[str, Any]]


def answer_of(suite: str, steps: Rows) -> str:
    """The answer over the steps of one suite, as HTML: of each model with its optimizer, the best one's in detail."""
    ways = group(steps, lambda s: f"{s['model']} by {s['optimizer']}")
    ranked = sorted(ways.items(), key=lambda way: (-share_within(way[1]), way[0]))
    lead = " ".join(sentence(way, mine) for way, mine in ranked)
    return answer(f"{suite}: the answer", lead, cards(ranked[0][1]))


def last_steps(steps: Rows) -> list[dict[str, Any]]:
    """The last step of every fold."""
    return list({s["key"]: s for s in steps}.values())


def share_within(steps: Rows) -> float:
    return float(np.mean([inside(s) for s in last_steps(steps)]))


def off_by(steps: Rows) -> float:
    """%, by which an estimate is off its reference in the middle of all."""
    return 100 * float(np.median([abs(s["value"] / s["reference"] - 1) for s in steps]))


def sentence(way: str, steps: Rows) -> str:
    last = last_steps(steps)
    within = sum(map(inside, last))
    return (
        f"<b>{text(way)}</b> ends within the range of the reference for {within} of {len(last)} fabrics, after "
        f"{max(s['step'] for s in last)} steps."
    )


def cards(steps: Rows) -> list[Card]:
    last = last_steps(steps)
    first = [s for s in steps if s["step"] == min(each["step"] for each in steps)]
    missed = [s["case"] for s in last if not inside(s)]
    sure = sum(s["low"] <= s["reference"] <= s["high"] for s in last)
    slips = sum(bool(s["slips"]) for s in steps)
    slowest = max(sum(s["wall_s"] for s in mine) for mine in group(steps, lambda s: s["key"]).values())
    outside = f"outside: {', '.join(missed)}" if missed else "every fabric, at the last step"
    return [
        Card("Within ± 2σ of the reference", f"{len(last) - len(missed)} of {len(last)}", outside, good=not missed),
        Card("Off the reference", f"{off_by(last):.2g} %",
             f"median at the last step; at the first {off_by(first):.2g} %"),
        Card("Reference in the 95 % interval", f"{sure} of {len(last)}", "of the last estimate, of this one strip; the "
             "reference is a mean over strips"),
        Card("Friction", f"{max(s['friction'] for s in steps):.2f}",
             f"the most that a step needs; {slips or 'no'} {'steps slip' if slips > 1 else 'step slips'} on the desk",
             good=not slips),
        Card("Time", duration(slowest), "for the estimates of a whole fold, at most"),
    ]  # fmt: skip
