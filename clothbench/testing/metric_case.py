"""A metric under test: a waving sheet made by formula, what was seen of it, and errors to add to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clothbench.core.drape import RINGS, SPOKES, Outlines, drape_points, outlines_of_points
from clothbench.core.observation import Observation
from clothbench.core.protocols import Metric, Score
from clothbench.core.rollout import Rollout

SIGMA = 1e-3  # m, noise of one coordinate
EYE = (0.2, -1.2, 0.9)  # m, where it was seen from


@dataclass(frozen=True, eq=False)
class MetricCase:
    """truth: where the points were; observation: what was seen, without noise; error: a field of mm size."""

    metric: Metric
    truth: np.ndarray
    observation: Observation
    error: np.ndarray

    def score(self, *position: np.ndarray, observation: Observation | None = None) -> Score:
        """The score of rollouts, each (T, N, 3) m, against the observation."""
        observation = self.observation if observation is None else observation
        return self.metric(observation, rollout_of(observation.time, np.stack(position)))

    @property
    def scale(self) -> float:
        """The value that an error of about 4 mm gives, in the metric's unit."""
        return float(self.score(self.truth + 4 * self.error).value[0])


def rollout_of(time: np.ndarray, position: np.ndarray) -> Rollout:
    """A rollout made by hand: position (B, T, N, 3) m; a member with a number missing counts as diverged."""
    status = tuple("ok" if np.isfinite(member).all() else "diverged" for member in position)
    return Rollout(time, position, status, np.full(len(position), 100), position.shape[2])


def waving(metric: Metric) -> MetricCase:
    """6 × 5 nodes, 24 uneven frames; one frame and one node are never seen, others now and then."""
    random, time = np.random.default_rng(7), np.sort(np.random.default_rng(6).uniform(0.0, 1.5, 24))
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(0.0, 0.3, 6), np.linspace(0.0, 0.25, 5)))
    wave = 0.04 * np.sin(12 * u + 6 * v - 5 * time[:, None]) * (0.2 + v)
    truth = np.stack([np.broadcast_to(u + 0.1, wave.shape), wave, np.broadcast_to(1.0 - v, wave.shape)], axis=-1)
    visible = random.random(wave.shape) < 0.85
    visible[5], visible[:, 11] = False, False
    seen = np.where(visible[..., None], truth, np.nan)
    observation = Observation(time, seen, visible, SIGMA, np.stack([u, v], axis=1), eye=np.array(EYE))
    return MetricCase(metric, truth, observation, random.normal(0.0, 1e-3, truth.shape))


def draped(metric: Metric) -> MetricCase:
    """Six drapes of three discs, six to eight folds each, made by formula; the error draws their rims out."""
    plate, disc = 0.09, 0.15
    out = np.linspace(0.0, 1.0, RINGS)[:, None]
    turn = 2 * np.pi * np.arange(SPOKES) / SPOKES
    truth = []
    for k, folds in enumerate((6, 7, 7, 7, 8, 7)):
        radius = plate + out * (0.035 + 0.002 * k + 0.012 * np.cos(folds * turn + k))
        truth.append(np.stack([radius * np.cos(turn), radius * np.sin(turn), -0.04 * out + 0 * turn], axis=-1))
    drapes = np.stack(truth).reshape(6, RINGS * SPOKES, 3)
    points = drape_points(plate, disc)
    outlines = outlines_of_points(drapes, (0.0, 0.0, 0.0), plate)
    seen = Outlines(outlines, plate, disc, np.array([1, 1, 2, 2, 3, 3]), 4e-4, 1.4e-3)
    nothing = np.full(drapes.shape, np.nan)
    time, visible = np.arange(6.0), np.zeros(drapes.shape[:2], bool)
    observation = Observation(time, nothing, visible, np.nan, points, outlines=seen)
    away = np.concatenate([points - disc, np.zeros((len(points), 1))], axis=1)
    error = 1e-3 * np.repeat(out, SPOKES, axis=1).reshape(-1, 1) * away / np.linalg.norm(away, axis=1, keepdims=True)
    return MetricCase(metric, drapes, observation, np.broadcast_to(error, drapes.shape).copy())
