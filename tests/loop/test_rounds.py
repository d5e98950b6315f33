"""How the loop goes from one round to the next, with made-up fits in the place of simulations."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from clothbench.loop.budget import Budget
from clothbench.loop.fitting import Fitted
from clothbench.loop.improve import POLISHES, Round, improve, settled
from clothbench.parameters import Parameter, ParameterSpace

SPACE = ParameterSpace((Parameter("k", "k", "N/m", (1.0, 9.0), "linear", 2.0, "a stiffness", "a test"),))


def fitted(rms: float) -> Fitted:
    theta = np.array([2.0])
    return Fitted((), SPACE, theta, [np.full(9, rms)] * 2, [np.ones((9, 1))] * 2, theta, theta, 1)


def test_a_better_fit_of_the_base_is_kept_whether_anything_is_named_or_not(monkeypatch):
    base, better, problem = fitted(4e-3), fitted(2e-3), SimpleNamespace(rounds=0)
    for name, value in {
        "calibrated": base, "noise_of": 1e-3, "repeat_spread": 0.0, "corrected": (problem, base, 1e-3),
        "each_alone": {}, "one_round": Round(better, 1e-3, (), (), ()),
    }.items():  # fmt: skip
        monkeypatch.setattr(f"clothbench.loop.improve.{name}", lambda *_, value=value: value)
    found = improve(problem, ["quadratic_drag"], lambda *_: None)
    assert found.base is better
    assert found.final is better


@pytest.mark.parametrize(
    ("falls", "polished"), [([1.0], 1), ([0.9, 0.96], 2), ([0.8, 0.8, 0.99, 0.5], 3), ([0.5] * 9, POLISHES)]
)
def test_a_finalist_is_polished_as_long_as_that_pays(monkeypatch, falls, polished):
    """falls: of the rms, from one polish to the next."""
    asked = []

    def polish(problem, fit, rounds):
        asked.append(fit.rms)
        left = [falls[len(asked) - 1] * r for r in fit.residual]
        return dataclasses.replace(fit, residual=left), 7

    monkeypatch.setattr("clothbench.loop.improve.polish", polish)
    budget = Budget(lambda *_: None)
    budget.stage("contest", 0, 1)
    found = settled(None, fitted(4e-3), budget)
    assert len(asked) == polished
    assert found.rms == pytest.approx(4e-3 * np.prod(falls[:polished]))
    assert budget.evaluations == 7 * polished
