"""A section of a page: HTML, and the figures that its script draws."""

from __future__ import annotations

import json
import re
import zlib
from base64 import b64encode
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

LONG = 100_000  # characters of HTML that may come later, from which on it is packed
LONG_DATA = 300_000
LATER = re.compile(r"<!--later-->(.*?)<!--/later-->", re.DOTALL)


@dataclass(frozen=True)
class Section:
    """html: what stands there; data: JSON by the id of the element that holds it; script: draws it, once plotly.js and
    the helpers of `assets/figures.js` are there; early: runs at once, without them (`await dataOf(id)` gives data);
    style: of its own, behind the page's; later: data that are unpacked only when they are asked for.
    """

    html: str
    data: Mapping[str, Any] = field(default_factory=dict)
    script: str = ""
    style: str = ""
    early: str = ""
    later: Mapping[str, Any] = field(default_factory=dict)

    @property
    def whole(self) -> str:
        """The section with its data, as the page has it."""
        data = [element(name, json_text(content)) for name, content in self.data.items()]
        data += [packed_element(name, json_text(content), later=True) for name, content in self.later.items()]
        return "\n".join([with_fragments(self.html), *data])


def drawing(data: str, prefix: str) -> str:
    """A script that draws the figures which the element `data` lists into the elements PREFIX0, PREFIX1, …, and again
    when the reader turns to dark or light.
    """
    return f'''
{{
  const figures = JSON.parse(document.getElementById("{data}").textContent);
  const all = () => figures.forEach((figure, n) => draw("{prefix}" + n, figure));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", all);
  all();
}}
'''


def later(html: str) -> str:
    """HTML that the page may fill in when it comes near the window, or is unfolded: it does where it is long."""
    return f"<!--later-->{html}<!--/later-->"


def with_fragments(html: str) -> str:
    """What may come later, as it is where it is short, packed where it is long."""

    def packed_if_long(found: re.Match[str]) -> str:
        if len(found[1]) < LONG:
            return found[1]
        return f'<div class="later"><script type="text/plain" data-fragment>{packed(found[1])}</script></div>'

    return LATER.sub(packed_if_long, html)


def element(name: str, data: str) -> str:
    """The element that holds some data: as they are, or packed where they are long."""
    if len(data) < LONG_DATA:
        return f'<script type="application/json" id="{name}">{data}</script>'
    return packed_element(name, data)


def packed_element(name: str, data: str, later: bool = False) -> str:
    mark = " data-later" if later else ""
    return f'<script type="text/plain" data-packed{mark} id="{name}">{packed(data)}</script>'


def packed(text: str) -> str:
    """Text deflated and in letters, as `unpacked` of `assets/start.js` reads it."""
    return b64encode(zlib.compress(text.encode(), 9)).decode()


def json_text(content: Any) -> str:
    """JSON that may stand inside HTML."""
    text = json.dumps(content, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c")
