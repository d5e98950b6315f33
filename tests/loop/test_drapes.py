"""Evidence of drapes: what tells faces and threads apart, and that neither chance nor a mesh does."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from clothbench import Outlines, Silhouettes
from clothbench.core.drape import outlines_of_points
from clothbench.core.parameters import Parameter, ParameterSpace
from clothbench.estimation.trials import Trial
from clothbench.plugins.discovery import catalogue
from clothbench.recordings.scenes import drapes_of
from clothbench.studies.improve.attribution import Probe
from clothbench.studies.improve.candidates import candidates_of
from clothbench.studies.improve.drape_quantities import (
    CONTRASTS,
    LEAST_SPREAD,
    alike,
    asymmetries,
    contrasts,
    elongation,
    line_of,
    specimens_of,
    spread_of,
)
from clothbench.studies.improve.drapes import (
    DrapeCase,
    DrapeError,
    DrapeEvidence,
    Drapemeter,
    DrapeRollout,
    quartered,
    turned,
)
from clothbench.studies.improve.fitted import Fitted, jackknife_interval
from clothbench.studies.improve.permutation import permutation_test
from clothbench.studies.improve.problem import Problem, residuals
from clothbench.studies.improve.refits import by_chance
from clothbench.studies.improve.selection import Candidate, assess, away_from_null, choose, told_from_nothing
from clothbench.studies.improve.settings import LOOP

PLATE, DISC = 0.09, 0.15
TURN = 2 * np.pi * np.arange(360) / 360


def captured(specimens, long=0.004, at=0.6, up=0.0, seed=0, sides=(1, 2)):
    """Outlines of specimens that are long along `at` rad, with DC that differs by the side."""
    random = np.random.default_rng(seed)
    radius, sample, side = [], [], []
    for k in range(specimens):
        for s in sides:
            mean = 0.125 + random.normal(0, 2e-4) + (up if s == 1 else -up)
            radius.append(mean + long * np.cos(2 * (TURN - at)) + 0.01 * np.cos(7 * TURN + random.uniform(0, 6)))
            sample.append(k)
            side.append(s)
    return Outlines(np.array(radius), PLATE, DISC, np.array(sample), 1e-4, 1.4e-3), np.array(side)


def evidence(specimens=8, resolution=13, **planted):
    """Of the specimens all but the last two are fitted."""
    seen, side = captured(specimens, **planted)
    (found,), sides = specimens_of([seen], [side], [True])
    drapes = Silhouettes(
        name="petals", image=blank(), sample=np.array([0]), side=np.array([1]), pixel_size=1.4e-3, disc_radius=DISC,
        plate_radius=PLATE, areal_density=0.15,
    )  # fmt: skip
    scenes = drapes_of(drapes, resolution=(resolution, resolution), starts=1)
    held = {"k1": 50.0, "zeta": 0.05}
    meter = Drapemeter((*scenes, *map(quartered, scenes)), sides, PLATE, DISC, held)
    return DrapeEvidence(
        tuple(DrapeCase(f"s{k}", "fit" if k < specimens - 2 else "held_out", one, meter) for k, one in found)
    )


def blank():
    x, y = np.meshgrid(np.arange(256) - 127.5, np.arange(256) - 127.5)
    return np.where(np.hypot(x, y) * 1.4e-3 < 0.12, 0, 255).astype(np.uint8)[None]


# --- what is read off ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("at", [0.0, 0.6, 1.5, 2.9])
def test_the_line_along_which_drapes_are_long_is_found_whatever_its_sign(at):
    seen, side = captured(6, at=at)
    found = elongation(seen.radius)
    assert np.abs(found) == pytest.approx(0.004, rel=1e-6)
    line = line_of(np.stack([found[side == s] for s in (1, 2)], axis=1))
    assert np.abs((found / line).real) == pytest.approx(0.004, rel=1e-6)
    assert np.abs((found / line).imag).max() < 1e-9


def test_specimens_have_a_mean_for_each_side_and_share_a_spread():
    seen, side = captured(5, up=0.003)
    (found,), sides = specimens_of([seen], [side], [True])
    assert sides == (1, 2)
    number, first = found[0]
    assert number == 0
    assert first.mean.shape == (2, 2)
    assert first.mean[0, 0] > first.mean[1, 0] + 0.05  # face up it covers more
    assert first.labels == (
        "drape coefficient face up", "elongation face up", "drape coefficient face down", "elongation face down",
    )  # fmt: skip
    assert (first.spread[[1, 3]] == LEAST_SPREAD[1]).all()  # all are alike; a floor keeps what nobody could tell apart


def test_the_spread_is_pooled_over_sides_and_knows_missing_ones():
    random = np.random.default_rng(1)
    values = random.normal([[[0.5, 0.0]], [[0.7, 0.004]]], [0.05, 0.002], (2, 4000, 2)).swapaxes(0, 1)
    assert spread_of(values) == pytest.approx([0.05, 0.002], rel=0.05)
    values[::2, 1] = np.nan
    assert spread_of(values) == pytest.approx([0.05, 0.002], rel=0.05)
    few = np.array([[1.0, 10.0], [2.0, 14.0], [3.0, np.nan]])[..., None].repeat(2, axis=2)
    np.testing.assert_allclose(spread_of(few), (10 / 3) ** 0.5)  # 2 + 8 over 2 + 1 degrees of freedom


def test_captures_of_one_drape_are_told_from_those_laid_on_anew():
    seen, side = captured(6, long=0.0)
    twice = Outlines(np.repeat(seen.radius, 2, axis=0), PLATE, DISC, np.repeat(seen.sample, 2), 1e-4, 1.4e-3)
    remembered = {r["pairs"]: r for r in alike([twice], [np.repeat(side, 2)], seed=0)}
    assert remembered["the same side of a specimen"]["correlation"] == pytest.approx(1.0)
    assert remembered["the same side of a specimen"]["number"] == 12
    assert remembered["the same side of a specimen"]["p_value"] < 0.01
    assert abs(remembered["different specimens"]["correlation"]) < 0.3
    anew = alike([seen], [side], seed=0)
    assert [r["pairs"] for r in anew] == ["the two sides of a specimen", "different specimens"]
    assert all(r["p_value"] > 0.05 for r in anew)


# --- chance -----------------------------------------------------------------------------------------------------------


class Fixed:
    """A simulation that always comes to the same quantities (S, Q)."""

    def __init__(self, quantity):
        self.quantity = quantity

    def run(self, theta):
        return DrapeRollout(self.quantity[None], ("ok",))


def test_a_name_has_to_hold_from_other_first_shapes():
    found = evidence(up=0.003)
    fitted = [case for case in found.cases if case.split == "fit"]
    told = np.mean([case.specimen.mean for case in fitted], axis=0)
    alike = np.repeat(told.mean(axis=0, keepdims=True), 2, axis=0)

    def leaves(quantity):
        return [
            Trial(case.name, case.specimen, Fixed(quantity), DrapeError(case.specimen)) for case in fitted
        ]  # fmt: skip

    def why(*others):
        problem = SimpleNamespace(
            evidence=found, relaid=lambda: [SimpleNamespace(trials=lambda *_, o=one: leaves(o)) for one in others]
        )
        before = SimpleNamespace(residual=[residuals(t, np.zeros((1, 1)))[0] for t in leaves(alike)])
        after = SimpleNamespace(effects=("curl",), theta=np.zeros(1))
        return by_chance(problem, before, after, SimpleNamespace(count=lambda number: None))

    assert why() == why(told, told) == ""
    assert why(told, alike) == ""  # on average, three quarters of the squares
    assert why(told, alike, alike, alike).startswith(
        "does not hold from other first shapes: faces and threads stay as unlike"
    )
    assert why(told, np.full((2, 2), np.nan)) == "cannot be simulated from other first shapes"


def test_other_first_shapes_are_simulated_anew():
    found = evidence()
    meter = found.cases[0].meter
    other = (dataclasses.replace(meter.scenes[0], start=1.5 * meter.scenes[0].start),)
    laid = DrapeEvidence(
        tuple(dataclasses.replace(c, meter=dataclasses.replace(meter, others=(other,))) for c in found.cases)
    )
    model = catalogue().make("models", "mass_spring")
    first = laid.cases[0].trial(model, (), None).simulation
    (again,) = laid.relaid()
    assert {c.meter.scenes for c in again.cases} == {other}
    assert again.relaid() == []
    assert again.cases[0].trial(model, (), None).simulation is not first
    assert found.relaid() == []


# --- symmetry --------------------------------------------------------------------------------------------------------


def test_a_cloth_that_is_alike_on_both_sides_and_along_both_threads_leaves_nothing_to_tell():
    found = evidence()
    case = found.cases[0]
    simulation = case.trial(catalogue().make("models", "mass_spring"), (), None).simulation
    drape = simulation.run(simulation.parameters.from_unit(np.array([[0.4], [0.6]])))
    assert drape.status == ("ok", "ok")
    np.testing.assert_allclose(drape.quantity[:, 0], drape.quantity[:, 1], atol=1e-9)  # face up and face down
    assert np.abs(drape.quantity[:, :, 1]).max() < 0.1e-3  # of two first shapes, a quarter apart
    assert (drape.quantity[:, :, 0] > 0.2).all()


def test_turning_over_twice_and_four_quarters_change_nothing():
    scene = evidence().cases[0].meter.scenes[0]
    again = turned(turned(scene))
    assert again.gravity == scene.gravity
    np.testing.assert_array_equal(again.start, scene.start)
    four = quartered(quartered(quartered(quartered(scene))))
    np.testing.assert_array_equal(four.start, scene.start)
    before = elongation(outlines_of_points(bulged(scene.start), (0, 0, 0), PLATE))
    after = elongation(outlines_of_points(bulged(quartered(scene).start), (0, 0, 0), PLATE))
    assert after == pytest.approx(-before, abs=1e-5)


def bulged(place):
    """Places (N, 3) moved outwards by their height."""
    away = place[:, :2] / np.linalg.norm(place[:, :2], axis=1, keepdims=True)
    return np.column_stack([place[:, :2] + place[:, 2:] * away, place[:, 2]])


def test_surrogates_are_turned_over_and_by_quarters():
    case = evidence().cases[0]
    draw, random = case.surrogates(np.array([1.0, 2.0, 3.0, 4.0])), np.random.default_rng(0)
    drawn = {tuple(draw(random)) for _ in range(100)}
    assert drawn == {(1, 2, 3, 4), (1, -2, 3, -4), (3, 4, 1, 2), (3, -4, 1, -2)}


def test_a_curl_makes_faces_and_threads_differ_and_specimens_share_one_simulation():
    found = evidence(up=0.004)
    problem = Problem("mass_spring", found, catalogue(), "least_squares")
    trials = problem.trials(("rest_curvature",), "fit")
    assert len({id(trial.simulation) for trial in trials}) == 1
    space = trials[0].simulation.parameters
    assert space.names == ("k2", "rest_curvature.warp", "rest_curvature.weft")
    flat, curled = (space.from_unit(space.to_unit(np.array([1.0, warp, 0.0]))) for warp in (0.0, 3e-4))
    away = residuals(trials[0], np.stack([flat, curled]))
    change = (away[1] - away[0]).reshape(2, 2)
    assert change[0, 0] * change[1, 0] < 0  # one face up drapes more, the other less
    assert change[0, 1] * change[1, 1] < 0  # and long lines of the one are short lines of the other


def test_only_forces_are_candidates():
    plugins = catalogue()
    names = candidates_of(None, "silhouette", (), plugins)
    assert {"rest_curvature", "bending_anisotropy"} <= set(names)
    assert not {"clock_offset", "grip_slip", "grip_patch", "load_offset"} & set(names)


# --- amounts together ------------------------------------------------------------------------------------------------


def fitted_amounts(amounts, random, count=8, noise=0.05):
    """A fit of two amounts of which the data hold the sum much better than the difference."""
    space = ParameterSpace(
        tuple(Parameter(f"e.{n}", n, "1", (-1.0, 1.0), "linear", 0.1, n, "", 0.0) for n in ("a", "b"))
    )
    jacobian = [np.array([[2.0, 2.0], [0.02, -0.02]]) for _ in range(count)]
    theta = np.array(amounts)
    residual = [noise * random.standard_normal(2) for _ in range(count)]
    low, high = jackknife_interval(space, theta, residual, jacobian)
    return Fitted(("e",), space, theta, residual, jacobian, low, high, evaluations=1)


def test_amounts_may_be_told_from_nothing_together_though_not_alone():
    random = np.random.default_rng(2)
    null = np.zeros(2)
    found = fitted_amounts([0.2, 0.2], random)
    assert (found.low < 0).all()
    assert (found.high > 0).all()
    assert told_from_nothing(found, [0, 1], null)


def test_nothing_is_rarely_told_from_nothing():
    random = np.random.default_rng(3)
    null, wrong = np.zeros(2), 0
    for _ in range(200):
        noise = np.array([0.05, 0.05]) * random.standard_normal((8, 2))
        found = fitted_amounts([0.0, 0.0], random)
        moved = np.linalg.lstsq(np.vstack(found.jacobian), noise.ravel(), rcond=None)[0] * 2
        found = dataclasses.replace(found, theta=moved)
        wrong += told_from_nothing(found, [0, 1], null)
    assert wrong / 200 < 2 * LOOP.significance


def even_amounts(t, wider=1.0):
    """Two amounts, each t standard errors from nothing, that four recordings tell one as well as the other: their means
    of ±e have a standard error of e/√3. Intervals are so many times as wide as recordings left out make them.
    """
    space = fitted_amounts([0.0, 0.0], np.random.default_rng(0)).space
    residual = [0.01 * np.array([a, b]) for a in (-1.0, 1.0) for b in (-1.0, 1.0)]
    theta = np.full(2, 2 * t * 0.01 / 3**0.5)  # half of it is its place in the unit cube
    low, high = jackknife_interval(space, theta, residual, [np.eye(2)] * 4)
    low, high = theta + wider * (low - theta), theta + wider * (high - theta)
    return Fitted(("e",), space, theta, residual, [np.eye(2)] * 4, low, high, evaluations=1)


def test_amounts_are_told_from_nothing_together_by_hotellings_bound():
    """T² = 2 t², of which (R − 2)/(2 (R − 1)) is above F(0.95; 2, R − 2) = (R − 2)/2 (0.05^(−2/(R − 2)) − 1)."""
    bound = (3 * 19 / 2) ** 0.5  # of t, for R = 4
    for wider, as_wide in ((1.0, 1.0), (2.0, 2.0), (0.5, 1.0)):  # never surer than recordings left out make it
        assert told_from_nothing(even_amounts(1.01 * as_wide * bound, wider), [0, 1], np.zeros(2))
        assert not told_from_nothing(even_amounts(0.99 * as_wide * bound, wider), [0, 1], np.zeros(2))


def test_one_amount_is_told_from_nothing_as_its_interval_has_it():
    for factor in (0.99, 1.01):
        found = even_amounts(3.1824 * factor)  # Student's t of three degrees of freedom
        assert told_from_nothing(found, [0], np.zeros(1)) == (found.low[0] > 0) == (factor > 1)


@pytest.mark.parametrize(
    ("bounds", "value", "away"),
    [
        ((-1.0, 1.0), 1.9e-3, False),
        ((-1.0, 1.0), -2.1e-3, True),
        ((-4.0, 0.0), -3.9e-3, False),
        ((-4.0, 0.0), -4.1e-3, True),
    ],
)
def test_an_amount_is_something_from_a_thousandth_of_its_range_on(bounds, value, away):
    space = ParameterSpace((Parameter("e.a", "a", "1", bounds, "linear", 0.0, "a", "", 0.0),))
    theta = np.array([value])
    found = Fitted(("e",), space, theta, [np.ones(2)] * 3, [np.ones((2, 1))] * 3, theta, theta, evaluations=1)
    assert away_from_null(found, [0]).tolist() == [away]


# --- what the drapes say themselves ----------------------------------------------------------------------------------


def test_drapes_say_without_a_model_what_symmetry_forbids():
    said = {}
    for name, planted in {"plain": {"long": 0.0}, "ribbed": {}, "curled": {"long": 0.0, "up": 0.004}}.items():
        seen, side = captured(8, **planted)
        (found,), _ = specimens_of([seen], [side], [True])
        said[name] = {r["contrast"]: r for r in asymmetries([s for _, s in found])}
    faces, threads = CONTRASTS[0][0], CONTRASTS[1][0]
    assert all(r["p_value"] > 0.05 and r["low"] < 0 < r["high"] for r in said["plain"].values())
    assert abs(said["ribbed"][threads]["mean"]) == pytest.approx(4.0, abs=0.1)  # mm
    assert said["ribbed"][threads]["p_value"] < 1e-3
    assert said["ribbed"][faces]["p_value"] > 0.05
    assert said["curled"][faces]["mean"] == pytest.approx(200 * 0.125 * 0.008 / (DISC**2 - PLATE**2), rel=0.05)  # %
    assert said["curled"][faces]["p_value"] < 1e-3
    seen, side = captured(2)
    (few,), _ = specimens_of([seen], [side], [True])
    assert asymmetries([s for _, s in few]) == []
    assert asymmetries([]) == []  # of a split that no recording is in


def test_a_line_chosen_from_the_specimens_makes_no_elongation():
    random, found = np.random.default_rng(0), {CONTRASTS[1][0]: [], CONTRASTS[2][0]: []}
    for _ in range(300):
        radius = 0.125 + np.zeros((10, len(TURN)))
        for at in (TURN, TURN + np.pi / 4):
            radius = radius + random.normal(0, 8e-3, (10, 1)) * np.cos(2 * at)
        seen = Outlines(radius, PLATE, DISC, np.repeat(np.arange(5), 2), 1e-4, 1.4e-3)
        (specimens,), _ = specimens_of([seen], [np.tile([1, 2], 5)], [True])
        for row in asymmetries([s for _, s in specimens]):
            if row["contrast"] in found:
                found[row["contrast"]].append(row["p_value"] < 0.05)
    assert [np.mean(each) for each in found.values()] == pytest.approx([0.05, 0.05], abs=0.03)


def test_a_name_explains_what_tells_faces_or_threads_apart_and_contradicts_none_of_it():
    found, random = evidence(), np.random.default_rng(5)
    noise = [0.1 * random.standard_normal(4) for _ in range(6)]
    # Long one way on both sides, which the base does not know.
    alike_faces = [r + np.array([0.0, 4.0, 0.0, 4.0]) for r in noise]
    better = [r + np.array([0.0, 0.5, 0.0, 0.5]) for r in noise]
    by_curling = [r + np.array([-2.0, 0.5, 2.0, 0.5]) for r in noise]  # at the price of faces that differ
    assert found.objection(alike_faces, better) == ""
    assert "drape coefficient, face up less face down" in found.objection(alike_faces, by_curling)
    assert "stay as unlike" in found.objection(alike_faces, alike_faces)
    heavier = [r + np.array([9.0, 0.0, 9.0, 0.0]) for r in noise]  # what stiffness, weight or the mesh would do as well
    assert "as alike as chance" in found.objection(heavier, noise)
    assert "stay as unlike" in found.objection([a + h for a, h in zip(alike_faces, heavier, strict=True)], alike_faces)
    twins = [np.array([0.0, 0.7, 0.0, 0.7])] * 6  # alike to a hair: less than other first shapes change is nothing yet
    assert "as alike as chance" in found.objection(twins, [0 * r for r in twins])


def test_contrasts_are_face_up_less_face_down_whichever_side_comes_first():
    up, down = [0.5, 4e-3], [0.3, 1e-3]  # drape coefficient and elongation
    expected = [0.2, 2.5e-3, 1.5e-3]
    np.testing.assert_allclose(contrasts(np.array([up, down]), (1, 2)), expected)
    np.testing.assert_allclose(contrasts(np.array([[9.0, 9.0], down, up]), (0, 2, 1)), expected)
    np.testing.assert_allclose(contrasts(np.array([up]), (1,)), [np.nan, 4e-3, np.nan])


def test_where_one_side_is_known_only_threads_can_be_told():
    seen, side = captured(5, sides=(1,))
    (found,), _ = specimens_of([seen], [side], [True])
    assert [r["contrast"] for r in asymmetries([s for _, s in found])] == [CONTRASTS[1][0]]


def test_a_side_that_only_recordings_held_out_have_takes_nothing_from_those_that_are_fitted():
    (seen, side), (unseen, others) = captured(5, sides=(1,)), captured(5, seed=1)
    alone = specimens_of([seen], [side], [True])[0][0]
    (fitted, held_out), sides = specimens_of([seen, unseen], [side, others], [True, False])
    assert sides == (1, 2)
    for (_, one), (_, other) in zip(fitted, alone, strict=True):
        assert (one.labels, one.known.tolist()) == (other.labels, [[True, True], [False, False]])
        np.testing.assert_array_equal(one.mean[:1], other.mean)
    assert held_out[0][1].known.all()
    rows = asymmetries([s for _, s in fitted])
    assert rows == asymmetries([s for _, s in alone])
    assert [r["contrast"] for r in rows] == [CONTRASTS[1][0]]
    cases = tuple(DrapeCase("s", "fit", one, Drapemeter((), sides, PLATE, DISC)) for _, one in fitted)
    long = [np.array([0.0, 4.0 + 0.1 * k]) for k in range(5)]
    assert DrapeEvidence(cases).objection(long, [0.1 * r for r in long]) == ""


def test_faces_are_compared_only_where_it_is_known_which_was_up():
    seen, side = captured(6, up=0.004)
    (found,), sides = specimens_of([seen], [np.where(side == 2, 0, side)], [True])
    assert sides == (0, 1)
    assert [r["contrast"] for r in asymmetries([s for _, s in found])] == [CONTRASTS[1][0]]


def test_specimens_of_several_recordings_are_told_apart_whatever_their_numbers():
    seen, side = captured(3)
    twice = [seen, dataclasses.replace(seen, sample=seen.sample + 1000)]
    pairs = {r["pairs"]: r["number"] for r in alike(twice, [side, side], seed=0)}
    assert pairs == {"the two sides of a specimen": 6, "different specimens": 60}
    assert pairs == {r["pairs"]: r["number"] for r in alike(twice[::-1], [side, side], seed=0)}


@pytest.mark.parametrize(("specimens", "said"), [(5, "too few to tell"), (8, "")])
def test_few_drapes_of_one_side_are_too_few_to_tell(specimens, said):
    seen, side = captured(specimens, sides=(1,))
    (found,), sides = specimens_of([seen], [side], [True])
    cases = [DrapeCase(f"s{k}", "fit", one, Drapemeter((), sides, PLATE, DISC)) for k, one in found]
    base = fitted_with((), [np.array([0.0, 4.0])] * specimens)  # all long one way, which is as much as can be
    columns = [np.array([[0.0], [1.0]])] * specimens
    probe = Probe("long", np.zeros(1), (0,), np.ones(1), np.zeros((1, 0)), columns)
    test = permutation_test(cases, base, [probe], 0)
    why = test.why_not(test.p_value(0))
    assert why.startswith(said) if said else not why


def test_what_contradicts_the_drapes_is_no_rival_of_the_others():
    random = np.random.default_rng(6)
    residual = [np.array([4.0, 1.0]) + 0.1 * random.standard_normal(2) for _ in range(6)]
    current = fitted_with((), residual)
    wrong = Candidate("wrong", 0.9, 0.01, fitted=fitted_with(("wrong",), [0.1 * r for r in residual]))
    right = Candidate("right", 0.9, 0.01, fitted=fitted_with(("right",), [0.3 * r for r in residual]))
    search = SimpleNamespace(together=False)
    strict = SimpleNamespace(
        search=search, objection=lambda before, after: "no" if after is wrong.fitted.residual else ""
    )
    lenient = SimpleNamespace(search=search, objection=lambda before, after: "")
    for evidence_of, named in ((strict, ("right",)), (lenient, ("wrong",))):
        assessed = assess(current, 1.0, [wrong, right], evidence_of)
        assert choose(current, assessed) == named
    assert {c.name: c.why_not for c in assess(current, 1.0, [wrong, right], strict)}["wrong"] == "no"


def fitted_with(effects, residual):
    """A fit whose one amount, if it has an effect, is far from nothing."""
    names = [f"{e}.amount" for e in effects]
    space = ParameterSpace(tuple(Parameter(n, "a", "1", (-1.0, 1.0), "linear", 0.1, n, "", 0.0) for n in names))
    theta, half = np.full(len(names), 0.5), np.full(len(names), 0.1)
    jacobian = [np.ones((2, len(names))) for _ in residual]
    return Fitted(effects, space, theta, residual, jacobian, theta - half, theta + half, evaluations=1)
