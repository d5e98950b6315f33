"""An effect under test: the models it is tried on, and a sheet for its kernels alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from clothbench.core.protocols import Effect, Model
from clothbench.core.rollout import Rollout
from clothbench.modelling.mesh import grid_triangles
from clothbench.modelling.sheet import Sheet, sheet_of
from clothbench.plugins.discovery import catalogue
from clothbench.testing import probe
from clothbench.testing.model_case import ModelCase


@dataclass(frozen=True, eq=False)
class EffectCase:
    """An effect, the models it is tried on, and the bare rollouts that it is held against."""

    effect: Effect
    models: tuple[ModelCase, ...]

    @cached_property
    def bare(self) -> dict[tuple[int, str], Rollout]:
        """Rollouts without any effect, by number of the model and name of the scene."""
        return {(m, name): self.run(m, name) for m, case in enumerate(self.models) for name in case.scenes}

    @cached_property
    def null(self) -> np.ndarray:
        return probe.null_values(self.effect)

    def run(self, model: int, scene: str, *pairs: tuple[Effect, np.ndarray]) -> Rollout:
        """Two parameter sets of a model in one of its scenes, with effects at given values."""
        case = self.models[model]
        return case.run_with(case.scenes[scene], case.theta(0.4), *pairs)


def first_that_takes_effects() -> list[Callable[..., Model]]:
    found = catalogue()
    for name in found.names("models"):
        make = found.load("models", name)
        if {"effects", "dynamic"} <= set(make().capabilities):
            return [make]
    return []


def waving_sheet(nodes: int = 5) -> tuple[Sheet, np.ndarray, np.ndarray]:
    """A sheet of n × n nodes, y = 0.02 sin(20 u + 10 v); positions m and velocities m/s (3, n²), without order in
    them.
    """
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(0.0, 0.2, nodes), np.linspace(0.0, 0.2, nodes)))
    position = np.stack([u, 0.02 * np.sin(20 * u + 10 * v), 1.0 - v])
    velocity = 0.3 * np.random.default_rng(5).standard_normal((3, nodes**2))
    slope = 0.02 * np.cos(20 * u + 10 * v)
    normal = np.stack([-20 * slope, np.ones(nodes**2), 10 * slope])
    share = np.ones(nodes)
    share[[0, -1]] = 0.5
    area = 0.04 / (nodes - 1) ** 2 * np.outer(share, share).ravel()
    sheet = sheet_of(
        np.stack([u, v], axis=1), 0.12 * area, area, grid_triangles((nodes, nodes)), (0.0, 0.0, -9.81), air_density=1.2
    )
    sheet.normal[:] = normal / np.linalg.norm(normal, axis=0)
    return sheet, position, velocity


def smooth_velocity(position: np.ndarray) -> np.ndarray:
    """A velocity [m/s] (3, n) that differs from place to place, the same at every place (3, n) m whatever the mesh."""
    x, _, z = position
    return np.stack([0.1 + 0.5 * x, 0.4 + x + 0.5 * z, -0.2 + 0.3 * z])
