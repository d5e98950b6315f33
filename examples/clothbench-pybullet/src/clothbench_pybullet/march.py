"""A member of a batch: it settles in one world, and follows the grips in another."""

from __future__ import annotations

import dataclasses
from contextlib import closing

import numpy as np
from clothbench import Scene
from clothbench.modelling import GridBatch

from clothbench_pybullet.world import Cloth, World

SETTLE = (0.5, 20.0)  # s, least and most that the sheet is given to come to rest
BRAKE = 0.3  # √(k m): dashpots that let no spring swing while it does
EASED, SHORT = 300, 8  # times that the sheet is stopped after so few steps, before it may move
WATCH = 4e-3  # s, how often it is looked at
AT_REST, CALM = 1e-6, 4  # m/s, and at how many looks in a row
LOOK = 32  # steps between two looks whether the sheet has blown up


def march(cloth: Cloth, batch: GridBatch, b: int) -> tuple[bool, int]:
    """Run member b and fill its positions; whether it was lost, and the steps taken."""
    scene, dt, bounds = batch.simulation.scene, float(batch.dt[b]), batch.bounds()
    held, shape, settled = batch.simulation.sheet.held, batch.shape.copy(), 0
    shape[held] = scene.grips_at(np.array([scene.start_time]))[0]
    if batch.simulation.anchored:
        brake = BRAKE * np.sqrt(cloth.stiffness * cloth.mass / len(shape))
        with closing(World(dataclasses.replace(cloth, damping=brake), shape, held, dt)) as world:
            shape, settled = settle(world, bounds)
    late = np.maximum(batch.times[b] - scene.start_time, 0.0) / dt
    before = np.floor(late).astype(np.int64)
    stops = np.union1d(before, before + 1)
    with closing(World(cloth, shape, held, dt)) as world:
        seen = follow(world, scene, stops, bounds)
    if len(seen) == len(stops):
        first, then = (seen[np.searchsorted(stops, ends)] for ends in (before, before + 1))
        part = (late - before)[:, None, None]
        batch.position[b] = batch.interpolator(((1 - part) * first + part * then)[None])[0]
        grips = scene.grips_at(batch.times[b])
        batch.position[b][:, batch.held_points] = grips[:, batch.pins_of_points]
    return len(seen) < len(stops), settled + int(stops[-1])


def settle(world: World, bounds: float) -> tuple[np.ndarray, int]:
    """The shape (n, 3) m in which the sheet comes to rest, and the steps that it took.

    First it gives way to its springs and is stopped again and again: let go at once, a sheet that begins longer than it
    is would spring back, and stay crumpled where nothing resists bending. Then its speed is taken away whenever that
    has been largest (kinetic damping: Barnes 1999, Form finding and analysis of tension structures by dynamic
    relaxation).
    """
    each = max(1, round(WATCH / world.dt))
    least, most = (int(np.ceil(span / (each * world.dt))) for span in SETTLE)
    for _ in range(EASED):
        world.step(SHORT)
        world.stop()
    place, before, calm, look = world.places(), 0.0, 0, 0
    while look < most and not (look >= least and calm >= CALM):
        world.step(each)
        look, last, place = look + 1, place, world.places()
        moved = place - last
        if not np.abs(place).max() < bounds:
            break
        calm = calm + 1 if np.abs(moved).max() < AT_REST * each * world.dt else 0
        energy = float((moved**2).sum())
        if energy < before:
            world.stop()
            energy = 0.0
        before = energy
    return place, EASED * SHORT + look * each


def follow(world: World, scene: Scene, stops: np.ndarray, bounds: float) -> np.ndarray:
    """Nodes (S, n, 3) m after each number of steps in `stops`; fewer of them if they leave the bounds [m]."""
    seen, wanted = [], set(stops.tolist())
    grips = scene.grips_at(scene.start_time + world.dt * np.arange(stops[-1] + 1)).tolist()
    for now, after in enumerate([*grips[1:], None]):
        if now in wanted or now % LOOK == 0:
            place = world.places()
            if not np.abs(place).max() < bounds:
                break
            if now in wanted:
                seen.append(place)
        if after is not None:
            world.lead(grips[now], after)
            world.step()
    return np.array(seen)
