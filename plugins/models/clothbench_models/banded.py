"""Cholesky of a banded symmetric matrix, given by its lower half: band[j, k] is entry (j + k, j), (N, w)."""

from __future__ import annotations

import numpy as np

from clothbench.modelling import fast_kernel, lean_kernel


@lean_kernel
def keep_out(band, held):
    """Put ones on the diagonal and zeros beside it for unknowns that are `held` (N,)."""
    count, wide = band.shape
    for j in range(count):
        if held[j]:
            band[j] = 0.0
            band[j, 0] = 1.0
        else:
            for k in range(1, min(wide, count - j)):
                if held[j + k]:
                    band[j, k] = 0.0


@fast_kernel(allocates=False)
def factor(band):
    """In place; false where the matrix is not positive definite."""
    count, wide = band.shape
    for j in range(count):
        if not band[j, 0] > 0.0:
            return False
        last = min(wide, count - j)
        root = 1.0 / np.sqrt(band[j, 0])
        for k in range(last):
            band[j, k] *= root
        column = band[j]
        for i in range(1, last):
            s = column[i]
            if s != 0.0:
                below, from_here = band[j + i], column[i:last]
                for k in range(last - i):
                    below[k] -= from_here[k] * s
    return True


@fast_kernel(allocates=False)
def substitute(band, x):
    """Solve with the factor, in place."""
    count, wide = band.shape
    for j in range(count):
        x[j] /= band[j, 0]
        last = min(wide, count - j)
        column, rest, s = band[j], x[j:], x[j]
        for k in range(1, last):
            rest[k] -= column[k] * s
    for j in range(count - 1, -1, -1):
        last = min(wide, count - j)
        column, rest, s = band[j], x[j:], 0.0
        for k in range(1, last):
            s += column[k] * rest[k]
        x[j] = (x[j] - s) / band[j, 0]


@fast_kernel(allocates=False)
def times(band, x, out):
    """out = A x."""
    count, wide = band.shape
    for j in range(count):
        out[j] = band[j, 0] * x[j]
    for j in range(count):
        last = min(wide, count - j)
        column, s, y = band[j], 0.0, x[j]
        for k in range(1, last):
            out[j + k] += column[k] * y
            s += column[k] * x[j + k]
        out[j] += s
