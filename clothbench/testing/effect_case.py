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


def waving_sheet() -> tuple[Sheet, np.ndarray, np.ndarray]:
    """A sheet of 5 × 5 nodes, y = 0.02 sin(20 u + 10 v); positions m and velocities m/s (3, 25)."""
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(0.0, 0.2, 5), np.linspace(0.0, 0.2, 5)))
    position = np.stack([u, 0.02 * np.sin(20 * u + 10 * v), 1.0 - v])
    velocity = 0.3 * np.random.default_rng(5).standard_normal((3, 25))
    slope = 0.02 * np.cos(20 * u + 10 * v)
    normal = np.stack([-20 * slope, np.ones(25), 10 * slope])
    area = np.full(25, 0.04 / 25)
    sheet = sheet_of(
        np.stack([u, v], axis=1), 0.12 * area, area, grid_triangles((5, 5)), (0.0, 0.0, -9.81), air_density=1.2
    )
    sheet.normal[:] = normal / np.linalg.norm(normal, axis=0)
    return sheet, position, velocity
