"""Toy fits on which optimizers are tried: cheap, with a known bottom, parameters of very different scale."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from clothbench.core.parameters import Parameter, ParameterSpace
from clothbench.core.protocols import Evaluation

BOTTOM = np.array([0.62, 0.31, 0.73, 0.44, 0.17, 0.81])  # of the bowl, in the unit cube; nowhere special


@dataclass(frozen=True)
class Problem:
    """A toy fit: `residuals` maps the unit cube (B, P) to (B, R); its squares vanish at one point inside."""

    name: str
    space: ParameterSpace
    residuals: Callable[[np.ndarray], np.ndarray]
    lost: Callable[[np.ndarray], np.ndarray] = field(default=lambda unit: np.zeros(len(unit), dtype=bool))

    def evaluate(self, theta: np.ndarray) -> Evaluation:
        """Value √Σr² (B,) and residual (B, R) of theta (B, P); not a number where the run is lost."""
        unit = self.space.to_unit(theta)
        residual = np.where(self.lost(unit)[:, None], np.nan, self.residuals(unit))
        return Evaluation(np.sqrt((residual**2).sum(axis=1)), residual)


def bowl(count: int = 3) -> Problem:
    """A tilted bowl over parameters of different scale: r = A (u − u*), condition number about 10."""
    return Problem("a bowl", _space(count), _linear(BOTTOM[:count]))


def cornered() -> Problem:
    return Problem("a bowl with its bottom in a corner", _space(3), _linear(np.array([1.0, 0.0, 1.0])))


def plain(count: int = 3) -> Problem:
    """The same error everywhere: a search cannot get better, and has to end all the same."""
    return Problem("a plain", _space(count), lambda unit: np.ones((len(unit), 2)))


def valley(count: int = 3) -> Problem:
    """Rosenbrock's curved valley (1960), chained: r = (3 (x_{i+1} − x_i²), 1 − x_i), bottom at x = 1."""

    def residuals(unit: np.ndarray) -> np.ndarray:
        x = 2 * unit - 0.5
        return np.hstack([3 * (x[:, 1:] - x[:, :-1] ** 2), 1 - x[:, :-1]])

    return Problem("a curved valley", _space(count), residuals)


def partly_lost() -> Problem:
    return Problem("a bowl a third of which is lost", bowl().space, bowl().residuals, lambda unit: unit[:, 0] < 1 / 3)


def wholly_lost() -> Problem:
    return Problem("a bowl that is lost", bowl().space, bowl().residuals, lambda unit: np.ones(len(unit), dtype=bool))


def _linear(bottom: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """u → A (u − bottom), every direction weighted differently and coupled to the next one."""
    identity = np.eye(len(bottom))
    shape = np.diag(np.geomspace(3.0, 1.0, len(bottom))) + 0.7 * np.roll(identity, 1, axis=1)
    return lambda unit: (unit - bottom) @ shape.T


def _space(count: int) -> ParameterSpace:
    """Linear and logarithmic parameters by turns, over ranges such as stiffness and damping have."""
    kinds = (((1.0, 1e4), "log", 20.0), ((-0.5, 2.0), "linear", 0.1), ((1e-7, 1e-3), "log", 1e-6))
    return ParameterSpace(
        tuple(Parameter(f"p{i}", f"p{i}", "1", *kinds[i % 3], "of a toy fit", "none") for i in range(count))
    )
