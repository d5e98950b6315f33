"""Several first shapes of one drape as one simulation: its frames are where each of them came to rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clothbench.core.optional import runs_in_threads
from clothbench.core.parallel import side_by_side
from clothbench.core.parameters import ParameterSpace
from clothbench.core.protocols import Simulation
from clothbench.core.rollout import Rollout


@dataclass(frozen=True, eq=False)
class Placements:
    """Simulations of the same cloth, alike but for the shape that each begins with; none of them has many frames.

    A member is as well as the worst of its placements.
    """

    simulations: tuple[Simulation, ...]

    @property
    def parameters(self) -> ParameterSpace:
        return self.simulations[0].parameters

    @property
    def threads(self) -> bool:
        return all(map(runs_in_threads, self.simulations))

    def run(self, theta: np.ndarray) -> Rollout:
        """All placements of theta (B, P), their frames one after the other; `time` counts them."""
        if self.threads:
            runs = side_by_side(lambda simulation: simulation.run(theta), self.simulations)
        else:
            runs = [simulation.run(theta) for simulation in self.simulations]
        position = np.concatenate([run.position for run in runs], axis=1)
        status, reasons = [], []
        for b in range(len(theta)):
            worst = next((run for run in runs if run.status[b] != "ok"), runs[0])
            status.append(worst.status[b])
            reasons.append(worst.reasons[b] if worst.reasons else "")
        steps = np.sum([run.steps for run in runs], axis=0)
        time = np.arange(position.shape[1], dtype=float)
        return Rollout(time, position, tuple(status), steps, runs[0].nodes, tuple(reasons))


def joined(simulations: Sequence[Simulation]) -> Simulation:
    """The one simulation, or several placements as one."""
    return simulations[0] if len(simulations) == 1 else Placements(tuple(simulations))  # type: ignore[return-value]
