"""How a candidate is tried in exchange with the base, on residuals that are linear in everything."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from clothbench.core.parameters import Parameter, ParameterSpace
from clothbench.plugins.discovery import catalogue
from clothbench.studies.improve import attribution
from clothbench.studies.improve.attribution import best_settings, exchange, explained_share, shape_settings, shifted
from clothbench.studies.improve.fitted import Fitted, with_discrepancy
from clothbench.studies.improve.selection import Candidate, allowances, assess, choose, least_fall

BASE = ParameterSpace(
    tuple(Parameter(n, n, "1", (0.0, 1.0), "linear", 0.5, "of the base", "a test") for n in ("a", "b"))
)
ROWS, RECORDINGS = 400, 3


ONE_SIDED = ParameterSpace((Parameter("amount", "φ", "1", (0.0, 10.0), "linear", 1.0, "how much", "a test", 0.0),))


@pytest.fixture
def fit() -> Fitted:
    random = np.random.default_rng(0)
    jacobian = [random.normal(size=(ROWS, 2)) for _ in range(RECORDINGS)]
    residual = [1e-3 * random.normal(size=ROWS) for _ in range(RECORDINGS)]
    return Fitted((), BASE, BASE.defaults, residual, jacobian, BASE.defaults - 0.1, BASE.defaults + 0.1, 0)


def test_the_base_makes_up_for_what_it_can(fit):
    """A candidate that does what the first base parameter does is cancelled by moving that parameter."""
    change = [1e-3 * j[:, 0] for j in fit.jacobian]
    step, shift = exchange(fit, ONE_SIDED, change, np.zeros(1), 0, 1.0)
    left = [step * c + j @ shift for c, j in zip(change, fit.jacobian, strict=True)]
    assert np.linalg.norm(left) < 1e-4 * np.linalg.norm(change)
    assert shifted(fit, shift) == pytest.approx(BASE.defaults + shift)


def test_as_much_as_is_left_and_never_over_the_bounds(fit):
    random = np.random.default_rng(1)
    change = [1e-4 * random.normal(size=ROWS) for _ in range(RECORDINGS)]
    step, _ = exchange(fit, ONE_SIDED, change, np.zeros(1), 0, 1.0)
    assert step == pytest.approx(10.0, rel=0.1)  # a tenth of the residual's size for an amount of 1
    against = [r.copy() for r in fit.residual]  # would have to be negative to help
    step, _ = exchange(fit, ONE_SIDED, against, np.zeros(1), 0, 1.0)
    assert 0.0 < step <= 10.0


def test_share_of_what_is_really_in_it(fit):
    change = [-r[None] for r in fit.residual]
    assert explained_share(fit, change) == pytest.approx(1.0)
    nothing = [np.random.default_rng(5).normal(size=(1, ROWS)) for _ in range(RECORDINGS)]
    assert explained_share(fit, nothing) < 0.05
    assert explained_share(fit, [np.full((1, ROWS), np.nan)] * RECORDINGS) == -1.0


def test_the_shape_is_looked_for_where_most_is_left(fit, monkeypatch):
    """On two recordings out of three, whatever the third has to say."""
    loud = dataclasses.replace(fit, residual=[fit.residual[0], 3 * fit.residual[1], 2 * fit.residual[2]])
    settings = [(np.array([shape, 0.0]), (1,), np.array([1.0])) for shape in range(5)]
    asked = []

    def tangents(problem, fitted, name, settings, where):
        asked.append(list(where))
        noise = np.random.default_rng(3).normal(size=(len(settings), len(where), ROWS))
        out = [[1e-3 * noise[k, i][None] for i in range(len(where))] for k in range(len(settings))]
        out[3] = [-loud.residual[r][None] for r in where]
        return out

    monkeypatch.setattr(attribution, "tangents", tangents)
    monkeypatch.setattr(attribution, "shapes_looked_at", lambda problem, name: settings)
    chosen, sets = best_settings(None, loud, "an effect with a shape")
    assert asked == [[1, 2]]
    assert chosen == [settings[3]]
    assert sets == 4  # two thirds of five


def test_no_time_after_the_end_is_looked_at():
    slip = catalogue().make("effects", "grip_slip")
    at = slip.parameters.names.index("time")
    times = [phi[at] for phi, _, _ in shape_settings(slip.parameters, 0, last=3.0)]
    assert len(times) >= 4
    assert max(times) <= 3.0
    late = slip.parameters.bounded({"time": (5.0, 10.0)})
    assert all(5.0 <= phi[at] <= 10.0 for phi, _, _ in shape_settings(late, 0, last=3.0))


@pytest.mark.parametrize(("bounds", "steps"), [((-0.5, 0.0), (-0.05, -0.25)), ((0.0, 0.5), (0.05, 0.25))])
def test_an_amount_whose_bounds_end_at_nothing_is_tried_on_the_side_that_is_left(bounds, steps):
    space = catalogue().make("effects", "clock_offset").parameters.bounded({"delay": bounds})
    space = ParameterSpace((dataclasses.replace(space.parameters[0], default=0.0),))
    assert [float(step[0]) for _, _, step in shape_settings(space, 0)] == pytest.approx(steps)


def test_the_mesh_widens_an_interval_by_what_it_would_shift(fit):
    doubt = [0.03 * j[:, 0] for j in fit.jacobian]
    wide = with_discrepancy(fit, doubt, noise=fit.rms)
    assert BASE.defaults[0] - wide.low[0] == pytest.approx(np.hypot(0.1, 0.03), rel=1e-3)
    assert wide.high[1] - BASE.defaults[1] == pytest.approx(0.1, rel=1e-3)


def test_what_is_left_above_the_noise_widens_an_interval_and_the_bounds_end_it(fit):
    """A fifth of it may look like a parameter: as far as that takes one whose column is at right angles to the rest."""
    still = [0 * r for r in fit.residual]
    wide = with_discrepancy(fit, still, noise=0.6 * fit.rms)
    column = np.sqrt(np.mean([np.mean(j[:, 0] ** 2) for j in fit.jacobian]))
    assert BASE.defaults[0] - wide.low[0] == pytest.approx(np.hypot(0.1, 0.2 * 0.8 * fit.rms / column), rel=0.01)
    large = dataclasses.replace(fit, residual=[1e4 * r for r in fit.residual])
    wide = with_discrepancy(large, still, noise=0.0)
    assert wide.low == pytest.approx(BASE.low)
    assert wide.high == pytest.approx(BASE.high)


def test_large_amounts_stay_inside_the_bounds():
    for name in ("quadratic_drag", "grip_offset", "total_mass", "bending_hysteresis"):
        space = catalogue().make("effects", name).parameters
        sizes = [phi[list(amounts)] + steps for phi, amounts, steps in shape_settings(space, 0)]
        amounts = next(shape_settings(space, 0))[1]
        for values in sizes:
            assert (values >= space.low[list(amounts)]).all()
            assert (values <= space.high[list(amounts)]).all()
        assert (np.abs(sizes[1] - sizes[0]) > 0).any()


def fitted_to(residual: np.ndarray, parameters: int = 5, name: str = "base") -> Fitted:
    space = ParameterSpace(
        tuple(Parameter(f"p{k}", "p", "1", (0.0, 1.0), "linear", 0.5, "a number", "a test") for k in range(parameters))
    )
    theta = space.defaults
    return Fitted((name,), space, theta, [residual] * RECORDINGS, [], theta, theta, 0)


BEFORE = np.random.default_rng(8).normal(size=ROWS)


def candidate(name: str, parameters: int, rms: float, taken: int = 0) -> Candidate:
    """Leaves a residual of this size; two with the same `taken` correct the same, others something else."""
    random = np.random.default_rng(taken)
    away = BEFORE * random.choice([0.3, 1.7], ROWS) if taken else BEFORE
    left = BEFORE - away
    left = rms * (left / np.linalg.norm(left) if taken else BEFORE / np.linalg.norm(BEFORE)) * np.sqrt(ROWS)
    return Candidate(name, 0.5, 0.005, fitted=fitted_to(left, parameters, name))


@pytest.fixture(scope="module")
def before() -> Fitted:
    return fitted_to(BEFORE)


def test_further_parameters_have_to_pay(before):
    simple, rich = candidate("simple", 5, 0.35), candidate("rich", 9, 0.34)
    assert allowances(before, [simple, rich])[1, 0] == pytest.approx(1.3)
    assert choose(before, [rich, simple]) == ("simple",)
    assert choose(before, [candidate("rich", 9, 0.2), simple]) == ("rich",)


def test_two_as_good_as_each_other_are_tied(before):
    assert choose(before, [candidate("one", 5, 0.30, 1), candidate("other", 5, 0.305, 2)]) == ("one", "other")
    assert choose(before, [candidate("one", 5, 0.30, 1), candidate("other", 5, 0.35, 2)]) == ("one",)
    assert choose(before, []) == ()


def test_a_fit_that_could_not_be_simulated_is_no_rival(before):
    good = dataclasses.replace(candidate("good", 5, 0.3), fitted=fitted_to(0.3 * BEFORE, 5, "good"))
    lost = dataclasses.replace(good, name="lost", fitted=fitted_to(np.nan * BEFORE, 5, "lost"))
    alone = assess(before, 0.1, [good])[0]
    beside = {c.name: c for c in assess(before, 0.1, [good, lost])}
    assert alone.selected == beside["good"].selected == RECORDINGS
    assert beside["lost"].selected == 0


def test_two_that_correct_the_same_are_tied_though_one_is_less_simple(before):
    assert choose(before, [candidate("simple", 5, 0.30), candidate("other", 6, 0.28)]) == ("simple", "other")


def test_the_error_of_the_mesh_does_not_decide_between_two_that_correct_the_same(before):
    """They differ by 0.06, which an error of 1.7 may well look like: a share of 0.2 of it, twice."""
    simple, other = candidate("simple", 5, 0.36), candidate("other", 6, 0.30)
    assert choose(before, [simple, other]) == ("other",)
    assert choose(before, [simple, other], mesh=1.6) == ("other",)
    assert choose(before, [simple, other], mesh=1.7) == ("simple", "other")
    assert [c.selected for c in assess(before, 0.1, [simple, other])] == [RECORDINGS, 0]
    assert [c.selected for c in assess(before, 0.1, [simple, other], mesh=1.7)] == [RECORDINGS, RECORDINGS]
    early = np.arange(ROWS) < 0.45 * ROWS
    elsewhere = fitted_to(np.where(early, 0.0, BEFORE), 5, "elsewhere"), fitted_to(np.where(early, BEFORE, 0.0), 6)
    tried = [Candidate(name, 0.5, 0.005, fitted=f) for name, f in zip(("elsewhere", "other"), elsewhere, strict=True)]
    assert choose(before, tried, mesh=9.0) == ("other",)


def test_nor_between_two_that_correct_much_the_same(before):
    """Their corrections correlate with 0.7, and what they leave differs by 0.51 (seen with frames and grips turned)."""
    across = np.random.default_rng(1).normal(size=ROWS)
    across -= (across @ BEFORE) / (BEFORE @ BEFORE) * BEFORE
    across *= 0.714 * np.linalg.norm(BEFORE) / np.linalg.norm(across)
    for parameters in ((6, 5), (5, 6)):
        best, other = (
            Candidate(name, 0.5, 0.005, fitted=fitted_to(left, size, name))
            for name, left, size in zip(
                ("best", "other"), (0.3 * BEFORE, 0.3 * BEFORE - across), parameters, strict=True
            )
        )
        assert choose(before, [best, other], mesh=1.6) == ("best",)
        assert choose(before, [best, other], mesh=2.0) == ("best", "other")


def test_what_leaves_clearly_less_without_paying_for_all_its_parameters_decides_nothing(before):
    """Seen with wind: gravity that leans does nearly the same with three parameters less, and left 16 % more."""
    simple, rich = candidate("simple", 5, 1.16**0.5 * 0.3), candidate("rich", 8, 0.3)
    assert choose(before, [rich, simple]) == ("simple", "rich")
    assert choose(before, [candidate("rich", 8, 0.3 * (1.16 / 1.08) ** 0.5), simple]) == ("simple",)
    assert choose(before, [candidate("rich", 8, 0.3 * (1.16 / 1.3) ** 0.5), simple]) == ("rich",)


def with_amounts(found: Candidate, told: int) -> Candidate:
    """The candidate with three amounts, as many of which are told from nothing, in place of its first parameters."""
    assert found.fitted is not None
    amounts = [
        Parameter(f"{found.name}.a{k}", "a", "1", (0.0, 1.0), "linear", 0.5, "an amount", "a test", null=0.0)
        for k in range(3)
    ]
    space = ParameterSpace((*amounts, *found.fitted.space.parameters[3:]))
    low = np.where(np.arange(len(space)) < told, 0.4, 0.0)
    return dataclasses.replace(found, fitted=dataclasses.replace(found.fitted, space=space, low=low))


def test_what_leaves_less_with_more_amounts_that_are_something_decides_nothing(before):
    """Seen with wind: gravity that leans left 8 % more. Wind always leaves less than drag, which it is in a calm."""
    simple, rich = with_amounts(candidate("simple", 5, 0.31), 1), candidate("rich", 8, 0.30)
    assert choose(before, [with_amounts(rich, 2), simple]) == ("simple", "rich")
    assert choose(before, [with_amounts(rich, 1), simple]) == ("simple",)
    assert choose(before, [with_amounts(candidate("rich", 8, 0.32), 2), simple]) == ("simple",)


def test_a_simpler_one_that_corrects_something_else_does_not_take_the_place_of_the_best(before):
    """Both may be missing: the best is named, the other is for the next round."""
    best, simpler = candidate("best", 6, 0.60, 1), candidate("simpler", 5, 0.64, 2)
    assert choose(before, [simpler, best]) == ("best",)
    assert choose(before, [simpler, candidate("best", 6, 0.632, 1)]) == ("simpler",)  # not better by what it costs


@pytest.mark.parametrize(
    ("rms", "noise", "fall"),
    [
        (2.0, 0.5, 0.25 * (4 - 1)),
        (1.2, 0.9, 0.25 * (1.44 - 1)),
        (1.2, 0.1, 0.45 * (1 - 0.01)),
        (1.1, 0.5, 0.45 * (1.21 - 0.25)),  # at the floor: of all that stands above the noise
    ],
)
def test_a_name_has_to_explain_more_than_a_coarse_mesh_may_stand_for(rms, noise, fall):
    """Noise and mesh together are 1."""
    assert least_fall(fitted_to(np.full(ROWS, rms)), 1.0, noise) == pytest.approx(fall)
