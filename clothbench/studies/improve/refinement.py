"""Stage 2: what the mesh and the step have to do with the residual, and the floor of noise and mesh."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from clothbench.estimation.trials import over
from clothbench.studies.improve.account import Account
from clothbench.studies.improve.attribution import projected_out, shifted
from clothbench.studies.improve.fitted import Fitted, with_discrepancy
from clothbench.studies.improve.fitting import fit
from clothbench.studies.improve.problem import Problem, residuals
from clothbench.studies.improve.settings import LOOP

STAGE = "mesh and step refined"


def corrected(problem: Problem, fitted: Fitted, noise: float, account: Account) -> tuple[Problem, Fitted, float]:
    """The problem with the mesh's error near this fit taken away, the fit again, the floor of noise and mesh; all as
    they are, and the noise, where nothing is discretised.
    """
    account.stage(STAGE, 0, 2)
    plain = problem.uncorrected()
    changes = discretisation_error(plain, beside_fit(problem, fitted), "fit")
    account.stage(STAGE, 1, 2)
    if changes is None:
        return plain, with_discrepancy(fitted, [0 * r for r in fitted.residual], noise), noise
    doubt = numerical_floor(fitted, changes)
    if unexplained_with(fitted, changes) >= unexplained_with(fitted, [0 * c for c in changes]):
        # What a finer mesh changes is no step towards what was seen: the model does not converge to it, and all of the
        # change is doubt.
        return plain, with_discrepancy(fitted, changes, noise), float(np.hypot(noise, 2 * doubt))
    names = [case.name for case in problem.of_split("fit")]
    problem = dataclasses.replace(problem, corrections=dict(zip(names, changes, strict=True)))
    again = fit(problem, fitted.effects, fitted.theta, LOOP.refit_rounds)
    account.count(again.evaluations)
    return problem, with_discrepancy(again, [c / 3 for c in changes], noise), float(np.hypot(noise, doubt))


def discretisation_error(problem: Problem, fitted: Fitted, split: str) -> list[np.ndarray] | None:
    """What a mesh and step of half the size would change, carried on to the limit (Richardson extrapolation), (M,) per
    recording; None where nothing is discretised.

    Added to the coarse model's residual it takes the error of the mesh away where the model converges as the square of
    the cell's size; a third of it is what may be left (`numerical_floor`).
    """
    if (refined := problem.refined()) is None:
        return None
    coarse, fine = problem.trials(fitted.effects, split), refined.trials(fitted.effects, split)
    runs = over([*coarse, *fine], lambda trial: residuals(trial, fitted.theta[None])[0])
    out = []
    for a, b in zip(runs[: len(coarse)], runs[len(coarse) :], strict=True):
        change = b - a
        out.append(LOOP.richardson * change if np.isfinite(change).all() else np.zeros_like(change))
    return out


def beside_fit(problem: Problem, fitted: Fitted) -> Fitted:
    """The fit with its base moved a little, all ways at random: where the mesh's error is looked at.

    At the fit itself the change would hold the ripples of just this coarse rollout as well; with them taken away no
    other parameters could fit as well as these, right or wrong.
    """
    shift = np.zeros(len(fitted.theta))
    base = len(problem.space(()))
    shift[:base] = LOOP.refinement_offset * np.random.default_rng(problem.seed).choice([-1.0, 1.0], base)
    return dataclasses.replace(fitted, theta=shifted(fitted, shift))


def numerical_floor(fitted: Fitted, corrections: Sequence[np.ndarray]) -> float:
    """What the mesh may still be wrong by (rms): a third of the correction, less what a refit takes up."""
    rest = projected_out(fitted.weighted_jacobian, (np.concatenate(corrections) * fitted.weights)[:, None])
    return float(np.sqrt(np.square(rest).sum() / len(corrections))) / 3


def unexplained_with(fitted: Fitted, changes: Sequence[np.ndarray]) -> float:
    """What a refit could not take up of the residual with these changes (norm of the weighted residual)."""
    total = fitted.weighted_residual + np.concatenate(changes) * fitted.weights
    return float(np.linalg.norm(projected_out(fitted.weighted_jacobian, total[:, None])))
