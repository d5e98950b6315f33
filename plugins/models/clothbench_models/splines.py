"""Cubic B-splines on an open knot vector: where quadrature points lie, and the functions that do not vanish there.

Hughes, Cottrell, Bazilevs 2005, Isogeometric analysis. Cubic, thus twice continuously differentiable: bending needs
one derivative less, and with quadratics thin shells lock.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from clothbench.modelling import kernel

DEGREE = 3
SUPPORT = DEGREE + 1  # functions that do not vanish on an element
GAUSS = 2  # points of an element


@dataclass(frozen=True, eq=False)
class Spline:
    """Cubic splines between `breaks` (E + 1,) m, one element between each two."""

    breaks: np.ndarray

    @classmethod
    def even(cls, length: float, elements: int) -> Spline:
        return cls(np.linspace(0.0, length, elements + 1))

    @property
    def elements(self) -> int:
        return len(self.breaks) - 1

    @property
    def count(self) -> int:
        """How many functions, and control points, there are."""
        return self.elements + DEGREE

    @cached_property
    def knots(self) -> np.ndarray:
        first, last = self.breaks[[0, -1]]
        return np.concatenate([[first] * DEGREE, self.breaks, [last] * DEGREE])

    @cached_property
    def greville(self) -> np.ndarray:
        """Where control points lie along a line whose parameter is its length (count,) m."""
        inner = self.knots[1:-1]
        return np.mean([inner[k : k + self.count] for k in range(DEGREE)], axis=0)

    def element_of(self, at: np.ndarray) -> np.ndarray:
        """The element (M,) in which each of `at` (M,) m lies; its functions are those from that number on."""
        return np.clip(np.searchsorted(self.breaks, at, side="right") - 1, 0, self.elements - 1)

    def functions(self, at: np.ndarray, derivative: int = 0) -> np.ndarray:
        """Values (M, 4) [m^-derivative] at `at` (M,) m of the functions that do not vanish there."""
        at = np.clip(np.asarray(at, dtype=float), *self.breaks[[0, -1]])
        out = np.empty((len(at), SUPPORT))
        _functions(self.knots, at, self.element_of(at), derivative, out)
        return out

    def matrix(self, at: np.ndarray, derivative: int = 0) -> np.ndarray:
        """(M, count): what turns control points into values at `at` (M,) m."""
        out = np.zeros((len(at), self.count))
        rows, first = np.arange(len(at))[:, None], self.element_of(at)[:, None]
        out[rows, first + np.arange(SUPPORT)] = self.functions(at, derivative)
        return out

    @cached_property
    def quadrature(self) -> tuple[np.ndarray, np.ndarray]:
        """Gauss points and weights, both (E, 2) m."""
        at, weight = np.polynomial.legendre.leggauss(GAUSS)
        half, middle = np.diff(self.breaks)[:, None] / 2, (self.breaks[1:] + self.breaks[:-1])[:, None] / 2
        return middle + half * at, half * weight

    @cached_property
    def tables(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Functions and their first two derivatives at the quadrature points, (E, 2, 4) each."""
        at = self.quadrature[0].ravel()
        shape = (self.elements, GAUSS, SUPPORT)
        found = [self.functions(at, d).reshape(shape) for d in range(3)]
        return found[0], found[1], found[2]

    @cached_property
    def shares(self) -> np.ndarray:
        """∫ N_i du (count,) m: the length that each control point stands for."""
        out = np.zeros(self.count)
        share = (self.tables[0] * self.quadrature[1][..., None]).sum(axis=1)
        np.add.at(out, np.arange(self.elements)[:, None] + np.arange(SUPPORT), share)
        return out

    def through(self, values: np.ndarray) -> np.ndarray:
        """Control points (count, d) of the spline that takes values (count, d) at the Greville points."""
        from scipy.interpolate import make_interp_spline

        at = np.clip(self.greville, *self.breaks[[0, -1]])  # the last one may lie a rounding error beyond
        return make_interp_spline(at, values, k=DEGREE, t=self.knots).c


@kernel
def _functions(knots, at, element, derivative, out):
    """Cox–de Boor: functions of degree 3 − d from those of degree 0 up, then d times the differences of neighbours."""
    low = np.empty(SUPPORT)
    for m in range(at.shape[0]):
        span, x = element[m] + DEGREE, at[m]
        low[:] = 0.0
        low[0] = 1.0
        for p in range(1, DEGREE + 1 - derivative):
            before = 0.0
            for r in range(p):
                right, left = knots[span + r + 1], knots[span + r + 1 - p]
                share = low[r] / (right - left)
                low[r] = before + (right - x) * share
                before = (x - left) * share
            low[p] = before
        for p in range(DEGREE + 1 - derivative, DEGREE + 1):
            before = 0.0
            for r in range(p):
                share = p * low[r] / (knots[span + r + 1] - knots[span + r + 1 - p])
                low[r] = before - share
                before = share
            low[p] = before
        for k in range(SUPPORT):
            out[m, k] = low[k]
