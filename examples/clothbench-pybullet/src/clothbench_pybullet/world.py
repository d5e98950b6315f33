"""One sheet in a deformable world of its own, in a PyBullet client without a window."""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np

NO_TIME = 1e-12  # s
SMALL = 1e-3  # m, radius of a body that holds a node and touches nothing


@contextlib.contextmanager
def hushed() -> Iterator[None]:
    """Drop what C code prints: standard output belongs to the command that is running.

    C keeps a buffer of its own, which is emptied before the descriptors come back.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    kept = os.dup(1), os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        for descriptor in (1, 2):
            os.dup2(nowhere, descriptor)
        yield
    finally:
        ctypes.CDLL(None).fflush(None)
        for descriptor, copy in zip((1, 2), kept, strict=True):
            os.dup2(copy, descriptor)
            os.close(copy)
        os.close(nowhere)


def library() -> ModuleType:
    """PyBullet, which prints when it was built as soon as it is imported."""
    with hushed():
        import pybullet
    return pybullet


@dataclass(frozen=True)
class Cloth:
    """What `loadSoftBody` is told. mass: kg of the whole sheet, which Bullet deals out to all nodes alike."""

    mesh: Path
    mass: float
    gravity: tuple[float, float, float]
    stiffness: float
    damping: float
    bending: float


class World:
    """shape (n, 3) m: where the nodes are at first, at rest; held (G,): nodes that bodies without mass lead;
    dt: time step [s]."""

    def __init__(self, cloth: Cloth, shape: np.ndarray, held: np.ndarray, dt: float):
        self.bullet = library()
        with hushed():
            self.client = self.bullet.connect(self.bullet.DIRECT)
            self.sheet = self._load(cloth)
        self.pace(NO_TIME)
        self.step()  # in the first one Bullet measures how long springs are at rest: flat, as in the file
        self.bullet.resetMeshData(self.sheet, shape.tolist(), physicsClientId=self.client)
        self.leaders = [self._leader(int(node), shape[node].tolist()) for node in held]
        self.pace(dt)
        self._stay_awake()

    def _load(self, cloth: Cloth) -> int:
        """Files are cached by their names, which would give every scene the mesh of the first."""
        b, client = self.bullet, self.client
        b.resetSimulation(b.RESET_USE_DEFORMABLE_WORLD, physicsClientId=client)
        b.setPhysicsEngineParameter(enableFileCaching=0, physicsClientId=client)
        b.setGravity(*cloth.gravity, physicsClientId=client)
        return b.loadSoftBody(
            str(cloth.mesh), mass=cloth.mass, useMassSpring=1, useNeoHookean=0, useSelfCollision=0, useFaceContact=0,
            useBendingSprings=int(cloth.bending > 0), springElasticStiffness=cloth.stiffness,
            springDampingStiffness=cloth.damping, springDampingAllDirections=0,
            springBendingStiffness=cloth.bending, collisionMargin=SMALL, physicsClientId=client,
        )  # fmt: skip

    def _leader(self, node: int, place: list[float]) -> int:
        """A body that holds a node: of maximal coordinates, since multi-bodies take their anchors along a step late."""
        b, client = self.bullet, self.client
        ball = b.createCollisionShape(b.GEOM_SPHERE, radius=SMALL, physicsClientId=client)
        body = b.createMultiBody(0, ball, -1, place, useMaximalCoordinates=1, physicsClientId=client)
        b.setCollisionFilterGroupMask(body, -1, 0, 0, physicsClientId=client)
        b.createSoftBodyAnchor(self.sheet, node, body, -1, physicsClientId=client)
        return body

    def _stay_awake(self) -> None:
        state = self.bullet.ACTIVATION_STATE_DISABLE_SLEEPING
        self.bullet.changeDynamics(self.sheet, -1, activationState=state, physicsClientId=self.client)

    def pace(self, dt: float) -> None:
        """Steps of dt [s] from now on."""
        self.dt = dt
        self.bullet.setTimeStep(dt, physicsClientId=self.client)

    def lead(self, before: list, after: list) -> None:
        """Bring the held nodes from `before` to `after`, G × 3 m, within the next step."""
        b, client = self.bullet, self.client
        for body, old, new in zip(self.leaders, before, after, strict=True):
            speed = [(n - o) / self.dt for n, o in zip(new, old, strict=True)]
            b.resetBasePositionAndOrientation(body, new, (0, 0, 0, 1), physicsClientId=client)
            b.resetBaseVelocity(body, speed, (0, 0, 0), physicsClientId=client)

    def step(self, count: int = 1) -> None:
        for _ in range(count):
            self.bullet.stepSimulation(self.client)

    def places(self) -> np.ndarray:
        """Where the nodes are, (n, 3) m."""
        flag = self.bullet.MESH_DATA_SIMULATION_MESH
        return np.array(self.bullet.getMeshData(self.sheet, -1, flags=flag, physicsClientId=self.client)[1])

    def stop(self) -> None:
        """Take all speed from the sheet, which only a sheet that falls asleep loses at once."""
        b, dt = self.bullet, self.dt
        b.changeDynamics(self.sheet, -1, activationState=b.ACTIVATION_STATE_SLEEP, physicsClientId=self.client)
        self.pace(NO_TIME)
        self.step()
        self.pace(dt)
        self._stay_awake()

    def close(self) -> None:
        with hushed():
            self.bullet.disconnect(self.client)
