"""Intervals along valleys of the error, straight and bent, on residuals that are stated in closed form."""

from __future__ import annotations

import dataclasses
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from clothbench.core.parameters import Parameter, ParameterSpace
from clothbench.core.protocols import Evaluation
from clothbench.engine.checkpoint import Checkpoint
from clothbench.studies.improve import constrained, jumps, profile
from clothbench.studies.improve.fitted import Fitted
from clothbench.studies.improve.settings import LOOP, SearchSettings

SPACE = ParameterSpace(
    tuple(Parameter(n, n, "1", (0.0, 1.0), "linear", 0.5, "one of three", "a test") for n in ("base", "a", "b"))
)
BEST = np.array([0.5, 0.2, 0.6])


@dataclasses.dataclass
class OneParameterBase:
    """All that is asked of a problem: the base has one parameter, two belong to the effect."""

    bounds: dict = dataclasses.field(default_factory=dict)
    evidence = SimpleNamespace(search=SearchSettings())
    checkpoint = Checkpoint()

    def key(self, *more):
        return ""

    def space(self, names):
        return SPACE.parameters[: 1 + 2 * len(names)]

    def trials(self, names, split):
        return []


def straight(theta):
    """a + b is well known, a - b hardly."""
    return np.array([theta[0] - 0.5, 3 * (theta[1] + theta[2] - 0.8), 0.1 * (theta[1] - theta[2] + 0.4), 0.3])


def bent(theta):
    """a times b is well known, a and b hardly: a hem's weight per area and its width."""
    return np.array([theta[0] - 0.5, 10 * (theta[1] * theta[2] - 0.12), 0.02 * (theta[1] - 0.2), 0.3])


def fitted(law, space, theta, half=0.0) -> Fitted:
    """A fit that ended at theta, of one effect to two recordings that are alike."""
    away, unit, residual = 1e-6, space.to_unit(theta), np.asarray(law(theta))
    jacobian = np.array([(law(space.from_unit(unit + away * e)) - residual) / away for e in np.eye(3)]).T
    low, high = np.clip(theta - half, 0, 1), np.clip(theta + half, 0, 1)
    effect = space.names[1].partition(".")[0]
    return Fitted((effect,), space, theta, [residual] * 2, [jacobian] * 2, low, high, 1)


def simulated_by(law):
    """What stands in for `evaluate`."""

    def evaluate(trials, theta):
        residual = np.array([np.concatenate([law(t), law(t)]) for t in theta]) / np.sqrt(8)
        return Evaluation(np.zeros(len(theta)), residual), []

    return evaluate


@pytest.fixture
def judged(monkeypatch):
    """A function from a law and the half-widths to first order to the profiled fit."""

    def of(law, half):
        monkeypatch.setattr(constrained, "evaluate", simulated_by(law))
        before = fitted(law, SPACE, BEST, half)
        return before, *profile.profile_intervals(OneParameterBase(), before)

    return of


def test_a_straight_valley_keeps_its_intervals(judged):
    before, after, _, count = judged(straight, [0.01, 0.05, 0.05])
    assert count > 0
    assert after.low == pytest.approx(before.low, abs=1e-6)
    assert after.high == pytest.approx(before.high, abs=1e-6)


def test_a_bent_valley_is_followed(judged):
    """b = 0.12/a: at the end of a's interval, a = 0.12, b is 1, where the tangent ends it at 0.84."""
    before, after, _, _ = judged(bent, [0.01, 0.08, 0.24])
    assert before.high[2] == pytest.approx(0.84)
    assert after.high[2] > 0.95
    assert after.low[2] == before.low[2]  # on this side the valley rises sooner, but nothing is made narrower
    rise = (0.02 * 0.08) ** 2  # of the sum of squares at the end of a's interval
    for a in (after.low[1], after.high[1]):
        assert np.sum(bent([0.5, a, 0.12 / a]) ** 2) - 0.09 <= 1.1 * rise
    assert after.low[0] == before.low[0]  # the base's own intervals are left alone


def test_a_parameter_at_its_bound_is_not_led_beyond(judged):
    for after in judged(straight, [0.01, 0.5, 0.5])[1:3]:
        assert (after.low >= 0).all()
        assert (after.high <= 1).all()


def test_a_path_ends_at_the_bound_also_where_rounding_ends_it_before():
    path = profile.ProfilePath(0, 1.0, 0.7, np.array([0.1, 0.1]), np.array([1.0, 1.0]), np.ones(1))
    path.own.append(profile.ProfilePoint(np.nextafter(0.7, 0.0), 0.5, np.array([np.nextafter(0.7, 0.0)])))
    assert path.next() is None
    path.own[0] = profile.ProfilePoint(0.6, 0.5, np.array([0.6]))
    assert path.next() == pytest.approx(0.7)


def test_what_is_reported_holds_all_that_leaves_hardly_more(judged):
    def law(theta):
        return bent(theta) + np.array([0.0, 0.0, 0.5 * (theta[1] - 0.2), 0.0])

    _, narrow, reported, _ = judged(law, [0.01, 0.02, 0.06])
    assert (reported.low[1:] < narrow.low[1:]).all()
    assert (reported.high[1:] > narrow.high[1:]).all()
    a = reported.high[1]
    assert np.sum(law([0.5, a, 0.12 / a]) ** 2) - 0.09 == pytest.approx(2 * LOOP.tie_margin * 0.09, rel=0.3)


def test_a_long_valley_is_followed_to_its_end_in_all_that_it_bends(judged):
    """At the fit the error rises as if a could go from 0.2 to 0.33 only; further on it hardly rises any more."""

    def law(theta):
        return bent(theta) + np.array([0.0, 0.0, 0.1 * np.tanh((theta[1] - 0.2) / 0.1), 0.0])

    _, narrow, reported, _ = judged(law, [0.01, 0.02, 0.06])
    assert narrow.high[1] < 0.3
    assert reported.high[1] == pytest.approx(1.0)
    assert reported.low[2] <= 0.121


def test_a_valley_that_curves_hard_is_not_taken_for_its_wall(judged):
    """b makes up for a down to b = 0, where a is 0.402; beside the tangent it takes many corrections to get there."""

    def law(theta):
        made_up = np.exp(3 * (theta[2] - 0.6)) + np.exp(3 * (theta[1] - 0.2)) - 2
        return np.array([theta[0] - 0.5, 10 * made_up, 0.1 * np.tanh((theta[1] - 0.2) / 0.1), 0.3])

    _, _, reported, _ = judged(law, [0.01, 0.02, 0.02])
    assert reported.high[1] == pytest.approx(0.402, abs=0.002)
    assert reported.low[2] == pytest.approx(0.0)


def test_an_end_between_a_valley_and_a_cliff_is_looked_for(judged):
    """Hardly any rise up to 0.5, where a cliff begins; it has risen too much from 0.529 on."""

    def law(theta):
        rise = 0.1 * np.tanh((theta[1] - 0.2) / 0.1) + 40 * max(theta[1] - 0.5, 0.0) ** 2
        return np.array([theta[0] - 0.5, 10 * (theta[1] * theta[2] - 0.12), rise, 0.3])

    _, _, reported, _ = judged(law, [0.01, 0.02, 0.06])
    assert reported.high[1] == pytest.approx(0.529, abs=0.02)


def test_what_is_reported_does_not_reach_nothing_if_the_interval_does_not(judged, monkeypatch):
    own = [dataclasses.replace(p, null=0.0) if p.name == "a" else p for p in SPACE]
    monkeypatch.setattr(sys.modules[__name__], "SPACE", ParameterSpace(tuple(own)))
    _, narrow, reported, _ = judged(straight, [0.01, 0.1, 0.1])
    assert narrow.low[1] == pytest.approx(0.1)
    assert reported.low[1] == narrow.low[1]
    assert reported.high[1] > narrow.high[1]


HEM = ParameterSpace(
    (
        Parameter("base", "base", "1", (0.0, 1.0), "linear", 0.5, "one of three", "a test"),
        Parameter("hem.a", "a", "1", (0.0, 1.0), "linear", 0.1, "an amount", "a test", null=0.0),
        Parameter("hem.b", "b", "1", (0.01, 1.0), "log", 0.1, "its shape", "a test"),
    )
)
START = np.array([0.5, 0.1, 0.9])


def rippled(theta):
    """a times b is well known, a hardly, and ripples lie across the valley."""
    a = theta[1]
    return np.array([theta[0] - 0.5, 10 * (a * theta[2] - 0.09), 0.1 * (a - 0.7) + 0.004 * np.sin(90 * a), 0.03])


@pytest.mark.parametrize(("law", "end"), [(rippled, 0.7), (lambda theta: [*(theta - START), 0.03], 0.1)])
def test_a_search_that_stopped_in_a_ripple_jumps_along_the_valley(monkeypatch, law, end):
    monkeypatch.setattr(constrained, "evaluate", simulated_by(law))
    monkeypatch.setattr(
        "clothbench.studies.improve.fitting.fit",
        lambda problem, effects, theta, rounds, goal, unless, tolerance: fitted(law, HEM, theta),
    )
    before = fitted(law, HEM, START)
    after, count = jumps.jump_along_valley(OneParameterBase(), before)
    assert after.theta[1] == pytest.approx(end, abs=0.11)
    assert after.rms <= before.rms
    assert count <= LOOP.jump_limit * (2 * (LOOP.jump_steps + 1) + 2)


@pytest.mark.parametrize(("worse", "end"), [(0.0, 0.1), (0.2, 0.8)])
def test_a_longer_search_may_set_out_from_a_jump_that_landed_in_a_ripple(monkeypatch, worse, end):
    """Here every jump is a tenth worse than the fit, and only a search of 8 rounds gets from 0.2 to 0.4 and so on."""

    def law(theta):
        valley = 0.1 * (theta[1] - 0.8)
        return np.array([theta[0] - 0.5, 10 * (theta[1] * theta[2] - 0.09), valley, 0.03])

    def landed(trials, before, which, where, corrections):
        return np.full(len(where), 1.1 * before.rms**2), np.array(where), len(where)

    def fit(problem, effects, theta, rounds, goal, unless, tolerance):
        assert (rounds, goal) == (8, pytest.approx(goals[-1]))
        again = fitted(law, HEM, np.array([0.5, min(theta[1], 0.8), 0.09 / min(theta[1], 0.8)]))
        goals.append(min(goals[-1], again.rms**2))
        return again

    monkeypatch.setattr(jumps, "constrained_fits", landed)
    monkeypatch.setattr("clothbench.studies.improve.fitting.fit", fit)
    before = fitted(law, HEM, START)
    goals = [before.rms**2]
    after, _ = jumps.jump_along_valley(OneParameterBase(), before, LOOP.jump_limit, 8, worse)
    assert after.theta[1] == pytest.approx(end)


@pytest.mark.parametrize(("start", "end"), [(0.85, 0.25), (0.25, 0.25)])
def test_a_calibration_leaves_a_valley_for_a_better_one(monkeypatch, start, end):
    """Made-up law: in its first parameter a valley at 0.25, and a worse one at 0.85; searches end in the nearer."""

    def law(theta):
        return np.array([(theta[0] - 0.25) * (theta[0] - 0.85), 0.2 * (theta[0] - 0.25), theta[1] - 0.1, 0.03])

    def fit(problem, effects, theta, rounds, goal, unless, tolerance):
        return fitted(law, HEM, np.array([0.25 if theta[0] < 0.55 else 0.85, 0.1, 0.9]))

    monkeypatch.setattr(constrained, "evaluate", simulated_by(law))
    monkeypatch.setattr("clothbench.studies.improve.fitting.fit", fit)
    after, count = jumps.in_another_valley(OneParameterBase(), fitted(law, HEM, np.array([start, 0.1, 0.9])))
    assert after.theta[0] == pytest.approx(end)
    assert count <= LOOP.valley_turns * 2 * (
        len(HEM) * len(LOOP.valley_moves) * (LOOP.jump_steps + 1) + LOOP.valley_fits
    )


@pytest.mark.parametrize(("driven", "end"), [(0.0, 0.5), (0.0078, 0.5), (0.012, 1.0), (1.0, 1.0)])
def test_an_amount_at_its_bound_stays_there_only_if_half_of_it_leaves_more(monkeypatch, driven, end):
    """The same hem with half of the weight on twice the width; or one whose weight alone is wanted beyond the bound, so
    that half of it leaves 5 %, 12 % or much more.
    """

    def law(theta):
        return np.array([theta[0] - 0.5, 10 * (theta[1] * theta[2] - 0.09), driven * (theta[1] - 1.5), 0.03])

    def fitted_at(problem, names, theta, count):
        return dataclasses.replace(fitted(law, HEM, theta), evaluations=count + 1 + len(HEM))

    def fit(problem, effects, theta, rounds, goal):
        (low, high), asked = problem.bounds["hem.a"], theta[1]
        assert (low, high, asked) == (0.0, 0.5, 0.5)
        return fitted(law, HEM, np.array([0.5, high, 0.09 / high]))

    monkeypatch.setattr(jumps, "fit", fit)
    monkeypatch.setattr(jumps, "fitted_at", fitted_at)
    before = fitted(law, HEM, np.array([0.5, 1.0, 0.09]))
    after, count = jumps.off_bounds(OneParameterBase(), before)
    assert after.theta[1] == pytest.approx(end)
    assert after.theta[1] * after.theta[2] == pytest.approx(0.09, rel=0.05)
    assert count == (1 + 1 + len(HEM) if end == 0.5 else 1)


@pytest.mark.parametrize(("left", "turns"), [(0.996, 1), (0.994, LOOP.jump_limit), (1.0, 1)])
def test_jumps_go_on_as_long_as_each_takes_off_half_a_percent(monkeypatch, left, turns):
    """left: of the mean square, by every jump."""

    def across(problem, fitted, which, where):
        return np.where(np.arange(len(which)) == 0, 0.0, np.inf), where, 5

    def better_of(problem, fit, start, rounds, goal):
        return dataclasses.replace(fit, residual=[left**0.5 * r for r in fit.residual]), 1

    monkeypatch.setattr(jumps, "across", across)
    monkeypatch.setattr(jumps, "better_of", better_of)
    before = fitted(rippled, HEM, START)
    after, count = jumps.jump_along_valley(OneParameterBase(), before)
    assert after.rms**2 == pytest.approx(left**turns * before.rms**2)
    assert count == turns * (5 + 1)


def test_an_amount_is_doubled_and_halved_from_where_it_is_nothing():
    """One that is nothing at 0.1, and no further than to its bounds; its shape goes along in the valley."""
    own = [dataclasses.replace(p, null=0.1) if p.name == "hem.a" else p for p in HEM]

    def law(theta):
        return np.array([theta[0] - 0.5, 10 * (theta[1] + np.log(theta[2])), 0.03])

    before = fitted(law, ParameterSpace(tuple(own)), np.array([0.5, 0.4, 0.6]))
    which, where = jumps.jumps(before)
    assert which == [1, 1]
    np.testing.assert_allclose([point[1] for point in where], [0.7, 0.25])
    for point in where:  # along b = 0.6 exp(0.4 − a), on the logarithmic scale of b from 0.01 to 1
        assert point[2] == pytest.approx(1 + (np.log(0.6) + 0.4 - point[1]) / np.log(100), abs=1e-3)
    high = dataclasses.replace(before, theta=np.array([0.5, 0.8, 0.6]))
    assert [point[1] for point in jumps.jumps(high)[1]] == pytest.approx([1.0, 0.45])


def test_an_amount_within_its_bounds_is_let_be():
    before = fitted(rippled, HEM, START)
    assert jumps.off_bounds(OneParameterBase(), before) == (before, 0)
