"""The recordings held out: what fits leave of them, the placebo, and every recording beside the model, for pictures."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from clothbench.studies.improve.attribution import null_point
from clothbench.studies.improve.evidence import Comparison
from clothbench.studies.improve.finding import Placebo
from clothbench.studies.improve.fitted import Fitted
from clothbench.studies.improve.fitting import fit
from clothbench.studies.improve.problem import Problem, residuals_of_fit
from clothbench.studies.improve.refinement import discretisation_error
from clothbench.studies.improve.settings import LOOP
from clothbench.studies.improve.state import Round


def held_out_errors(problem: Problem, fitted: Fitted) -> list[float]:
    """rms of each held-out recording, the mesh's own error taken away if it was on the fit recordings."""
    return [float(np.sqrt(np.mean(residual**2))) for residual in held_out_residuals(problem, fitted)]


def held_out_residuals(problem: Problem, fitted: Fitted) -> list[np.ndarray]:
    """Simulated minus measured (M,) of each held-out recording; kept."""
    key = problem.key("held out", fitted.effects, fitted.theta.tolist())
    if (known := problem.checkpoint.recall(key)) is not None:
        return [known[str(k)] for k in range(len(known))]
    if not problem.of_split("held_out"):
        return []
    corrected = plain = problem.uncorrected()
    if problem.corrections:
        changes = discretisation_error(plain, fitted, "held_out")
        names = [case.name for case in plain.of_split("held_out")]
        corrected = dataclasses.replace(plain, corrections=dict(zip(names, changes, strict=True)))
    found = residuals_of_fit(corrected, fitted, "held_out")
    problem.checkpoint.keep(key, **{str(k): residual for k, residual in enumerate(found)})
    return found


def placebo_of(problem: Problem, final: Fitted, rounds: Sequence[Round]) -> tuple[Placebo | None, int]:
    """The candidate that spoke least for itself, fitted beside what was named: it must not help on held-out data; and
    how many parameter sets that took.
    """
    if not final.effects or not problem.of_split("held_out"):
        return None, 0
    tried = [c for c in rounds[-1].candidates if c.name not in final.effects and c.share > 0]
    if not tried:
        return None, 0
    name = min(tried, key=lambda c: c.share).name
    start = np.concatenate([final.theta, null_point(problem.space_of(name))])
    fitted = fit(problem, (*final.effects, name), start, LOOP.refit_rounds)
    return Placebo(name, tuple(held_out_errors(problem, fitted))), fitted.evaluations


def comparisons_of(problem: Problem, before: Fitted, after: Fitted) -> tuple[Comparison, ...]:
    """All recordings of which something was seen, beside both fits; those that were fitted first."""
    out: list[Comparison] = []
    fits = (before,) if after is before else (before, after)
    for split in ("fit", "held_out"):
        seen = [simulated(problem, fitted, split) for fitted in fits]
        residual = [residuals_of(problem, fitted, split) for fitted in fits]
        found = zip(problem.of_split(split), seen[0], seen[-1], residual[0], residual[-1], strict=True)
        out += [Comparison(*one) for one in found if one[3].size]
    return tuple(out)


def simulated(problem: Problem, fitted: Fitted, split: str) -> list[np.ndarray]:
    """What the sensor would see of each recording of a split; the mesh's own error is in it."""
    trials, cases = problem.uncorrected().trials(fitted.effects, split), problem.of_split(split)
    return [case.simulated(t.simulation.run(fitted.theta[None])) for case, t in zip(cases, trials, strict=True)]


def residuals_of(problem: Problem, fitted: Fitted, split: str) -> list[np.ndarray]:
    """The residual (M,) of each recording of a split; that of the fit recordings is known from the fit."""
    return fitted.residual if split == "fit" else held_out_residuals(problem, fitted)
