"""The journal of a search: every simulated batch, on disk at once, so that a stopped cell goes on where it stood.

A search is the same for the same seed and answers, so it asks the same questions again, and the journal answers.
"""

from __future__ import annotations

import hashlib
import shutil
import zipfile
from pathlib import Path

import numpy as np

from clothbench.files import whole_file
from clothbench.protocols import Evaluation


class Journal:
    """Batches by their parameters, one `.npz` each below a folder of the cell's own."""

    def __init__(self, folder: Path):
        self.folder = folder

    def _path(self, theta: np.ndarray) -> Path:
        return self.folder / f"{hashlib.sha256(np.ascontiguousarray(theta).tobytes()).hexdigest()[:24]}.npz"

    def recall(self, theta: np.ndarray) -> Evaluation | None:
        """What was found for this batch (B, P); None if it was not simulated, or its file cannot be read."""
        if not (path := self._path(theta)).is_file():
            return None
        try:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
                return Evaluation(stored["value"], stored.get("residual"))
        except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile):
            return None

    def keep(self, theta: np.ndarray, evaluation: Evaluation) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        residual = {} if evaluation.residual is None else {"residual": evaluation.residual}
        with whole_file(self._path(theta)) as part, part.open("wb") as file:
            np.savez(file, value=evaluation.value, **residual)  # type: ignore[arg-type]

    def forget(self) -> None:
        """All of it; the cell is finished."""
        shutil.rmtree(self.folder, ignore_errors=True)
