"""What the models on a rectangular grid share: nodes, what is held, and a batch's way to a rollout."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.parallel import for_each
from clothbench.core.parameters import ParameterSpace
from clothbench.core.resting import RestShapes, rest_shapes
from clothbench.core.rollout import Interpolator, Rollout
from clothbench.core.scene import Obstacle, Scene, initial_shape, initial_velocity
from clothbench.modelling.bound_effects import BoundEffects
from clothbench.modelling.cover import Cover
from clothbench.modelling.grid import cloth_of_cells, grid_lines, tributary, unstretched
from clothbench.modelling.kernels import no_effect
from clothbench.modelling.mesh import grid_triangles
from clothbench.modelling.sheet import Sheet, own_sheet, sheet_of
from clothbench.modelling.time_loop import (
    DIVERGED,
    GOES_ON,
    OK,
    RESTLESS,
    RESTS,
    SETTLES,
    SLOTS,
    Clock,
    Grips,
    Sampling,
    Start,
    Terms,
)

MAX_STEPS = 20_000_000
NEAR_DISC = 0.1  # radii over or under a disc at which a sheet still counts as lying on it
LOST = 20.0  # cloth sizes from the start at which a sheet has blown up


def leapfrog_step(square: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """The longest stable step (B,) s of leapfrog with a lagging damping force, ω² Δt² + 2 r Δt = 4, from the greatest
    ω² (B,) 1/s² and the rate of damping r (B,) 1/s.
    """
    return (np.sqrt(rate**2 + 4 * square) - rate) / square


@dataclass(frozen=True, eq=False)
class GridSimulation:
    """One scene on one grid `shape` (nu, nv), node number j·nu + i, ready for batches of parameter sets."""

    scene: Scene
    shape: tuple[int, int]
    effects: BoundEffects
    threads: ClassVar[bool] = True  # several of them may run at the same time

    @property
    def parameters(self) -> ParameterSpace:
        return self.effects.parameters

    @property
    def nodes(self) -> int:
        return self.shape[0] * self.shape[1]

    @cached_property
    def lines(self) -> tuple[np.ndarray, np.ndarray]:
        """Grid lines along u (nu,) and v (nv,) m, moved onto the held points so that every grip is a node."""
        held = self.scene.grip_material
        return (
            grid_lines(self.scene.width, self.shape[0], held[:, 0]),
            grid_lines(self.scene.height, self.shape[1], held[:, 1]),
        )

    @cached_property
    def uv(self) -> np.ndarray:
        """Where each node lies on the flat sheet, (n, 2) m."""
        return np.stack(np.meshgrid(*self.lines), axis=-1).reshape(-1, 2)

    @cached_property
    def cover(self) -> Cover | None:
        """How much of the grid is cloth; None where all of it is."""
        scene = self.scene
        return None if scene.outline is None else Cover.of(scene.outline, self.lines, (scene.width, scene.height))

    @cached_property
    def sheet(self) -> Sheet:
        """Nodes with the mass and area that they stand for, and the triangles between them."""
        scene, (u, v), triangles, outline = self.scene, self.lines, grid_triangles(self.shape), self.scene.outline
        if self.cover is not None:
            area, (triangles, share) = self.cover.area.ravel(), self.cover.triangles(triangles)
        else:
            area = np.outer(tributary(v, scene.height), tributary(u, scene.width)).ravel()
            share = np.repeat(cloth_of_cells(self.lines, (scene.width, scene.height)).ravel(), 2)
            if (np.abs(share - 1) > 1e-6).any():  # and not because lines lie on grips to a nanometre
                outline = np.array([[0.0, 0.0], [scene.width, 0.0], [scene.width, scene.height], [0.0, scene.height]])
        held = _nearest(self.uv, scene.grip_material)
        if (area[held] == 0).any() and not scene.grips_carry:
            off = int(np.argmin(area[held]))
            raise ClothbenchError(
                f"grip_material {off} is at {tuple(scene.grip_material[off].tolist())} m, where the outline leaves "
                "next to no cloth on this grid, expected some to hold; move the grip inwards, or change the resolution"
            )
        still = np.setdiff1d(np.flatnonzero((area == 0) | self.clamped), held)
        return sheet_of(
            self.uv, scene.areal_density * area, area, triangles, scene.gravity, scene.air_density, held, still, share,
            outline, whole=True if self.cover is None else None,
        )  # fmt: skip

    @cached_property
    def clamped(self) -> np.ndarray:
        """Which nodes lie between a disc that clamps and the plate upon it, (n,) bool.

        Held as far as three quarters of a cell beyond the rim: a sheet on a mesh that kinks at the last node held would
        begin at the rim, on average, with half a cell, one that bends, of which that node carries a half, with a whole.
        A ring that bends little under its weight then sags as it should within 8 % from 13 nodes on.
        """
        reach = 0.75 * math.sqrt(np.prod([lines[-1] / (len(lines) - 1) for lines in self.lines]))
        held = _beyond_rims(self.scene, self._first_shape) > -reach
        if held[slice(None) if self.cover is None else self.cover.nodes.ravel()].all():
            size = f"{self.scene.width:g} m by {self.scene.height:g} m"
            raise ClothbenchError(
                f"obstacles: a disc clamps all of the cloth, {size}, so that nothing can move; expected a smaller "
                "radius, in m"
            )
        return held

    @cached_property
    def anchored(self) -> bool:
        """Whether anything holds the sheet, a grip or a clamp: then it settles before a run."""
        return len(self.scene.grip_material) > 0 or bool(self.clamped.any())

    @cached_property
    def _first_shape(self) -> np.ndarray:
        return initial_shape(self.scene, self.uv)

    @cached_property
    def start(self) -> tuple[np.ndarray, np.ndarray]:
        """The shape (n, 3) m that the run, or the settling before it, begins with, and its velocity (n, 3) m/s."""
        return self.start_with(None), initial_velocity(self.scene, self.sheet.uv)

    def start_with(self, curve: np.ndarray | None) -> np.ndarray:
        """The same shape (n, 3) m where the grips follow `curve` (4, K−1, G, 3), as `Scene.grip_curve` gives it."""
        scene, sheet, shape = self.scene, self.sheet, self._first_shape
        if scene.velocity is not None:  # noise of the measurement would else be let loose as stretch
            grips = scene.grips_at(np.array([scene.start_time]), curve)[0] if sheet.gripped else np.zeros((0, 3))
            shape = unstretched(shape, self.lines, sheet.held[: sheet.gripped], grips)
        return _flat_in_clamps(scene, shape, self.clamped)

    @property
    def settles(self) -> bool:
        """Whether the sheet comes to rest in its grips before the run."""
        return self.scene.velocity is None and self.anchored

    @cached_property
    def hanging(self) -> GridSimulation | None:
        """The same sheet without what acts in motion only, seen everywhere as the run begins: where it comes to rest.

        None where the time loop has to find that by itself: an effect has a say in it or remembers the way there, the
        cloth lies on something or on itself, is cut to an outline, or nothing comes after.
        """
        scene = self.scene
        whole = self.cover is None and not scene.obstacles and scene.thickness == 0
        if not (self.settles and whole and scene.times.max() > scene.start_time) or self.effects.at_rest:
            return None
        effects = BoundEffects(self.effects.model, self.effects.at("boundary"))
        begins = dataclasses.replace(scene, times=np.array([scene.start_time]), points=self.uv, start=None)
        still = dataclasses.replace(self, scene=begins, effects=effects)
        vars(still).update(start=self.start, _first_shape=self._first_shape)  # which the scene tells by its own points
        return still

    def come_to_rest(
        self, theta: np.ndarray, keys: Sequence[bytes], kept: RestShapes | None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Shapes (B, n, 3) m in which theta (B, P) come to rest, of a sheet seen everywhere as the run begins; how that
        ended (B,), and the steps (B,) that it took: none for what is kept under its key.
        """
        own = [f.name for f in dataclasses.fields(self) if f.name not in ("scene", "effects")]
        mine = repr([type(self), *(getattr(self, name) for name in own)]).encode()
        shapes = np.full((len(theta), self.nodes, 3), np.nan)
        status, steps, new = np.full(len(theta), "ok", dtype=object), np.zeros(len(theta), np.int64), []
        for b, key in enumerate(keys):
            if kept is None or (known := kept.get(mine + key)) is None:
                new.append(b)
            else:
                shapes[b] = known
        if new:
            found = self.run(theta[new])
            shapes[new], status[new], steps[new] = found.position[:, 0], found.status, found.steps
            for b in new:
                if kept is not None and status[b] == "ok":
                    kept.keep(mine + keys[b], shapes[b].copy())
        return shapes, status, steps

    if TYPE_CHECKING:  # each model has its own; a grid that is only laid out needs none

        def run(self, theta: np.ndarray) -> Rollout: ...

    def settled(self, ended: int) -> int:
        """How settling ended, OK or RESTLESS, as far as it counts: where effects do no more to a sheet at rest than
        weigh, what still moves is a limp one that goes to and fro between two wrinkles, and either is as good to begin
        with.
        """
        return OK if ended == RESTLESS and self.effects.only_weighs else ended

    def calmed(self, theta: np.ndarray) -> np.ndarray:
        """The parameters (B, P) with which the sheet settles in its grips: where it comes to rest must be the same."""
        return theta

    def stiffest_effect(self, theta: np.ndarray) -> np.ndarray:
        """A bound on what effects add to the largest ω² (B,) 1/s²: that of a plate of the smallest cell [rad²/s²].

        ω² ≤ 4 E (1/h_u² + 1/h_v²)/ρ in the plane and 16 D (1/h_u² + 1/h_v²)²/ρ across, the finite-difference values;
        triangles stay below three times as much.
        """
        stretch, bending = self.effects.stiffness(theta).T
        wave = sum(1 / np.diff(lines).min() ** 2 for lines in self.lines)
        return 3 * (4 * stretch * wave + 16 * bending * wave**2) / self.scene.areal_density

    def restrained_step(self, theta: np.ndarray, square: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """The longest step (B,) s of leapfrog with a lagging damping force that is stable where effects hold nodes by
        themselves, ∞ where none does: of ω² + ω_e² and r + r_e, from the model's own ω² 1/s² and r 1/s.
        """
        more, slower = self.effects.restraint(theta).T / self.effects.lightest(theta)
        return np.where((more > 0) | (slower > 0), leapfrog_step(square + more, rate + slower), np.inf)

    @property
    def slowest(self) -> float:
        """ω₁ of the hanging sheet, (2.4048/2)√(g/L) [rad/s]; where nothing pulls it down, that of a gentle pull.

        L is the height of the sheet; or how far it reaches beside its grips, if that is more and nobody saw how it
        hangs: a strip clamped at its side turns all the way down from its first guess.
        """
        length, held = self.scene.height, self.scene.grip_material[:, 0]
        if self.scene.start is None and len(held):
            length = max(length, float(held.min()), self.scene.width - float(held.max()))
        if self.clamped.any():  # only what hangs over the rim swings
            length = min(length, -float(_beyond_rims(self.scene, self._first_shape).min()))
        return 1.2024 * math.sqrt(max(float(np.linalg.norm(self.scene.gravity)), 1.0) / length)


class GridBatch:
    """One call of `run`: what every member needs, and the arrays that members fill side by side.

    dt (B,) s and settling (s) tell which members nobody could afford: they are timeouts, not begun at all. Only
    `members` are run: the others move as one of them does, and just the sensor sees them otherwise.
    """

    def __init__(self, simulation: GridSimulation, theta: np.ndarray, dt: np.ndarray, settling: float):
        self.simulation, self.theta, self.dt = simulation, theta, dt
        scene, effects, members = simulation.scene, simulation.effects, len(theta)
        self.times = effects.times(scene, theta)
        self.position = np.full((members, scene.times.size, len(scene.points), 3), np.nan)
        self.status, self.steps = np.zeros(members, np.int64), np.zeros(members, np.int64)
        self.kernels, self.stages, self.terms = effects.kernels(SLOTS, no_effect)
        cover = simulation.cover
        nodes = None if cover is None else cover.nodes
        self.interpolator = Interpolator.on_lines(scene.points, *simulation.lines, nodes)
        self.held_points, self.pins_of_points = _shared_points(scene.points, scene.grip_material)
        self.shape, self.velocity = simulation.start
        curves = effects.grip_curves(scene, theta)
        # Effects may hold the grips elsewhere; cloth that is already moving begins there, and does not jump onto them.
        elsewhere = not simulation.settles and len(scene.grip_material) > 0 and len(effects.at("boundary")) > 0
        self.shapes = np.stack([simulation.start_with(curve) for curve in curves]) if elsewhere else self.shape[None]
        self.knots = np.array(scene.grip_time) if len(scene.grip_material) else np.zeros(2)
        still = simulation.sheet.held[simulation.sheet.gripped :]
        self.curves = _with_still(curves, self.shapes[:, still])
        span = self.times.max(axis=1) - scene.start_time + settling
        self.late = span / dt > MAX_STEPS
        first, self.alike = effects.distinct(theta, self.times)
        self.members = first[~self.late[first]]
        self.hung: np.ndarray | None = None

    @cached_property
    def settling_kernels(self) -> tuple[Callable, ...]:
        """The effects' kernels for a loop in which members come to rest."""
        return self.simulation.effects.kernels(SLOTS, no_effect, settling=True)[0]

    def hang(self) -> None:
        """Find where the members come to rest, once for all that come to rest alike; those that fail are not run.

        The steps that this takes are counted where they were made: not again for whoever hangs in the same shape.
        """
        still = self.simulation.hanging
        if still is None or not len(self.members):
            return
        members, simulation = self.members, self.simulation
        theta = simulation.calmed(self.theta[members])
        pose = self.curves[members % len(self.curves), 3, 0].reshape(len(members), -1)  # of the grips as the run begins
        questions = np.hstack([simulation.effects.of_model(theta), pose])
        _, first, of_members = np.unique(questions, axis=0, return_index=True, return_inverse=True)
        moved = [own[first] for effect, own in simulation.effects.of_effects(theta) if effect.place == "boundary"]
        rows, keys = np.hstack([still.effects.of_model(theta[first]), *moved]), [q.tobytes() for q in questions[first]]
        shapes, status, steps = still.come_to_rest(rows, keys, rest_shapes(simulation.scene))
        self.steps[members[first]] = steps
        shapes, status = shapes[of_members.ravel()], status[of_members.ravel()]
        self.late[members] = status == "timeout"
        self.status[members[status == "diverged"]] = DIVERGED
        self.hung = np.full((len(self.theta), *shapes.shape[1:]), np.nan)
        self.hung[members] = shapes
        self.members = members[status == "ok"]

    def run(self, march: Callable[[int], tuple[int, int]]) -> Rollout:
        """March all members side by side, `march(b)` → status and steps filling its `sampling`; what was seen of it."""

        def one(b: int) -> None:
            self.status[b], steps = march(b)
            self.steps[b] += steps

        for_each(one, self.members.tolist())
        return self.rollout()

    def begin(self, b: int | None = None) -> Start:
        """Where member b begins, arrays of its own; any of them, if none has been hung up yet."""
        if self.hung is None or b is None:
            shape, how = self.shape_of(b or 0), SETTLES if self.simulation.settles else GOES_ON
        else:
            shape, how = self.hung[b], RESTS
        x, v = (np.ascontiguousarray(rows.T, dtype=float).copy() for rows in (shape, self.velocity))
        return Start(x, v, how)

    def shape_of(self, b: int) -> np.ndarray:
        """The shape (n, 3) m with which member b begins to move or to settle."""
        return self.shapes[b % len(self.shapes)]

    def sheet(self) -> Sheet:
        """The sheet for one member's loop, with normals and grips of its own."""
        return own_sheet(self.simulation.sheet, self.simulation.effects.normals)

    def grips(self, b: int) -> Grips:
        """Where the grips are for member b."""
        return Grips(self.knots, self.curves[b % len(self.curves)], self.held_points, self.pins_of_points)

    def sampling(self, b: int) -> Sampling:
        """Where and when member b is looked at; it fills this batch's positions."""
        return Sampling(self.interpolator.index, self.interpolator.weight, self.times[b], self.position[b])

    def effect_terms(self, b: int) -> Terms:
        """The effects' terms of member b, with a memory of its own."""
        effects, own = self.simulation.effects, self.theta[b : b + 1]
        state = effects.kernel_state(1, SLOTS, self.simulation.sheet)[0]
        return Terms(self.stages, self.terms, effects.kernel_parameters(own, SLOTS)[0], state)

    def clock(self, b: int, tolerance: float = 0.0) -> Clock:
        return Clock(self.simulation.scene.start_time, float(self.dt[b]), tolerance, self.bounds())

    def grips_of(self, members: np.ndarray) -> Grips:
        """The same of several members that run together."""
        curves = self.curves if len(self.curves) == 1 else self.curves[members]
        return Grips(self.knots, curves, self.held_points, self.pins_of_points)

    def bounds(self) -> float:
        """How far from the origin a sheet may get before it counts as blown up [m]; grips and free fall allowed."""
        scene = self.simulation.scene
        span = float(self.times.max() - scene.start_time)
        fall = 0.5 * float(np.linalg.norm(scene.gravity)) * span**2 if not self.simulation.anchored else 0.0
        reach = max(np.abs(self.shape).max(), np.abs(scene.grip_position).max(initial=0.0))
        return LOST * max(scene.width, scene.height) + float(reach) + fall

    def rollout(self) -> Rollout:
        """What the sensor makes of the positions, with a status for every member."""
        scene = self.simulation.scene
        position = self.simulation.effects.seen(scene, self.theta, self.position[self.alike])
        lost = ~(np.abs(position).max(axis=(2, 3), initial=0.0) < 1e6)
        ended = self.status[self.alike]
        gone = (ended != OK) | (lost.any(axis=1) & ~self.late)
        status = np.where(self.late, "timeout", np.where(gone, "diverged", "ok"))
        why = np.where((status == "diverged") & (ended == RESTLESS), "restless", status)
        reasons = {
            "ok": "",
            "diverged": "the sheet left all bounds: the step is too long for these parameters",
            "restless": "the sheet did not come to rest before the run: these effects keep it moving",
            "timeout": f"more than {MAX_STEPS:.0e} steps: these parameters need too short a step",
        }
        position[np.logical_or.accumulate(lost, axis=1)] = np.nan
        return Rollout(
            scene.times, position, tuple(map(str, status)), self.steps[self.alike], self.simulation.nodes,
            tuple(reasons[w] for w in why),
        )  # fmt: skip


def _with_still(curves: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Grips' piecewise cubics (M, 4, K − 1, G, 3), and after them nodes that stay at `places` (M or 1, S, 3) m."""
    if not places.shape[1]:
        return curves
    still = np.zeros((*curves.shape[:3], places.shape[1], 3))
    still[:, 3] = places[:, None]
    return np.ascontiguousarray(np.concatenate([curves, still], axis=3))


def _rims(scene: Scene, shape: np.ndarray) -> list[tuple[Obstacle, np.ndarray, np.ndarray]]:
    """Every disc that clamps, with the height over it and the distance from its axis of places (n, 3) m."""
    out = []
    for disc in (o for o in scene.obstacles if o.clamps):
        to = shape - np.array(disc.centre)
        height = to @ np.array(disc.normal)
        out.append((disc, height, np.linalg.norm(to - height[:, None] * np.array(disc.normal), axis=1)))
    return out


def _beyond_rims(scene: Scene, shape: np.ndarray) -> np.ndarray:
    """How far within the rim of a disc that clamps each place (n, 3) m lies [m], below 0 outside; −∞ without one."""
    inner = np.full(len(shape), -np.inf)
    for disc, height, away in _rims(scene, shape):
        near = np.abs(height) < NEAR_DISC * disc.radius
        inner = np.maximum(inner, np.where(near, disc.radius - away, -disc.radius))
    return inner


def _flat_in_clamps(scene: Scene, shape: np.ndarray, clamped: np.ndarray) -> np.ndarray:
    """The shape (n, 3) m with what is clamped laid onto its disc."""
    for disc, height, away in _rims(scene, shape):
        on = clamped & (away < 2 * disc.radius)
        shape = np.where(on[:, None], shape - height[:, None] * np.array(disc.normal), shape)
    return shape


def _nearest(uv: np.ndarray, held: np.ndarray) -> np.ndarray:
    """The node on each held material point (G,): grid lines were laid through them."""
    return np.array([np.argmin(((uv - point) ** 2).sum(axis=1)) for point in held], dtype=np.int64)


def _shared_points(points: np.ndarray, held: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which of the wanted points (N, 2) are grips: their numbers, and the grip of each."""
    if not len(held):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    apart = np.abs(points[:, None] - held[None]).max(axis=2)
    on = np.flatnonzero(apart.min(axis=1) < 1e-9)
    return on, apart[on].argmin(axis=1)
