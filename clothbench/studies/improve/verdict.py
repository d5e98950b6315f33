"""Stage 6: the verdict on the held-out recordings, as `verdict.json` (schema 1)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.stats import t as student

from clothbench.engine.store import finite
from clothbench.estimation.trials import over
from clothbench.studies.improve.attribution import null_of
from clothbench.studies.improve.curves import CurveCase
from clothbench.studies.improve.fitting import Fitted, fit
from clothbench.studies.improve.guard import field_of
from clothbench.studies.improve.judge import AT_THE_FLOOR, COARSE, EXPLAINED, Candidate, likeness, parameters_of
from clothbench.studies.improve.problem import Case, Problem, residuals
from clothbench.studies.improve.residual import correction
from clothbench.studies.improve.rounds import AGAIN, REFITS, Outcome, Round

SCHEMA = 1


@dataclasses.dataclass(frozen=True)
class Placebo:
    """An effect that nothing speaks for, fitted all the same: its held-out errors [mm] must be no better."""

    name: str
    errors: tuple[float, ...]


def held_out_errors(problem: Problem, fitted: Fitted) -> list[float]:
    """rms [mm] of each held-out recording, the mesh's own error taken away if it was on the fit recordings."""
    return [1e3 * float(np.sqrt(np.mean(left**2))) for left in held_out_residuals(problem, fitted)]


def held_out_residuals(problem: Problem, fitted: Fitted) -> list[np.ndarray]:
    """Simulated minus seen (M,) m of each held-out recording at its visible coordinates; remembered."""
    key = problem.key("held out", fitted.effects, fitted.theta.tolist())
    if (known := problem.memory.recall(key)) is not None:
        return [known[str(k)] for k in range(len(known))]
    plain = dataclasses.replace(problem, corrections={})
    if not plain.of_split("held_out"):
        return []
    corrected = plain
    if problem.corrections:
        changes = correction(plain, fitted, "held_out")
        names = [case.name for case in plain.of_split("held_out")]
        corrected = dataclasses.replace(plain, corrections=dict(zip(names, changes, strict=True)))
    found = over(corrected.trials(fitted.effects, "held_out"), lambda trial: residuals(trial, fitted.theta[None])[0])
    problem.memory.keep(key, **{str(k): left for k, left in enumerate(found)})
    return found


def pooled(values: Sequence[float]) -> float | None:
    """Over recordings, each with the same say; None where there are none or one of them could not be simulated."""
    return finite(np.sqrt(np.mean(np.square(values)))) if len(values) else None


def paired_interval(before: Sequence[float], after: Sequence[float]) -> list[float | None]:
    """95 % interval of the mean fall of the error over recordings [mm] (Student's t; wide for few recordings)."""
    fall = np.subtract(before, after)
    if len(fall) < 2:
        return [None, None]
    half = student.ppf(0.975, len(fall) - 1) * fall.std(ddof=1) / np.sqrt(len(fall))
    return [finite(fall.mean() - half), finite(fall.mean() + half)]


def word(outcome: Outcome) -> str:
    """complete, attributed, tied or unexplained."""
    named = [r for r in outcome.rounds if r.named]
    if not named:
        return "complete" if outcome.final.rms <= AT_THE_FLOOR * outcome.floor else "unexplained"
    if left_over(outcome) > 1 - (EXPLAINED if above_floor(outcome) else COARSE):
        return "unexplained"
    return "tied" if any(len(r.named) > 1 for r in named) else "attributed"


def left_over(outcome: Outcome) -> float:
    """Share of the mean square above the floor (above the noise, if the base stood at the floor) that is still there
    after all that was named.
    """
    floor = (outcome.floor if above_floor(outcome) else outcome.noise) ** 2
    return (outcome.final.rms**2 - floor) / max(outcome.base.rms**2 - floor, 1e-12)


def above_floor(outcome: Outcome) -> bool:
    """Whether the calibrated model stood above what noise and mesh account for."""
    return outcome.base.rms > AT_THE_FLOOR * (outcome.rounds[0].floor if outcome.rounds else outcome.floor)


def standing(outcome: Outcome) -> Fitted:
    """The fit that the verdict stands by: with what was named, or the calibrated model if nothing was."""
    return outcome.final if word(outcome) in ("attributed", "tied") else outcome.base


def judged(outcome: Outcome) -> dict[str, Any]:
    """The document of the verdict, after the only look at the held-out recordings."""
    outcome.budget.stage("held-out recordings", 0, 1)
    placebo = placebo_of(outcome)
    return document(outcome, placebo, outcome.problem.memory.seconds)


def document(outcome: Outcome, placebo: Placebo | None, wall_s: float) -> dict[str, Any]:
    """`verdict.json`. Errors are rms over visible node coordinates, pooled over recordings, in mm."""
    problem, final, verdict = outcome.problem, standing(outcome), word(outcome)
    before = held_out_errors(problem, outcome.base)
    after = held_out_errors(problem, final) if final.effects else before
    left, remark, unseen = final.rms, hint(outcome, verdict), 1e-3 * (pooled(before) or 0.0)
    stopped = [case.name for case, error in zip(problem.of_split("held_out"), before, strict=True) if np.isnan(error)]
    if verdict == "complete" and stopped:
        verdict = "unexplained"
        remark = f"the fit stands at the floor, but {stopped[0]}, held out, could not be simulated with it"
    elif verdict == "complete" and unseen > problem.carried * outcome.floor:
        verdict, left = "unexplained", unseen
        remark = (
            f"the fit stands at the floor, but the error on held-out recordings at {unseen / outcome.floor:.1f} times "
            "of it: what is missing shows in their motions; let some of them be fitted too"
        )
    held_out = problem.of_split("held_out")
    return {
        "schema": SCHEMA, "model": problem.model, "base": list(problem.base), "verdict": verdict,
        "effects": [effect_entry(outcome, n) for n, r in enumerate(outcome.rounds) if r.named] if final.effects else [],
        "error_mm": {
            "fit": {"before": 1e3 * outcome.base.rms, "after": 1e3 * final.rms},
            "held_out": {
                "before": pooled(before), "after": pooled(after), "ci95": paired_interval(before, after),
                "per_recording": [
                    {"recording": c.name, "before": finite(b), "after": finite(a)}
                    for c, b, a in zip(held_out, before, after, strict=True)
                ],
                "placebo": placebo and {"name": placebo.name, "after": pooled(placebo.errors)},
            },
            "noise_floor": 1e3 * outcome.floor,
        },
        "unexplained_mm": 1e3 * max(left**2 - outcome.floor**2, 0.0) ** 0.5,
        "hint": remark,
        "candidates": candidate_entries(outcome),
        "condition": finite(np.linalg.cond(final.tangent)),
        "evaluations": outcome.evaluations, "wall_s": wall_s, "seed": problem.seed,
        "recordings": {split: [c.name for c in problem.of_split(split)] for split in ("fit", "held_out")},
        "parameters": {
            p.name: {"value": float(v), "low": finite(a), "high": finite(b), "unit": p.unit}
            for p, v, a, b in zip(final.space, final.theta, final.low, final.high, strict=True)
        },
    }  # fmt: skip


def effect_entry(outcome: Outcome, turn: int) -> dict[str, Any]:
    """What was named in one round, with its amounts as the last fit has them."""
    found, final = outcome.rounds[turn], outcome.final
    name = found.named[0]
    candidate = next(c for c in found.candidates if c.name == name)
    effect = outcome.problem.plugins.make("effects", name)
    parameters = {
        own: {
            "value": float(final.theta[i]), "low": finite(final.low[i]), "high": finite(final.high[i]),
            "unit": final.space.parameters[i].unit,
        }
        for own, i in parameters_of(final.space, name).items()
    }  # fmt: skip
    return {
        "name": name, "place": effect.place, "summary": effect.summary, "parameters": parameters,
        "tied_with": list(found.named[1:]), "p_value": candidate.p_value,
        "selected_in": f"{candidate.selected}/{len(final.squares)}",
    }  # fmt: skip


def candidate_entries(outcome: Outcome) -> list[dict[str, Any]]:
    """Every candidate as the last round that tried it saw it; gain: mm² by which the mean square fell."""
    latest: dict[str, dict[str, Any]] = {}
    dropped = outcome.final is not standing(outcome)
    for found in outcome.rounds:
        for c in found.candidates:
            latest[c.name] = {
                "name": c.name, "share": c.share, "gain": finite(1e6 * c.gain), "p_value": c.p_value,
                "why_not": too_little(outcome) if dropped and c.name in found.named else why_not(c, found),
            }  # fmt: skip
    return sorted(latest.values(), key=lambda c: (-(c["gain"] or 0.0), -c["share"]))


def too_little(outcome: Outcome) -> str:
    """Why what passed every test of its own is no finding after all."""
    return f"{left_over(outcome):.0%} of what stands above the floor is left, so that something else must be missing"


def why_not(candidate: Candidate, of: Round) -> str:
    """Why a candidate was not named in a round; "" if it was."""
    if candidate.name in of.named:
        return ""
    if candidate.why_not:
        return candidate.why_not
    if candidate.fitted is None:
        return f"promises too little to first order, or is not among the {REFITS} that promise most"
    return "another explains as much or more, with as few parameters"


def hint(outcome: Outcome, verdict: str) -> str:
    """What the reader may want to know or do next, in one or two sentences."""
    if verdict == "complete":
        return "nothing is left above the noise and the mesh"
    if verdict == "attributed":
        return ""
    if verdict == "tied":
        return "; ".join(undecided(outcome, r) for r in outcome.rounds if len(r.named) > 1)
    said, dropped = [], outcome.final.effects
    if dropped:
        fall = 1 - outcome.final.rms / outcome.base.rms
        said.append(f"{' and '.join(dropped)} would lower the error of the fit by {fall:.0%}, too little for a name")
    last = outcome.rounds[-1] if outcome.rounds else None
    near = {c: explained(c, last) for c in last.candidates if c.name not in dropped} if last else {}
    if near:
        best = max(near, key=lambda c: near[c])
        forces = [c for c in near if outcome.problem.plugins.make("effects", c.name).place == "dynamics"]
        force = max(forces, key=lambda c: near[c], default=best)
        beside = " beside that" if dropped else ""
        among = f", {told(force, near[force])} among forces" if force is not best else ""
        said.append(f"{told(best, near[best])} comes nearest{beside}{among}")
    if not said:
        return "the residual stands above the noise, and no candidate could be tried"
    return f"a hint, no finding: {'; '.join(said)}{where(outcome)}"


def explained(candidate: Candidate, tried: Round) -> float:
    """Share of the mean square a candidate took off when it was fitted, else what it promises to first order."""
    return candidate.share if candidate.fitted is None else max(0.0, candidate.gain) / tried.before.rms**2


def told(candidate: Candidate, share: float) -> str:
    """A candidate, what it explains and with which amounts: "lift (fitted with c = 1: 9% of the mean square)"."""
    fitted = candidate.fitted
    if fitted is None:
        return f"{candidate.name} ({share:.0%} of the mean square to first order)"
    amounts = []
    for own, i in parameters_of(fitted.space, candidate.name).items():
        unit = fitted.space.parameters[i].unit
        amounts.append(f"{own} = {fitted.theta[i]:.3g}" + ("" if unit == "1" else f" {unit}"))
    return f"{candidate.name} (fitted with {', '.join(amounts)}: {share:.0%} of the mean square)"


def where(outcome: Outcome) -> str:
    """Where on the sheet, in which recording and when in it most is left; nothing for curves, which have no sheet."""
    cases = outcome.problem.of_split("fit")
    if isinstance(cases[0], CurveCase):
        return ""
    squares: dict[str, list[np.ndarray]] = {"upper": [], "middle": [], "lower": []}
    for case, residual in zip(cases, standing(outcome).residual, strict=True):
        left, seen = field_of(case, residual), case.observation.visible
        third = np.minimum(3 * case.observation.material[:, 1] / case.scene.height, 2).astype(int)
        for k, rows in enumerate(squares.values()):
            rows.append(left[:, third == k][seen[:, third == k]].ravel() ** 2)
    sizes = {name: 1e3 * float(np.sqrt(np.concatenate(rows).mean())) for name, rows in squares.items() if len(rows[0])}
    most = max(sizes, key=lambda name: sizes[name])
    worst = int(np.argmax(standing(outcome).squares))
    rest = ", ".join(f"{name} {size:.1f} mm" for name, size in sizes.items())
    around = peak(cases[worst], standing(outcome).residual[worst])
    return f"; most is left in the {most} third ({rest}), in {cases[worst].name}, and there around {around}"


def peak(case: Case, residual: np.ndarray) -> str:
    """Where in a recording most of a residual (M,) is: the second, or the stretch."""
    if isinstance(case, CurveCase):
        return f"a stretch of {case.observation.stretch[case.observation.visible][np.argmax(np.abs(residual))]:.2f}"
    time, left = case.observation.time, field_of(case, residual)
    second = max(1, round((len(time) - 1) / float(time[-1] - time[0])))
    return f"{time[int(np.argmax(uniform_filter1d((left**2).sum(axis=(1, 2)), second, mode='constant')))]:.1f} s"


def undecided(outcome: Outcome, found: Round) -> str:
    """How much alike a tied pair corrects, where the two differ most in these recordings, and what would decide."""
    pair = [next(c for c in found.candidates if c.name == name) for name in found.named]
    one, other = (c.fitted.residual for c in pair if c.fitted is not None)
    apart = [a - b for a, b in zip(one, other, strict=True)]
    size = [float(np.sqrt(np.mean(a**2))) for a in apart]
    most = int(np.argmax(size))
    case = outcome.problem.of_split("fit")[most]
    differ = f"{size[most]:.2g} N" if isinstance(case, CurveCase) else f"{1e3 * size[most]:.2g} mm"
    return (
        f"{' and '.join(found.named)} fit alike (what they correct correlates with "
        f"{likeness(found.before, pair)[0, 1]:.2f}); they differ most in {case.name}, by {differ}, around "
        f"{peak(case, apart[most])}: a recording that goes further there would tell them apart"
    )


def placebo_of(outcome: Outcome) -> Placebo | None:
    """The candidate that spoke least for itself, fitted beside what was named: it must not help on held-out data."""
    problem, final = outcome.problem, standing(outcome)
    if not final.effects:
        return None
    tried = [c for c in outcome.rounds[-1].candidates if c.name not in final.effects and c.share > 0]
    if not tried or not problem.of_split("held_out"):
        return None
    name = min(tried, key=lambda c: c.share).name
    start = np.concatenate([final.theta, null_of(problem.plugins.make("effects", name))])
    fitted = fit(problem, (*final.effects, name), start, AGAIN)
    outcome.budget.count(fitted.evaluations)
    return Placebo(name, tuple(held_out_errors(problem, fitted)))
