"""What recordings tell of parameters, and what further ones would: information matrices in the unit cube.

J (M, P) is of a recording's residuals by scaled parameters, κ [the residual's unit] what each of its elements counts as
its noise. The information of a recording is JᵀJ/κ², that of several is their sum, and the range that is searched counts
as known beforehand: without any recording an interval is as wide as the range. Its inverse is the covariance, and half
the logarithm of the ratio of determinants is the expected information of an experiment in nats (Bayesian D-optimality,
Chaloner and Verdinelli 1995, Bayesian experimental design: a review).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import ndtri

TWO_SIDED = float(ndtri(0.975))
BEFOREHAND = 0.5  # half of the scaled range: the 95 % interval of a parameter of which nothing was measured


def beforehand(count: int) -> np.ndarray:
    """Information (P, P) of the range that is searched."""
    return np.eye(count) * (TWO_SIDED / BEFOREHAND) ** 2


def information(jacobian: np.ndarray, counted: float) -> np.ndarray:
    """JᵀJ/κ² (P, P)."""
    return jacobian.T @ jacobian / counted**2


def half_widths(known: np.ndarray, pull: np.ndarray) -> np.ndarray:
    """Of the 95 % intervals (P,), in scaled ranges, from all information together (P, P), and from how far the mesh may
    have moved the fit to first order, by which each reaches further; pull: (P,), see `pull_of`.
    """
    inverse = np.linalg.inv(known)
    return TWO_SIDED * np.sqrt(np.diag(inverse)) + np.abs(inverse @ pull)


def pull_of(jacobian: np.ndarray, error: np.ndarray, counted: float) -> np.ndarray:
    """Jᵀe/κ² (P,): how an error e (M,) of the model itself, such as its mesh's, pulls at the parameters."""
    return jacobian.T @ error / counted**2


def gain(known: np.ndarray, more: np.ndarray) -> float:
    """Expected information of an experiment [nats], from what is known (P, P) and what it adds (P, P)."""
    return 0.5 * float(np.linalg.slogdet(known + more)[1] - np.linalg.slogdet(known)[1])


def counted_noise(residual: np.ndarray, jacobian: np.ndarray, groups: Sequence[np.ndarray], noise: float) -> float:
    """κ: what each element of a recording's residual (M,) counts as its noise, in the residual's unit.

    Not the sensor's alone: what a fit leaves hangs together over time and over the sheet, so that many elements are
    few pieces of evidence. κ² is by how much more the sums of Jᵀr over groups of rows (seconds of a recording) spread
    than independent errors of variance 1 would make them, as a mean over the directions of the parameters (the
    dispersion of quasi-likelihood, McCullagh and Nelder 1989, ch. 9, from the sandwich's middle). It is never below
    the mean square that is left, nor below `noise`.
    """
    least = max(noise**2, float(np.mean(residual**2)))
    inverse = np.linalg.inv(jacobian.T @ jacobian + least * beforehand(jacobian.shape[1]))
    told = float(np.trace(inverse @ (jacobian.T @ jacobian)))  # how many directions the recording tells of
    sums = np.array([jacobian[rows].T @ residual[rows] for rows in groups])
    spread = float(np.einsum("gp,pq,gq->", sums, inverse, sums))
    return float(np.sqrt(max(least, spread / max(told, 1e-12))))


def told_apart(counted: np.ndarray, pieces: np.ndarray) -> np.ndarray:
    """Noises κ (R,) that recordings count, as far as they are told apart; pieces: (R,), of evidence behind each.

    κ² is judged from few sums, and a recording whose sums happen to be small seems surer than it is. So log κ² keeps of
    its distance from the mean noise only the share that is more than chance (James and Stein 1961, Estimation with
    quadratic loss): of n pieces it scatters by a variance of 2/(n − 1).
    """
    own, usual = np.log(counted**2), np.log(np.mean(counted**2))
    apart = float(own.var(ddof=1)) if len(own) > 1 else 0.0
    kept = max(0.0, 1 - float(np.mean(2 / (pieces - 1))) / apart) if apart else 0.0
    return np.asarray(np.exp((usual + kept * (own - usual)) / 2))


def made_up(
    apart: np.ndarray, jacobian: np.ndarray, known: np.ndarray, unit: np.ndarray, moved: np.ndarray, counted: float
) -> tuple[np.ndarray, float]:
    """By which step δ (P,) of its parameters a rival makes up for as much as it can, and Δχ² that is left.

    apart: (M,) rival minus the other, in the experiment; jacobian: (M, P) of the rival there; unit: (P,), its
    parameters; known: (P, P), what the recordings say of these, and moved: (P,), how far they are from the fit to
    the recordings. To first order, and inside the range: min_δ ‖apart + J δ‖²/κ² + (moved + δ)ᵀ known (moved + δ).
    """
    from scipy.optimize import lsq_linear

    root = np.linalg.cholesky(known).T
    rows = np.vstack([jacobian / counted, root])
    wanted = -np.concatenate([apart / counted, root @ moved])
    room = 1e-9  # lsq_linear wants a start strictly inside
    found = lsq_linear(rows, wanted, bounds=(-unit - room, 1 - unit + room))
    return found.x, 2 * float(found.cost)


def separation(
    apart: np.ndarray,
    jacobian: np.ndarray,
    known: np.ndarray,
    unit: np.ndarray,
    moved: np.ndarray,
    counted: float,
    doubt: np.ndarray,
) -> tuple[float, float]:
    """How far apart two models would be [σ] after an experiment: √Δχ², where the one is right; and at least.

    The rival makes up for as much as it can, see `made_up` (T-optimality, Atkinson and Fedorov 1975). doubt: (M,), by
    how much both may be wrong; at worst that speaks for the rival.
    """
    step, square = made_up(apart, jacobian, known, unit, moved, counted)
    against = 2 * abs(float((apart + jacobian @ step) @ doubt)) / counted**2
    return float(np.sqrt(square)), float(np.sqrt(max(square - against, 0.0)))
