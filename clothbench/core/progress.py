"""What work that takes long tells whoever waits for it."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[int, float], None]  # steps done so far, and the value that they have come to
StageProgress = Callable[[str, int, int], None]  # the stage that runs, how much of it is done, and of how much
FileProgress = Callable[[int, int, str], None]  # files done, files planned, and the file that is dealt with
