"""What a study's part of a page begins with: the answer in a sentence or two, then what it rests on as cards."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from markupsafe import Markup

from clothbench.display.templates import rendered


@dataclass(frozen=True)
class Card:
    """One part of the answer: a word above, what is to be known, and what it rests on; good: whether it is good news,
    None where that is not to be said; said: the same for a sentence.
    """

    title: str
    value: str
    detail: str
    good: bool | None = None
    said: str = ""


def answer(title: str, lead: str, cards: Sequence[Card]) -> str:
    """The HTML of it. lead: HTML."""
    return rendered(Path(__file__).parent, "answer.html", title=title, lead=Markup(lead), cards=cards)
