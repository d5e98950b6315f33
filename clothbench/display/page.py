"""A page: one self-contained HTML file made of sections; works offline."""

from __future__ import annotations

from collections.abc import Sequence

from clothbench.display.section import Section
from clothbench.display.style import CSS, DRAWING


def whole_page(title: str, sections: Sequence[Section]) -> str:
    """The sections that are not empty, one after the other; `title` is HTML.

    plotly.js stands in the page itself, once, and only where a section draws something.
    """
    style = "".join(dict.fromkeys(s.style for s in sections))
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<meta name="color-scheme" content="light dark">'
        f"<title>clothbench: {title}</title><style>{CSS}{style}</style></head><body><main>\n"
        + "\n".join(s.whole for s in sections if s.html)
        + f"\n</main>{scripts(sections)}</body></html>\n"
    )


def scripts(sections: Sequence[Section]) -> str:
    """plotly.js, then what the sections draw with it."""
    drawn = [s.script for s in sections if s.script]
    if not drawn:
        return ""
    from plotly.offline import get_plotlyjs

    return f"\n<script>{get_plotlyjs()}</script>\n<script>{DRAWING}{''.join(drawn)}</script>"
