"""Rectangular grids: how many nodes, where their lines lie, and which part of the cloth each line stands for."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.scene import Scene

NEAR, HELD, ROUNDS = (
    1e-3,
    1e3,
    100,
)  # `unstretched`: weights of a measured place and of a grip, those of a length being 1


def check_resolution(model: str, resolution: int | Sequence[int]) -> None:
    """Refuse what is not one or two whole numbers of nodes."""
    counts = [resolution] if isinstance(resolution, int) else resolution
    whole = isinstance(counts, Sequence) and all(isinstance(n, int) and n >= 3 for n in counts)
    if not whole or len(counts) not in (1, 2):
        raise ClothbenchError(f"{model}: resolution is {resolution!r}, expected one or two whole numbers ≥ 3")


def check_number(
    model: str, name: str, value: float | None, low: float, high: float = math.inf, optional: bool = True
) -> None:
    """Refuse an option that is no number above `low` and at most `high`; None passes where it is optional."""
    if value is None and optional:
        return
    if not isinstance(value, int | float) or isinstance(value, bool) or not low < value <= high or value == math.inf:
        limit = f"above {low:g}" + ("" if high == math.inf else f" and at most {high:g}")
        raise ClothbenchError(f"{model}: {name} is {value!r}, expected a number {limit}")


def grid_shape(scene: Scene, resolution: int | Sequence[int]) -> tuple[int, int]:
    """Nodes along (u, v): as the scene says, else as asked, with square cells."""
    if scene.resolution is not None:
        return scene.resolution
    if not isinstance(resolution, int):
        if len(resolution) == 2:
            nu, nv = resolution
            return int(nu), int(nv)
        resolution = int(resolution[0])
    wide = scene.width >= scene.height
    length, other = (scene.width, scene.height) if wide else (scene.height, scene.width)
    count = even_count(resolution, length, scene.grip_material[:, 0 if wide else 1])
    across = max(3, round(other * (count - 1) / length) + 1)
    return (count, across) if wide else (across, count)


def even_count(asked: int, length: float, held: np.ndarray) -> int:
    """How many evenly spaced lines over [0, length] m to use: the number nearest to `asked` (within 5) for which
    every held coordinate lies on a line, so that no line has to be moved; `asked` if there is none."""
    for count in sorted(range(max(3, asked - 5), asked + 6), key=lambda n: (abs(n - asked), n)):
        at = held / length * (count - 1)
        if np.abs(at - np.round(at)).max(initial=0.0) < 1e-6:
            return count
    return asked


def grid_lines(length: float, count: int, held: np.ndarray) -> np.ndarray:
    """`count` lines over [0, length] m, even except that the nearest line to each held coordinate lies on it."""
    even = np.linspace(0.0, length, count)
    held = np.unique(np.round(held, 9))
    nearest = np.abs(even[:, None] - held[None]).argmin(axis=0)
    if len(set(nearest)) < len(nearest):
        raise ClothbenchError(
            f"grips {length / (count - 1):.3g} m or less apart on a grid of {count} nodes over {length:g} m; "
            "raise the resolution"
        )
    anchors = dict(zip(nearest.tolist(), held.tolist(), strict=True))
    anchors = {0: 0.0, count - 1: length} | anchors
    at = sorted(anchors)
    return np.interp(np.arange(count), at, [anchors[i] for i in at])


def to_hems(lines: np.ndarray, length: float) -> np.ndarray:
    """The grid lines with the outermost at the hems, 0 and `length` m: between which the cloth of each cell lies, with
    what hangs over the edge of the grid where a grip beside a hem has moved its line.
    """
    out = np.clip(lines, 0.0, length)
    out[[0, -1]] = 0.0, length
    return out


def cloth_of_cells(lines: tuple[np.ndarray, np.ndarray], size: tuple[float, float]) -> np.ndarray:
    """How much cloth each cell between lines u (nu,) and v (nv,) m stands for, of what fits into it, (nv − 1, nu − 1):
    along a hem of a sheet of that size [m] more or less than 1 where a grip beside it has moved its line.
    """
    wide, high = (np.diff(to_hems(one, length)) / np.diff(one) for one, length in zip(lines, size, strict=True))
    return np.outer(high, wide)


def tributary(lines: np.ndarray, length: float) -> np.ndarray:
    """The length of cloth that each grid line stands for [m]; one over the hem, where a grip is, stands for what is
    nearest to it.
    """
    lines = np.clip(lines, 0.0, length)
    edges = np.concatenate([[0.0], (lines[1:] + lines[:-1]) / 2, [length]])
    return np.diff(edges)


def unstretched(
    shape: np.ndarray, lines: tuple[np.ndarray, np.ndarray], held: np.ndarray, grips: np.ndarray
) -> np.ndarray:
    """The shape (n, 3) m next to a measured one whose mesh lines and diagonals have the lengths that they have at rest.

    lines: u (nu,), v (nv,) m; held: (G,) nodes, which lie at `grips` (G, 3) m. Alternates between lengths and places
    (Bouaziz et al. 2014, Projective Dynamics, section 3).
    """
    from scipy.sparse import coo_matrix, diags
    from scipy.sparse.linalg import splu

    u, v = lines
    node = np.arange(len(u) * len(v)).reshape(len(v), len(u))
    uv = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    pairs = (
        (node[:, :-1], node[:, 1:]), (node[:-1], node[1:]),
        (node[:-1, :-1], node[1:, 1:]), (node[:-1, 1:], node[1:, :-1]),
    )  # fmt: skip
    first, last = (np.concatenate([pair[k].ravel() for pair in pairs]) for k in (0, 1))
    length = np.linalg.norm(uv[last] - uv[first], axis=1)
    row = np.arange(len(first))
    difference = coo_matrix(
        (np.repeat([1.0, -1.0], len(row)), (np.tile(row, 2), np.concatenate([last, first]))), (len(row), len(uv))
    ).tocsr()
    anchor = np.full(len(uv), NEAR)
    anchor[held] = HELD
    goal = shape.copy()
    goal[held] = grips
    solve = splu((difference.T @ difference + diags(anchor)).tocsc()).solve
    out = goal
    for _ in range(ROUNDS):
        along = difference @ out
        along *= (length / np.maximum(np.linalg.norm(along, axis=1), 1e-12))[:, None]
        out = solve(difference.T @ along + anchor[:, None] * goal)
    out[held] = grips
    return out
