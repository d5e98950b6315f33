"""What `clothbench suggest` reckons with, on numbers that are known, and the motions that it offers."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from clothbench import ClothbenchError, Parameter, ParameterSpace, Scene
from clothbench.suggest import ranking, subject
from clothbench.suggest.experiments import (
    AS_RECORDED,
    EXPERIMENTS,
    GRIPS,
    HOLD,
    LET_OUT,
    LOWER,
    MOTIONS,
    RATE,
    RISE,
    directions,
    experiment,
    experiments,
    fastest,
)  # fmt: skip
from clothbench.suggest.information import (
    BEFOREHAND,
    beforehand,
    counted_noise,
    gain,
    half_widths,
    information,
    pull_of,
    separation,
)  # fmt: skip
from clothbench.suggest.settings import Wanted, wanted_of

RANDOM = np.random.default_rng(5)


def scene() -> Scene:
    """A sheet of 0.3 m × 0.4 m held at two points of its upper edge; the warp lies along world y."""
    clock = np.linspace(0.0, 1.0, 11)
    held = np.array([[0.05, 0.0], [0.25, 0.0]])
    at = np.array([[0.2, -0.1, 1.5], [0.2, 0.1, 1.5]])
    points = np.array([[0.0, 0.4], [0.15, 0.2], [0.3, 0.4]])
    return Scene(0.3, 0.4, 0.2, clock, held, np.repeat(at[None], 11, axis=0), clock, points)


def test_without_measurements_an_interval_is_the_whole_range():
    assert half_widths(beforehand(3), np.zeros(3)) == pytest.approx([BEFOREHAND] * 3)


def test_information_of_a_known_slope():
    """100 points of slope 2 and noise 0.1: σ = 0.1 / √(100 · 4)."""
    told = information(np.full((100, 1), 2.0), 0.1)
    known = beforehand(1) + told
    assert half_widths(known, np.zeros(1)) == pytest.approx([1.96 * 0.005], rel=1e-3)
    pull = pull_of(np.full((100, 1), 2.0), np.full(100, -0.05), 0.1)  # an error of slope and all: a shift by 0.025
    assert half_widths(known, pull) == pytest.approx([1.96 * 0.005 + 0.025], rel=1e-3)
    assert gain(known, 3 * known) == pytest.approx(np.log(2))  # four times as much, half as wide


def test_white_noise_counts_as_what_it_is_and_errors_that_last_count_for_more():
    jacobian = RANDOM.normal(size=(6000, 3))
    seconds = np.array_split(np.arange(6000), 30)
    noise = RANDOM.normal(0.0, 0.2, 6000)
    assert counted_noise(noise, jacobian, seconds, 0.2) == pytest.approx(0.2, rel=0.15)
    steady = np.ones((6000, 3)) + 0.1 * jacobian  # such errors look like these parameters
    lasting = np.repeat(RANDOM.normal(0.0, 0.2, 30), 200)
    assert counted_noise(lasting, steady, seconds, 0.2) > 0.2 * np.sqrt(200) / 3


def test_a_rival_makes_up_for_what_it_can():
    """What its own parameter does as well is no difference, as far as it is free to move and inside its bounds."""
    way = np.ones((400, 1))
    free, held = beforehand(1), np.array([[1e8]])
    apart = np.full(400, -0.3)  # a change of 0.3 of its range
    sure = np.zeros(400)
    assert separation(apart, way, free, np.array([0.5]), np.zeros(1), 0.1, sure)[0] < 1.5
    assert separation(apart, way, held, np.array([0.5]), np.zeros(1), 0.1, sure) == pytest.approx([60, 60], rel=1e-3)
    near_its_end, _ = separation(apart, way, free, np.array([0.9]), np.zeros(1), 0.1, sure)  # 0.1 is all that is left
    assert near_its_end == pytest.approx(20 * 0.2 / 0.1, rel=0.01)


def test_a_model_that_may_be_wrong_by_as_much_tells_nothing_apart():
    apart, way, held = np.full(400, -0.3), np.ones((400, 1)), np.array([[1e8]])
    for share, left in ((0.25, 0.5), (0.5, 0.0), (1.0, 0.0)):
        found, least = separation(apart, way, held, np.array([0.5]), np.zeros(1), 0.1, share * apart)
        assert found == pytest.approx(60, rel=1e-3)
        assert least == pytest.approx(60 * np.sqrt(left), rel=1e-3, abs=1.0)


def test_everything_offered_is_there():
    assert {grips for grips, _ in EXPERIMENTS} == {AS_RECORDED, *GRIPS}
    assert {motion for _, motion in EXPERIMENTS} == set(MOTIONS)
    assert len(set(EXPERIMENTS)) == len(EXPERIMENTS)


def test_motions_keep_to_what_the_robot_can_and_end_where_they_began():
    wanted = Wanted(max_speed=0.4, max_acceleration=3.0, reach=0.1, durations=(1.0, 1.5))
    offered = list(experiments(scene(), 30.0, wanted, contact=True))
    assert len(offered) > 20
    for one in offered:
        for duration in one.durations:
            path = one.lasting(duration).grip_position
            speed, acceleration = fastest(path)
            assert speed <= 0.4 + 1e-9
            assert acceleration <= 3.0 + 1e-9
            assert np.linalg.norm(path - path[0], axis=-1).max() <= 0.1 + 1e-9
            end = round((duration + RISE) * RATE)
            assert path[end:] == pytest.approx(np.repeat(path[:1], len(path[end:]), axis=0), abs=1e-9)
            assert one.fastest(duration) == fastest(path)
    assert any(np.ptp([one.fastest(duration) for duration in one.durations]) > 0 for one in offered)


def test_a_motion_goes_the_way_it_is_called():
    swung = experiment(scene(), 30.0, Wanted(), AS_RECORDED, "swing across the sheet, 1 Hz")
    across, out, up, middle = directions(scene())
    assert across == pytest.approx([0.0, 1.0, 0.0])
    assert middle == pytest.approx([0.2, 0.0, 1.5])
    moved = swung.scene.grip_position - swung.scene.grip_position[0]
    assert np.abs(moved @ out).max() > 0.05
    assert np.abs(moved @ across).max() == pytest.approx(0.0, abs=1e-12)
    lowered = experiment(scene(), 30.0, Wanted(), AS_RECORDED, LOWER)
    assert lowered.scene.obstacles[-1].centre[2] < 1.5 - 0.4
    assert (lowered.scene.grip_position[..., 2] @ np.ones(2)).min() < 3.0 - 0.1
    assert up == pytest.approx([0.0, 0.0, 1.0])


def test_what_cannot_be_done_is_not_offered():
    slow = Wanted(max_acceleration=0.01, durations=(1.0,))
    assert {one.motion for one in experiments(scene(), 30.0, slow, contact=True)} <= {HOLD, "pull longer by 2 %"}
    assert LOWER not in {one.motion for one in experiments(scene(), 30.0, Wanted(), contact=False)}
    corners = np.array([[0.0, 0.0], [0.3, 0.0], [0.15, 0.4]])
    cut = dataclasses.replace(scene(), outline=corners)
    assert {one.grips for one in experiments(cut, 30.0, Wanted(), contact=True)} == {AS_RECORDED}
    with pytest.raises(ClothbenchError, match="a cloth that was cut along an outline may not have"):
        next(experiments(cut, 30.0, Wanted(grips=("two corners",)), contact=True))
    with pytest.raises(ClothbenchError, match=r"setting 'durations' begins with 0.03 s, expected two frames at least"):
        next(experiments(scene(), 30.0, Wanted(durations=(0.03,)), contact=True))
    with pytest.raises(ClothbenchError, match="setting 'grips' names '', expected some of as recorded, two corners"):
        next(experiments(scene(), 30.0, Wanted(grips=("",)), contact=True))


@pytest.mark.parametrize("slow", [{"reach": 0.015}, {"max_speed": 0.02}, {"max_acceleration": 0.3}])
def test_cloth_that_would_not_meet_the_table_is_not_lowered_onto_it(slow):
    assert experiment(scene(), 30.0, Wanted(**slow), AS_RECORDED, LOWER) is None
    lowered = experiment(scene(), 30.0, Wanted(durations=(0.1, 2.0)), AS_RECORDED, LOWER)
    assert lowered.durations == (2.0,)  # after a tenth of a second it has not come down
    assert lowered.scene.times[-1] == pytest.approx(2.0)


def test_a_swing_that_is_let_out_lasts_longer_than_its_grips_move():
    assert experiment(scene(), 30.0, Wanted(durations=(0.5, 1.0)), AS_RECORDED, LET_OUT) is None
    assert experiment(scene(), 30.0, Wanted(durations=(1.0, 2.0)), AS_RECORDED, LET_OUT).durations == (2.0,)


def test_grips_as_the_sheet_was_recorded_in_are_known_by_their_name():
    corners = dataclasses.replace(
        scene(), grip_material=np.array([[0.0, 0.0], [0.3, 0.0]]),
        grip_position=np.repeat(np.array([[[0.2, -0.15, 1.5], [0.2, 0.15, 1.5]]]), 11, axis=0),
    )  # fmt: skip
    wanted = Wanted(grips=("two corners",))
    assert {one.grips for one in experiments(corners, 30.0, wanted, contact=True)} == {AS_RECORDED}
    assert {one.grips for one in experiments(scene(), 30.0, wanted, contact=True)} == {"two corners"}


@pytest.mark.parametrize(
    ("word", "said"),
    [
        ({"max_speed": "fast"}, "setting 'max_speed' is 'fast', expected a number above 0"),
        ({"reach": "0"}, "setting 'reach' is '0', expected a number above 0"),
        ({"durations": "1,-2"}, "setting 'durations' is '-2', expected a number above 0"),
        ({"durations": "0.001"}, "setting 'durations' is '0.001', expected seconds from 0.02 to 600"),
        ({"draws": "99999999999"}, "setting 'draws' is '99999999999', expected 1000 at most"),
        ({"grips": ""}, "setting 'grips' is '', expected names with a comma between each two"),
        ({"grips": "two corners,"}, "setting 'grips' is 'two corners,', expected names"),
        ({"draws": "1.5"}, "setting 'draws' is '1.5', expected a whole number, 0 or above"),
    ],
)
def test_settings_that_make_no_sense(word, said):
    with pytest.raises(ClothbenchError, match=said):
        wanted_of(word)


@pytest.mark.parametrize("count", [4, 40])
def test_as_many_parameter_sets_are_drawn_as_are_asked_for(count, monkeypatch):
    """The recordings fit well on one side of the fit only, which first-order tells nobody: there the sets lie."""
    space = ParameterSpace((Parameter("a", "a", "1", (0.0, 1.0), "linear", 0.5, "a number", "a test"),))
    fitted = SimpleNamespace(space=space, effects=(), residual=[np.zeros(1)], jacobian=[np.zeros((1, 1))])
    known = SimpleNamespace(fitted=fitted, unit=np.array([0.5]), matrix=np.array([[100.0]]), counted=np.ones(1))
    problem = SimpleNamespace(seed=0, trials=lambda effects, split: [None])
    monkeypatch.setattr(ranking, "residuals", lambda trial, theta: 30.0 * (theta < 0.5))
    sets = ranking.draws(SimpleNamespace(known=known, problem=problem), count)
    assert len(np.unique(sets)) == 1 + count
    assert (sets[1:] > 0.5).all()


def test_settings_as_they_are_given():
    wanted = wanted_of({"durations": "[2,1]", "max_speed": "0.3", "best": "2"})
    assert (wanted.durations, wanted.max_speed, wanted.best) == ((1.0, 2.0), 0.3, 2)


def fit_of(left: float, names: tuple[str, ...]) -> SimpleNamespace:
    """What is known of a fit of one parameter that leaves so much of two recordings."""
    space = ParameterSpace((Parameter("a", "a", "1", (0.0, 1.0), "linear", 0.5, "a number", "a test"),))
    fitted = SimpleNamespace(
        space=space, theta=np.array([0.5]), effects=names, residual=[np.full(9, left)] * 2,
        jacobian=[np.ones((9, 1))] * 2,
    )  # fmt: skip
    return subject.Known(fitted, np.full(2, 0.1), 0.01, (np.zeros(9),) * 2, np.empty(0), np.empty(0))


@pytest.mark.parametrize(("left", "first"), [(0.11, "drag"), (0.099, "drag"), (0.01, "wind")])
def test_what_clearly_fits_better_is_what_the_others_are_held_against(left, first, monkeypatch):
    """left: m, by the rival, beside 0.1 m and a noise as large: 1.4 σ less is no reason to change places."""
    fits = {("drag",): fit_of(0.1, ("drag",)), ("wind",): fit_of(left, ("wind",))}
    monkeypatch.setattr(subject, "require_sheets", lambda problem: None)
    monkeypatch.setattr(subject, "searched", lambda problem, names, start=None: fits[names])
    found = subject.subject_of(None, ("drag",), [("drag", "wind")])
    (tie,) = found.ties
    assert (found.known.fitted.effects, tie.one, {tie.one, tie.other}) == ((first,), first, {"drag", "wind"})
    more = 18 * (left**2 - 0.1**2) / 0.1**2
    apart = (tie.now, tie.behind) if first == "drag" else (tie.behind, tie.now)
    assert apart == pytest.approx((np.sqrt(max(more, 0.0)), np.sqrt(max(-more, 0.0))))


def test_what_makes_intervals_wider_is_not_suggested_first():
    """The mesh pulls by more than the experiment tells, which nats do not know of; a parameter asked for is its own."""
    made = [SimpleNamespace(name="table"), SimpleNamespace(name="swing")]
    table, swing = (
        ranking.Promise(one, 1.0, gain, np.array(after), np.array(after), np.array(after), (), 0.1, 0.0)
        for one, gain, after in zip(made, (2.7, 1.8), ([0.4, 0.1], [0.21, 0.05]), strict=True)
    )
    space = SimpleNamespace(names=("a", "b"))
    known = SimpleNamespace(half=np.array([0.2, 0.1]), fitted=SimpleNamespace(space=space))
    asked = SimpleNamespace(known=known, ties=())
    assert (table.widens(known.half), swing.widens(known.half)) == (True, False)
    assert ranking.ranked(asked, [table, swing], None) == [swing, table]
    assert ranking.ranked(asked, [swing, table], "b") == [swing, table]
