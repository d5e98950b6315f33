"""How the loop goes from one round to the next, with made-up fits in the place of simulations."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from clothbench.core.parameters import Parameter, ParameterSpace
from clothbench.core.protocols import Evaluation
from clothbench.plugins.discovery import catalogue
from clothbench.studies.improve.account import Account
from clothbench.studies.improve.attribution import Probe
from clothbench.studies.improve.fitted import Fitted
from clothbench.studies.improve.fitting import calibrated_anew, multistart, sums_of_squares
from clothbench.studies.improve.held_out import placebo_of
from clothbench.studies.improve.loop import all_rounds, confirmed, from_better, next_round, recalibrated
from clothbench.studies.improve.refits import (
    as_a_limit,
    beside_tied,
    fit_starts,
    near,
    polished,
    refine_finalists,
    refit,
    standing,
)
from clothbench.studies.improve.rounds import witnessed_round
from clothbench.studies.improve.selection import Candidate, assess, choose
from clothbench.studies.improve.settings import LOOP, SearchSettings
from clothbench.studies.improve.sheets import SheetEvidence
from clothbench.studies.improve.state import Round, State

SPACE = ParameterSpace((Parameter("k", "k", "N/m", (1.0, 9.0), "linear", 2.0, "a stiffness", "a test"),))


@dataclasses.dataclass(frozen=True)
class Held:
    """Of a problem, what is held in each recording."""

    own: dict[str, dict[str, float]]


def fitted(rms: float) -> Fitted:
    theta = np.array([2.0])
    return Fitted((), SPACE, theta, [np.full(9, rms)] * 2, [np.ones((9, 1))] * 2, theta, theta, 1)


def test_a_better_fit_of_the_base_is_kept_whether_anything_is_named_or_not(monkeypatch):
    base, better = fitted(4e-3), fitted(2e-3)
    evidence = SimpleNamespace(search=SearchSettings(), noise=lambda: 1e-3, repeat_spread=lambda residual: 0.0)
    evidence.balance = lambda seed: None
    cases = [SimpleNamespace(name=name) for name in ("first", "second")]
    problem = SimpleNamespace(evidence=evidence, seed=0, corrections={}, of_split=lambda split: cases)
    for name, value in {
        "calibrated": base, "corrected": (problem, base, 1e-3), "each_alone": {},
        "one_round": Round(better, 1e-3, (), (), ()), "in_another_valley": (base, 0),
    }.items():  # fmt: skip
        monkeypatch.setattr(f"clothbench.studies.improve.loop.{name}", lambda *_, value=value: value)
    found, timed_out = all_rounds(problem, ["quadratic_drag"], Account(lambda *_: None))
    assert not timed_out
    assert found.base is found.final
    assert found.final.rms == better.rms
    assert found.final.low < better.low  # as unsure as every other fit: by what the model may be wrong by, too


@pytest.mark.parametrize(("elsewhere", "stands"), [(1e-3, True), (1.99e-3, False)])
def test_a_name_in_doubt_is_fitted_in_another_valley_before_it_is_withdrawn(monkeypatch, elsewhere, stands):
    """Made-up: the name leaves 2 mm, with an amount that cannot be told from nothing; in another valley 1 mm, where it
    can; or hardly less.
    """
    hem = Candidate("heavy_hem", 0.8, 0.005, fitted=fitted(2e-3))
    named = dataclasses.replace(fitted(2e-3), effects=("heavy_hem",))
    better = dataclasses.replace(fitted(elsewhere), effects=("heavy_hem",))
    evidence = SimpleNamespace(unit=SheetEvidence.unit)
    problem = SimpleNamespace(evidence=evidence)
    for name, value in {
        "beside_tied": lambda *_: "", "as_a_limit": lambda *_: "", "by_chance": lambda *_: "",
        "continued": lambda *_: named,
        "in_another_valley": lambda *_: (better, 5),
        "corrected": lambda problem, fit, noise, account: (problem, fit, 1e-4),
        "profile_intervals": lambda problem, fit: (fit, fit, 3),
        "faulty": lambda name, before, fit, evidence: "" if fit.rms < 1.5e-3 else "in doubt",
    }.items():  # fmt: skip
        monkeypatch.setattr(f"clothbench.studies.improve.loop.{name}", value)
    before, account = fitted(6e-3), Account(lambda *_: None)
    account.stage("round 1", 0, 1)
    found = Round(before, 1e-3, (hem,), (), ("heavy_hem",), named)
    state, goes_on = confirmed(State(problem, before, before, 1e-3, 1e-4), found, account)
    assert goes_on == stands
    assert state.final is (better if stands else before)
    assert state.rounds[-1].named == (("heavy_hem",) if stands else ())


def told(law: str, *alike: str) -> SimpleNamespace:
    """A law of the recordings whose first term goes with this, and cannot be told from these."""
    terms = [SimpleNamespace(term=SimpleNamespace(law=one)) for one in (law, *alike)]
    return SimpleNamespace(amounts=tuple(terms[:1]), alike=tuple(one.term for one in terms[1:]))


@pytest.mark.parametrize(
    ("law", "p_value", "leaves", "named"),
    [
        (None, 0.005, 3.5e-3, ()),
        (told("mass along the lower edge"), 0.005, 3.5e-3, ()),
        (told("normal velocity squared"), 0.005, 3.5e-3, ("quadratic_drag",)),
        (told("", "normal velocity squared"), 0.005, 3.5e-3, ("quadratic_drag",)),  # a power that no effect has
        (told("normal velocity squared"), 0.14, 3.5e-3, ()),  # chance explains it
        (told("normal velocity squared"), 0.005, 3.95e-3, ()),  # two parameters have to take off a tenth
    ],
)
def test_what_the_torques_tell_without_a_model_has_to_pay_for_its_parameters_only(
    monkeypatch, law, p_value, leaves, named
):
    """Made-up: nothing explained enough for a name, the drag among them; some other effect corrects something else."""
    drag = ParameterSpace(
        (
            *SPACE,
            *(
                Parameter(f"quadratic_drag.{n}", "C", "1", (0.0, 4.0), "linear", 1.0, "drag", "a test", null=0.0)
                for n in "nt"
            ),
        )
    )
    theta, low, high = np.array([2.0, 1.0, 0.0]), np.array([1.9, 0.8, 0.0]), np.array([2.1, 1.2, 0.5])
    residual, other = np.full(9, leaves), np.tile([4e-3, 3e-3, -4e-3], 3)
    after = Fitted(("quadratic_drag",), drag, theta, [residual] * 3, [np.ones((9, 3))] * 3, low, high, 1)
    before = dataclasses.replace(fitted(4e-3), residual=[np.full(9, 4e-3)] * 3, jacobian=[np.ones((9, 1))] * 3)
    mass = dataclasses.replace(after, residual=[other] * 3)
    tried = (
        Candidate("point_mass", 0.2, 0.005, 1e-6, fitted=mass, why_not="explains only 40% of what a name has to"),
        Candidate(
            "quadratic_drag",
            0.1,
            0.4,
            1e-6,
            fitted=after,
            why_not="explains no more than chance would (p = 0.4)",
            p_alone=p_value,
        ),
    )
    for what, value in {"fit_starts": lambda *_: theta[None], "polished": lambda problem, fit, *_: fit}.items():
        monkeypatch.setattr(f"clothbench.studies.improve.rounds.{what}", value)
    monkeypatch.setattr("clothbench.studies.improve.rounds.refit_null", lambda problem, current, *_: current)
    monkeypatch.setattr("clothbench.studies.improve.rounds.at_any_shape", lambda *_: p_value)
    evidence = SimpleNamespace(search=SearchSettings(), objection=lambda before, after: "")
    problem = SimpleNamespace(make=catalogue().make, space_of=lambda name: drag.parameters[1:], evidence=evidence)
    account = Account(lambda *_: None)
    account.stage("round 1", 0, 1)
    probes = tuple(SimpleNamespace(effect=c.name) for c in tried)
    found = witnessed_round(problem, law, Round(before, 3e-3, tried, probes, ()), 0.0, account)
    assert found.named == named
    assert found.witnessed == bool(named)
    assert found.after is (after if named else None)
    assert {c.name for c in found.candidates} == {"point_mass", "quadratic_drag"}
    why = next(c.why_not for c in found.candidates if c.name == "quadratic_drag")
    assert ("though the recordings say the same without any model" in why) == (leaves > 3.9e-3)


@pytest.mark.parametrize(
    ("falls", "times"), [([1.0], 1), ([0.9, 0.96], 2), ([0.8, 0.8, 0.99, 0.5], 3), ([0.5] * 9, LOOP.polish_limit)]
)
def test_a_finalist_is_polished_as_long_as_that_pays(monkeypatch, falls, times):
    """falls: of the rms, from one polish to the next."""
    asked = []

    def polish(problem, fit, rounds, goal):
        asked.append(fit.rms)
        residual = [falls[len(asked) - 1] * r for r in fit.residual]
        return dataclasses.replace(fit, residual=residual), 7

    monkeypatch.setattr("clothbench.studies.improve.refits.polish", polish)
    account = Account(lambda *_: None)
    account.stage("contest", 0, 1)
    found = polished(None, fitted(4e-3), account)
    assert len(asked) == times
    assert found.rms == pytest.approx(4e-3 * np.prod(falls[:times]))
    assert account.evaluations == 7 * times


def wind(shapes: int) -> ParameterSpace:
    """An effect of one amount and so many shape parameters."""
    amount = Parameter("amount", "c", "1", (0.0, 1.0), "linear", 0.5, "how much", "a test", null=0.0)
    shape = [Parameter(f"w{n}", "w", "1", (-1.0, 1.0), "linear", 0.0, "which way", "a test") for n in range(shapes)]
    return ParameterSpace((amount, *shape))


@pytest.mark.parametrize(("shapes", "rms"), [(1, 4e-3), (2, 1e-3)])
def test_an_effect_with_several_shape_parameters_is_sought_in_other_valleys(monkeypatch, shapes, rms):
    """Made-up law: a fit ends at 4 mm where it starts with w0 < 0, at 1 mm where w0 > 0; the first one has w0 < 0."""
    effect, goals, one_valley = wind(shapes), [], shapes < LOOP.multistart_shapes
    space = ParameterSpace((*SPACE, *effect))
    evidence = SimpleNamespace(search=SearchSettings())
    problem = SimpleNamespace(
        seed=0, evidence=evidence, space_of=lambda name: effect, trials=lambda names, split: None
    )  # fmt: skip

    def ended(start):
        rms = 1e-3 if start[2] > 0 else 4e-3
        return Fitted(("wind",), space, start, [np.full(9, rms)] * 2, [np.ones((9, len(space)))] * 2, start, start, 10)

    def fit(problem, names, start, rounds, goal, unless, tolerance):
        goals.append(goal)
        return ended(start)

    monkeypatch.setattr("clothbench.studies.improve.fitting.fit", fit)
    # From afar the wrong valley looks the better one, but for a corner of the right one.
    value = lambda theta: np.where(theta[:, 2] > 0.9, 1.0, 2.0 + theta[:, 2])  # noqa: E731
    monkeypatch.setattr(
        "clothbench.studies.improve.fitting.evaluate",
        lambda _, t: (Evaluation(value(t), np.sqrt(value(t))[:, None]), []),
    )
    first = ended(np.array([2.0, 0.5, *([-0.5] * shapes)]))
    found, count = multistart(problem, fitted(9e-3), first, rounds=8)
    assert found.rms == pytest.approx(rms)
    assert found.theta[0] == 2.0
    assert count == (0 if one_valley else LOOP.multistart_points + 10 * LOOP.multistart_fits)
    assert goals == ([] if one_valley else pytest.approx([1.6e-5, 1e-6]))


def test_the_model_is_sought_anew_beside_what_was_named(monkeypatch):
    """Made-up: a fit ends at 4 mm where it starts with a soft sheet, at 1 mm with a stiff one; the wind stays."""
    effect = wind(1)
    space = ParameterSpace((*SPACE, *effect))
    problem = SimpleNamespace(
        seed=0, space=lambda names: SPACE, trials=lambda names, split: None, evidence=SimpleNamespace()
    )  # fmt: skip

    def fit(problem, names, start, rounds, goal, unless, tolerance):
        rms = 1e-3 if start[0] > 5 else 4e-3
        return Fitted(("wind",), space, start, [np.full(9, rms)] * 2, [np.ones((9, 3))] * 2, start, start, 10)

    monkeypatch.setattr("clothbench.studies.improve.fitting.fit", fit)
    value = lambda theta: 9 - theta[:, 0] + 9 * (theta[:, 1] != 0.3)  # noqa: E731
    monkeypatch.setattr(
        "clothbench.studies.improve.fitting.evaluate",
        lambda _, t: (Evaluation(value(t), np.sqrt(value(t))[:, None]), []),
    )
    found, count = calibrated_anew(problem, fit(problem, (), np.array([2.0, 0.3, -0.5]), 8, np.inf, None, 0.0))
    assert found.rms == pytest.approx(1e-3)
    assert found.theta[0] > 5
    assert found.theta[1:].tolist() == [0.3, -0.5]
    assert count == LOOP.calibration_points + 10 * LOOP.calibration_fits


@pytest.mark.parametrize(("elsewhere", "own"), [(1e-3, True), (1e-3, False), (1.99e-3, False)])
def test_a_further_round_sets_out_from_the_better_valley(monkeypatch, elsewhere, own):
    """Made-up: a wind leaves 2 mm; with the model sought anew beside it 1 mm, or hardly less than before."""
    first = dataclasses.replace(fitted(2e-3), effects=("wind",))
    better = dataclasses.replace(fitted(elsewhere), effects=("wind",))
    anew, asked = {"one": fitted(elsewhere)}, []

    def by_recording(problem, current, name, goal, known):
        asked.append((problem.own, current, name, known))
        return current, anew, 7

    for name, value in {
        "calibrated_anew": lambda *_: (better, 50), "fitted_by_recording": by_recording,
        "corrected": lambda problem, fit, noise, account: (problem, fit, 4e-4),
        "profile_intervals": lambda problem, fit: (fit, fit, 3),
    }.items():  # fmt: skip
        monkeypatch.setattr(f"clothbench.studies.improve.loop.{name}", value)
    known = {"one": fitted(2e-3)}
    problem = Held({"one": {"k": 2.0}} if own else {})
    last = Round(fitted(6e-3), 1e-3, (), ("a probe",), ("wind",), first, own={"wind": known} if own else {})
    state, account = State(problem, fitted(6e-3), first, 1e-3, 9e-4, (last,)), Account(lambda *_: None)
    account.stage("round 1", 0, 1)
    found = recalibrated(state, account)
    if elsewhere > 1.9e-3:
        assert found is state
        return
    assert found.final is better
    assert found.mesh == 4e-4
    assert found.rounds[-1].probes == ()
    assert account.evaluations == (57 if own else 53)
    assert asked == ([({}, better, "wind", known)] if own else [])
    assert found.own == ({"wind": anew} if own else {})
    assert found.problem.own == ({"one": {"k": 2.0}} if own else {})


@pytest.mark.parametrize(("turn", "valley"), [(0, True), (1, True), (1, False)])
def test_a_second_name_has_to_hold_in_the_better_valley(monkeypatch, turn, valley):
    """Made-up: whatever the state, a round names something, but for the state in a better valley; the first name is
    given without one being sought.
    """
    state = SimpleNamespace(rounds=("named before",) * turn)
    better, named, nothing = (SimpleNamespace(rounds=state.rounds) for _ in range(3))
    monkeypatch.setattr(
        "clothbench.studies.improve.loop.one_more",
        lambda state, *_: (nothing, False) if state is better else (named, True),
    )
    monkeypatch.setattr(
        "clothbench.studies.improve.loop.recalibrated", lambda state, account: better if valley else state
    )
    monkeypatch.setattr("clothbench.studies.improve.loop.too_much_left", lambda state: False)
    assert next_round(state, (), Account(lambda *_: None)) == ((nothing, False) if turn and valley else (named, True))


@pytest.mark.parametrize(("left", "asked"), [(True, 2), (False, 1)])
def test_before_names_fall_a_better_valley_is_sought_beside_them(monkeypatch, left, asked):
    """Made-up: no round names anything more; in the better valley little is left."""
    state, better, after, end = (SimpleNamespace(rounds=("named before",)) for _ in range(4))
    rounds = []

    def one_more(state, *_):
        rounds.append(state)
        return (end if state is better else after), False

    monkeypatch.setattr("clothbench.studies.improve.loop.one_more", one_more)
    monkeypatch.setattr("clothbench.studies.improve.loop.recalibrated", lambda *_: better)
    monkeypatch.setattr("clothbench.studies.improve.loop.too_much_left", lambda state: left and state is after)
    found, goes_on = next_round(state, (), Account(lambda *_: None))
    assert found is (end if left else after)
    assert not goes_on
    assert rounds == [state, better][:asked]


def with_wind(name: str, shapes: int, rms: float) -> Fitted:
    """A fit with an effect that so many shape parameters belong to; its amount is 0.5 ± 0.1."""
    effect = [dataclasses.replace(p, name=f"{name}.{p.name}") for p in wind(shapes)]
    space = ParameterSpace((*SPACE, *effect))
    theta = np.array([2.0, 0.5, *np.zeros(shapes)])
    low, high = theta - 0.1, theta + 0.1
    return Fitted((name,), space, theta, [np.full(9, rms)] * 3, [np.ones((9, len(space)))] * 3, low, high, 10)


def test_a_fit_with_many_more_parameters_has_to_leave_so_much_less():
    evidence = SimpleNamespace(search=SearchSettings(), objection=lambda before, after: "")
    problem, current = SimpleNamespace(evidence=evidence), fitted(9e-3)
    simple, alike, rich = with_wind("a", 0, 2e-3), with_wind("b", 1, 2e-3), with_wind("c", 5, 1.9e-3)
    known = {simple.effects: simple}
    assert standing(problem, current, {}, rich) == np.inf
    margin, penalty = LOOP.tie_margin, LOOP.parameter_penalty
    assert standing(problem, current, known, alike) == pytest.approx((1 + 2 * margin) * 4e-6)  # may be tied
    assert standing(problem, current, known, rich) == pytest.approx(4e-6)  # tied, or instead
    assert standing(problem, current, {rich.effects: rich}, simple) == pytest.approx(
        (1 + 2 * margin + 5 * penalty) * 3.61e-6
    )
    nothing = dataclasses.replace(simple, low=simple.low - 1)  # an amount that may be none is in nobody's way
    assert standing(problem, current, {nothing.effects: nothing}, rich) == np.inf


class Spring:
    """Made-up: an effect that is a stiffness where its shape r is 0, out of its bounds."""

    parameters = ParameterSpace(
        (
            Parameter("k", "k", "1", (0.0, 1.0), "linear", 0.5, "an amount", "a test", null=0.0),
            Parameter("r", "r", "1", (0.1, 1.0), "linear", 0.5, "a shape", "a test"),
        )
    )

    def limits(self, phi):
        return {"stiffness": np.array([phi[0], 0.0])}


@pytest.mark.parametrize(
    ("leaves", "follows", "why"),
    [(1.05, 0.0, "cannot be told from stiffness"), (3.0, 0.0, ""), (3.0, 2.0, "cannot be told from stiffness"),
     (np.nan, 0.0, "")],
    ids=["alike", "apart", "alike once the others follow", "cannot be simulated"],
)  # fmt: skip
def test_what_its_limit_does_nearly_as_well_is_not_named(monkeypatch, leaves, follows, why):
    """Made-up: at its limit the effect leaves `leaves` mm for 1 mm; then the model's own parameter takes `follows`."""
    space = ParameterSpace((*SPACE, *(dataclasses.replace(p, name=f"spring.{p.name}") for p in Spring.parameters)))
    theta, ones = np.array([2.0, 0.5, 0.5]), np.ones((9, 1))
    jacobian = np.hstack([1e-3 * ones, ones, ones])
    fit = Fitted(("spring",), space, theta, [np.full(9, 1e-3)] * 2, [jacobian] * 2, theta, theta, 1)
    problem = SimpleNamespace(trials=lambda names, split: None, make=lambda kind, name: Spring())

    def evaluate(trials, asked):
        ((k, *effect),) = asked
        assert effect == [0.5, 0.0]
        left = 1e-3 * (leaves if k == theta[0] else leaves - follows)
        return SimpleNamespace(residual=np.full((1, 18), left / np.sqrt(18))), []

    monkeypatch.setattr("clothbench.studies.improve.refits.evaluate", evaluate)
    account = Account(lambda *_: None)
    account.stage("round 1", 0, 1)
    assert as_a_limit(problem, fit, account) == why


def test_beside_a_limit_the_others_go_where_the_residual_falls(monkeypatch):
    """It is −3 mm there, and rises by 10 mm over the range of the model's own parameter: three tenths further up."""
    space = ParameterSpace((*SPACE, *(dataclasses.replace(p, name=f"spring.{p.name}") for p in Spring.parameters)))
    theta, jacobian = np.array([2.0, 0.5, 0.5]), np.hstack([np.full((9, 1), 1e-2), np.ones((9, 2))])
    fit = Fitted(("spring",), space, theta, [np.full(9, 1e-3)] * 2, [jacobian] * 2, theta, theta, 1)
    problem, asked = SimpleNamespace(trials=lambda names, split: None, make=lambda kind, name: Spring()), []

    def evaluate(trials, theta):
        asked.append(float(space.to_unit(theta)[0, 0] - space.to_unit(fit.theta)[0]))
        return SimpleNamespace(residual=np.full((1, 18), (1e-2 * asked[-1] - 3e-3) / np.sqrt(18))), []

    monkeypatch.setattr("clothbench.studies.improve.refits.evaluate", evaluate)
    account = Account(lambda *_: None)
    account.stage("round 1", 0, 1)
    assert as_a_limit(problem, fit, account) == "cannot be told from stiffness"
    assert asked == pytest.approx([0.0, 0.3], abs=1e-6)


@pytest.mark.parametrize(("floor", "sought"), [(1e-3, ["a", "c"]), (2.1e-3, ["a"])], ids=["room", "no room"])
def test_nobody_is_sought_who_would_have_to_leave_less_than_the_floor(monkeypatch, floor, sought):
    """With five parameters more it has something to say only if it leaves less than 2 mm."""
    evidence = SimpleNamespace(search=SearchSettings(), objection=lambda before, after: "")
    problem, current, asked = SimpleNamespace(evidence=evidence), fitted(9e-3), []

    def multistart(problem, base, fit, rounds, goal):
        asked.append(fit.effects[0])
        return fit, 0

    monkeypatch.setattr("clothbench.studies.improve.refits.multistart", multistart)
    monkeypatch.setattr("clothbench.studies.improve.refits.polished", lambda problem, fit, account, goal: fit)
    tried = [
        Candidate(f.effects[0], 0.5, 0.005, fitted=f) for f in (with_wind("c", 5, 2.3e-3), with_wind("a", 0, 2e-3))
    ]
    found = refine_finalists(problem, current, floor, 1e-6, tried, Account(lambda *_: None), 0)
    assert asked == sought
    assert [c.fitted for c in found] == [c.fitted for c in tried]


def test_whoever_gains_half_of_what_a_name_takes_may_yet_be_named(monkeypatch):
    """A name takes 4 mm² of 9; of four one gains that, one 2.5 mm², one 1.5 mm², one nothing."""
    evidence, asked = SimpleNamespace(search=SearchSettings(), objection=lambda before, after: ""), []
    monkeypatch.setattr(
        "clothbench.studies.improve.refits.multistart",
        lambda problem, base, fit, rounds, goal: (asked.append(fit.effects[0]) or fit, 0),
    )
    monkeypatch.setattr("clothbench.studies.improve.refits.polished", lambda problem, fit, account, goal: fit)
    monkeypatch.setattr("clothbench.studies.improve.refits.better_of", lambda problem, fit, *_: (fit, 0))
    tried = [
        Candidate(name, 0.5, 0.005, fitted=with_wind(name, 0, (9e-6 - gain) ** 0.5))
        for name, gain in (("d", 0.0), ("c", 1.5e-6), ("b", 2.5e-6), ("a", 4e-6))
    ]
    problem = SimpleNamespace(evidence=evidence)
    refine_finalists(problem, fitted(3e-3), 1e-5, 4e-6, tried, Account(lambda *_: None), 0)
    assert asked == ["a", "b"]


def test_a_ripple_keeps_a_fit_from_its_goal_by_a_quarter_at_most():
    assert near(with_wind("a", 0, 1.24**0.5), 1.0)
    assert not near(with_wind("a", 0, 1.26**0.5), 1.0)


def test_a_probe_of_an_earlier_round_may_be_set_out_from():
    """It knows nothing of the effect named since, whose parameters follow those that it knows."""
    one, random = fitted(4e-3), np.random.default_rng(0)
    space = ParameterSpace((*one.space, Parameter("wind.x", "w", "m/s", (-2.0, 2.0), "linear", 0.5, "wind", "a test")))
    jacobian = [np.hstack([j, random.normal(size=(len(j), 1))]) for j in one.jacobian]
    now = dataclasses.replace(one, space=space, theta=np.append(one.theta, 1.0), jacobian=jacobian, effects=("wind",))
    columns = [random.normal(size=(len(j), 1)) for j in one.jacobian]
    probe = Probe("a", np.zeros(1), (0,), np.array([0.1]), np.full((1, len(one.theta)), 0.02), columns)
    starts = fit_starts("a", now, [probe])
    assert starts.shape == (3, len(now.theta) + 1)
    assert starts[2, -2] == pytest.approx(1.0)  # as tried: what it did not know stays where it is
    assert starts[2, 0] != one.theta[0]


def test_a_probe_is_set_out_from_with_and_without_the_step_of_the_base():
    """All that is left is three tenths of what the probe does and 0.05 of what the base's parameter does."""
    random = np.random.default_rng(0)
    columns, jacobian = ([random.normal(size=(9, 1)) for _ in range(2)] for _ in range(2))
    residual = [-0.3 * c[:, 0] - 0.05 * j[:, 0] for c, j in zip(columns, jacobian, strict=True)]
    now = dataclasses.replace(fitted(1.0), residual=residual, jacobian=jacobian)
    probe = Probe("a", np.zeros(1), (0,), np.array([0.1]), np.zeros((1, 1)), columns)
    # The base's parameter goes from 1 to 9.
    np.testing.assert_allclose(fit_starts("a", now, [probe]), [[2.4, 0.03], [2.0, 0.03], [2.0, 0.1]], rtol=1e-3)


def test_a_candidate_is_fitted_from_whichever_of_its_probes_leaves_least(monkeypatch):
    """First order may promise most where a wind blows the wrong way."""
    problem = SimpleNamespace(evidence=SimpleNamespace(search=SearchSettings()))
    refits, asked, ended = "clothbench.studies.improve.refits", [], with_wind("a", 0, 1e-3)

    def fit(problem, names, starts, *_, **__):
        asked.extend(starts.tolist())
        return ended

    monkeypatch.setattr(f"{refits}.first_order_starts", lambda current, probe: np.full((3, 2), probe.size))
    monkeypatch.setattr(f"{refits}.fit", fit)
    monkeypatch.setattr(f"{refits}.jump_along_valley", lambda problem, fit: (fit, 1))
    probes = [SimpleNamespace(effect=effect, size=size) for effect, size in (("a", 1.0), ("b", 3.0), ("a", 2.0))]
    found, count = refit(problem, ("a",), fit_starts("a", fitted(9e-3), probes), 1e-6)
    assert found is ended
    assert count == ended.evaluations + 1
    assert asked == [[1.0, 1.0]] * 3 + [[2.0, 2.0]] * 3


@pytest.mark.parametrize(("same", "named"), [(True, ("a", "b")), (False, ("a",))])
def test_ripples_on_some_recordings_do_not_part_two_effects_that_correct_the_same(same, named):
    """On two of four recordings b leaves a third less than a, on the others more; over all of them 8 % more."""
    random, sides = np.random.default_rng(4), np.repeat([True, False], 200)
    signal = [random.choice([-4e-3, 4e-3], 400) for _ in range(4)]

    def after(effect, squares, takes):
        """What is left where all of the signal that it `takes` is gone, scaled to these mean squares."""
        left = [np.where(takes, 0.05 * s, s) for s in signal]
        left = [r * np.sqrt(q / np.mean(r**2)) for r, q in zip(left, squares, strict=True)]
        found = with_wind(effect, 0, 1.0)
        return Candidate(effect, 0.5, 0.005, fitted=dataclasses.replace(found, residual=left, jacobian=[]))

    current = dataclasses.replace(fitted(1.0), residual=signal)
    everything = np.ones(400, bool)
    tried = [
        after("a", 1e-6 * np.array([5.2, 3.5, 4.5, 4.0]), everything if same else sides),
        after("b", 1e-6 * np.array([3.7, 3.3, 6.9, 4.7]), everything if same else ~sides),
    ]
    assessed = assess(current, 2e-6, tried)
    assert choose(current, assessed) == named
    assert {c.name: bool(c.why_not) for c in assessed} == {"a": False, "b": not same}


def leaving(effect: str, squares: list[float]) -> Candidate:
    """Takes nearly all of what `signal_of` has, and leaves these mean squares of the recordings."""
    left = [q**0.5 * s / 4 for q, s in zip(squares, signal_of(len(squares)).residual, strict=True)]
    return Candidate(effect, 0.5, 0.005, fitted=dataclasses.replace(with_wind(effect, 0, 1.0), residual=left))


def signal_of(count: int) -> Fitted:
    """A mean square of 16 in each recording."""
    random = np.random.default_rng(4)
    return dataclasses.replace(fitted(1.0), residual=[random.choice([-4.0, 4.0], 400) for _ in range(count)])


@pytest.mark.parametrize(
    ("squares", "gain", "stands", "why"),
    [
        ([1, 1, 1, 17], 1.0, 4, ""),
        ([1, 1, 17, 17], 1.0, 4, "helps in 2 of 4 recordings only"),
        ([1, 15, 15, 15], 2.0, 3, ""),
        ([6, 6, 15.5, 15.5], 5.0, 2, "falls short or behind another when a recording is left out (stands in 2 of 4)"),
        ([11.1] * 4, 5.0, 0, "explains only 98% of what a name has to"),
    ],
)
def test_a_name_may_fail_on_one_recording_and_not_on_two(squares, gain, stands, why):
    (found,) = assess(signal_of(4), gain, [leaving("a", squares)])
    assert (found.selected, found.why_not) == (stands, why)
    assert found.gain == pytest.approx(16 - np.mean(squares))


def test_two_that_correct_the_same_are_compared_on_all_recordings_at_once():
    """b leaves 15 % more than a in all; without the third or the fourth recording it would be a third."""
    tried = [leaving("a", [1.0, 1.0, 1.0, 1.0]), leaving("b", [1.7, 1.7, 0.6, 0.6])]
    assert [(c.name, c.selected, c.why_not) for c in assess(signal_of(4), 5.0, tried)] == [("a", 4, ""), ("b", 4, "")]


def test_of_equally_simple_effects_the_one_with_fewest_shapes_comes_first():
    plain, shaped = with_wind("plain", 1, 1.0), with_wind("shaped", 1, 0.99)
    amounts = (*plain.space.parameters[:-1], dataclasses.replace(plain.space.parameters[-1], null=0.0))
    plain = dataclasses.replace(plain, space=ParameterSpace(amounts))
    before = dataclasses.replace(fitted(9.0), residual=[np.full(9, 9.0)] * 3)
    tried = [Candidate(fit.effects[0], 0.5, 0.005, fitted=fit) for fit in (shaped, plain)]
    assert choose(before, tried) == ("plain", "shaped")


@pytest.mark.parametrize(
    ("rival", "gains", "holds"),
    [(2.1e-3, 0.5e-6, False), (2.1e-3, 2e-6, True), (2.3e-3, 0.0, True)],
    ids=["explains little beside it", "explains enough", "the rival has fallen behind"],
)
def test_a_further_name_has_to_hold_beside_what_an_earlier_one_is_tied_with(monkeypatch, rival, gains, holds):
    first, second, third = (
        with_wind(name, 0, rms) for name, rms in (("first", 2e-3), ("second", 2.1e-3), ("third", 1.8e-3))
    )
    after = dataclasses.replace(
        third, effects=("first", "third"), space=ParameterSpace((*first.space, *third.space.parameters[1:])),
        theta=np.array([2.5, 0.4, 0.7]),
    )  # fmt: skip
    spaces = {
        ("second",): second.space,
        ("second", "third"): ParameterSpace((*second.space, *third.space.parameters[1:])),
    }
    asked = []

    def fit(problem, names, start, rounds, goal=np.inf):
        asked.append((names, start.tolist()))
        square = rival**2 - (gains if "third" in names else 0)
        return dataclasses.replace(
            second, effects=names, space=spaces[names], theta=start[0], residual=[np.full(9, square**0.5)]
        )

    monkeypatch.setattr("clothbench.studies.improve.refits.fit", fit)
    tie = (Candidate("first", 0.5, 0.005, fitted=first), Candidate("second", 0.5, 0.005, fitted=second))
    named = Round(fitted(9e-3), 1e-3, tie, (), ("first", "second"), first)
    evidence = SimpleNamespace(search=SearchSettings())
    problem = SimpleNamespace(space=lambda names: spaces[names], evidence=evidence)
    state = State(problem, fitted(9e-3), first, 0.5e-3, 0.9e-3, (named,))
    found = Round(first, 1e-3, (), (), ("third",), after)
    account = Account(lambda *_: None)
    account.stage("contest", 0, 1)
    why = beside_tied(state, found, account)
    assert (why == "") == holds
    assert holds or "beside second, which first is tied with" in why
    assert asked[0] == (("second",), [[2.0, 0.5], [2.0, 0.5]])
    assert asked[1:] == ([] if rival == 2.3e-3 else [(("second", "third"), [[2.0, 0.5, 0.7], [2.5, 0.5, 0.7]])])


def test_amounts_of_each_recordings_own_are_beside_no_tie(monkeypatch):
    """What they are tied with was fitted by recording as well, which nobody does again."""
    first, second = with_wind("first", 0, 2e-3), with_wind("second", 0, 2.1e-3)
    monkeypatch.setattr("clothbench.studies.improve.refits.fit", None)
    tie = (Candidate("first", 0.5, 0.005, fitted=first), Candidate("second", 0.5, 0.005, fitted=second))
    named = Round(fitted(9e-3), 1e-3, tie, (), ("first", "second"), first, own={"first": {"rec-01": first}})
    state = State(SimpleNamespace(), fitted(9e-3), first, 0.5e-3, 0.9e-3, (named,))
    found = Round(first, 1e-3, (), (), ("third",), dataclasses.replace(first, effects=("first", "third")))
    assert beside_tied(state, found, Account(lambda *_: None)) == ""


def test_the_placebo_is_the_candidate_that_promised_least_but_something(monkeypatch):
    """Fitted beside what was named, from where that ended and nothing of it; none where nothing was named or left."""
    held_out, asked = "clothbench.studies.improve.held_out", []

    def fit(problem, names, start, rounds):
        asked.append((names, start.tolist()))
        return with_wind("c", 1, 1e-3)

    monkeypatch.setattr(f"{held_out}.fit", fit)
    monkeypatch.setattr(f"{held_out}.held_out_errors", lambda problem, fit: [2e-3, 3e-3])
    problem = SimpleNamespace(of_split=lambda split: ["third", "fourth"], space_of=lambda name: wind(1))
    shares = {"a": 0.01, "b": 0.5, "c": 0.02, "d": 0.0, "e": -1.0}
    tried = tuple(Candidate(name, share, 0.5) for name, share in shares.items())
    final = with_wind("a", 0, 2e-3)
    last = Round(final, 1e-3, tried, (), ())
    found, count = placebo_of(problem, final, (last,))
    assert (found.name, found.errors, count) == ("c", (2e-3, 3e-3), 10)
    assert asked == [(("a", "c"), [2.0, 0.5, 0.0, 0.0])]
    for fitted_, rounds in ((fitted(2e-3), (last,)), (final, (Round(final, 1e-3, tried[3:], (), ()),))):
        assert placebo_of(problem, fitted_, rounds) == (None, 0)


def test_fits_are_compared_by_the_mean_square_of_all_recordings():
    """Of two recordings, 1 and 3 m are 2 m in the mean, and yet further off than twice 2.1 m."""
    residual = np.array([[1.0, 3.0], [2.1, 2.1], [np.nan, 1.0]]) / np.sqrt(2)
    found = sums_of_squares(Evaluation(np.array([2.0, 2.1, np.nan]), residual))
    np.testing.assert_allclose(found, [5.0, 2.1**2, np.inf])


def test_a_hair_better_fit_of_what_was_named_does_not_narrow_its_intervals(monkeypatch):
    """Those that were followed along the valleys hold; a first-order one in its place would be surer than it can be."""
    monkeypatch.setattr(
        "clothbench.studies.improve.loop.with_errors_of_mesh_and_model",
        lambda problem, fit, noise: dataclasses.replace(fit, low=np.array([1.95]), high=np.array([2.05])),
    )
    wide = dataclasses.replace(fitted(2e-3), low=np.array([1.0]), high=np.array([9.0]))
    found = Round(wide, 1e-3, (), (), ())
    before = from_better(State(None, wide, wide, 1e-3, 1e-4), found, fitted(1.99e-3))[0]
    assert before.final.low == 1.95  # of the base nothing was followed
    later = from_better(State(None, wide, wide, 1e-3, 1e-4, (found,)), found, fitted(1.99e-3))[0]
    assert (later.final.low, later.final.high) == (1.0, 9.0)
