"""The one exception a user can cause, a single line that says what to do; and what ends any work from outside."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable

# What has no business in a text: it moves a terminal's cursor, turns what follows around, or is half a letter. Line
# breaks and tabs are not among it.
UNSEEN = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
BEGINNING, END = 1200, 400  # characters of a line that is too long for one that are kept


class ClothbenchError(Exception):
    """Wrong use or bad input. Shown as one line; the command ends with exit code 2."""

    def __init__(self, text: object = ""):
        super().__init__(one_line(str(text)))


class Stopped(BaseException):
    """Nobody waits for this work any more; no `except Exception` of a plugin holds it up."""


# What ends a work and is no word of it: everything else that a plugin raises is a fault, whatever it is made of (an
# asyncio.CancelledError and what Rust's libraries raise are no Exceptions).
ENDS = (KeyboardInterrupt, GeneratorExit, Stopped)


def seen(text: str) -> str:
    """A text that may come from anywhere, without what cannot be seen."""
    return UNSEEN.sub("\ufffd", text)


def one_line(text: str) -> str:
    """A text that may come from anywhere as one line that a terminal shows as it is."""
    line = seen(re.sub(r"\s*[\n\r\v\f\x1c-\x1e\x85\u2028\u2029]\s*", " ", text).strip())
    return line if len(line) <= BEGINNING + END else f"{line[:BEGINNING]} … {line[-END:]}"


def known_names(name: str, known: Iterable[str]) -> str:
    """What to say of a name that is none of those known: the nearest, if one is near, and all of them."""
    there = list(known)
    return f"{nearest(name, there)}there are: {', '.join(there) or 'none'}"


def nearest(name: str, known: Iterable[str]) -> str:
    """ "did you mean 'budget'? " of "budgett", for before what else is said; "" where no name is near: of four letters
    one may be a slip, and names that differ in digits alone are all meant.
    """
    there = list(known)
    close = [
        one for one in difflib.get_close_matches(name, there, n=max(len(there), 1))
        if slips(name, one) <= max(len(name) // 4, 1) and _NUMBER.sub("0", name) != _NUMBER.sub("0", one)
    ]  # fmt: skip
    return f"did you mean {close[0]!r}? " if close else ""


_NUMBER = re.compile(r"\d+")


def slips(word: str, meant: str) -> int:
    """How many slips make a word of the one that was meant: a letter that is wrong, too many, missing, or after the
    next (the restricted distance of Damerau, Communications of the ACM 7 (1964) 171).
    """
    rows = [list(range(len(meant) + 1))]
    for i, a in enumerate(word, 1):
        row = [i]
        for j, b in enumerate(meant, 1):
            least = min(rows[-1][j] + 1, row[-1] + 1, rows[-1][j - 1] + (a != b))
            if min(i, j) > 1 and (a, word[i - 2]) == (meant[j - 2], b):
                least = min(least, rows[-2][j - 2] + 1)
            row.append(least)
        rows.append(row)
    return rows[-1][-1]


NEAR = 0.85  # alikeness of two words from which on one is the other misspelled


def misspelled(names: Iterable[str], absent: Iterable[str]) -> tuple[str, str] | None:
    """The first name that is nearly a word which somebody may state and did not, and that word; None if none is. What
    takes any other name for a note of its own would lose what was meant by it.
    """
    words = sorted(absent)
    for name in sorted(names):
        if near := difflib.get_close_matches(name.lower(), words, n=1, cutoff=NEAR):
            return name, near[0]
    return None


def check_choice(plugin: str, option: str, value: object, choices: Iterable[str]) -> None:
    """Refuse an option of a plugin that is not one of some words, whatever type it has."""
    known = tuple(choices)
    if not isinstance(value, str) or value not in known:
        raise ClothbenchError(f"{plugin}: {option} is {value!r}, expected one of {', '.join(known)}")
