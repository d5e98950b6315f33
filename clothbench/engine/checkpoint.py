"""What was computed of an unfinished cell, kept until the result is whole: a stopped run goes on from it.

A search is the same for the same seed and answers, so it asks the same questions again, and the checkpoint answers.
"""

from __future__ import annotations

import errno
import os
import shutil
import time
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.files import FULL, read_arrays, whole_file

Arrays = dict[str, np.ndarray]
CLOSED = (*FULL, errno.EROFS, errno.EACCES, errno.EPERM)  # what the system says where nothing more can be kept


class Unwritable(ClothbenchError):
    """The folder of results takes no more; ends the command."""


def cannot_be_written(path: Path, fault: OSError) -> str:
    """What is said of it, and what to do."""
    found = os.strerror(fault.errno) if fault.errno else str(fault)
    return (
        f"{path}: found that it cannot be written ({found}), expected room and the right to; "
        "nothing half-written is left: make room and run the same command again"
    )


def uncompiled() -> float:
    """A clock [s] that stands still while this process compiles: kernels are compiled on a machine's first search only,
    which would else pass for a slow one.
    """
    from clothbench.core.kernels import compiled_for  # numba takes a while, and tables are shown without any clock

    return time.perf_counter() - compiled_for()


class Checkpoint:
    """Arrays by key, one `.npz` each; without a folder nothing is kept. whole: whose part this is, if it is one, and
    prefix: what its keys begin with.
    """

    def __init__(self, folder: Path | None = None, whole: Checkpoint | None = None, prefix: str = ""):
        self.folder, self.whole, self.prefix = folder, whole or self, prefix
        self.began = uncompiled()
        self.fault: Unwritable | None = None  # of the whole: what could not be kept for want of room
        known = self.recall("seconds")
        self.before = 0.0 if known is None else float(known["seconds"])

    @property
    def seconds(self) -> float:
        """Wall time [s] since this object was made, and that of the stopped runs before it, both without compiling."""
        return self.whole.before + uncompiled() - self.whole.began

    def recall(self, key: str) -> Arrays | None:
        """What was kept under this key; None if there is nothing, or a file that can no longer be read."""
        if self.folder is None or not (path := self.folder / f"{self.prefix}{key}.npz").is_file():
            return None
        try:
            return read_arrays(path)
        except (OSError, ValueError, zipfile.BadZipFile):
            return None

    def keep(self, key: str, **arrays: np.ndarray) -> None:
        """Each written whole or not at all; and with it the time that it has taken to come here. A folder that takes no
        more is `Unwritable`.
        """
        if self.folder is None:
            return
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._write(f"{self.prefix}{key}", arrays)
            self.whole._write("seconds", {"seconds": np.array(self.seconds)})
        except OSError as fault:
            if fault.errno not in CLOSED:
                raise
            self.whole.fault = Unwritable(cannot_be_written(self.folder, fault))
            raise self.whole.fault from fault

    def require_kept(self) -> None:
        """Raise what could not be kept, also where a study took that for a fault of one of its parts."""
        if self.whole.fault is not None:
            raise self.whole.fault

    def once(self, key: str, computed: Callable[[], Arrays]) -> Arrays:
        """What was kept under this key, or what is computed, and kept, now."""
        known = self.recall(key)
        if known is None:
            known = computed()
            self.keep(key, **known)
        return known

    def _write(self, key: str, arrays: Mapping[str, np.ndarray]) -> None:
        assert self.folder is not None
        with whole_file(self.folder / f"{key}.npz") as part, part.open("wb") as file:
            np.savez(file, **arrays)  # type: ignore[arg-type]

    def part(self, name: str) -> Checkpoint:
        """For a part of the work that asks the same questions of something else; the clock is that of the whole."""
        return Checkpoint(self.folder, self.whole, f"{self.prefix}{name}-")

    def everything(self) -> dict[str, Arrays]:
        """All that is kept of this part, by its own key, but for the time that it has taken."""
        kept = [path.stem for path in sorted(self.folder.glob("*.npz"))] if self.folder else []
        keys = [stem.removeprefix(self.prefix) for stem in kept if stem.startswith(self.prefix)]
        return {key: found for key in keys if key != "seconds" and (found := self.recall(key)) is not None}

    def forget(self) -> None:
        """All of it; the verdict is written."""
        if self.folder is not None:
            shutil.rmtree(self.folder, ignore_errors=True)
