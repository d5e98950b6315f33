"""How the loop goes from one round to the next, with made-up fits in the place of simulations."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from clothbench.core.parameters import Parameter, ParameterSpace
from clothbench.studies.improve.budget import Budget
from clothbench.studies.improve.fitting import PLACES, SEVERAL, WALKS, Fitted, elsewhere
from clothbench.studies.improve.rounds import POLISHES, Round, improve, settled

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
        monkeypatch.setattr(f"clothbench.studies.improve.rounds.{name}", lambda *_, value=value: value)
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

    monkeypatch.setattr("clothbench.studies.improve.rounds.polish", polish)
    budget = Budget(lambda *_: None)
    budget.stage("contest", 0, 1)
    found = settled(None, fitted(4e-3), budget)
    assert len(asked) == polished
    assert found.rms == pytest.approx(4e-3 * np.prod(falls[:polished]))
    assert budget.evaluations == 7 * polished


def wind(shapes: int) -> SimpleNamespace:
    """An effect of one amount and so many shape parameters."""
    amount = Parameter("amount", "c", "1", (0.0, 1.0), "linear", 0.5, "how much", "a test", null=0.0)
    shape = [Parameter(f"w{n}", "w", "1", (-1.0, 1.0), "linear", 0.0, "which way", "a test") for n in range(shapes)]
    return SimpleNamespace(parameters=ParameterSpace((amount, *shape)))


@pytest.mark.parametrize(("shapes", "left"), [(1, 4e-3), (2, 1e-3)])
def test_an_effect_with_several_shape_parameters_is_sought_in_other_valleys(monkeypatch, shapes, left):
    """Made-up law: a fit ends at 4 mm where it starts with w0 < 0, at 1 mm where w0 > 0; the first one has w0 < 0."""
    effect, goals = wind(shapes), []
    space = ParameterSpace((*SPACE, *effect.parameters))
    problem = SimpleNamespace(seed=0, plugins=SimpleNamespace(make=lambda *_: effect), trials=lambda names, split: None)

    def ended(start):
        rms = 1e-3 if start[2] > 0 else 4e-3
        return Fitted(("wind",), space, start, [np.full(9, rms)] * 2, [np.ones((9, len(space)))] * 2, start, start, 10)

    def fit(problem, names, start, rounds, goal):
        goals.append(goal)
        return ended(start)

    monkeypatch.setattr("clothbench.studies.improve.fitting.fit", fit)
    # From afar the wrong valley looks the better one, but for a corner of the right one.
    value = lambda theta: np.where(theta[:, 2] > 0.9, 1.0, 2.0 + theta[:, 2])  # noqa: E731
    monkeypatch.setattr(
        "clothbench.studies.improve.fitting.evaluate", lambda _, t: (SimpleNamespace(value=value(t)), [])
    )
    first = ended(np.array([2.0, 0.5, *([-0.5] * shapes)]))
    found, count = elsewhere(problem, fitted(9e-3), first, rounds=8)
    assert found.rms == pytest.approx(left)
    assert found.theta[0] == 2.0
    assert count == (0 if shapes < SEVERAL else PLACES + 10 * WALKS)
    assert goals == ([] if shapes < SEVERAL else pytest.approx([1.6e-5, 1e-6]))
