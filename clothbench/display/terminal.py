"""What every table in the terminal shares: where it is printed."""

from __future__ import annotations

from rich.console import Console


class Terminal(Console):
    """Standard output; a reader that has gone is told by the error that `print` has, too, and not by an exit."""

    def on_broken_pipe(self) -> None:
        raise BrokenPipeError


def console() -> Console:
    """Standard output; wide enough for a table where it is no terminal."""
    out = Terminal(highlight=False)
    return out if out.is_terminal else Terminal(highlight=False, width=120, color_system=None)
