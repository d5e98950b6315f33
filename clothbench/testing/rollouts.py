"""What every rollout must keep, however it came about."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from clothbench.core.rollout import STATUSES, Rollout
from clothbench.core.scene import Scene
from clothbench.testing.rules import require


def require_whole(rollout: Rollout, scene: Scene, members: int, where: str) -> None:
    """Shapes, types and statuses as the records say; finite where ok, else up to a frame and not after it."""
    require(isinstance(rollout, Rollout), f"{type(rollout).__name__} in {where}", "a clothbench.Rollout")
    position, shape = rollout.position, (members, scene.times.size, len(scene.points), 3)
    require(position.shape == shape, f"positions {position.shape} in {where}", f"(B, T, N, 3) = {shape}")
    require(position.dtype == np.float64, f"positions of type {position.dtype}", "float64")
    require(
        np.array_equal(rollout.time, scene.times),
        f"other times than asked for in {where}",
        "the scene's times",
    )
    known = (
        isinstance(rollout.status, tuple) and len(rollout.status) == members and set(rollout.status) <= set(STATUSES)
    )
    require(known, f"status {rollout.status!r} in {where}", f"{members} of {STATUSES}")
    steps = np.asarray(rollout.steps)
    counted = steps.shape == (members,) and np.issubdtype(steps.dtype, np.integer) and (steps >= 0).all()
    require(counted, f"steps {rollout.steps!r} in {where}", f"{members} whole numbers, 0 or above")
    require(rollout.nodes >= 1, f"{rollout.nodes} nodes in {where}", "at least 1")
    require(
        len(rollout.reasons) in (0, members),
        f"{len(rollout.reasons)} reasons in {where}",
        f"none or {members}",
    )
    for b, status in enumerate(rollout.status):
        _require_finite_while(status, position[b], f"member {b} in {where}")


def _require_finite_while(status: str, position: np.ndarray, whose: str) -> None:
    """Positions (T, N, 3) finite to the end where ok, else up to some frame, with nothing after it."""
    finite = np.isfinite(position).all(axis=(1, 2))
    require(status != "ok" or finite.all(), f"status 'ok' but positions not finite: {whose}", "'diverged'")
    require(status == "ok" or not finite.all(), f"status {status!r} but all is finite: {whose}", "'ok'")
    returned = (np.diff(finite.astype(int)) > 0).any()
    require(not returned, f"finite frames after lost ones: {whose}", "not a number from there on")
    empty = np.isnan(position[~finite]).all()
    require(empty, f"numbers in the frames after it was lost: {whose}", "not a number from there on")


def require_independent(run: Callable[[np.ndarray], Rollout], theta: np.ndarray, where: str) -> None:
    """Every member of theta (B, P) alone gives the bits that it gave among the others."""
    together = run(theta)
    for b in range(len(theta)):
        alone = run(theta[b : b + 1])
        equal = np.array_equal(alone.position[0], together.position[b], equal_nan=True)
        away = np.nanmax(np.abs(alone.position[0] - together.position[b]), initial=0.0)
        found = f"member {b} of a batch {away:.3g} m away from the same set run alone ({where})"
        require(equal and alone.status[0] == together.status[b], found, "equal bits")
