"""The strip that `kirchhoff_love` folds: lifted, held at a pose, or led along a whole folding path."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from clothbench import ClothbenchError, FoldPath, FoldState
from clothbench.modelling import for_each
from clothbench_models import strip_path, strip_trials
from clothbench_models.strip import Ends, State, Strip

SAMPLES = 4001  # points of a profile
FINE = 3.0  # elements to a bending length, at least, of a strip that is folded over
NEAR = 3.0  # ratio of η_b up to which Newton's method is tried from another strip's state, on its mesh


class FoldingStrip:
    """A strip `length` m long on a desk, its mesh of `elements`; a strip does not feel the parameter ν."""

    def __init__(self, length: float, elements: int):
        self.length, self.elements = length, elements

    def lift(self, height: float, theta: np.ndarray) -> FoldState:
        """The end raised to `height` m without horizontal force; each member on its own, from the flat strip."""
        if not 0 < height < self.length:
            raise ClothbenchError(f"fold: height is {height!r} m, expected between 0 and the strip's {self.length:g} m")

        def one(b: int) -> State:
            return strip_trials.lift(self._strip(theta[b]), theta[b, 0], height)

        return self._all(one, len(theta))

    def hold(self, pose: np.ndarray, theta: np.ndarray, near: FoldState) -> FoldState:
        """The end at poses (B, 3): x, z [m] and slope [rad]; on the mesh of the one state `near` if it is."""
        start: State | None = near.kept[0]

        def one(b: int) -> State:
            strip, ends = self._strip(theta[b]), Ends(0.0, 0.0, 0.0, *map(float, pose[b]))
            if start is not None and abs(math.log(theta[b, 0] / start.eta_b)) < math.log(NEAR):
                found = strip.beside(start, theta[b, 0], ends)
                if found is not None:
                    return found
            return strip.equilibrium(theta[b, 0], ends, strip_trials.lift(strip, theta[b, 0], ends.z1))

        return self._all(one, len(theta))

    def fold(self, theta: np.ndarray, tip: float = 0.0) -> FoldPath:
        """All three phases of the path that lays the end down at x = `tip` m, for one fabric theta (P,)."""
        found = strip_path.path(self._fine(theta), float(theta[0]), tip)
        state = self._side_by_side(found.states)
        return FoldPath(np.array(found.phases), state, np.zeros(len(found.states)), state.friction, found.laid)

    def follow(self, places: np.ndarray, theta: np.ndarray, friction: float) -> FoldPath:
        """What becomes of a strip led through places (P, 2) m on a desk of `friction`."""
        states, needed = strip_path.followed(self._fine(theta), float(theta[0]), places, friction)
        origin = np.array([s.ends.x0 for s in states])
        return FoldPath(np.zeros(len(states)), self._side_by_side(states), origin, np.array(needed))

    def _fine(self, theta: np.ndarray) -> Strip:
        """As many elements as a strip needs that touches itself, where `hold` and `lift` do with fewer."""
        sized = self._strip(theta)
        return Strip(self.length, theta[1], max(self.elements, math.ceil(FINE * self.length / sized.size(theta[0]))))

    def _strip(self, theta: np.ndarray) -> Strip:
        return Strip(self.length, theta[1], self.elements)

    def _all(self, one, members: int) -> FoldState:
        """The members' states side by side; one that is not found is diverged."""
        found: list[State | None] = [None] * members

        def work(b: int) -> None:
            try:
                found[b] = one(b)
            except ClothbenchError:
                found[b] = None

        for_each(work, range(members))
        return self._side_by_side(found)

    def _side_by_side(self, found: Sequence[State | None]) -> FoldState:
        u = np.linspace(0.0, self.length, SAMPLES)
        nowhere = np.full((SAMPLES, 2), np.nan)
        return FoldState(
            pose=np.array([(s.ends.x1, s.ends.z1, s.ends.angle1) if s else (math.nan,) * 3 for s in found]),
            profile=np.array([s.at(u) if s else nowhere for s in found]),
            pull=np.array([s.pull if s else math.nan for s in found]),
            press=np.array([s.press if s else math.nan for s in found]),
            status=tuple("ok" if s else "diverged" for s in found),
            kept=tuple(found),
        )
