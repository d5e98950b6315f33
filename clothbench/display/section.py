"""A section of a page: HTML, and the figures that its script draws."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Section:
    """html: what stands there; data: JSON by the id of the element that holds it; script: draws it, once plotly.js and
    the helpers of `display.style.DRAWING` are there; style: of its own, behind the page's.
    """

    html: str
    data: Mapping[str, Any] = field(default_factory=dict)
    script: str = ""
    style: str = ""

    @property
    def whole(self) -> str:
        """The section with its data, as the page has it."""
        return self.html + "".join(
            f'\n<script type="application/json" id="{name}">{json_text(content)}</script>'
            for name, content in self.data.items()
        )


def json_text(content: Any) -> str:
    """JSON that may stand inside HTML."""
    text = json.dumps(content, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c")
