"""What the loop has computed already, kept below a folder until the verdict is written: a stopped run goes on."""

from __future__ import annotations

import shutil
import zipfile
from pathlib import Path

import numpy as np

from clothbench.files import whole_file


class Memory:
    """Arrays by key, one `.npz` each; without a folder nothing is kept."""

    def __init__(self, folder: Path | None = None):
        self.folder = folder

    def recall(self, key: str) -> dict[str, np.ndarray] | None:
        """What was kept under this key; None if there is nothing, or a file that can no longer be read."""
        if self.folder is None or not (path := self.folder / f"{key}.npz").is_file():
            return None
        try:
            with np.load(path, allow_pickle=False) as stored:
                return dict(stored)
        except (OSError, ValueError, EOFError, zipfile.BadZipFile):
            return None

    def keep(self, key: str, **arrays: np.ndarray) -> None:
        """Written whole or not at all."""
        if self.folder is None:
            return
        self.folder.mkdir(parents=True, exist_ok=True)
        with whole_file(self.folder / f"{key}.npz") as part, part.open("wb") as file:
            np.savez(file, **arrays)  # type: ignore[arg-type]

    def forget(self) -> None:
        """All of it; the verdict is written."""
        if self.folder is not None:
            shutil.rmtree(self.folder, ignore_errors=True)
