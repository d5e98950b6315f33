"""The journal of a search: every simulated batch, on disk at once, so that a stopped cell goes on where it stood.

A search is the same for the same seed and answers, so it asks the same questions again, and the journal answers.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from clothbench.core.protocols import Evaluation
from clothbench.engine.memory import Memory


class Journal:
    """Batches by their parameters, below a folder of the cell's own; without a folder nothing is kept."""

    def __init__(self, folder: Path | None = None):
        self.memory = Memory(folder)

    @property
    def seconds(self) -> float:
        """Wall time since this journal was opened, and that of the stopped runs before it."""
        return self.memory.seconds

    def recall(self, theta: np.ndarray) -> Evaluation | None:
        """What was found for this batch (B, P); None if it was not simulated, or its file cannot be read."""
        known = self.memory.recall(key_of(theta))
        return None if known is None or "value" not in known else Evaluation(known["value"], known.get("residual"))

    def keep(self, theta: np.ndarray, evaluation: Evaluation) -> None:
        residual = {} if evaluation.residual is None else {"residual": evaluation.residual}
        self.memory.keep(key_of(theta), value=evaluation.value, **residual)

    def forget(self) -> None:
        """All of it; the cell is finished."""
        self.memory.forget()


def key_of(theta: np.ndarray) -> str:
    """24 hexadecimal digits of a batch of parameter sets."""
    return hashlib.sha256(np.ascontiguousarray(theta).tobytes()).hexdigest()[:24]
