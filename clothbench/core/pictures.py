"""Pictures and videos as anybody may hand them in: the libraries that decode them say what they think of them on the
process's standard error, whatever Python does with that, and the reader says it in one line anyway.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Lock

import numpy as np

PNG = b"\x89PNG\r\n\x1a\n"
MOST_PIXELS = 2**27  # of one picture: more than any camera's, and what a file of a megabyte may claim

# OpenCV asks once, when it is loaded, and makes room for eight times as many if nobody says so.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(MOST_PIXELS))


_lock = Lock()
_silent: list[None] = []  # one for each thread that wants silence
_kept: list[int] = []  # the terminal, while there is silence


@contextmanager
def silenced() -> Iterator[None]:
    """Keep what OpenCV and its decoders say of a broken file off the terminal. Of several threads at once the first to
    come turns it away and the last to go gives it back: each by itself might keep what another had turned away.
    """
    import cv2

    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    with _lock:
        if not _silent:
            sys.stderr.flush()
            _kept.append(os.dup(2))
            nothing = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nothing, 2)
            os.close(nothing)
        _silent.append(None)
    try:
        yield
    finally:
        with _lock:
            _silent.pop()
            if not _silent:
                kept = _kept.pop()
                os.dup2(kept, 2)
                os.close(kept)


def picture_of(content: bytes | np.ndarray | Path, flags: int) -> np.ndarray | None:
    """A picture (H, W[, 3]), blue first, from a file or its bytes, read with these flags of OpenCV's; None for one that
    is broken.
    """
    import cv2

    if isinstance(content, Path):
        content = content.read_bytes()
    stream = np.frombuffer(content, np.uint8)
    if not stream.size or _claims_more(stream):
        return None
    try:
        with silenced():
            return cv2.imdecode(stream, flags)
    except cv2.error:  # a claim of more pixels than OpenCV takes
        return None


def _claims_more(stream: np.ndarray) -> bool:
    """Whether a chunk of a PNG states more bytes than the whole file has: OpenCV makes room for what is stated."""
    if stream[: len(PNG)].tobytes() != PNG:
        return False
    place = len(PNG)
    while place + 8 <= len(stream):
        length = int.from_bytes(stream[place : place + 4].tobytes(), "big")
        if length > len(stream):
            return True
        place += 12 + length  # length, kind, content, check sum
    return False
