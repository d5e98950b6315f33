"""Cloth of any outline on a rectangular grid: which nodes are of it, and how much of it each part of the grid carries.

The grid spans the sheet that the cloth was cut from. Mass and stiffness of whatever a model has there, nodes, edges,
long springs, triangles, are those of the share of its own box that lies within the outline, so that an even strain
costs what it costs the cloth, whatever way the outline cuts the cells (the finite cell method: Parvizian, Düster and
Rank 2007). Nodes that stand for next to nothing are left out, and their mass goes to the nearest that stay.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.outline import covered
from clothbench.modelling.grid import to_hems

LEAST = 0.05  # share of its cell that a node must carry to be a node of the cloth


@dataclass(frozen=True, eq=False)
class Cover:
    """An outline over grid lines u (nu,) and v (nv,) m.

    quarter: (2 nv − 2, 2 nu − 2) m², cloth in each quarter of the cells, the outermost up to the hems: what any box of
    the grid holds is a sum of them; hems: the lines with the outermost at the hems, `to_hems`.
    """

    u: np.ndarray
    v: np.ndarray
    quarter: np.ndarray
    hems: tuple[np.ndarray, np.ndarray]

    @classmethod
    def of(
        cls, outline: np.ndarray, lines: tuple[np.ndarray, np.ndarray], size: tuple[float, float] | None = None
    ) -> Cover:
        """size: of the flat sheet [m], which lines need not reach, or may overstep, where grips lie beside its hems;
        None: as far as the lines go.
        """
        size = size or (float(lines[0][-1]), float(lines[1][-1]))
        hems = (to_hems(lines[0], size[0]), to_hems(lines[1], size[1]))
        halves = [
            to_hems(_halved(np.clip(of_one, 0.0, length)), length) for of_one, length in zip(lines, size, strict=True)
        ]
        return cls(*lines, covered(outline, *halves), hems)

    @cached_property
    def share(self) -> np.ndarray:
        """What each node carries, of what an inner node of a whole sheet would, (nv, nu)."""
        return self._node_area / np.outer(spaces(self.v), spaces(self.u))

    @cached_property
    def nodes(self) -> np.ndarray:
        """Which nodes are of the cloth, (nv, nu) bool."""
        found = self.share >= LEAST
        if found.sum() < 9:
            raise ClothbenchError(
                f"outline: {found.sum()} nodes of a grid of {len(self.u)} × {len(self.v)} lie in it, expected at least "
                "9; raise the resolution"
            )
        if not _whole_cells(found).any():
            raise ClothbenchError(
                f"outline: no whole cell of a grid of {len(self.u)} × {len(self.v)} nodes lies in it, expected some; "
                "raise the resolution"
            )
        return found

    @cached_property
    def area(self) -> np.ndarray:
        """What each node stands for (nv, nu) m², 0 off the cloth; all of it together is the outline's area."""
        out = np.where(self.nodes, self._node_area, 0.0)
        place = np.stack(np.meshgrid(self.u, self.v), axis=-1)
        stay = np.argwhere(self.nodes)
        for j, i in np.argwhere(~self.nodes & (self._node_area > 0)):
            near = stay[((place[tuple(stay.T)] - place[j, i]) ** 2).sum(axis=1).argmin()]
            out[tuple(near)] += self._node_area[j, i]
        return out

    @cached_property
    def cells(self) -> np.ndarray:
        """How much cloth each cell stands for, of what fits into it (nv − 1, nu − 1); 0 where a corner is off it."""
        return np.where(_whole_cells(self.nodes), self.boxes(1, 1), 0.0)

    def triangles(self, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Those of a grid's triangles (F, 3), `grid_triangles`, whose corners are all of the cloth, and how much cloth
        each stands for, of what fits into it: the share of its cell.
        """
        keep = self.nodes.ravel()[triangles].all(axis=1)
        share = np.repeat(self.boxes(1, 1).ravel(), 2)
        keep &= share > 0
        return np.ascontiguousarray(triangles[keep]), share[keep]

    def springs(self, di: int, dj: int) -> np.ndarray:
        """The stiffness of springs from each node to that di to the right and dj down, of what it is within a whole
        sheet, (nv, nu): the share of its box that is cloth, 0 where there is no such spring.

        Not more than such a spring has in a whole sheet beside nodes as light as its ends, at a border or a corner:
        stiff springs on light nodes would only ask for short steps.
        """
        first, last = self._ends(di, dj)
        out = self._shares(di, dj)
        lightest = np.minimum(self.share[first], self.share[last])
        out[first] = np.minimum(out[first], lightest * (4 if di and dj else 2))
        return out

    def _shares(self, di: int, dj: int) -> np.ndarray:
        """The share of its box that is cloth for all that joins each node to that di to the right and dj down."""
        first, last = self._ends(di, dj)
        out = np.zeros(self.nodes.shape)
        out[first] = np.where(self.nodes[first] & self.nodes[last], self.boxes(abs(di), dj), 0.0)
        return out

    def _ends(self, di: int, dj: int) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
        """Where in (nv, nu) the nodes lie from which such a pair goes, and to which."""
        nv, nu = self.nodes.shape
        left, right = slice(0, nu - abs(di)), slice(abs(di), nu)
        columns = (left, right) if di >= 0 else (right, left)
        return (slice(0, nv - dj), columns[0]), (slice(dj, nv), columns[1])

    def widths(self, di: int, dj: int) -> np.ndarray:
        """What the edge from each node to the next along u (1, 0) or v (0, 1) stands for, (nv, nu) m of width."""
        return self._shares(di, dj) * (spaces(self.v)[:, None] if di else spaces(self.u))

    def boxes(self, di: int, dj: int) -> np.ndarray:
        """Which share of its box is cloth, for all that spans di ≥ 0 cells to the right and dj ≥ 0 down: between lines
        where it spans any, else half-way to the lines beside it, (nv − dj, nu − di). What lies beside the outermost
        lines counts to what is along them and to the cells, above 1 then; what ends there does not pull at it.
        """
        ends = self.hems if (di == 0) != (dj == 0) else (self.u, self.v)
        rows, high = _spans(self.v, ends[1], dj)
        columns, wide = _spans(self.u, ends[0], di)
        total = np.pad(self.quarter.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
        held = np.diff(np.diff(total[rows][:, :, columns], axis=1)[:, 0], axis=-1)[..., 0]
        return held / np.outer(high, wide)

    @cached_property
    def _node_area(self) -> np.ndarray:
        return self.boxes(0, 0) * np.outer(spaces(self.v), spaces(self.u))


def _whole_cells(nodes: np.ndarray) -> np.ndarray:
    """Which cells (nv − 1, nu − 1) have all four corners among the nodes (nv, nu)."""
    return nodes[:-1, :-1] & nodes[:-1, 1:] & nodes[1:, :-1] & nodes[1:, 1:]


def _halved(lines: np.ndarray) -> np.ndarray:
    """The lines with another half-way between each two."""
    return np.interp(np.arange(2 * len(lines) - 1) / 2, np.arange(len(lines)), lines)


def spaces(lines: np.ndarray) -> np.ndarray:
    """From half-way before each line to half-way after it [m], beyond the outer lines as far as before them."""
    gaps = np.diff(lines)
    return (np.concatenate([gaps[:1], gaps]) + np.concatenate([gaps, gaps[-1:]])) / 2


def _spans(lines: np.ndarray, ends: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """For all that spans `count` cells: first and last of the halved lines (K, 2) around it, and how long it is [m],
    between `ends`."""
    first = np.arange(len(lines) - count)
    if count:
        return np.stack([2 * first, 2 * (first + count)], axis=1), ends[count:] - ends[:-count]
    return np.clip(np.stack([2 * first - 1, 2 * first + 1], axis=1), 0, 2 * (len(lines) - 1)), spaces(lines)
