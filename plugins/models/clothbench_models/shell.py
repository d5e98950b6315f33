"""A rectangular shell in a scene: what is held, what it rests on, and how its equilibrium is found."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from clothbench import Scene
from clothbench.modelling import initial_shape
from clothbench_models import shell_kernels as kernels
from clothbench_models.splines import SUPPORT, Spline

TOLERANCE = 1e-8  # of the longer side, Newton's last step
MOST = 150
REACH = 0.1  # of the longer side
RATIO = 30.0  # of η_b between stages
STIFF = 30.0  # η_b × longer side³ of the cloth with which a continuation begins
SINK = 0.05  # bending lengths that the sheet sinks into the ground in the stages before the last
DENT = 5e-3  # of the longer side, how far a sheet is put out of shape before each stage
FIRM = 1e4  # of the membrane's stiffness, what a grip's force is first guessed by


@dataclass(eq=False)
class ShellState:
    """control (n, 3) m; stress (Q, 6) m²/s² and m³/s²; holding (H, 3): forces of the grips [m³/s²]."""

    control: np.ndarray
    stress: np.ndarray
    holding: np.ndarray


def turned_over(scene: Scene) -> bool:
    """Whether a sheet on the ground is first seen with a part of it upside down."""
    u, v = np.meshgrid(np.linspace(0, scene.width, 65), np.linspace(0, scene.height, 5), indexing="ij")
    at = initial_shape(scene, np.stack([u.ravel(), v.ravel()], axis=1)).reshape(65, 5, 3)
    across = np.cross(np.diff(at, axis=0)[:, :-1], np.diff(at, axis=1)[:-1]) @ scene.obstacles[0].normal
    return bool(across.min() < 0 < across.max())


class Shell:
    """The sheet of a scene on cubic splines with `elements` along (u, v); ground: a plane (point, normal) or None.

    Control points are numbered along the shorter side first: the band is as narrow as it can be. bend_ratio,
    stretch_ratio: stiffness along u over that along v.
    """

    def __init__(
        self, scene: Scene, elements: tuple[int, int], eta_m: float, poisson: float, bend_ratio: float = 1.0,
        stretch_ratio: float = 1.0,
    ):  # fmt: skip
        self.scene, self.eta_m, self.poisson = scene, eta_m, poisson
        self.roots = np.sqrt([stretch_ratio, bend_ratio])
        self.u, self.v = (Spline.even(side, n) for side, n in zip((scene.width, scene.height), elements, strict=True))
        self.flipped = self.v.count > self.u.count
        self.iterations = 0  # of Newton's method, those included that led nowhere

    @property
    def count(self) -> int:
        return self.u.count * self.v.count

    @property
    def size(self) -> float:
        return max(self.scene.width, self.scene.height)

    @cached_property
    def turn(self) -> np.ndarray:
        """(3, 3) rotation of the world after which the ground's normal is z."""
        if not self.scene.obstacles:
            return np.eye(3)
        z = np.array(self.scene.obstacles[0].normal)
        x = np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0], z)
        x /= np.linalg.norm(x)
        return np.stack([x, np.cross(z, x), z])

    @property
    def floor(self) -> float:
        """Height of the ground in the turned world [m]."""
        return float(self.turn[2] @ self.scene.obstacles[0].centre) if self.scene.obstacles else -math.inf

    def numbers(self, i: np.ndarray, j: np.ndarray) -> np.ndarray:
        """Of the control points in column i and row j."""
        return j * self.u.count + i if self.flipped else i * self.v.count + j

    @property
    def wide(self) -> int:
        """Width of the stiffness' band."""
        far = self.numbers(np.array(SUPPORT - 1), np.array(SUPPORT - 1)) - self.numbers(np.array(0), np.array(0))
        return 3 * int(far) + 3

    @cached_property
    def mesh(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """At each of Q quadrature points: control points (Q, 16), derivatives (Q, 5, 16), weight (Q,) m²."""
        (pu, wu), (pv, wv) = self.u.quadrature, self.v.quadrature
        at = np.stack([a.ravel() for a in np.meshgrid(pu, pv, indexing="ij")], axis=1)
        pairs = ((1, 0), (0, 1), (2, 0), (0, 2), (1, 1))
        shape = np.stack([self.functions(at, *p)[1] for p in pairs], axis=1)
        return self.functions(at)[0], np.ascontiguousarray(shape), np.outer(wu, wv).ravel()

    def functions(self, at: np.ndarray, du: int = 0, dv: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Control points (M, 16) and weights (M, 16) of material points `at` (M, 2) m, or of derivatives there."""
        (i, j), k = (self.u.element_of(at[:, 0]), self.v.element_of(at[:, 1])), np.arange(SUPPORT)
        numbers = self.numbers((i[:, None] + k)[:, :, None], (j[:, None] + k)[:, None, :])
        weights = self.u.functions(at[:, 0], du)[:, :, None] * self.v.functions(at[:, 1], dv)[:, None, :]
        return numbers.reshape(len(at), -1), weights.reshape(len(at), -1)

    def positions(self, state: ShellState, points: np.ndarray) -> np.ndarray:
        """World positions (M, 3) m of material points (M, 2) m."""
        numbers, weights = self.functions(points)
        return np.einsum("mk,mkc->mc", weights, state.control[numbers]) @ self.turn

    def start(self, eta_b: float) -> ShellState:
        """The scene's own first guess, with the moments of its shape but no tension."""
        u, v = (a.ravel() for a in np.meshgrid(self.u.greville, self.v.greville, indexing="ij"))
        at = initial_shape(self.scene, np.stack([u, v], axis=1)) @ self.turn.T
        grid = at.reshape(self.u.count, self.v.count, 3)
        grid = np.stack([self.u.through(grid[..., c]) for c in range(3)], axis=-1)
        grid = np.stack([self.v.through(grid[..., c].T).T for c in range(3)], axis=-1)
        i, j = np.meshgrid(np.arange(self.u.count), np.arange(self.v.count), indexing="ij")
        control = np.empty((self.count, 3))
        control[self.numbers(i, j)] = grid
        control[:, 2] = np.maximum(control[:, 2], self.floor)
        stress = np.zeros((len(self.mesh[2]), 6))
        kernels.moments(control, *self.mesh[:2], float(eta_b), float(self.poisson), self.roots, stress)
        return ShellState(control, stress, np.zeros((len(self.scene.grip_material), 3)))

    def equilibrium(self, eta_b: float, grips: np.ndarray, start: ShellState | None = None) -> ShellState | None:
        """Rest with the grips at (G, 3) m, from a start or by way of stiffer cloth; None where it is not found."""
        known = start
        if known is None and self.scene.obstacles:
            # What lies on the ground may be folded, and stiffer cloth would unfold.
            known = self.solved(self.start(eta_b), eta_b, grips, SINK)
        state = self.solved(known, eta_b, grips) if known is not None else None
        if state is not None:
            return state
        stiff = min(eta_b, STIFF / self.size**3)
        state = start or self.start(stiff)
        count = max(0, math.ceil(math.log(eta_b / stiff) / math.log(RATIO)))
        for stage in [*np.geomspace(stiff, eta_b, count + 1)]:
            state = self.solved(self.dented(state), float(stage), grips, SINK)
            if state is None:
                return None
        return self.solved(state, eta_b, grips)

    def dented(self, state: ShellState) -> ShellState:
        """The same sheet a little out of shape along its normals, by a pattern without symmetry.

        An even sheet that is about to buckle would leave it to rounding errors on which side it does.
        """
        u, v = (a.ravel() for a in np.meshgrid(self.u.greville, self.v.greville, indexing="ij"))
        i, j = (a.ravel() for a in np.meshgrid(np.arange(self.u.count), np.arange(self.v.count), indexing="ij"))
        along = []
        for du, dv in ((1, 0), (0, 1)):
            numbers, weights = self.functions(np.stack([u, v], axis=1), du, dv)
            along.append(np.einsum("mk,mkc->mc", weights, state.control[numbers]))
        normal = np.cross(*along)
        normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-12)[:, None]
        pattern = np.sin(1 + 2.3 * u / self.scene.width) * np.cos(0.7 + 3.1 * v / self.scene.height)
        control = state.control.copy()
        control[self.numbers(i, j)] += DENT * self.size * pattern[:, None] * normal
        return ShellState(control, state.stress, state.holding)

    def solved(self, start: ShellState, eta_b: float, grips: np.ndarray, sink: float = 0.0) -> ShellState | None:
        """Newton's method from one state to another; `sink` in bending lengths, 0 for rigid ground."""
        control, stress, holding = start.control.copy(), start.stress.copy(), start.holding.copy()
        nodes, shape, weight = self.mesh
        lines, hold = self.functions(self.scene.grip_material)
        gravity = self.turn @ self.scene.gravity
        area = np.zeros(self.count)
        i, j = np.meshgrid(np.arange(self.u.count), np.arange(self.v.count), indexing="ij")
        area[self.numbers(i, j)] = np.outer(self.u.shares, self.v.shares)
        pull = float(np.linalg.norm(gravity))
        springs = area * (pull / (sink * (pull * eta_b) ** (-1 / 3)) if sink and pull else 0.0)
        status, iterations = kernels.equilibrium(
            control, stress, lines, hold, np.ascontiguousarray(grips @ self.turn.T), holding, FIRM / self.eta_m,
            np.full(self.count, self.floor), springs, nodes, shape, weight, area[:, None] * gravity, self.eta_m,
            float(eta_b), float(self.poisson), self.roots, REACH * self.size, TOLERANCE * self.size, MOST, self.wide,
        )  # fmt: skip
        self.iterations += iterations
        if status != kernels.CONVERGED:
            return None
        return ShellState(control, stress, holding)
