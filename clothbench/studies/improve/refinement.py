"""Stage 2: what the mesh and the step have to do with the residual, and what they may still be wrong by."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from clothbench.studies.improve.account import Account
from clothbench.studies.improve.attribution import projected_out, shifted
from clothbench.studies.improve.fitted import Fitted, with_discrepancy
from clothbench.studies.improve.fitting import fit
from clothbench.studies.improve.problem import Problem, residuals_of_fit
from clothbench.studies.improve.settings import LOOP

STAGE = "mesh and step refined"


def corrected(problem: Problem, fitted: Fitted, noise: float, account: Account) -> tuple[Problem, Fitted, float]:
    """The problem with the mesh's error near this fit taken away, the fit again, and what the mesh may still be wrong
    by (rms, base unit); all as they are, and 0, where nothing is discretised.

    Cells are halved until that lies below the noise, `LOOP.halvings` times at most, and no further where that leads
    away from what was seen. What an earlier fit was corrected by is not built upon: it is found anew beside this one.
    """
    account.stage(STAGE, 0, LOOP.halvings)
    plain, mesh = dataclasses.replace(problem.uncorrected(), halvings=0), 0.0
    names = [case.name for case in problem.of_split("fit")]
    residual = [r - problem.corrections.get(name, 0.0) for name, r in zip(names, fitted.residual, strict=True)]
    fitted = dataclasses.replace(fitted, residual=residual)
    changes = nothing = [0 * r for r in residual]
    for halvings, (error, step) in enumerate(refinements(plain, beside_fit(problem, fitted), "fit"), 1):
        account.stage(STAGE, halvings, LOOP.halvings)
        doubt = numerical_doubt(fitted, step)
        if unexplained_with(fitted, error) >= unexplained_with(fitted, nothing):
            # What a finer mesh changes is no step towards what was seen: the model does not converge to it. Where the
            # first halving shows that, all of the change is doubt; else what was known before stands.
            if halvings == 1:
                changes, mesh = error, 2 * doubt
            break
        plain, changes, mesh = dataclasses.replace(plain, halvings=halvings), error, doubt
        if mesh <= noise:
            break
    if plain.halvings:
        plain = dataclasses.replace(plain, corrections=dict(zip(names, changes, strict=True)))
    elif not problem.corrections:
        return plain, with_discrepancy(fitted, changes, noise), mesh
    again = fit(plain, fitted.effects, fitted.theta, LOOP.refit_rounds)
    account.count(again.evaluations)
    if plain.halvings:
        return plain, with_errors_of_mesh_and_model(plain, again, noise), mesh
    return plain, with_discrepancy(again, changes, noise), mesh


def with_errors_of_mesh_and_model(problem: Problem, fitted: Fitted, noise: float) -> Fitted:
    """The fit with intervals that hold a third of what the mesh is corrected by, and what the model may be wrong by."""
    cases = zip(problem.of_split("fit"), fitted.residual, strict=True)
    doubt = [problem.corrections.get(case.name, np.zeros_like(residual)) / 3 for case, residual in cases]
    return with_discrepancy(fitted, doubt, noise)


def discretisation_error(problem: Problem, fitted: Fitted, split: str) -> list[np.ndarray]:
    """The mesh's error (M,) of each recording, from as many halvings as the problem's corrections come from."""
    *_, (error, _) = refinements(problem, fitted, split, problem.halvings)
    return error


def refinements(
    problem: Problem, fitted: Fitted, split: str, halvings: int = LOOP.halvings
) -> Iterator[tuple[list[np.ndarray], list[np.ndarray]]]:
    """With one halving of cells and step after the other: what that comes to, carried on to the limit (Richardson
    extrapolation), and how much of it the last halving is, (M,) per recording; none where nothing is discretised.

    Added to the coarse model's residual the first takes the error of the mesh away where the model converges as the
    square of the cell's size; a third of the second is what may be left (`numerical_doubt`). A recording that cannot be
    simulated on the finer mesh is not corrected by it, and what the halving changes of it is not finite.
    """
    known = residuals_of_fit(problem, fitted, split)
    so_far = [np.zeros_like(r) for r in known]  # also of what cannot be simulated
    for _ in range(halvings):
        if (finer := problem.refined()) is None:
            return
        problem = finer
        found = residuals_of_fit(problem, fitted, split)
        steps = [b - a for a, b in zip(known, found, strict=True)]
        last = [LOOP.richardson * step for step in steps]
        yield [a + where_known(b) for a, b in zip(so_far, last, strict=True)], last
        so_far, known = [a + where_known(b) for a, b in zip(so_far, steps, strict=True)], found


def where_known(step: np.ndarray) -> np.ndarray:
    """What a halving changes of a recording (M,); nothing where that could not be simulated."""
    return step if np.isfinite(step).all() else np.zeros_like(step)


def beside_fit(problem: Problem, fitted: Fitted) -> Fitted:
    """The fit with its base moved a little, all ways at random: where the mesh's error is looked at.

    At the fit itself the change would hold the ripples of just this coarse rollout as well; with them taken away no
    other parameters could fit as well as these, right or wrong.
    """
    shift = np.zeros(len(fitted.theta))
    base = len(problem.space(()))
    shift[:base] = LOOP.refinement_offset * np.random.default_rng(problem.seed).choice([-1.0, 1.0], base)
    return dataclasses.replace(fitted, theta=shifted(fitted, shift))


def numerical_doubt(fitted: Fitted, step: Sequence[np.ndarray]) -> float:
    """What the mesh may still be wrong by (rms): a third of its last step, less what a refit takes up; of a recording
    that cannot be simulated on the finer mesh all that the fit leaves, since nothing then says that it is not the mesh.
    """
    third = [s / 3 if np.isfinite(s).all() else r for s, r in zip(step, fitted.residual, strict=True)]
    rest = projected_out(fitted.weighted_jacobian, (np.concatenate(third) * fitted.weights)[:, None])
    return float(np.sqrt(np.square(rest).sum() / len(step)))


def unexplained_with(fitted: Fitted, changes: Sequence[np.ndarray]) -> float:
    """What a refit could not take up of the residual with these changes (norm of the weighted residual)."""
    total = fitted.weighted_residual + np.concatenate(changes) * fitted.weights
    return float(np.linalg.norm(projected_out(fitted.weighted_jacobian, total[:, None])))
