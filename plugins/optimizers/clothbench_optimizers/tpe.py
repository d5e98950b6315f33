"""`tpe`: the model-based search of the package `optuna`, towards one goal or several."""

from __future__ import annotations

from typing import Any

import numpy as np

from clothbench import ParameterSpace
from clothbench_optimizers.search import GeneratorSearch, Steps, check_whole, spread


class Tpe(GeneratorSearch):
    """Tree-structured Parzen estimators (Bergstra et al. 2011; of several objectives, Ozaki et al. 2022), several
    parameters together, in the scaled space; the first batch is a Sobol spread.

    batch: points that are asked for at once; lost runs are told as failed.
    """

    name = "tpe"
    version = 1
    needs_residual = False
    built_on = ("optuna",)

    def __init__(self, space: ParameterSpace, *, seed: int, budget: int, batch: int = 8):
        check_whole(self.name, "batch", batch, 1)
        self.batch = batch
        super().__init__(space, seed=seed, budget=budget)

    def steps(self) -> Steps:
        import optuna

        optuna.logging.set_verbosity(optuna.logging.ERROR)
        axes: dict[str, Any] = {
            f"x{i}": optuna.distributions.FloatDistribution(0.0, 1.0) for i in range(len(self.space))
        }
        asked = spread(self, max(2 * self.batch, 2) - 1)
        wanted = _goals((yield asked))
        study = self._study(wanted.shape[1])
        for point, goals in zip(asked, wanted, strict=True):
            params = {name: float(x) for name, x in zip(axes, point, strict=True)}
            if np.isfinite(goals).all():
                study.add_trial(optuna.trial.create_trial(params=params, distributions=axes, values=goals.tolist()))
        while True:  # until the budget is spent
            trials = [study.ask(axes) for _ in range(self.batch)]
            asked = np.array([[trial.params[name] for name in axes] for trial in trials])
            for trial, goals in zip(trials, _goals((yield asked)), strict=False):
                if np.isfinite(goals).all():
                    study.tell(trial, goals.tolist())
                else:
                    study.tell(trial, state=optuna.trial.TrialState.FAIL)

    def _study(self, goals: int) -> Any:
        import warnings

        import optuna

        with warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            sampler = optuna.samplers.TPESampler(
                seed=int(self.random.integers(2**31)), multivariate=True, constant_liar=True, n_startup_trials=1
            )
        return optuna.create_study(directions=["minimize"] * goals, sampler=sampler)


def _goals(evaluation: Any) -> np.ndarray:
    """What is to be small (B, M): the objectives, or the value alone."""
    return evaluation.value[:, None] if evaluation.objectives is None else evaluation.objectives
