"""`chamfer` and `hausdorff`: how far two clouds of points are apart that do not say which point is which."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from clothbench import ClothbenchError, Metric, Observation, Rollout, Score, check_choice
from clothbench_metrics.node_error import flat_rows

UNITS = {"mm": 1e3, "cm": 1e2, "m": 1.0}  # to a metre
DRAWN = 100  # frames at least whose mean the floor is, each with noise of its own


class Chamfer:
    """½ (mean over the seen points of the distance to the nearest simulated one + mean over the simulated points of the
    distance to the nearest seen one) of a frame, averaged over the frames in which something was seen (Barrow et al.,
    Parametric Correspondence and Chamfer Matching, 1977; both ways, and averaged, as in Fan et al., A Point Set
    Generation Network, 2017).

    Nothing is taken from which node a point is: a sheet that slides along itself by whole cells scores 0. Where the
    rollout has as many points as were tracked, those that were not seen in a frame count in neither cloud: what was
    hidden says nothing. Where it has another number, and of recordings of kind "points", all of them count. Searches by
    residuals lower the sum of the squared distances, both ways. The map has each seen point's distance to the nearest
    simulated one.
    unit: "mm", "cm" or "m".
    """

    name = "chamfer"
    version = 1
    kinds = frozenset({"nodes", "points"})

    def __init__(self, unit: str = "mm"):
        check_choice(self.name, "unit", unit, UNITS)
        self.unit = unit

    def __call__(self, observation: Observation, rollout: Rollout) -> Score:
        score, away = scored(self, observation, rollout, halfway)
        rows = [flat_rows(part) for pair in away for part in pair]
        residual = np.concatenate(rows, axis=1) if rows else np.zeros((len(rollout), 0))
        return Score(score.value, score.unit, score.per_frame, score.per_node, residual)

    def floor(self, observation: Observation) -> float:
        """Drawn, see `drawn_floor`; σ √(8/π) as of `node_error` where σ is small beside the points' spacing. Of a
        cloud not known."""
        return drawn_floor(self, observation)


class Hausdorff:
    """The larger of the two directed distances of a frame, averaged over the frames in which something was seen: how
    far the seen point that lies farthest from all simulated ones is from the nearest of them, and the other way round
    (Huttenlocher et al., Comparing Images Using the Hausdorff Distance, 1993).

    One stray point decides; share: below 1, the distance that this share of the points keeps, in each direction (their
    partial distance, 0.95: the 95th of a hundred points). Which points count, and the map, are as of `chamfer`. It has
    no residual, since it is one point's. unit: "mm", "cm" or "m".
    """

    name = "hausdorff"
    version = 1
    kinds = frozenset({"nodes", "points"})

    def __init__(self, share: float = 1.0, unit: str = "mm"):
        check_choice(self.name, "unit", unit, UNITS)
        if not isinstance(share, int | float) or isinstance(share, bool) or not 0 < share <= 1:
            raise ClothbenchError(f"hausdorff: share is {share!r}, expected above 0, up to 1 (all points)")
        self.unit, self.share = unit, float(share)

    def __call__(self, observation: Observation, rollout: Rollout) -> Score:
        def larger(there: np.ndarray, back: np.ndarray) -> np.ndarray:
            return np.maximum(self._kept(there), self._kept(back))

        return scored(self, observation, rollout, larger)[0]

    def _kept(self, distance: np.ndarray) -> np.ndarray:
        """The distance that the share of the points (B, M) m keeps, (B,) m: the K-th of them in order."""
        rank = math.ceil(self.share * distance.shape[1] - 1e-9) - 1
        return np.sort(distance, axis=1)[:, max(rank, 0)]

    def floor(self, observation: Observation) -> float:
        """Drawn, see `drawn_floor`."""
        return drawn_floor(self, observation)


def halfway(there: np.ndarray, back: np.ndarray) -> np.ndarray:
    """Halfway between the means of both directions' distances (B, P) and (B, Q) m, (B,) m."""
    return (there.mean(axis=1) + back.mean(axis=1)) / 2


def scored(
    metric: Metric, observation: Observation, rollout: Rollout, of_frame: Callable[[np.ndarray, np.ndarray], np.ndarray]
) -> tuple[Score, list[tuple[np.ndarray, np.ndarray]]]:
    """The score without its residual, of_frame being what both directions' distances (B, P) and (B, Q) m make of a
    frame; and for each frame in which something was seen what `nearest_both_ways` gave, m.
    """
    check(metric.name, observation, rollout)
    members, seen = len(rollout), observation.visible
    scale, watched = UNITS[metric.unit], np.flatnonzero(seen.any(axis=1))
    per_frame, total, away = np.full((members, len(seen)), np.nan), np.zeros((members, seen.shape[1])), []
    for t in watched:
        alike = not observation.cloud and rollout.position.shape[2] == seen.shape[1]
        simulated = rollout.position[:, t, seen[t]] if alike else rollout.position[:, t]
        away.append(nearest_both_ways(observation.position[t, seen[t]], simulated))
        there, back = (scale * np.linalg.norm(part, axis=-1) for part in away[-1])
        per_frame[:, t] = of_frame(there, back)
        total[:, seen[t]] += there
    count = seen.sum(axis=0)
    per_node = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    value = per_frame[:, watched].mean(axis=1) if watched.size else np.full(members, np.nan)
    return Score(value, metric.unit, per_frame, per_node), away


def nearest_both_ways(points: np.ndarray, simulated: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Simulated minus seen, m: from each seen point (P, 3) m to the nearest of B simulated clouds (B, Q, 3) m, as
    (B, P, 3), and to each of their points from the nearest seen one, (B, Q, 3). Not a number of clouds that are not
    whole: a point that is not a number has spoilt the simulation.
    """
    from scipy.spatial import cKDTree

    there, back = np.full((len(simulated), *points.shape), np.nan), np.full_like(simulated, np.nan)
    whole, tree = np.isfinite(simulated).all(axis=(1, 2)), cKDTree(points)
    back[whole] = simulated[whole] - points[tree.query(simulated[whole])[1]]
    for b in np.flatnonzero(whole):
        there[b] = simulated[b, cKDTree(simulated[b]).query(points)[1]] - points
    return there, back


def check(name: str, observation: Observation, rollout: Rollout) -> None:
    """Refuse points of a picture, a rollout of other frames than were observed, and one without points."""
    if observation.sight is not None:
        raise ClothbenchError(f"{name}: the points were seen in a picture, which has no depth; take node_error")
    frames, points = rollout.position.shape[1:3]
    if frames != len(observation.time) or not points:
        raise ClothbenchError(
            f"{name}: found a rollout of {frames} frames and {points} points, "
            f"expected {len(observation.time)} frames as observed, and points"
        )


def drawn_floor(metric: Metric, observation: Observation) -> float:
    """What noise alone gives a perfect model with as many points as were tracked, drawn with a fixed seed: the cloud
    that was seen against the same with noise of σ per coordinate. There is no closed form where σ is not small beside
    the points' spacing, and there what was seen, being noisy itself, is a little wider than the cloth was.

    NaN if σ is not known or nothing was seen; and of a cloud, which was seen elsewhere on the cloth than it is
    simulated: a perfect model's points are as far from it as both lie between each other's, and how far nobody knows.
    """
    frames = int(observation.visible.any(axis=1).sum())
    if observation.cloud or not frames or not math.isfinite(observation.sigma):
        return math.nan
    draws = -(-DRAWN // frames)
    noise = np.random.default_rng(0).normal(0.0, observation.sigma, (draws, *observation.position.shape))
    noisy = Rollout(
        observation.time, observation.position + noise, ("ok",) * draws, np.zeros(draws, int), noise.shape[2]
    )
    return float(metric(observation, noisy).value.mean())
