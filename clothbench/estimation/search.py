"""The one loop of ask and tell: whoever searches iterates over it, and may end it early."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.parameters import ParameterSpace
from clothbench.core.protocols import Evaluation, Optimizer


def drive(
    optimizer: Optimizer,
    space: ParameterSpace,
    evaluate: Callable[[np.ndarray], Evaluation],
    budget: int | None = None,
) -> Iterator[tuple[np.ndarray, Evaluation]]:
    """Every batch (B, P) that the optimizer asks for with what came of it, after it was told so, until it is done; or
    until the budget of evaluations is spent: results are compared at equal budgets, and a search that minds none may
    have no end. Of a batch that goes beyond it the rest is not evaluated, and nothing of it told. What is asked for
    must lie in the space (P parameters).
    """
    left = float("inf") if budget is None else budget
    while not optimizer.done and left > 0:
        theta = _asked(optimizer, space)
        if len(theta) > left:
            theta = theta[: int(left)]
            yield theta, evaluate(theta)
            return
        evaluation = evaluate(theta)
        optimizer.tell(theta.copy(), evaluation)
        left -= len(theta)
        yield theta, evaluation


def _asked(optimizer: Optimizer, space: ParameterSpace) -> np.ndarray:
    found = optimizer.ask()
    try:
        theta = np.array(found, dtype=float)
    except (TypeError, ValueError):
        theta = np.empty(0)
    if theta.ndim != 2 or not theta.size or not np.isfinite(theta).all():
        shape = f"of shape {np.shape(found)}" if isinstance(found, np.ndarray) else f"{type(found).__name__}"
        raise ClothbenchError(
            f"optimizer {optimizer.name!r}: `ask` gave {shape}, expected finite parameter sets (B, P), B at least 1"
        )
    if theta.shape[1] != len(space):
        raise ClothbenchError(
            f"optimizer {optimizer.name!r} asked for {theta.shape[1]} parameters, expected {len(space)}: "
            f"{', '.join(space.names)}"
        )
    outside = np.argwhere((theta < space.low) | (theta > space.high))
    if outside.size:
        b, p = outside[0]
        parameter = space.parameters[p]
        raise ClothbenchError(
            f"optimizer {optimizer.name!r} asked for {parameter.name} = {theta[b, p]:.6g}, expected a value within its "
            f"bounds {parameter.bounds}"
        )
    return theta
