"""What the page on models against mechanics begins with: which model meets how many references, and where it is off."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from clothbench.display.answer import Card, answer
from clothbench.display.html import group, text
from clothbench.studies.mechanics.tables import called, finest, relative_error

Rows = Sequence[dict[str, Any]]
NEAR = 1.0  # %: so near to its reference a value meets it, on meshes that a page is made with
ORDER = 1.8  # an observed order of convergence from here on counts as the second
MEASURED = "eta_b"  # of fabrics that were measured by hand: known to some tens of a percent, and no reference to meet


def answer_of(suite: str, rows: Rows, levels: Rows = ()) -> str:
    """The answer over the rows of one suite, as HTML; of a test that was run on several meshes the finest counts."""
    rows, name = finest(rows, levels), called(rows)
    cards = sorted((card_of(*pair) for pair in group(rows, name).items()), key=rank)
    if not any(judged(rows)):
        return answer(f"{suite}: the answer", "There is no answer: no model came to a value.", cards)
    most, of = met_by(cards[0]), cards[0].said
    best = [card.title for card in cards if (met_by(card), card.said) == (most, of)]
    names = " and ".join(f"<b>{text(name)}</b>" for name in best)
    what = "its references" if len(cards) == 1 else "the most references"
    said = f"{names} {'meet' if len(best) > 1 else 'meets'} {what}: {most} of {of}"
    lead = f"{said} within {NEAR:g} %, or of second order where that is the test."
    return answer(f"{suite}: the answer", lead, cards)


def card_of(model: str, rows: Rows) -> Card:
    """What one model, set in one way, meets, where it is farthest off, and what it was not asked."""
    found = judged(rows)
    met = [r for r in found if meets(r)]
    values = [r for r in found if r["metric"] != "order"]
    parts = []
    if values:
        far = max(values, key=lambda r: abs(relative_error(r) or 0.0))
        parts.append(f"farthest off: {far['case']}, {relative_error(far):+.2g} %")
    parts += [f"order {r['value']:.2f} in {r['case']}" for r in found if r["metric"] == "order" and not meets(r)]
    for word in ("skipped", "diverged", "timeout", "error"):
        if count := sum(r["status"] == word for r in rows):
            parts.append(f"{count} {word}")
    good = None if not found else len(met) == len(found)
    return Card(model, f"{len(met)} of {len(found)}", "; ".join(parts), good, said=str(len(found)))


def judged(rows: Rows) -> list[dict[str, Any]]:
    """Rows with a value beside a reference that mechanics gives; one that a time limit stopped is of a coarser mesh."""
    return [r for r in rows if r["status"] == "ok" and r["metric"] != MEASURED and relative_error(r) is not None]


def meets(row: dict[str, Any]) -> bool:
    error = relative_error(row)
    if row["metric"] == "order":
        return bool(row["value"] >= ORDER)
    return error is not None and abs(error) <= NEAR


def met_by(card: Card) -> int:
    return int(card.value.split()[0])


def rank(card: Card) -> tuple[int, int, str]:
    return -met_by(card), int(card.said), card.title
