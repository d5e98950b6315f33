"""A calibrated model: its parameters, what it leaves, and how sure they are."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from clothbench.core.parameters import ParameterSpace
from clothbench.core.statistics import jackknife_half_width
from clothbench.estimation.intervals import undetermined_by_some
from clothbench.studies.improve.settings import LOOP

Parts = Sequence[np.ndarray]  # one array for each recording


@dataclass(frozen=True, eq=False)
class Fitted:
    """A calibrated model with some effects. Lengths of residuals are in the evidence's base unit, m or N.

    effects: names beyond the problem's base;
    space: the P parameters;
    theta: (P,), each in its unit;
    residual: per fit recording (M,), simulated minus measured;
    jacobian: per fit recording (M, P), by the scaled parameters;
    low, high: (P,), ends of the 95 % intervals, NaN where there are too few recordings;
    evaluations: parameter sets that the fit took.
    """

    effects: tuple[str, ...]
    space: ParameterSpace
    theta: np.ndarray
    residual: list[np.ndarray]
    jacobian: list[np.ndarray]
    low: np.ndarray
    high: np.ndarray
    evaluations: int

    @cached_property
    def weights(self) -> np.ndarray:
        """1/√M of every row of all recordings joined, so that each recording has the same say."""
        return np.concatenate([np.full(len(r), len(r) ** -0.5) for r in self.residual])

    @cached_property
    def weighted_residual(self) -> np.ndarray:
        """The residuals joined and weighted."""
        return np.concatenate(self.residual) * self.weights

    @cached_property
    def weighted_jacobian(self) -> np.ndarray:
        """The Jacobians joined and weighted: what small changes of the parameters do."""
        return np.vstack(self.jacobian) * self.weights[:, None]

    @property
    def at_bound(self) -> np.ndarray:
        return self.space.at_bound(self.theta)

    @property
    def mean_squares(self) -> np.ndarray:
        """Mean square of the residual of each fit recording (R,)."""
        return np.array([float(np.mean(r**2)) for r in self.residual])

    def on(self, where: Sequence[int]) -> Fitted:
        """The same fit as some of its recordings see it, by their numbers."""
        residual, jacobian = ([parts[k] for k in where] for parts in (self.residual, self.jacobian))
        return dataclasses.replace(self, residual=residual, jacobian=jacobian)

    @property
    def rms(self) -> float:
        """Over all fit recordings; every one has the same say."""
        return float(np.sqrt(self.mean_squares.mean()))


def jackknife_interval(
    space: ParameterSpace, theta: np.ndarray, residual: Parts, jacobian: Parts, alone: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """95 % intervals (P,), (P,): how far the fit moves, to first order, when one recording is left out; the whole range
    of a parameter that the recordings, or those without one of them, do not determine: nobody knows what another one
    would say. alone: whether one of them alone may tell it.
    """
    unit = space.to_unit(theta)
    if len(residual) < LOOP.least_recordings:
        return np.full(len(space), np.nan), np.full(len(space), np.nan)
    moved = jackknife_moves(residual, jacobian)
    half = jackknife_half_width(moved - moved.mean(axis=0))
    whole = normal_equations(residual, jacobian)[0]
    rest = [] if alone else [whole - part.T @ part / len(part) for part in jacobian]
    open_ = undetermined_by_some(whole, rest)
    low, high = np.where(open_, 0.0, unit - half), np.where(open_, 1.0, unit + half)
    return space.from_unit(low), space.from_unit(high)


def jackknife_moves(residual: Parts, jacobian: Parts) -> np.ndarray:
    """By how much the fit moves in the unit cube (R, P), to first order, when each recording is left out."""
    whole = normal_equations(residual, jacobian)
    parts = [normal_equations(residual[r : r + 1], jacobian[r : r + 1]) for r in range(len(residual))]
    return np.array([solve_damped(whole[0] - part[0], whole[1] - part[1]) for part in parts])


def with_discrepancy(fitted: Fitted, doubt: Parts, noise: float) -> Fitted:
    """The same fit with intervals that also hold what no number of recordings averages out.

    That is, to first order, what it would move by if the residual were changed by `doubt`, (M,) for each recording,
    the error of the mesh; and if a part of what is left above the noise (`LOOP.model_discrepancy`), wherever it comes
    from, looked like the parameter (Kennedy and O'Hagan 2001, Bayesian calibration of computer models). About a hundred
    patterns in space and time are independent, of which a parameter makes one.
    """
    hessian, gradient = normal_equations(doubt, fitted.jacobian)
    mesh = np.abs(solve_damped(hessian, gradient))
    above_noise = max(fitted.rms**2 - noise**2, 0.0)
    discrepancy = LOOP.model_discrepancy * np.sqrt(above_noise * inverse_curvature(hessian, len(fitted.residual)))
    unit, low, high = (fitted.space.to_unit(t) for t in (fitted.theta, fitted.low, fitted.high))
    lower = unit - np.sqrt((unit - low) ** 2 + mesh**2 + discrepancy**2)
    upper = unit + np.sqrt((high - unit) ** 2 + mesh**2 + discrepancy**2)
    return dataclasses.replace(
        fitted, low=fitted.space.from_unit(np.maximum(lower, 0.0)), high=fitted.space.from_unit(np.minimum(upper, 1.0))
    )


def inverse_curvature(hessian: np.ndarray, recordings: int) -> np.ndarray:
    """(P,): the square of how far each scaled parameter can go, the others fitted again, over the rise of the mean
    square that this makes.
    """
    return recordings * np.diag(np.linalg.pinv(hessian, rcond=1e-10, hermitian=True))


def normal_equations(residual: Parts, jacobian: Parts) -> tuple[np.ndarray, np.ndarray]:
    """JᵀJ (P, P) and −Jᵀr (P,), each recording with the same say."""
    hessian = np.asarray(sum(j.T @ j / len(j) for j in jacobian))
    gradient = np.asarray(-sum(j.T @ r / len(r) for j, r in zip(jacobian, residual, strict=True)))
    return hessian, gradient


def solve_damped(hessian: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """Solution (P,) of normal equations, the diagonal raised by next to nothing so that there is one."""
    raised = 1e-10 * np.trace(hessian) / max(len(hessian), 1)  # of no parameters at all there is none
    return np.linalg.lstsq(hessian + raised * np.eye(len(hessian)), gradient, rcond=None)[0]
