"""What every table in the terminal shares: where it is printed."""

from __future__ import annotations

from rich.console import Console


def console() -> Console:
    """Standard output; wide enough for a table where it is no terminal."""
    out = Console(highlight=False)
    return out if out.is_terminal else Console(highlight=False, width=120, color_system=None)
