"""Simulations some of whose parameters are not free."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.optional import runs_in_threads
from clothbench.core.parameters import ParameterSpace
from clothbench.core.protocols import Simulation
from clothbench.core.rollout import Rollout


@dataclass(frozen=True, eq=False)
class Fixed:
    """A simulation with some parameters held at the values in `fixed`; `parameters` are the others, and `run` takes
    those.
    """

    simulation: Simulation
    fixed: Mapping[str, float]

    @property
    def threads(self) -> bool:
        return runs_in_threads(self.simulation)

    @property
    def parameters(self) -> ParameterSpace:
        return ParameterSpace(tuple(p for p in self.simulation.parameters if p.name not in self.fixed))

    def run(self, theta: np.ndarray) -> Rollout:
        """Simulate the free parameters theta (B, P)."""
        free = self.parameters.check(theta)
        whole = np.empty((len(free), len(self.simulation.parameters)))
        columns = iter(free.T)
        for i, name in enumerate(self.simulation.parameters.names):
            whole[:, i] = self.fixed[name] if name in self.fixed else next(columns)
        return self.simulation.run(whole)


def holding(simulation: Simulation, fixed: Mapping[str, float]) -> Simulation:
    """The simulation with what it knows of `fixed` held at those values; itself if that is nothing.

    A suite fixes parameters for all the models that it is run with; one that has no such parameter has nothing to fix.
    Of a parameter that is searched for on a logarithmic scale, what is below 0 is refused; 0 may switch it off.
    """
    for p in simulation.parameters:
        if p.scale == "log" and fixed.get(p.name, 0.0) < 0:
            raise ClothbenchError(f"parameter {p.name!r} is fixed at {fixed[p.name]:g} {p.unit}, expected 0 or above")
    mine = {name: value for name, value in fixed.items() if name in simulation.parameters.names}
    return Fixed(simulation, mine) if mine else simulation  # type: ignore[return-value]
