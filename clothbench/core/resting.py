"""Shapes in which sheets come to rest, kept for those who simulate one scene many times: finding one may take as long
as the motion after it, and most of what a search changes has no say in it.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from weakref import WeakKeyDictionary

import numpy as np

from clothbench.core.scene import Scene

MOST = 2**24  # bytes of shapes that are kept for one scene


class RestShapes:
    """Shapes (n, 3) m of one scene by what decides about them; the longest unused goes first when room is short."""

    def __init__(self) -> None:
        self._shapes: OrderedDict[bytes, np.ndarray] = OrderedDict()
        self._size = 0
        self._lock = threading.Lock()

    def get(self, key: bytes) -> np.ndarray | None:
        with self._lock:
            if (shape := self._shapes.get(key)) is not None:
                self._shapes.move_to_end(key)
            return shape

    def keep(self, key: bytes, shape: np.ndarray) -> None:
        with self._lock:
            if key in self._shapes:
                return
            self._shapes[key] = shape
            self._size += shape.nbytes
            while self._size > MOST:
                self._size -= self._shapes.popitem(last=False)[1].nbytes


_kept: WeakKeyDictionary[Scene, RestShapes] = WeakKeyDictionary()


def remember_rest(scene: Scene) -> None:
    """Keep, as long as the scene is there, the shapes in which sheets come to rest in it."""
    _kept.setdefault(scene, RestShapes())


def rest_shapes(scene: Scene) -> RestShapes | None:
    """What is kept of a scene; None if nobody asked for that."""
    return _kept.get(scene)
