"""Selection: what a candidate has to show to be named, and which of several is. Rules only, no simulation."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clothbench.core.parameters import ParameterSpace
from clothbench.core.statistics import fisher_quantile, student
from clothbench.studies.improve.evidence import Evidence
from clothbench.studies.improve.fitted import Fitted, jackknife_moves
from clothbench.studies.improve.settings import LOOP


@dataclass(frozen=True, eq=False)
class Candidate:
    """What came of one candidate in one round.

    name: of the effect;
    share: of the residual's variance that only it could explain, to first order;
    p_value: of that share, over all candidates of the round;
    gain: by which the mean square fell when all was refitted, base unit squared (NaN where it was not);
    selected: in how many of the leave-one-out rounds it is the best and explains enough;
    fitted: everything refitted with it, if it was;
    why_not: what speaks against it, or "";
    p_alone: of its share, over its own settings alone.
    """

    name: str
    share: float
    p_value: float
    gain: float = float("nan")
    selected: int = 0
    fitted: Fitted | None = None
    why_not: str = ""
    p_alone: float = 1.0


def least_fall(current: Fitted, floor: float, noise: float) -> float:
    """How far the mean square has to fall for a name (base unit squared).

    A share of what stands above the floor, and more than a coarse mesh may well stand for. Where nothing is above the
    floor, the mesh may stand for all that is left; then only an effect that explains much of it, noise apart, is no
    doing of the mesh.
    """
    mean_square = current.rms**2
    if current.rms > LOOP.floor_factor * floor:
        mesh = LOOP.least_explained_at_floor * (floor**2 - noise**2)
        return max(LOOP.least_explained * (mean_square - floor**2), mesh)
    return LOOP.least_explained_at_floor * max(mean_square - noise**2, 1e-12)


def least_fall_beside(current: Fitted, more: int) -> float:
    """The same for an effect with so many parameters that the recordings tell without any model: neither a mesh nor a
    model's fault made it up, and it has to pay for its parameters only.
    """
    return LOOP.parameter_penalty * more * current.rms**2


def assess(
    current: Fitted, gain: float, tried: Sequence[Candidate], evidence: Evidence | None = None, mesh: float = 0.0
) -> list[Candidate]:
    """What speaks against each of them, if anything; and in how many leave-one-out rounds it is the best and explains
    enough. What is left out there is a recording's say: nothing is fitted again. What contradicts the recordings, or
    could not be simulated to the end, is no rival of the others; what corrects the same as another is compared with it
    on all recordings at once: which of the two is ahead on some of them is a matter of ripples, and no reason to name
    one without the other. mesh: what the model's mesh may be wrong by, base unit.
    """
    count = len(current.mean_squares)
    square = np.array([c.fitted.mean_squares for c in tried if c.fitted is not None]).reshape(-1, count)
    faults = [faulty(c.name, current, c.fitted, evidence) if c.fitted is not None else "" for c in tried]
    objections = [
        evidence.objection(current.residual, c.fitted.residual) if evidence and c.fitted else "" for c in tried
    ]
    rivals = [k for k, why in enumerate(objections) if not why and np.isfinite(square[k]).all()]
    allowed, same, doubt = allowances(current, tried), alike(current, tried), mesh_decides(current, tried, mesh)
    out = []
    for k, candidate in enumerate(tried):
        candidate = dataclasses.replace(candidate, gain=float((current.mean_squares - square[k]).mean()))
        wins = 0
        for left_out in range(count):
            rest = [r for r in range(count) if r != left_out] or [0]
            shown = {j: list(range(count)) if same[j, k] else rest for j in rivals}
            best = all(
                square[k, on].mean() <= most_left(square[j, on].mean(), allowed[j, k], doubt[j, k])
                for j, on in shown.items()
            )
            wins += bool(best and (current.mean_squares - square[k])[rest].mean() >= gain)
        helped = int((square[k] < current.mean_squares).sum())
        why = ""
        if candidate.gain < gain:
            why = f"explains only {max(candidate.gain, 0) / gain:.0%} of what a name has to"
        elif helped < count - 1:
            why = f"helps in {helped} of {count} recordings only"
        elif faults[k]:
            why = faults[k]
        elif wins < count - 1:
            why = f"falls short or behind another when a recording is left out (stands in {wins} of {count})"
        out.append(dataclasses.replace(candidate, selected=int(wins), why_not=why))
    return sorted(out, key=lambda c: -c.gain)


def faulty(name: str, current: Fitted, fitted: Fitted, evidence: Evidence | None) -> str:
    """Why a fit with an effect cannot stand after the `current` one, by its amounts or what it contradicts, or ""."""
    if evidence is None:
        return unphysical(name, fitted)
    return unphysical(name, fitted, evidence.search.together) or evidence.objection(current.residual, fitted.residual)


def unphysical(name: str, fitted: Fitted, together: bool = False) -> str:
    """Why the amounts that were fitted to an effect cannot stand, or "". together: see `SearchSettings`."""
    amounts = amounts_of(fitted.space, name)
    if np.isnan(fitted.low[amounts]).all():
        return f"fewer than {LOOP.least_recordings} recordings to fit give its amount no interval"
    if why := at_bound(name, fitted):
        return why
    if not away_from_null(fitted, amounts).any():
        return "its amount is fitted to nothing"
    if not amounts_of_note(name, fitted) and not (
        together and told_from_nothing(fitted, amounts, nulls_of(fitted, amounts))
    ):
        return "its amount cannot be told from nothing"
    return ""


def nulls_of(fitted: Fitted, amounts: Sequence[int]) -> np.ndarray:
    """The values (A,) at which amounts, by their numbers in the space, are nothing."""
    return np.array([fitted.space.parameters[i].null for i in amounts], dtype=float)


def away_from_null(fitted: Fitted, amounts: Sequence[int]) -> np.ndarray:
    """Which amounts (A,), by their numbers in the space, are more than nothing."""
    null = nulls_of(fitted, amounts)
    range_ = (fitted.space.high - fitted.space.low)[list(amounts)]
    return np.asarray(np.abs(fitted.theta[list(amounts)] - null) > LOOP.away_from_null * range_)


def amounts_of_note(name: str, fitted: Fitted) -> list[int]:
    """Which amounts of an effect, by their numbers in the space, are each told from nothing by its interval."""
    amounts = amounts_of(fitted.space, name)
    null = nulls_of(fitted, amounts)
    told = (fitted.low[amounts] > null) | (fitted.high[amounts] < null)
    return [i for i, found in zip(amounts, told & away_from_null(fitted, amounts), strict=True) if found]


def amounts_at_bound(name: str, fitted: Fitted) -> list[int]:
    """Which amounts of an effect, by their numbers in the space, have run to a bound that is not nothing."""
    amounts = amounts_of(fitted.space, name)
    far = away_from_null(fitted, amounts)
    return [i for i, away in zip(amounts, far, strict=True) if away and fitted.at_bound[i]]


def told_from_nothing(fitted: Fitted, amounts: Sequence[int], null: np.ndarray) -> bool:
    """Whether amounts together differ from null, though each alone may not: Hotelling's T² over recordings left out
    one at a time, each amount as unsure as its interval says.
    """
    count, size = len(fitted.residual), len(amounts)
    if count <= size:
        return False
    moved = jackknife_moves(fitted.residual, fitted.jacobian)[:, list(amounts)]
    covariance = (count - 1) ** 2 / count * np.atleast_2d(np.cov(moved, rowvar=False))
    unit, low, high = (fitted.space.to_unit(end)[list(amounts)] for end in (fitted.theta, fitted.low, fitted.high))
    half = np.maximum(high - unit, unit - low) / student(count - 1)
    wider = np.maximum(half / np.sqrt(np.maximum(np.diag(covariance), 1e-300)), 1.0)
    whole = fitted.theta.copy()
    whole[list(amounts)] = null
    away = (unit - fitted.space.to_unit(whole)[list(amounts)]) / wider
    square = float(away @ np.linalg.pinv(covariance, hermitian=True) @ away)
    return square * (count - size) / (size * (count - 1)) > fisher_quantile(1 - LOOP.significance, size, count - size)


def at_bound(name: str, fitted: Fitted) -> str:
    """Which amount of an effect runs to its bound, or ""."""
    for i in amounts_at_bound(name, fitted)[:1]:
        return f"its {fitted.space.names[i]} runs to the bound {fitted.theta[i]:.3g}"
    return ""


def amounts_of(space: ParameterSpace, effect: str) -> list[int]:
    """Numbers of the parameters by which an effect vanishes; its others give it its shape."""
    return [i for i in parameters_of(space, effect).values() if space.parameters[i].null is not None]


def parameters_of(space: ParameterSpace, effect: str) -> dict[str, int]:
    """Numbers of an effect's parameters by their own names, which in the space begin with the effect's."""
    first = f"{effect}."
    return {p.name.removeprefix(first): i for i, p in enumerate(space) if p.name.startswith(first)}


def allowances(current: Fitted, tried: Sequence[Candidate]) -> np.ndarray:
    """(K, K): candidate k stands beside j if it leaves at most [j, k] times what j leaves (mean squares).

    Within the tie margin two cannot be told apart, within twice that if what they correct is alike; beyond that every
    further parameter has to pay for itself.
    """
    return allowance(more_parameters(tried), alike(current, tried))


def more_parameters(tried: Sequence[Candidate]) -> np.ndarray:
    """(K, K): how many parameters the fit of the first has more than that of the second."""
    size = np.array([0 if c.fitted is None else len(c.fitted.theta) for c in tried])
    return np.asarray(size[:, None] - size[None, :])


def alike(current: Fitted, tried: Sequence[Candidate]) -> np.ndarray:
    """(K, K): which correct the same of the residual, with as many parameters but for one."""
    correlated = correction_correlation(current, tried) >= LOOP.alike_correlation
    return np.asarray(correlated & (np.abs(more_parameters(tried)) <= 1))


def allowance(more: Any, alike: Any) -> Any:
    """Times what another leaves (mean squares) a candidate may leave to stand beside it, with so many `more` parameters
    and what it corrects `alike` or not; numbers or arrays.
    """
    return 1 + LOOP.tie_margin * np.where(alike, 2, 1) + LOOP.parameter_penalty * np.maximum(more, 0)


def correction_correlation(current: Fitted, tried: Sequence[Candidate]) -> np.ndarray:
    """(K, K): correlation of what the candidates correct of the residual."""
    before = np.concatenate(current.residual)
    taken = [np.zeros_like(before) if c.fitted is None else before - np.concatenate(c.fitted.residual) for c in tried]
    unit = np.array([t / max(float(np.linalg.norm(t)), 1e-300) for t in taken]).reshape(len(tried), len(before))
    return unit @ unit.T


def mesh_decides(current: Fitted, tried: Sequence[Candidate], mesh: float) -> np.ndarray:
    """(K, K): by how much more (mean square) than candidate j candidate k may leave through nothing but the error of
    the mesh, where the two correct much the same, with as many parameters but for one; else 0.

    An error e of the residual changes the difference of their mean squares by 2 e·d, d being what their residuals
    differ by; how much of e may look like d is what is allowed for wherever something looks like a parameter.
    mesh: rms of e, base unit.
    """
    left = [(c.fitted or current).weighted_residual for c in tried]
    apart = [[np.linalg.norm(a - b) / len(current.residual) ** 0.5 for b in left] for a in left]
    rivals = (correction_correlation(current, tried) >= LOOP.rival_correlation) & (np.abs(more_parameters(tried)) <= 1)
    return np.where(rivals, 2 * LOOP.model_discrepancy * mesh * np.array(apart), 0.0)


def most_left(square: Any, allowed: Any, doubt: Any) -> Any:
    """What a candidate may leave (mean square) to stand beside another that leaves `square`: so many times that by
    `allowances`, or so much more by `mesh_decides`; numbers or arrays.
    """
    return np.maximum(allowed * square, square + doubt)


def choose(current: Fitted, judged: Sequence[Candidate], mesh: float = 0.0) -> tuple[str, ...]:
    """The one that stands; of several as good as each other that correct the same as the best the one with the fewest
    parameters, and of these the fewest that only give it its shape; or several as tied: equally simple ones, and such
    as correct the same and are hardly less simple, or leave less, though not so much that all they have more is paid
    for: then nothing is decided. Leaving less counts if it tells the two apart, or if what they have more is something:
    every effect leaves less than the one that it becomes when an amount of it vanishes. What corrects something else
    may be missing as well as the best: being simpler it does not take its place. mesh: what the model's mesh may be
    wrong by, base unit.
    """
    standing = [c for c in judged if not c.why_not and c.fitted is not None]
    if not standing:
        return ()
    square = np.array([c.fitted.rms**2 for c in standing if c.fitted is not None])
    size = np.array([len(c.fitted.theta) for c in standing if c.fitted is not None])
    shapes = [sum(p.null is None for p in c.fitted.space) for c in standing if c.fitted is not None]
    known = [len(amounts_of_note(c.name, c.fitted)) for c in standing if c.fitted is not None]
    allowed, same = allowances(current, standing), alike(current, standing)
    doubt = mesh_decides(current, standing, mesh)
    most = most_left(square[:, None], allowed, doubt)
    close = [k for k in range(len(standing)) if (square[k] <= most[:, k]).all()]
    best = min(close, key=lambda k: (1 + LOOP.parameter_penalty * (size[k] - size.min())) * square[k])
    correlated = correction_correlation(current, standing) >= LOOP.alike_correlation
    first = min((k for k in close if correlated[best, k]), key=lambda k: (size[k], shapes[k], square[k]))

    def undecided(k: int) -> bool:
        if size[k] == size[first] or (same[k, first] and size[k] == size[first] + 1) or doubt[k, first] > 0:
            return True
        apart = (1 + LOOP.tie_margin) * square[k] < square[first]
        return bool(correlated[k, first] and (apart or (square[k] < square[first] and known[k] > known[first])))

    others = sorted((k for k in close if k != first and undecided(k)), key=lambda k: square[k])
    return tuple(standing[k].name for k in [first, *others][: LOOP.tied])
