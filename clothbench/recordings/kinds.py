"""Recordings of any kind: which reader stands for the kind that a file states. A new kind is a file, a line here
and its name in `layout.KINDS`."""

from __future__ import annotations

import os
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

from clothbench.recordings.codec import kind_of

# kind: (module in clothbench.recordings, its reader)
READERS = {
    "nodes": ("nodes", "read_recording"),
    "points": ("points", "read_points"),
    "curve": ("curve", "read_curve"),
    "laser": ("laser", "read_laser"),
    "depth": ("depth", "read_depth"),
    "video": ("colour_video", "read_video"),
    "silhouette": ("silhouette", "read_silhouettes"),
}

SHEETS = ("nodes", "points", "depth", "video", "silhouette")  # kinds that show a sheet of cloth, which models simulate


class AnyRecording(Protocol):
    """What records of every kind have: a name, the file they were read from, and a hash of all they hold."""

    @property
    def name(self) -> str: ...
    @property
    def path(self) -> str: ...
    @property
    def hash(self) -> str: ...


def reader_of(kind: str) -> Callable[[str | os.PathLike[str]], Any]:
    """The function that reads files of a kind; that of "nodes" for kinds not known, which it refuses in words."""
    module, name = READERS.get(kind, READERS["nodes"])
    return getattr(import_module(f"clothbench.recordings.{module}"), name)


def read_sheet(path: str | os.PathLike[str]) -> Any:
    """Read and check one recording that shows a sheet, tracked (`Recording`) or not yet (`PointCloud`,
    `DepthImages`, `ColourVideo`, `Silhouettes`).
    """
    kind = kind_of(Path(path))
    return reader_of(kind if kind in SHEETS else "nodes")(path)


def read_any(path: str | os.PathLike[str]) -> AnyRecording:
    """Read and check one recording of any kind."""
    return reader_of(kind_of(Path(path)))(path)
