"""Which parameters the error depends on over their whole range (Morris, Sobol; SALib); the error over two of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from clothbench.core.parameters import ParameterSpace
from clothbench.engine.checkpoint import Checkpoint
from clothbench.engine.tables import finite
from clothbench.estimation.calibrate import remembered
from clothbench.estimation.trials import Trial
from clothbench.studies.calibration.schema import LEAST_BLOCKS

LEVELS = 4  # of a Morris trajectory


def morris(
    trials: Sequence[Trial], space: ParameterSpace, trajectories: int, seed: int, checkpoint: Checkpoint | None = None
) -> list[dict[str, Any]]:
    """Elementary effects (Morris 1991) over the scaled ranges: μ* (mean size) and σ, in the error's unit.

    A trajectory of which a member could not be simulated is left out.
    """
    from SALib.analyze import morris as analysis
    from SALib.sample import morris as sampling

    problem = _problem(space)
    unit = sampling.sample(problem, trajectories, num_levels=LEVELS, seed=seed % 2**32)
    error, whole = _errors(trials, space, unit, len(space) + 1, checkpoint)
    if whole.sum() < 2 * (len(space) + 1):
        return _failed(space, "morris", error, "fewer than two trajectories could be simulated")
    found = analysis.analyze(problem, unit[whole], error[whole], num_levels=LEVELS, seed=seed % 2**32)
    spread = np.asarray(found["sigma"])
    return _rows(space, "morris", found["mu_star"], found["mu_star_conf"], spread, None, error)


def sobol(
    trials: Sequence[Trial], space: ParameterSpace, samples: int, seed: int, checkpoint: Checkpoint | None = None
) -> list[dict[str, Any]]:
    """First and total shares of the error's variance (Sobol 2001, Saltelli 2010) over the scaled ranges.

    samples: a power of two, at least `LEAST_BLOCKS`; (P + 2) evaluations each. A block of which a member could not be
    simulated is left out.
    """
    from SALib.analyze import sobol as analysis
    from SALib.sample import sobol as sampling

    problem, block = _problem(space), len(space) + 2
    unit = sampling.sample(problem, samples, calc_second_order=False, seed=seed % 2**32)
    error, whole = _errors(trials, space, unit, block, checkpoint)
    if whole.sum() < LEAST_BLOCKS * block or np.ptp(error[whole]) == 0:
        return _failed(space, "sobol", error, "fewer than four blocks could be simulated, or the error is constant")
    found = analysis.analyze(problem, error[whole], calc_second_order=False, seed=seed % 2**32)
    halves = (found["S1_conf"], found["ST_conf"])
    return _rows(space, "sobol", found["S1"], halves[0], found["ST"], halves[1], error)


def error_map(
    trials: Sequence[Trial],
    space: ParameterSpace,
    best: np.ndarray,
    names: Sequence[str],
    points: int,
    checkpoint: Checkpoint | None = None,
) -> list[dict[str, Any]]:
    """The error over the whole scaled ranges of two parameters, the others at their best (figure 3 of Bhat et al.)."""
    first, second = space[names[0]], space[names[1]]
    columns = [space.names.index(n) for n in names]
    unit = np.repeat(space.to_unit(best)[None], points**2, axis=0)
    line = np.linspace(0.0, 1.0, points)
    unit[:, columns] = np.stack([a.ravel() for a in np.meshgrid(line, line)], axis=1)
    theta = space.from_unit(unit)
    error = remembered(trials, theta, checkpoint).value
    about = {"x_name": first.name, "x_unit": first.unit, "y_name": second.name, "y_unit": second.unit, "reason": ""}
    return [
        {**about, "x": float(t[columns[0]]), "y": float(t[columns[1]]), "error": finite(e)}
        for t, e in zip(theta, error, strict=True)
    ]


def _problem(space: ParameterSpace) -> dict[str, Any]:
    return {"num_vars": len(space), "names": list(space.names), "bounds": [[0.0, 1.0]] * len(space)}


def _errors(
    trials: Sequence[Trial], space: ParameterSpace, unit: np.ndarray, block: int, checkpoint: Checkpoint | None
) -> tuple[np.ndarray, np.ndarray]:
    """Errors (B,) of points of the unit cube, and which belong to a block that was simulated as a whole (B,)."""
    error = remembered(trials, space.from_unit(unit), checkpoint).value
    known = np.isfinite(error).reshape(-1, block).all(axis=1)
    return error, np.repeat(known, block)


def _rows(space, method, main, main_half, total, total_half, error) -> list[dict[str, Any]]:
    half = [None] * len(space) if total_half is None else [finite(h) for h in total_half]
    return [
        {**_about(p, method, len(error)), "main": finite(main[i]), "main_half": finite(main_half[i]),
         "total": finite(total[i]), "total_half": half[i], "lost": int((~np.isfinite(error)).sum()), "reason": ""}
        for i, p in enumerate(space)
    ]  # fmt: skip


def _failed(space: ParameterSpace, method: str, error: np.ndarray, reason: str) -> list[dict[str, Any]]:
    lost = int((~np.isfinite(error)).sum())
    return [{**_about(p, method, len(error)), "lost": lost, "reason": reason} for p in space]


def _about(p: Any, method: str, evaluations: int) -> dict[str, Any]:
    return {"method": method, "name": p.name, "symbol": p.symbol, "unit": p.unit, "evaluations": evaluations}
