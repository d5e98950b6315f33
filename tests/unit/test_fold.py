"""Folds: the made-up strips, the parts of an estimate, and a suite of one fabric from the command's own parts."""

from dataclasses import replace

import numpy as np
import pytest
from clothbench_metrics.profile import Profile, nearest
from clothbench_models.kirchhoff_love import KirchhoffLove
from clothbench_optimizers.iterative_least_squares import IterativeLeastSquares

from clothbench import ClothbenchError, Observation, Rollout
from clothbench.core.folding import FoldState, circular_path, geometric_path, triangular_path
from clothbench.engine.leaderboard import leaderboard_row
from clothbench.engine.run import run_cell
from clothbench.engine.store import Store
from clothbench.engine.suite import plan as planned
from clothbench.plugins.discovery import catalogue
from clothbench.reference.fabrics import FABRICS, chosen_fabrics
from clothbench.reference.lifted_strip import lift
from clothbench.studies.folding.cell import FoldingCell, FoldSettings, fold_settings, selected
from clothbench.studies.folding.page import fold_section
from clothbench.studies.folding.run import hand_of
from clothbench.studies.folding.strip import TestStrip, scattered
from clothbench.studies.folding.tables import fold_table, summary

FIT = ("eta_b", "grip_offset.dx", "grip_offset.dz")
BOUNDS = {"grip_offset.dx": (-0.01, 0.01), "grip_offset.dz": (-0.01, 0.01)}


def cell(steps: int = 3, **changes) -> FoldingCell:
    settings = FoldSettings(steps=steps, friction=0.6, fit=FIT)
    content = {"suite": "folds", "case": "denim", "model": "kirchhoff_love", "effects": ("grip_offset",),
               "optimizer": "iterative_least_squares", "metric": "profile", "tracker": "laser_profile",
               "fold": settings, "bounds": BOUNDS, "evaluations": 120}  # fmt: skip
    return FoldingCell(**{**content, **changes})


def test_options_of_what_is_not_in_use_ask_nothing_else():
    assert cell(options={"ga": {"generations": 3}, "mass_spring": {"resolution": 9}}).key == cell().key
    for name in ("kirchhoff_love", "iterative_least_squares", "profile", "laser_profile", "grip_offset"):
        assert cell(options={name: {"word": 3}, "ga": {"generations": 3}}).key == cell(options={name: {"word": 3}}).key
        assert cell(options={name: {"word": 3}}).key != cell().key


def test_an_empty_choice_of_fabrics_is_none():
    assert selected({}) == selected({"select": None}) == ["*"]
    with pytest.raises(ClothbenchError, match=r"setting 'suite\.select' is empty; give some, for example"):
        selected({"select": []})


def test_the_table_of_fabrics_is_in_order():
    assert len(FABRICS) == 10
    for fabric in FABRICS:
        assert fabric.eta_low < fabric.eta < fabric.eta_high


@pytest.mark.parametrize("fabric", FABRICS, ids=lambda f: f.name)
def test_a_strip_is_as_stiff_as_its_fabric_within_its_spread(fabric):
    stiffness = scattered(fabric, 1.0, 4)(np.linspace(0, 1, 500))
    assert fabric.eta_low <= stiffness.min() < stiffness.max() <= fabric.eta_high


@pytest.mark.slow
def test_phase_one_lies_between_the_triangular_and_the_circular_path():
    """The stiffer the cloth, the nearer to the circle; to it, never beyond the triangle (figure 3 of the paper)."""
    strip, heights = KirchhoffLove().strip(1.0), (0.04, 0.2, 0.4)
    for height in heights:
        x = [strip.lift(height, np.array([[eta, 1e-5, 0.3]])).pose[0, 0] for eta in (1e2, 1e3, 1e4, 1e5)]
        assert (np.diff(x) < 0).all()
        assert triangular_path(1.0, height) < x[-1]
        assert x[0] < circular_path(1.0, height) + 1e-3


def test_a_geometric_path_is_a_half_circle_or_two_sides_of_a_triangle():
    """Up to the middle of the way; an end that is at half the strip's length is above its middle."""
    share = np.linspace(0.0, 0.5, 7)
    for name, path in (("circular", circular_path), ("triangular", triangular_path)):
        x, z = geometric_path(name, 1.2, share).T
        np.testing.assert_allclose(path(1.2, z), x, atol=1e-12)
        np.testing.assert_allclose([x[0], z[0], x[-1], z[-1]], [1.2, 0.0, 0.6, 0.6], atol=1e-12)
    x, z = geometric_path("circular", 1.2, share).T
    np.testing.assert_allclose((x - 0.6) ** 2 + z**2, 0.36)


def test_friction_has_no_sign():
    """A desk holds a strip that is pushed as one that is pulled."""
    state = FoldState(np.zeros((2, 3)), np.zeros((2, 4, 2)), np.array([0.4, -0.4]), np.array([2.0, 1.0]), ("ok", "ok"))
    assert state.friction.tolist() == [0.2, 0.4]


def test_the_strip_that_is_held_where_it_wants_to_be_pulls_at_nothing():
    strip, theta = KirchhoffLove().strip(1.0), np.array([[5e3, 1e-5, 0.3]])
    near = strip.lift(0.2, theta)
    held = strip.hold(near.pose, theta, near)
    assert np.abs(held.profile - near.profile).max() < 1e-6
    assert held.friction[0] < 1e-4
    aside = strip.hold(near.pose + np.array([0.01, 0.0, 0.0]), theta, near)
    assert aside.pull[0] > 0.01


def test_a_sheet_is_not_what_the_model_says_but_near():
    fabric = next(f for f in FABRICS if f.name == "denim")
    sheet = TestStrip.of(fabric, 1.0, lambda purpose: 8)
    free = lift(1.0, sheet.stiffness, 0.2)
    moved = sheet.move(np.array(free.pose))
    assert np.hypot(*(np.array(moved.pose[:2]) - free.pose[:2] - sheet.offset)) < 1e-6
    flat = KirchhoffLove().strip(1.0).lift(0.2, np.array([[fabric.eta, 1e-5, 0.3]]))
    away = np.abs(flat.profile[0] - free.line(np.linspace(0, 1, flat.profile.shape[1]))).max()
    assert 1e-4 < away < 2e-2


def test_profile_is_half_the_sum_of_squares():
    """Equation 7: a surface given as points, measured points 3 mm beside two of them."""
    surface = np.stack([np.linspace(0, 1, 11), np.zeros(11), np.zeros(11)], axis=1)
    points = np.array([[[0.3, 0.0, 0.003], [0.6, 0.0, -0.003], [np.nan] * 3]])
    seen = Observation(np.zeros(1), points, np.isfinite(points).all(-1), 1e-4, np.zeros((3, 2)))
    score = Profile()(seen, Rollout(np.zeros(1), surface[None, None], ("ok",), np.zeros(1, int), 11))
    assert score.value[0] == pytest.approx(0.5 * 2 * 0.003**2)
    assert (score.residual**2).sum() / 2 == pytest.approx(score.value[0])


def test_a_fine_surface_may_slide_along_itself():
    """Points between those of the surface count as lying on it; far ones are not joined."""
    surface = np.stack([np.linspace(0, 0.01, 11), np.zeros(11), np.zeros(11)], axis=1)
    points = np.array([[0.0034, 0.0, 0.002], [0.0071, 0.0, -0.001]])
    assert nearest(surface, points, 2e-3) == pytest.approx(np.array([[0, 0, -0.002], [0, 0, 0.001]]), abs=1e-12)
    assert nearest(surface, points, 1e-4)[0, 0] == pytest.approx(-0.0004)


def test_layers_that_lie_close_are_not_joined():
    """Two layers 1.5 mm apart with points 2 mm apart: a point between the layers is as far away as the nearer one."""
    x = np.linspace(0, 0.02, 11)
    lower, upper = np.stack([x, 0 * x, 0 * x], axis=1), np.stack([x[::-1], 0 * x, 0 * x + 1.5e-3], axis=1)
    between = np.array([[0.0101, 0.0, 0.6e-3]])
    away = nearest(np.concatenate([lower, upper]), between, 2.1e-3)
    assert away == pytest.approx(np.array([[0.0, 0.0, -0.6e-3]]), abs=1e-9)


def test_the_search_goes_on_from_where_it_stood():
    from clothbench.testing.toys import bowl

    problem = bowl()
    search = IterativeLeastSquares(problem.space, seed=0, budget=60)

    def run() -> int:
        asked = 0
        while not search.done:
            theta = search.ask()
            asked += len(theta)
            search.tell(theta, problem.evaluate(theta))
        return asked

    first = run()
    stood = search.here.copy()
    search.renew()
    assert not search.done
    assert problem.space.to_unit(search.ask())[0] == pytest.approx(stood)
    assert run() < first


def test_a_fold_ends_near_its_fabric(tmp_path):
    """Three steps of denim: the rows, the steps, the table and the page; and the same again to the bit."""
    store = Store(tmp_path)
    told = []
    assert run_cell(cell(), tmp_path, progress=lambda _, step, value: told.append(step)) == "ok"
    assert told == [1, 2, 3]
    rows = {r["metric"]: r for r in store.rows()}
    eta = rows["eta_b"]
    assert (eta["case"], eta["unit"], eta["reference"], eta["status"]) == ("denim", "m^-4 s^2", 5.2e3, "ok")
    assert eta["low"] < eta["value"] < eta["high"]
    assert 3.4e3 <= eta["value"] <= 8.3e3
    assert rows["friction"]["value"] < rows["friction"]["reference"] == 0.6
    assert rows["grip_offset_error"]["value"] < 2.0
    assert rows["tracker_error"]["value"] < 0.6
    steps = store.table("fold")
    assert [s["step"] for s in steps] == [1, 2, 3]
    assert steps[0]["z"] == pytest.approx(0.04)
    for step in steps:  # the stiffer the cloth, the further out it is led
        assert step["reference_x_low"] > step["reference_x"] > step["reference_x_high"]
    led = KirchhoffLove().strip(1.0).lift(0.12, np.array([[5.2e3, 1e-5, 0.3]])).pose[0, 0]
    assert steps[-1]["reference_x"] == pytest.approx(led, abs=1e-9)
    assert "denim" in fold_section(store.rows(), steps).whole
    assert fold_table("folds", store.rows(), steps).row_count == 1
    assert summary(steps).startswith("within ± 2σ at the last step: 1 of 1")
    assert leaderboard_row(eta)["recording"] is None
    other = Store(tmp_path / "again")
    run_cell(cell(), other.folder)
    assert [s["value"] for s in other.table("fold")] == [s["value"] for s in steps]


def test_a_reference_whose_state_is_not_found_has_no_path():
    class OneIsLost:
        def lift(self, height, theta):
            pose = np.arange(9.0).reshape(3, 3)
            return FoldState(pose, np.zeros((3, 4, 2)), np.zeros(3), np.ones(3), ("ok", "diverged", "ok"))

    path = replace(hand_of(cell(), catalogue()), strip=OneIsLost()).reference_path(0.1)
    assert path == {"reference_x": 0.0, "reference_x_low": None, "reference_x_high": 6.0}


def test_after_the_time_limit_no_step_is_begun(tmp_path):
    assert run_cell(cell(timeout=1e-9), tmp_path) == "timeout"
    (row,) = [r for r in Store(tmp_path).rows() if r["metric"] == "eta_b"]
    assert (row["status"], row["reason"]) == ("timeout", "stopped by the time limit after 1 of 3 steps")
    assert [s["step"] for s in Store(tmp_path).table("fold")] == [1]


def test_settings_are_checked():
    assert fold_settings({"steps": 3}).steps == 3
    with pytest.raises(ClothbenchError, match=r"setting of 'suite\.fold' 'hight' is not known"):
        fold_settings({"hight": 3})
    with pytest.raises(ClothbenchError, match=r"30 steps of 0\.04 m reach 1\.2 m"):
        fold_settings({"steps": 30})
    with pytest.raises(ClothbenchError, match=r"matches no fabric; there are: coating"):
        chosen_fabrics(["silk"])
    hand = hand_of(cell(fold=FoldSettings(first=1.0, fit=FIT)), catalogue())
    with pytest.raises(ClothbenchError, match=r"'suite\.fold\.first' is 1, expected 100 to 1e"):
        _ = hand.space


@pytest.mark.parametrize(
    ("changes", "found"),
    [
        (
            {"suite": {"fold": {"fit": ["eta_b", "eta_x"]}}},
            r"'suite.fold.fit': no parameter 'eta_x'; did you mean 'eta_m'\? there",
        ),
        (
            {"suite": {"fold": {"fit": ["eta_b", "grip_offset.dx"]}}, "effects": []},
            "'suite.fold.fit': no parameter 'grip",
        ),
        ({"bounds": {"eta_x": [1.0, 2.0]}}, r"'bounds': no parameter 'eta_x'; did you mean 'eta_m'\? there are: eta_b"),
        (
            {"suite": {"fold": {"fit": ["nu", "eta_b"]}}, "bounds": {}},
            "'suite.fold.fit' begins with 'nu', expected 'eta_b'",
        ),
        ({"suite": {"fold": {"fit": ["eta_b", "eta_b"]}}}, "'suite.fold.fit': 'eta_b' is there twice"),
        ({"suite": {"fold": {"first": 1e9}}, "bounds": {}}, "'suite.fold.first' is 1e"),
        ({"suite": {"fold": {"first": 300.0}}, "bounds": {"eta_b": [500, 1000]}}, "expected 500 to 1000, as eta_b"),
        ({"bounds": {"nu": [0.1, 0.2]}}, "'bounds.nu': it is not estimated; name it in suite.fold.fit"),
    ],
)
def test_parameters_that_cannot_be_estimated_or_are_not_are_refused(changes, found):
    base = {
        "study": "folding", "model": "kirchhoff_love", "effects": ["grip_offset"], "optimizer": "ga",
        "metric": "profile", "tracker": "laser_profile", "budget": 10, "seed": 0, "jobs": 1, "out": "runs",
        "rerun": False, "bounds": {"grip_offset.dx": [-0.005, 0.005]},
        "suite": {"fold": {"fit": ["eta_b", "grip_offset.dx"]}},
    }  # fmt: skip
    assert planned(base, catalogue())
    with pytest.raises(ClothbenchError, match=found):
        planned({**base, **changes}, catalogue())


@pytest.mark.parametrize("name", ["grip_slip", "grip_rotation", "grip_compliance"])
def test_effects_that_leave_a_single_grip_at_rest_where_it_is_are_refused(name):
    """Their parameters had been estimated as what they do nothing at, in an interval up to the bound."""
    with pytest.raises(ClothbenchError, match=f"effect '{name}' moves no single grip at rest"):
        hand_of(cell(effects=(name,)), catalogue())
    assert hand_of(cell(), catalogue()).effects


def test_a_cell_is_keyed_by_what_it_depends_on():
    assert cell().key == cell().key
    assert cell().key != cell(steps=4).key
    assert cell().stream("fabric") == cell(steps=4).stream("fabric") != cell().stream("gripper")


def held_too_far_out(friction: float) -> TestStrip:
    strip = TestStrip(1.0, lambda u: 5e3 + 0 * u, np.zeros(2), friction)
    strip.move(np.array(lift(1.0, strip.stiffness, 0.2).pose) + np.array([0.02, 0.0, 0.0]))
    return strip


def test_a_strip_that_is_pulled_at_slips_until_friction_holds_it():
    holds, slips = held_too_far_out(10.0), held_too_far_out(0.01)
    assert holds.origin == 0
    assert slips.needed == pytest.approx(holds.needed)
    assert slips.needed > 0.01
    assert 0 < slips.origin < 0.02
    assert slips.state.pull / slips.state.press == pytest.approx(0.01, rel=1e-3)
    assert slips.line(np.zeros(1))[0, 0] == slips.origin
    nowhere = held_too_far_out(1e-6)
    assert nowhere.origin == pytest.approx(0.02, abs=1e-4)  # without friction it goes back to where nothing pulls


def test_a_strip_that_a_guess_far_off_has_bent_is_lifted_on():
    """The pose of cloth twenty times as limp leaves it so bent that the next lift would find it rolled up."""
    fabric = next(f for f in FABRICS if f.name == "denim")
    strip = TestStrip.of(fabric, 1.0, cell().stream)
    for height, eta in ((0.04, 1e5), (0.08, 1.3e3)):
        strip.move(KirchhoffLove().strip(1.0).lift(height, np.array([[eta, 1e-5, 0.3]])).pose[0])
    assert strip.state.pose[2] < np.pi / 2


def test_a_strip_that_would_leave_the_desk_altogether_is_told_in_a_line(tmp_path):
    short = cell(case="chanel", fold=FoldSettings(length=0.06, steps=1, rise=0.02, first=300.0, fit=FIT))
    assert run_cell(short, tmp_path) == "error"
    (row,) = Store(tmp_path).rows()
    assert "a strip of 0.06 m with its end at" in row["reason"]
    assert "would leave the desk altogether: take a longer strip (suite.fold.length), or lift it less" in row["reason"]


def test_first_guesses_far_apart_end_alike(tmp_path):
    """From 10² and from 10⁵ m⁻⁴ s², stiffer and limper than any fabric of the table, to the same estimate."""
    ends = []
    for first in (1e2, 1e5):
        guessed = cell(fold=FoldSettings(steps=3, first=first, friction=0.6, fit=FIT))
        store = Store(tmp_path / f"{first:g}")
        assert run_cell(guessed, store.folder) == "ok"
        ends.append(store.table("fold"))
    first, last = ([steps[n]["value"] for steps in ends] for n in (0, -1))
    assert max(last) / min(last) < 1.02
    assert max(first) / min(first) > 1.1  # they had not ended alike after one step
