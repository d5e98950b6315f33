"""A page: one self-contained HTML file made of sections; works offline."""

from __future__ import annotations

import re
from collections.abc import Sequence, Set
from functools import cache
from html import unescape
from pathlib import Path

from markupsafe import Markup

from clothbench.display.section import Section, packed
from clothbench.display.templates import asset, rendered

HEADING = re.compile(r"<h2(?: id=\"([^\"]*)\")?>(.*?)</h2>", re.DOTALL)
IDENTITY = re.compile(r'\bid="([^"]*)"')
TAG = re.compile(r"<[^>]*>")
BEFORE_FIGURES = ("address.js", "start.js", "tables.js")  # what runs at once, on every page


def whole_page(title: str, sections: Sequence[Section]) -> str:
    """The sections that are not empty, one after the other; `title` is HTML.

    Every <h2> gets an anchor and stands in the list of contents. plotly.js stands in the page itself, once and packed,
    and only where a section draws something with it.
    """
    shown = [s for s in sections if s.html]
    contents: list[tuple[str, str]] = []
    known = set(IDENTITY.findall("".join(s.whole for s in shown)))
    return rendered(
        Path(__file__).parent, "page.html", title=Markup(title),
        style=Markup(asset("page.css") + "".join(dict.fromkeys(s.style for s in sections))),
        sections=[Markup(anchored(s.whole, contents, known)) for s in shown], contents=contents,
        library=Markup(packed_plotly()[1]) if any(s.script for s in sections) else "", version=packed_plotly()[0],
        script=Markup(script_of(sections)),
    )  # fmt: skip


def anchored(html: str, contents: list[tuple[str, str]], known: Set[str]) -> str:
    """The HTML with an anchor for each of its <h2>, which are added to `contents` as (anchor, words).

    known: what else of the page has a name of its own already.
    """

    def with_anchor(found: re.Match[str]) -> str:
        words = unescape(TAG.sub("", found[2])).strip()
        name = found[1] or re.sub(r"[^\w]+", "-", words.lower()).strip("-") or "section"
        taken = {anchor for anchor, _ in contents} | (known - {found[1]})
        anchor = next(n for n in (name, *(f"{name}-{k}" for k in range(2, len(taken) + 3))) if n not in taken)
        contents.append((anchor, words))
        return f'<h2 id="{anchor}">{found[2]}</h2>'

    return HEADING.sub(with_anchor, html)


def script_of(sections: Sequence[Section]) -> str:
    """What runs at once, then, when the page has been painted, what draws with plotly.js."""
    early = "".join(dict.fromkeys(s.early for s in sections if s.early))
    drawn = "".join(s.script for s in sections if s.script)
    parts = ['"use strict";\n', *(asset(name) for name in BEFORE_FIGURES), early]
    if drawn:
        begin = 'await painted();\nawait library("plotly");\nawait unpackAll();'
        parts += [asset("figures.js"), f"(async () => {{\n{begin}\n{drawn}\n}})();\n"]
    return "".join(parts)


@cache
def packed_plotly() -> tuple[str, str]:
    """(version, packed text) of plotly.js, a third as long as its text."""
    from plotly.offline import get_plotlyjs, get_plotlyjs_version

    return get_plotlyjs_version(), packed(get_plotlyjs())
