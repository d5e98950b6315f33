"""What the verdict's hint says of what is left: which candidate, how much of it, where and when."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from clothbench.core.observation import Observation
from clothbench.core.parameters import Parameter, ParameterSpace
from clothbench.plugins.discovery import catalogue
from clothbench.studies.improve.candidates import candidates_of
from clothbench.studies.improve.experiment import Experiment
from clothbench.studies.improve.fitted import Fitted
from clothbench.studies.improve.loop import notes
from clothbench.studies.improve.selection import Candidate
from clothbench.studies.improve.sheets import SheetCase, SheetEvidence
from clothbench.studies.improve.state import Round, State
from clothbench.studies.improve.verdict import concluded, fails_to_hold, fall_interval, pooled, what_would_part

TIME = np.arange(60) / 20.0
MATERIAL = np.array([[0.0, 0.1], [0.0, 0.5], [0.0, 0.9]])
STIFFNESS = Parameter("k", "k", "N/m", (1.0, 9.0), "linear", 2.0, "a stiffness", "a test")
DRAG = Parameter("quadratic_drag.normal", "C_N", "1", (0.0, 4.0), "linear", 1.0, "an amount", "a test", null=0.0)


def fitted(residual, effects=(), more=()) -> Fitted:
    space = ParameterSpace((STIFFNESS, *more))
    theta = np.full(len(space), 1.5)
    return Fitted(effects, space, theta, residual, [np.ones((len(r), len(space))) for r in residual], theta, theta, 1)


@pytest.fixture
def state():
    """A loop that named nothing: 1 mm of noise, and 20 mm of the lowest point of the second recording after 2 s."""
    cases = [
        SheetCase(
            name,
            "fit",
            None,
            Observation(TIME, np.zeros((60, 3, 3)), np.ones((60, 3), bool), 1e-3, MATERIAL),
            SimpleNamespace(height=1.0, velocity=None, grip_material=()),
        )
        for name in ("first", "second")
    ]
    left = np.random.default_rng(0).normal(0, 1e-3, (2, 60, 3, 3))
    left[1, 40:, 2] += 0.02
    residual = [one.ravel() for one in left]
    problem = SimpleNamespace(
        evidence=SheetEvidence(tuple(cases)),
        make=catalogue().make,
        model="mass_spring",
        of_split=lambda split: cases if split == "fit" else [],
    )
    base, drag = fitted(residual), fitted(residual, ("quadratic_drag",), [DRAG])
    tried = (
        Candidate("clock_offset", 0.3, 0.005),
        # Its fit came to less than it had promised: that is what counts.
        Candidate("quadratic_drag", 0.4, 0.005, 0.05 * base.rms**2, fitted=drag),
    )
    return State(problem, base, base, 1e-3, 0.0, (Round(base, 1e-3, tried, (), ()),))


@pytest.mark.parametrize(
    ("held_out", "verdict", "left", "said"),
    [
        ([1.2, 1.2], "complete", 0.0, "nothing is left"),
        ([1.2, 2.2], "unexplained", 1.46, "at 1.8 times"),
        ([1.2, np.nan], "unexplained", 0.0, "fourth, held out, could not be simulated"),
    ],
)
def test_complete_is_what_carries_over_to_recordings_held_out(state, held_out, verdict, left, said):
    """held_out: errors [mm] of two recordings held out; left: what is unexplained then [mm]."""
    state.problem.of_split = lambda split: [SimpleNamespace(name=name) for name in ("third", "fourth")]
    base = fitted([np.full(9, 1.1e-3)] * 2)
    found = concluded(replace(state, base=base, final=base), [1e-3 * error for error in held_out])
    assert found.word == verdict
    assert said in found.hint
    assert 1e3 * found.unexplained == pytest.approx(left, abs=0.01)


def test_nothing_is_complete_where_the_mesh_may_be_wrong_by_more_than_the_noise(state):
    state.problem.of_split = lambda split: [SimpleNamespace(name=name) for name in ("third", "fourth")]
    base = fitted([np.full(9, 1.1e-3)] * 2)
    barely = fitted([np.full(9, 1.25e-3)] * 2)  # a little above noise and mesh, which is no more than they account for
    coarse = replace(state, base=base, final=base, noise=0.5e-3, mesh=1e-3)
    assert coarse.floor == pytest.approx(np.hypot(0.5e-3, 1e-3))
    found = concluded(coarse, [1.2e-3, 1.2e-3])
    assert found.word == "unexplained"
    # That the mesh is wrong by 0.98 mm is not known: it is what is left above the noise, and the mesh may do more.
    below = "is below what this mesh can tell: it may be wrong by"
    assert f"1.1 mm, {below} at least as much as is left above the noise, 0.5 mm;" in found.hint
    hint = concluded(replace(coarse, base=barely, final=barely), [1.2e-3, 1.2e-3]).hint
    assert f"{below} 1 mm, beside a noise of 0.5 mm" in hint
    assert found.unexplained == 0.0
    assert concluded(replace(coarse, base=barely, final=barely), [1.2e-3, 1.2e-3]).unexplained == 0.0
    finer = concluded(replace(coarse, noise=1e-3, mesh=0.9e-3), [1.2e-3, 1.2e-3])
    assert finer.word == "complete"


def test_hint_says_who_comes_nearest_and_where_and_when_most_is_left(state):
    found = concluded(state, [])
    assert found.word == "unexplained"
    assert not found.fit.effects
    for said in (
        "clock_offset (30% of the mean square to first order) comes nearest",
        "quadratic_drag (fitted with normal = 1.5: 5% of the mean square) among forces",
        "left in the lower third (upper 1.0 mm, middle 1.0 mm, lower 8.2 mm)",
        "in second, and there around 2.5 s",
    ):
        assert said in found.hint


def test_no_third_is_named_that_hardly_stands_out(state):
    """As of 5.6, 5.4 and 5.6 mm, of which the lower had been named."""
    evidence, left = state.problem.evidence, [np.full((60, 3, 3), 1e-3) for _ in range(2)]
    left[1][40:, 2] += 1e-4
    said = evidence.location([one.ravel() for one in left])
    assert said.startswith("no third of the sheet has clearly more left than the others (upper 1.0 mm, middle 1.0 mm")
    assert "; most is left in second, and there around" in said


def test_grips_that_hold_by_forces_are_tried_and_told_as_boundary(state):
    """The engine has them among forces (`dynamics`); what they say is how the cloth was held."""
    tried = (Candidate("grip_patch", 0.5, 0.005), Candidate("quadratic_drag", 0.4, 0.005))
    alike = replace(state.rounds[0], candidates=tried)
    told = notes(state.problem, [alike])
    assert {name: note.place for name, note in told.items()} == {
        "grip_patch": "boundary", "quadratic_drag": "dynamics"
    }  # fmt: skip
    hint = concluded(replace(state, rounds=(alike,)), []).hint
    assert "grip_patch (50% of the mean square to first order) comes nearest" in hint
    assert "quadratic_drag (40% of the mean square to first order) among forces" in hint
    order = candidates_of("quadratic_drag,grip_patch,clock_offset", "nodes", (), catalogue())
    assert order == ("clock_offset", "grip_patch", "quadratic_drag")


def test_hint_says_which_bound_keeps_a_name_away(state):
    """Only where nothing else speaks against it: a wider bound would then give the name."""
    at_bound = replace(state.rounds[0].candidates[1].fitted, theta=np.array([1.5, 4.0]), low=np.array([1.0, 3.0]))
    for why, said in (("its quadratic_drag.normal runs to the bound 4", True), ("explains no more than chance", False)):
        tried = Candidate("quadratic_drag", 0.4, 0.005, 0.3 * state.base.rms**2, fitted=at_bound, why_not=why)
        found = concluded(replace(state, rounds=(replace(state.rounds[0], candidates=(tried,)),)), [])
        line = "its quadratic_drag.normal lies at its bound 4, which alone keeps it from a name; widen with "
        assert (f"{line}bounds.quadratic_drag.normal=[0,…]" in found.hint) == said


def test_hint_of_a_tie_says_how_alike_the_two_are_and_where_they_differ(state):
    base, names = state.base, ("quadratic_drag", "clock_offset")
    corrected = [0.05 * r for r in base.residual]
    otherwise = [corrected[0], corrected[1] + 1e-3 * (np.arange(540) // 9 // 20 == 1)]
    pair = [
        Candidate(name, 0.9, 0.005, fitted=fitted(left, (name,), [DRAG]))
        for name, left in zip(names, (corrected, otherwise), strict=True)
    ]
    final = pair[0].fitted
    rounds = (Round(base, 5e-4, tuple(pair), (), names, final),)
    found = concluded(replace(state, final=final, noise=5e-4, mesh=0.0, rounds=rounds), [])
    assert found.word == "tied"
    assert "correlates with 1.00" in found.hint
    assert "differ most in second, by 0.58 mm, around 1.5 s" in found.hint


@pytest.mark.parametrize(("noise", "said"), [(1e-3, ", 2.0 times the noise"), (0.0, "")])
def test_without_noise_nothing_is_told_in_times_of_it(state, monkeypatch, noise, said):
    moved = Experiment("first", "twice as far", 4.0, 2e-3)
    monkeypatch.setattr("clothbench.studies.improve.verdict.parting_experiment", lambda *_: moved)
    pair = Candidate("one", 0.9, 0.005, fitted=state.base), Candidate("other", 0.9, 0.005, fitted=state.base)
    found = what_would_part(replace(state, noise=noise), state.rounds[0], pair, 1e-3)
    assert found == f"moved as in first but twice as far, for 4.0 s, they would differ by 2 mm{said}"


@pytest.mark.parametrize(("model", "said"), [("mass_spring", True), ("baraff_witkin", False)])
def test_a_name_that_may_be_the_models_own_fault_is_told_so(state, model, said):
    base = state.base
    friction = Candidate("bending_hysteresis", 0.9, 0.005, fitted=fitted([0.05 * r for r in base.residual]))
    rounds = (Round(base, 1e-3, (friction,), (), ("bending_hysteresis",), friction.fitted),)
    state.problem.model = model
    found = concluded(replace(state, final=friction.fitted, rounds=rounds), [])
    assert found.word == "attributed"
    assert ("may be a fault of mass_spring, not of the cloth" in found.hint) == said


@pytest.mark.parametrize(
    ("before", "after", "fails"),
    [
        ([4.0, 2.0], [2.0, 2.0], False),
        ([4.0, 2.0], [4.0, 3.0], True),
        ([4.0, np.nan], [9.0, 9.0], False),  # the calibrated model could not be simulated there
        ([4.0, 2.0], [1.0, np.nan], True),
        ([4.0], [], False),
    ],
)
def test_a_name_has_to_hold_on_what_was_held_out(before, after, fails):
    assert fails_to_hold(before, after) is fails


def test_numbers_that_were_fitted_to_what_is_held_out_have_to_pay_there():
    """An error falls with them, whatever they stand for."""
    assert fails_to_hold([3.5, 1.9, 4.4, 2.5], [3.4, 1.8, 4.3, 2.5], own=12)
    assert not fails_to_hold([9.0, 8.0, 9.0, 10.0], [2.1, 2.0, 3.1, 2.2], own=12)


@pytest.mark.parametrize(
    ("before", "after"), [([10, 10, 10, 10, 40], [9, 9, 9, 9, 39]), ([1, 1, 1, 10], [2, 2, 2, 8]), ([5, 6], [6, 5.5])]
)
def test_the_interval_of_the_fall_holds_the_fall_that_is_shown(before, after):
    low, high = fall_interval(before, after)
    assert low < pooled(before) - pooled(after) < high


@pytest.mark.parametrize(
    ("before", "after"), [([4.0], [2.0]), ([4.0, np.nan], [2.0, 1.0]), ([4.0, 3.0], [2.0, np.nan])]
)
def test_a_fall_that_cannot_be_told_has_no_interval(before, after):
    assert fall_interval(before, after) == (None, None)


def test_where_time_ran_out_before_any_candidate_was_tried_nothing_is_complete(state):
    """What is left lies above the noise, and at what a coarse mesh may be wrong by: candidates would be tried."""
    base = fitted([np.full(9, 1.35e-3)] * 2)
    coarse = replace(state, base=base, final=base, noise=1e-3, mesh=0.9e-3, rounds=())
    assert concluded(coarse, []).word == "complete"
    stopped = concluded(coarse, [], timed_out=True)
    assert stopped.word == "unexplained"
    assert "but no candidate was tried; time ran out" in stopped.hint


@pytest.mark.parametrize(
    ("law", "verdict"),
    [
        (None, "unexplained"),
        ("past normal velocity", "unexplained"),
        ("", "unexplained"),
        ("normal velocity squared", "attributed"),
    ],
)
def test_a_name_stays_though_much_is_left_where_the_torques_say_the_same_without_a_model(state, law, verdict):
    """quadratic_drag takes off half of what stands above the noise; law: what the recordings' own law goes with."""
    cases = state.problem.of_split("fit")
    state.problem.of_split = lambda split: cases if split == "fit" else [SimpleNamespace(name="third")]
    base, final = state.base, fitted([0.7 * r for r in state.base.residual], ("quadratic_drag",), [DRAG])
    found = Candidate("quadratic_drag", 0.5, 0.005, 0.5 * base.rms**2, fitted=final)
    rounds = (Round(base, 1e-3, (found,), (), ("quadratic_drag",), final), Round(final, 1e-3, (), (), ()))
    told = None if law is None else SimpleNamespace(amounts=(SimpleNamespace(term=SimpleNamespace(law=law)),), alike=())
    state = replace(state, final=final, rounds=rounds, balance=SimpleNamespace(law=told))
    end = concluded(state, [5e-3], held_out_after=[4e-3])
    assert end.word == verdict
    if verdict == "attributed":
        assert end.fit is final
        assert "without any model; 47% of what noise and mesh do not account for is left: something else is" in end.hint
    else:
        assert "so that something else must be missing" in end.dropped
    # What does not hold on the recordings held out is no name, whoever says so.
    assert concluded(state, [5e-3], held_out_after=[6e-3]).word == "unexplained"


def test_every_law_that_effects_may_follow_is_one_that_torques_can_show():
    from clothbench.core.optional import FORCE_LAWS, law_of_force
    from clothbench.studies.improve.balance import terms

    plugins = catalogue()
    assert {term.law for term in terms()} - {""} == set(FORCE_LAWS)
    said = {law_of_force(plugins.make("effects", name)) for name in plugins.names("effects")}
    assert said - {""} == set(FORCE_LAWS)


def test_what_is_held_out_is_told_beside_noise_and_mesh_together(state):
    """Twice the noise, and less than half as much again as both."""
    state.problem.of_split = lambda split: [SimpleNamespace(name="third")]
    base = fitted([np.full(9, 1.1e-3)] * 2)
    coarse = replace(state, base=base, final=base, noise=1e-3, mesh=0.9e-3)
    assert concluded(coarse, [2.0e-3]).word == "complete"  # 1.5 times √(1² + 0.9²) is 2.02
    assert concluded(coarse, [2.1e-3]).word == "unexplained"


def test_what_a_coarse_mesh_hides_on_fitted_recordings_only_is_not_told_as_hidden(state):
    """Recordings held out stand at eight times noise and mesh together: that is what the verdict has to say."""
    state.problem.of_split = lambda split: [SimpleNamespace(name="third")]
    base = fitted([np.full(9, 1.1e-3)] * 2)
    found = concluded(replace(state, base=base, final=base, noise=0.5e-3, mesh=1e-3), [9e-3])
    assert found.word == "unexplained"
    assert "the error on held-out recordings stands at 8.0 times that" in found.hint
    assert 1e3 * found.unexplained == pytest.approx((81 - 0.25 - 1.1**2 + 0.25) ** 0.5, abs=0.1)


def test_what_is_unexplained_lies_above_noise_and_mesh(state):
    base = fitted([np.full(540, 3e-3)] * 2)
    found = concluded(replace(state, base=base, final=base, noise=1e-3, mesh=0.6e-3), [])
    assert found.word == "unexplained"
    assert 1e3 * found.unexplained == pytest.approx((9 - 1 - 0.36) ** 0.5)


@pytest.mark.parametrize(("share", "word"), [(0.5, "attributed"), (0.6, "unexplained")])
def test_where_the_base_is_at_the_floor_a_name_is_judged_by_what_stands_above_the_noise(state, share, word):
    """share: of the mean square above the noise that is left; at the floor 0.45 of it have to go."""
    noise, floor = 0.5e-3, np.hypot(0.5e-3, 1e-3)
    base = fitted([np.full(540, 1.1e-3)] * 2)
    left = (noise**2 + share * (base.rms**2 - noise**2)) ** 0.5
    final = fitted([np.full(540, left)] * 2, ("quadratic_drag",), [DRAG])
    named = Candidate("quadratic_drag", 0.5, 0.005, base.rms**2 - left**2, fitted=final)
    rounds = (Round(base, floor, (named,), (), ("quadratic_drag",), final), Round(final, floor, (), (), ()))
    assert concluded(replace(state, base=base, final=final, noise=noise, mesh=1e-3, rounds=rounds), []).word == word


@pytest.mark.parametrize(("second", "word"), [("quadratic_drag", "attributed"), ("total_mass", "unexplained")])
def test_where_much_is_left_the_torques_have_to_say_the_same_of_every_name(state, second, word):
    base, final = state.base, fitted([0.7 * r for r in state.base.residual], ("quadratic_drag",), [DRAG])
    rounds = tuple(
        Round(base, 1e-3, (Candidate(name, 0.5, 0.005, fitted=final),), (), (name,), final)
        for name in ("quadratic_drag", second)
    )
    told = SimpleNamespace(amounts=(SimpleNamespace(term=SimpleNamespace(law="normal velocity squared")),), alike=())
    told = SimpleNamespace(law=told)
    assert concluded(replace(state, final=final, rounds=rounds, balance=told), []).word == word
