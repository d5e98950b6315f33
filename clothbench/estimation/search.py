"""The one loop of ask and tell: whoever searches iterates over it, and may end it early."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from clothbench.core.protocols import Evaluation, Optimizer


def drive(
    optimizer: Optimizer, evaluate: Callable[[np.ndarray], Evaluation]
) -> Iterator[tuple[np.ndarray, Evaluation]]:
    """Every batch (B, P) that the optimizer asks for with what came of it, after it was told so, until it is done."""
    while not optimizer.done:
        theta = np.asarray(optimizer.ask(), dtype=float)
        evaluation = evaluate(theta)
        optimizer.tell(theta, evaluation)
        yield theta, evaluation
