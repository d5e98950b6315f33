"""`linear_stretch`: cloth that resists being pulled in proportion to how much longer it is; for curves only."""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from clothbench import ClothbenchError, Effect, Parameter, ParameterSpace, Scene, Simulation

WHAT_TO_DO = "answers force-extension curves only, for `clothbench improve`; take another model"


class LinearStretch:
    """T = k (λ − 1) per width: what every model of linear springs makes of a strip that is pulled."""

    name: ClassVar[str] = "linear_stretch"
    version: ClassVar[int] = 1
    capabilities: ClassVar[frozenset[str]] = frozenset({"curve"})
    parameters = ParameterSpace(
        (
            Parameter(
                "stiffness", "k", "N/m", (0.1, 1e5), "log", 30.0, "tension per width over strain",
                "Hooke's law; for a sample of unknown width times that width, in N",
            ),
        )
    )  # fmt: skip

    def curve(self, stretch: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Tension (M,) N/m at stretches (M,)."""
        return theta[0] * (stretch - 1)

    def skip(self, scene: Scene) -> str:
        return WHAT_TO_DO

    def prepare(self, scene: Scene, effects: Sequence[Effect] = ()) -> Simulation:
        raise ClothbenchError(f"model 'linear_stretch' {WHAT_TO_DO}")
