"""How far apart two tied models would be after an experiment: by what their simulations differ, less what the rival
makes up for once it is fitted to what the other expects there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from clothbench.studies.improve.fitting import finite_differences
from clothbench.studies.improve.problem import residuals
from clothbench.suggest.cameras import Look
from clothbench.suggest.experiments import Experiment, Unsimulated
from clothbench.suggest.information import made_up, separation
from clothbench.suggest.subject import Subject, Tie

REFITS = 2  # Gauss-Newton steps of a rival, each to new tangents: two more change a promise by a tenth at most
SHARES = (1.0, 0.5, 0.25)  # of such a step, tried in turn until the rival comes nearer

Compared = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]  # see `comparison`


@dataclass(frozen=True, eq=False)
class Apart:
    """How far apart two tied models would be. sigma: √Δχ², after the rival has made up for what it can; least: the
    same, where what the model may be wrong by speaks for the rival; rms: m, over coordinates, before.
    """

    tie: Tie
    sigma: float
    least: float
    rms: float


@dataclass(frozen=True, eq=False)
class Rival:
    """A tie's rival in an experiment. before: (M,) m, how far it is from the other as the recordings have both; unit:
    (P,), its parameters once it is fitted anew, in the unit cube; away: (M,) m, how far it is then, and tangent (M, P).
    """

    tie: Tie
    before: np.ndarray
    unit: np.ndarray
    away: np.ndarray
    tangent: np.ndarray


def comparison(subject: Subject, experiment: Experiment, tie: Tie) -> Compared:
    """Of parameters (P,) of the rival in the unit cube: how far it is in an experiment from where the other expects
    every coordinate (M,) m, and its tangents (M, P) m there.
    """
    (seen,) = residuals(subject.trial(experiment.scene, tie.known.fitted.effects), tie.known.fitted.theta[None])
    trial, space = subject.trial(experiment.scene, tie.rival.fitted.effects), tie.rival.fitted.space

    def compared(unit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        difference = subject.problem.evidence.search.difference
        (there,), (tangent,), _ = finite_differences([trial], space, space.from_unit(unit), difference)
        return there - seen, tangent

    return compared


def refitted(tie: Tie, compared: Compared, counted: float) -> Rival:
    """The rival, fitted to what the other expects of an experiment in which a coordinate counts as `counted` m, beside
    what the recordings say of its parameters.

    The tangents at its fit to the recordings do not reach: an experiment that tells two effects apart moves the cloth
    more than the recordings do, and there the rival makes up for much more than they promise.
    """
    fit, known = tie.rival.unit, tie.rival.matrix

    def left(unit: np.ndarray, away: np.ndarray) -> float:
        return float(away @ away / counted**2 + (unit - fit) @ known @ (unit - fit))

    before, tangent = compared(fit)
    if not np.isfinite(before).all():
        raise Unsimulated(f"could not be simulated with {tie.one} and with {tie.other}")
    unit, away = fit, before
    for _ in range(REFITS):
        step, _ = made_up(away, tangent, known, unit, unit - fit, counted)
        tries = ((to, *compared(to)) for to in (np.clip(unit + share * step, 0.0, 1.0) for share in SHARES))
        nearer = next((one for one in tries if left(*one[:2]) < left(unit, away)), None)
        if nearer is None:
            break
        unit, away, tangent = nearer
    return Rival(tie, before, unit, away, tangent)


def apart(rival: Rival, part: slice, doubt: np.ndarray, look: Look, noise: float) -> Apart:
    """How far apart the two are in the rows `part` of the experiment, as they are looked at, each of which then counts
    as `noise`; doubt: (M,) m. What the rival still gains over its fit to the whole experiment is to first order.
    """
    fit = rival.tie.rival
    sigma, least = separation(
        look(rival.away[part]), look(rival.tangent[part]), fit.matrix, rival.unit, rival.unit - fit.unit, noise,
        look(doubt[part]),
    )  # fmt: skip
    return Apart(rival.tie, sigma, least, float(np.sqrt(np.mean(rival.before[part] ** 2))))
