"""A model's parameters and those of its effects in one space: what is whose."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.parameters import ParameterSpace
from clothbench.core.protocols import Effect


@dataclass(frozen=True, eq=False)
class JoinedParameters:
    """The model's parameters, then those of each effect as `effect.parameter`. model: its own space."""

    model: ParameterSpace
    effects: tuple[Effect, ...]

    def __post_init__(self) -> None:
        names = [e.name for e in self.effects]
        if twice := next((name for name in names if names.count(name) > 1), None):
            raise ClothbenchError(f"effect {twice!r} is given twice; name every effect once")

    @cached_property
    def parameters(self) -> ParameterSpace:
        return self.model.joined(*(e.parameters.prefixed(e.name) for e in self.effects))

    def of_model(self, theta: np.ndarray) -> np.ndarray:
        """What of theta (..., P) is the model's own."""
        return theta[..., : len(self.model)]

    def of_effects(self, theta: np.ndarray) -> Iterator[tuple[Effect, np.ndarray]]:
        """Every effect with what of theta (..., P) is its own: views, not copies."""
        at = len(self.model)
        for effect in self.effects:
            yield effect, theta[..., at : at + len(effect.parameters)]
            at += len(effect.parameters)

    def of_effect(self, effect: Effect, theta: np.ndarray) -> np.ndarray:
        """What of theta (..., P) belongs to `effect`."""
        return next(own for other, own in self.of_effects(theta) if other is effect)
