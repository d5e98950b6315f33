"""What every table in the terminal shares: where it is printed."""

from __future__ import annotations

import os

from rich.console import Console


def console() -> Console:
    """Standard output; where it is no terminal as wide as COLUMNS says, which rich reads, or else wide enough for a
    table.
    """
    out = Console(highlight=False)
    width = None if os.environ.get("COLUMNS", "").isdecimal() else 120
    return out if out.is_terminal else Console(highlight=False, width=width, color_system=None)
