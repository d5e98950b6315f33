"""Forces that nobody declared: told from the balance of torques, without a model, and described by the sparsest law."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from clothbench import Observation, Recording, Scene, write_recording
from clothbench.cli.improve import command
from clothbench.plugins.discovery import catalogue
from clothbench.studies.improve.balance import delayed, late, power, terms
from clothbench.studies.improve.described import NUMBERS, Described
from clothbench.studies.improve.law import Amount, Law, Series, as_good_as, chance, jackknife, law_of, selected
from clothbench.studies.improve.motion import Motion, bridged, motion_of, smoothed, steady_axes
from clothbench.studies.improve.settings import LOOP
from clothbench.studies.improve.torque import LAGS, balance_of, kernel_of, left_out, of_past, past_of, smoothest

WIDTH, HEIGHT, DENSITY, NOISE = 0.3, 0.35, 0.18, 1e-3
NAMED = {term.name: term for term in terms()}


def law(**coefficients):
    """A law by the names of its terms."""
    return Law(tuple(Amount(NAMED[name], v, v, v) for name, v in coefficients.items()), 0.0, 0.005, 1.0, 0.5, 0.1)


def swung(number: int) -> Scene:
    """A sheet held at its upper corners, which are moved to and fro across it, in each recording another way."""
    time = np.arange(0.0, 4.0, 1 / 30)
    rate, size = ((0.6, 0.05), (0.9, 0.04), (1.3, 0.03), (0.8, 0.06), (1.1, 0.035))[number % 5]
    clock = np.linspace(0.0, 4.0, 601)
    held = np.array([[0.0, 0.0, 0.0], [WIDTH, 0.0, 0.0]])
    ramp = np.minimum(clock / 0.5, 1.0)
    away = size * ramp * np.sin(2 * np.pi * rate * clock + number)
    path = held + np.stack([0.3 * away, away, 0 * away], axis=1)[:, None]
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(0, WIDTH, 9), np.linspace(0, HEIGHT, 9)))
    return Scene(WIDTH, HEIGHT, DENSITY, clock, held[:, [0, 2]], path, time, np.stack([u, v], axis=1),
                 resolution=(13, 15))  # fmt: skip


@lru_cache
def simulated(number: int, planted: tuple[tuple[str, float], ...], effect: str = "") -> tuple[Scene, np.ndarray]:
    """Positions (T, N, 3) m of one recording, damped, with a law or an effect planted, without noise."""
    scene, model = swung(number), catalogue().make("models", "mass_spring")
    truth = {"k1": 200.0, "k2": 2.0, "zeta": 0.05, "linear_drag.coefficient": 0.1}
    effects = [catalogue().make("effects", "linear_drag")]
    if planted and not effect:
        described = Described(law(**dict(planted)))
        effects.append(described)
        names = [name for name, _ in NUMBERS]
        values = described.held | {names[slot]: value for slot, value in described.start.items()}
        truth |= {f"described.{name}": value for name, value in values.items()}
    elif effect:
        effects.append(catalogue().make("effects", effect))
        truth |= {f"{effect}.{name}": value for name, value in planted}
    simulation = model.prepare(scene, effects)
    theta = [truth.get(p.name, p.default if p.null is None else p.null) for p in simulation.parameters]
    rollout = simulation.run(np.array([theta]))
    assert rollout.status == ("ok",)
    return scene, rollout.position[0]


def motions(planted=(), effect="", seed=0, count=5):
    """What is seen of `count` recordings, with noise."""
    out, random = [], np.random.default_rng(seed)
    for number in range(count):
        scene, position = simulated(number, planted, effect)
        seen = position + random.normal(0, NOISE, position.shape)
        visible = random.random(position.shape[:2]) > 0.01
        observation = Observation(scene.times, np.where(visible[..., None], seen, np.nan), visible, NOISE, scene.points)
        found = motion_of(observation, scene, NOISE)
        assert found is not None
        out.append(found)
    return out


def test_weight_and_inertia_balance_what_acts_from_outside():
    """Without any air but what is declared, the torque that is missing is that of the declared damping."""
    for motion in motions():
        declared = 0.1 * motion.torque(-motion.v)
        left = motion.missing - declared
        assert np.sqrt(np.mean(left**2)) < 0.4 * np.sqrt(np.mean(declared**2))


PLANTED = [
    ("normal velocity to the power 2", (("normal", 1.1),), "quadratic_drag", 0.5 * 1.2 * 1.1),
    ("normal velocity to the power 1.5", (("normal velocity to the power 1.5", 0.5),), "", 0.5),
    ("place along y", (("place along y", 6.0),), "", 6.0),
    ("mass along the lower edge", (("mass along the lower edge", 0.01),), "", 0.01),
    ("a steady force along y", (("a steady force along y", 0.15),), "", 0.15),
]


@pytest.mark.parametrize(("name", "planted", "effect", "amount"), PLANTED, ids=[p[0] for p in PLANTED])
def test_a_planted_law_is_found_with_its_amount(name, planted, effect, amount):
    found = law_of(motions(planted, effect))
    assert found is not None
    assert [a.term.name for a in found.amounts] == [name]
    assert found.amounts[0].value == pytest.approx(amount, rel=0.15)
    assert found.p_value < 0.05
    assert found.after < 0.6 * found.before


def test_the_past_is_told_from_the_present():
    """Air that follows late (`air_memory`): neither drag nor added mass says it."""
    found = law_of(motions((("coefficient", 0.8), ("time", 0.15)), "air_memory"))
    assert found is not None
    assert found.amounts[0].term.slot == 5
    assert 0.1 <= found.amounts[0].term.shape[1] <= 0.25
    assert found.amounts[0].value == pytest.approx(0.8, rel=0.25)


def test_nothing_is_described_where_nothing_is_missing():
    assert [law_of(motions(seed=seed), seed) for seed in range(20)] == [None] * 20


def at_some_frames(seed=0):
    """Of a memory: every third frame or so, unevenly, and a lower corner that is not seen for half a second."""
    out, random = [], np.random.default_rng(seed)
    for number in range(5):
        scene, position = simulated(number, (("coefficient", 0.8), ("time", 0.15)), "air_memory")
        frames = np.flatnonzero(random.random(len(scene.times)) < 0.36)
        seen = position[frames] + random.normal(0, NOISE, position[frames].shape)
        visible = np.ones(seen.shape[:2], dtype=bool)
        visible[10:15, -1] = False
        observation = Observation(scene.times[frames], seen, visible, NOISE, scene.points)
        found = motion_of(observation, scene, NOISE)
        assert found is not None
        out.append(found)
    return out


def test_a_memory_is_told_from_frames_that_come_unevenly():
    found = law_of(at_some_frames())
    assert found is not None
    assert found.amounts[0].term.slot == 5
    assert found.amounts[0].value == pytest.approx(0.8, rel=0.25)


def test_the_kernel_of_a_memory_is_told_without_its_form():
    found = past_of(motions((("coefficient", 0.8), ("time", 0.15)), "air_memory"))
    assert found is not None
    shares = dict(found.shares)
    assert shares["velocity and its past"] > 0.9
    assert shares["velocity and its past"] > shares["velocity"] + 0.1
    lag, value = np.array(found.lag), np.array(found.value)
    early = (lag >= 0.05) & (lag <= 0.3)
    assert np.abs(value - 0.8 * np.exp(-lag / 0.15))[early].max() < 0.12
    assert np.abs(value[lag >= 0.75]).max() < 0.1


def test_without_a_memory_the_past_says_no_more_than_the_present():
    found = past_of(motions((("normal", 1.1),), "quadratic_drag"))
    assert found is not None
    shares = dict(found.shares)
    assert shares["velocity and its past"] < shares["velocity"] + 0.05


def test_a_balance_needs_a_line_of_grips_and_most_of_the_sheet():
    scene, position = simulated(0, ())
    visible = np.ones(position.shape[:2], dtype=bool)
    seen = Observation(scene.times, position, visible, NOISE, scene.points)
    assert motion_of(seen, scene, NOISE) is not None
    single = replace(scene, grip_material=scene.grip_material[:1], grip_position=scene.grip_position[:, :1])
    assert motion_of(seen, single, NOISE) is None
    third = np.array([[0.5 * WIDTH, 0.5 * HEIGHT]]), scene.grip_position[:, :1] + [0.5 * WIDTH, 0.0, -0.2]
    beside = replace(scene, grip_material=np.concatenate([scene.grip_material, third[0]]),
                     grip_position=np.concatenate([scene.grip_position, third[1]], axis=1))  # fmt: skip
    assert motion_of(seen, beside, NOISE) is None
    visible[:, scene.points[:, 1] > 0.8 * HEIGHT] = False
    assert motion_of(replace(seen, visible=visible), scene, NOISE) is None
    row = scene.points[:, 1] == 0.0
    line = Observation(scene.times, position[:, row], visible[:, row], NOISE, scene.points[row])
    assert motion_of(line, scene, NOISE) is None


def test_nothing_is_told_of_a_time_in_which_too_little_was_seen():
    """Frames without any node are as frames that are not there; those of the upper row alone say nothing of a sheet."""
    scene, position = simulated(0, ())
    position = position + np.random.default_rng(0).normal(0, NOISE, position.shape)
    whole = np.ones(position.shape[:2], dtype=bool)
    gap = (scene.times > 1.2) & (scene.times < 2.1)

    def seen(visible, frames=slice(None)):
        shown = np.where(visible[..., None], position, np.nan)[frames]
        return motion_of(Observation(scene.times[frames], shown, visible[frames], NOISE, scene.points), scene, NOISE)

    all_seen, absent, blank = seen(whole), seen(whole, ~gap), seen(whole & ~gap[:, None])
    np.testing.assert_array_equal(blank.counted, absent.counted)
    np.testing.assert_array_equal(blank.missing, absent.missing)
    row = seen(whole & ~(gap[:, None] & (scene.points[:, 1] > 0.0)))
    for motion in (blank, row):
        ends = 0.75 / motion.fastest  # as at the ends of a recording
        apart = np.abs(motion.time - 1.65)  # the gap is between 1.2 and 2.1 s
        assert not motion.counted[apart < 0.45 + ends].any()
        assert motion.counted[apart > 0.45 + ends + 1 / 30].all()
        truth = np.interp(motion.time, all_seen.time, all_seen.missing)
        off = (motion.missing - truth)[motion.counted]
        assert np.sqrt(np.mean(off**2)) < 0.2 * all_seen.missing_sigma
    assert seen(whole & ~(scene.times < 1.0)[:, None]).time[0] > 1.0


def test_a_balance_says_on_how_many_recordings_it_rests():
    seen = motions((("normal", 1.1),), "quadratic_drag")
    assert balance_of([*seen[:4], None], 0).recordings == (4, 5)
    assert balance_of([*seen[:2], None, None], 0) is None


def test_a_formula_tells_the_forces_first_and_the_memory_after():
    memory, push = "normal velocity of the last 0.4 s", "a steady force along y"
    assert law(**{memory: 0.394, push: 0.017}).formula == "f = −0.394 w n + 0.017 e_y, ẇ = v̇_n − w/(0.4 s)"
    assert law(**{memory: 0.394, "place along y": 3.0}).formula == "f = −0.394 w n − 3 y e_y, ẇ = v̇_n − w/(0.4 s)"


def test_few_recordings_tell_no_law():
    assert law_of(motions(count=2)) is None


@pytest.mark.slow
def test_what_has_no_name_is_described_put_into_the_model_and_judged(tmp_path):
    """A force that pulls the sheet back to a plane, which no effect knows: the loop names nothing, and describes it."""
    planted, random = (("place along y", 8.0),), np.random.default_rng(4)
    for number in range(6):
        scene, position = simulated(number, planted)
        seen = position + random.normal(0, NOISE, position.shape)
        recording = Recording(
            name=f"swung-{number}", fabric="made", split="fit" if number < 4 else "held_out", time=scene.times,
            material=scene.points, position=seen, grip_time=scene.grip_time, grip_material=scene.grip_material,
            grip_position=scene.grip_position, cloth_width=WIDTH, cloth_height=HEIGHT, areal_density=DENSITY,
            noise_sigma=NOISE,
        )  # fmt: skip
        write_recording(recording, tmp_path / "rec" / f"{recording.name}.nc")
    words = [f"recordings={tmp_path / 'rec'}", "model=mass_spring", f"out={tmp_path / 'out'}", "resolution=7"]
    assert command([*words, "candidates=frame_scale", "rerun=false"]) == 0
    found = json.loads((tmp_path / "out" / "verdict.json").read_text())
    assert found["verdict"] == "unexplained"
    described = found["description"]
    assert [term["term"] for term in described["terms"]] == ["place along y"]
    assert described["terms"][0]["value"] == pytest.approx(8.0, rel=0.2)
    error = described["error_mm"]["held_out"]
    assert error["before"] == pytest.approx(found["error_mm"]["held_out"]["before"])
    assert error["after"] < 0.6 * error["before"]
    assert described["formula"] in (tmp_path / "out" / "index.html").read_text()


@pytest.mark.slow
def test_chance_has_bursts_where_they_are():
    """Motion that comes and goes, and what no term goes with as large as the motion: seldom told from chance. Set
    elsewhere, a burst meets nothing that moves, and every third of these would be.
    """
    alarms, time = 0, np.arange(120) / 30
    for seed in range(40):
        random = np.random.default_rng(seed)
        missing, speeds = [], []
        for _ in range(4):
            burst = np.exp(-0.5 * ((time - random.uniform(1, 1.5)) / 0.35) ** 2)
            noise = gaussian_filter1d(random.normal(size=200), 3)[40:160]
            missing.append(burst * noise / noise.std())
            phase, rate = random.uniform(0, 2 * np.pi), random.uniform(0.6, 1.6)
            speeds.append(burst * np.sin(2 * np.pi * rate * time + phase))
        columns = [np.column_stack([np.abs(v) * v, np.gradient(v, time), np.abs(v), np.cumsum(v)]) for v in speeds]
        series = Series(missing, [-v for v in speeds], columns, 0.01, 1 / 30, [0, 1, 2, 3], np.zeros(4, bool))
        before = series.errors(())
        best = min(range(4), key=lambda k: series.errors([k]).mean())
        alarms += chance(series, best, before, seed) < 0.05
    assert alarms <= 7


def test_a_first_term_stands_for_those_that_predict_as_much():
    """A drag between two powers of the velocity is told by either; another force is not."""
    random, time = np.random.default_rng(0), np.arange(150) / 30
    speeds = [np.sin(2 * np.pi * rate * time + rate) for rate in (0.6, 0.9, 1.1, 1.4)]
    missing = [-(np.abs(v) ** 0.8) * v + 0.01 * random.normal(size=len(v)) for v in speeds]
    columns = [np.column_stack([-np.abs(v) * v, -(np.abs(v) ** 0.5) * v, np.gradient(v, time)]) for v in speeds]
    series = Series(missing, [-v for v in speeds], columns, 0.01, 1 / 30, [0, 0, 1], np.zeros(3, bool))
    assert as_good_as(series, 0, series.errors(())) == [1]
    assert as_good_as(series, 1, series.errors(())) == [0]


@pytest.mark.parametrize(("damping", "chosen"), [(0.95, [0]), (-0.95, [])])
def test_a_term_that_makes_up_for_negative_damping_is_no_law(damping, chosen):
    random, time = np.random.default_rng(1), np.arange(150) / 30
    speeds = [np.sin(2 * np.pi * rate * time + rate) for rate in (0.6, 0.9, 1.1, 1.4)]
    columns = [(-v + 0.3 * random.normal(size=len(v)))[:, None] for v in speeds]
    missing = [-damping * v + 1.27 * c[:, 0] + 0.01 * random.normal(size=len(v))
               for v, c in zip(speeds, columns, strict=True)]  # fmt: skip
    series = Series(missing, [-v for v in speeds], columns, 0.01, 1 / 30, [0], np.zeros(1, bool))
    assert selected(series, series.errors(()))[0] == chosen
    assert series.amounts([0])[0] == pytest.approx(damping, rel=0.05)


def test_damping_that_may_be_none_speaks_against_no_law():
    random, time = np.random.default_rng(1), np.arange(150) / 30
    speeds = [np.sin(2 * np.pi * rate * time + rate) for rate in (0.6, 0.9, 1.1, 1.4)]
    missing = [-np.abs(v) * v + 0.3 * random.normal(size=len(v)) for v in speeds]
    columns = [(-np.abs(v) * v)[:, None] for v in speeds]
    series = Series(missing, [-v for v in speeds], columns, 0.3, 1 / 30, [0], np.zeros(1, bool))
    assert series.amounts([0])[0] < 0
    assert selected(series, series.errors(()))[0] == [0]


def drawn_series() -> Series:
    """Of four recordings of unlike length, and two terms beside the damping."""
    random = np.random.default_rng(2)
    lengths = (60, 90, 120, 40)
    missing, damping, columns = ([random.normal(size=(n, *more)) for n in lengths] for more in ((), (), (2,)))
    missing = [q + d - 2 * c[:, 1] for q, d, c in zip(missing, damping, columns, strict=True)]
    return Series(missing, damping, columns, 0.1, 1 / 30, [0, 1], np.zeros(2, bool))


def least_squares_of(series: Series, which: list[int]) -> np.ndarray:
    """Damping and both coefficients from some recordings, each with the same say."""
    weight = [len(series.missing[r]) ** -0.5 for r in which]
    rows = [w * np.column_stack([series.damping[r], series.columns[r]]) for w, r in zip(weight, which, strict=True)]
    target = [w * series.missing[r] for w, r in zip(weight, which, strict=True)]
    return np.linalg.lstsq(np.vstack(rows), np.concatenate(target), rcond=None)[0]


def test_a_law_is_judged_on_recordings_that_it_was_not_fitted_to():
    series = drawn_series()
    without = [least_squares_of(series, [k for k in range(4) if k != r]) for r in range(4)]
    designs = [np.column_stack(pair) for pair in zip(series.damping, series.columns, strict=True)]
    left = [np.mean((q - d @ x) ** 2) for q, d, x in zip(series.missing, designs, without, strict=True)]
    np.testing.assert_allclose(series.errors([0, 1]), left)
    np.testing.assert_allclose(series.amounts([0, 1]), least_squares_of(series, [0, 1, 2, 3]))
    away = np.array(without) - np.mean(without, axis=0)
    half = 3.1824 * np.sqrt(3 / 4 * np.sum(away**2, axis=0))  # Student's t of three degrees of freedom
    np.testing.assert_allclose(jackknife(series, [0, 1]), half, rtol=1e-4)
    np.testing.assert_allclose(left_out(designs, series.missing), left)
    value, low, high = (np.array(ends) for ends in kernel_of(designs, series.missing, np.zeros((3, 3)), 2))
    np.testing.assert_allclose(value, [*least_squares_of(series, [0, 1, 2, 3])[1:], 0.0])
    np.testing.assert_allclose((high - low)[:2] / 2, jackknife(series, [0, 1])[1:])


def test_what_chance_never_does_has_the_least_p_value():
    series = drawn_series()
    assert chance(series, 1, series.errors(()), 0) == 1 / (1 + LOOP.permutations)


def test_the_kernel_is_as_smooth_as_the_recordings_allow():
    """The largest penalty (of 0.001, 0.01, …) within one standard error of the least error, 2 ± 0.5."""
    least = np.array([1.0, 2.0, 2.0, 3.0])  # a standard deviation of 0.816, half of that of their mean
    errors = [least + more for more in (0.5, 0.0, 0.3, 0.40, 0.42, 5.0)]
    assert smoothest(errors) == 1.0


def still(along: np.ndarray, area: np.ndarray, lever: np.ndarray) -> Motion:
    """A sheet 0.4 m wide at rest, of nodes with these places, areas and levers, seen at 30 Hz with 1 mm of noise."""
    nodes = len(area)
    nothing = np.zeros((10, nodes, 3))
    return Motion(
        np.arange(10) / 30, nothing, nothing, nothing, nothing, np.tile([1.0, 0.0, 0.0], (10, 1)),
        np.broadcast_to(lever, (10, nodes, 3)), area, along, 0.4, 0.2, np.array([0.0, 0.0, -9.81]), 1e-3, 30.0, 5.0,
        np.ones(10, bool),
    )  # fmt: skip


def test_the_noise_of_a_torque_is_that_of_accelerations_times_mass_and_lever():
    """White noise of σ²·2/rate per Hz through (2πf)² and the spline's response, independent from node to node."""
    f = np.linspace(0.0, 200.0, 400001)
    power = np.sum((2 * np.pi * f) ** 4 / (1 + (f / 5.0) ** 6) ** 2) * f[1]
    acceleration = 1e-3 * np.sqrt(2 / 30 * power)
    area, lever = np.array([0.01, 0.02, 0.01]), np.array([[0.0, 0.1, 0.0], [0.0, 0.0, 0.2], [0.0, 0.3, 0.4]])
    moments = 0.2 * area * np.linalg.norm(lever, axis=1)
    found = still(np.zeros((3, 2)), area, lever).missing_sigma
    assert found == pytest.approx(acceleration * np.sqrt(np.sum(moments**2)), rel=1e-3)


def test_nodes_of_the_lower_edge_stand_for_half_the_way_to_their_neighbours():
    along = np.array([[0.9, 1.0], [0.1, 1.0], [0.5, 0.5], [0.4, 1.0]])
    area = np.array([0.01, 0.02, 0.03, 0.04])
    length = 0.4 * np.array([0.35, 0.25, 0.0, 0.4])  # from 0.65 on, up to 0.25, and between
    np.testing.assert_allclose(still(along, area, np.zeros(3)).lower_edge * area, length)


def test_a_node_that_was_long_unseen_lies_on_the_plane_of_its_neighbours():
    """A corner of a sheet that is plane and turns; what was not seen for less than 0.3 s is left to the spline."""
    material = np.stack([a.ravel() for a in np.meshgrid(np.linspace(0, 0.4, 5), np.linspace(0, 0.3, 4))], axis=1)
    time = np.arange(90) / 30
    turn = np.stack([np.cos(time), np.sin(time), 0.2 * time], axis=1)
    truth = material[:, :1] * turn[:, None] + material[:, 1:] * [0.1, 0.2, -0.9]
    seen = truth.copy()
    seen[30:50, 0], seen[60:66, 0] = np.nan, np.nan
    found = bridged(seen, material, time, 0.3)
    np.testing.assert_allclose(found[30:50], truth[30:50], atol=1e-9)
    assert np.isnan(found[60:66, 0]).all()
    np.testing.assert_array_equal(np.delete(found, 0, axis=1), np.delete(truth, 0, axis=1))


def speeding_up(rate: float) -> Motion:
    """Two nodes that go ever faster along their normal, by `rate` m/s², from rest on: 1.5 s at 100 Hz."""
    motion, time = still(np.zeros((2, 2)), np.array([0.1, 0.3]), np.array([0.0, 0.0, 0.5])), np.arange(151) / 100
    normal = np.tile([0.0, 0.6, 0.8], (151, 2, 1))
    v = rate * time[:, None, None] * normal + [1.0, 0.0, 0.0]  # and evenly across it
    lever = np.tile(motion.lever[0], (151, 1, 1))
    return replace(motion, time=time, x=0 * v, v=v, a=rate * normal, normal=normal, lever=lever)


def test_air_that_follows_late_is_behind_by_what_its_equation_says():
    """ẇ = v̇ − w/τ, from w = 0 on: w = v̇ τ (1 − exp(−t/τ))."""
    motion = speeding_up(3.0)
    for relaxation in (0.02, 0.25, 1.2):
        expected = 3.0 * relaxation * (1 - np.exp(-motion.time / relaxation))
        np.testing.assert_allclose(late(motion, relaxation), np.stack([expected] * 2, axis=1), atol=1e-9)
        force = delayed(motion, relaxation)
        np.testing.assert_allclose(force, -expected[:, None, None] * motion.normal, atol=1e-9)


def test_a_power_of_the_speed_is_against_it_whichever_way_it_goes():
    for rate in (3.0, -3.0):
        motion = speeding_up(rate)
        v = rate * motion.time[:, None, None]
        np.testing.assert_allclose(power(motion, 1.5), -np.sign(rate) * np.abs(v) ** 1.5 * motion.normal, atol=1e-9)


def test_each_lag_of_the_past_weighs_as_far_as_half_the_way_to_its_neighbours():
    """Of acceleration that began long ago: the integral of a kernel that is 1 at a lag and 0 at the next ones."""
    motion, lags = speeding_up(3.0), np.array(LAGS)
    wide = np.concatenate([[lags[1]], lags[2:] - lags[:-2]]) / 2
    turned = -3.0 * 0.8 * 0.5 * (0.1 + 0.3)  # N·m: kg/m²·m/s² along the normal, whose lever is 0.8 of 0.5 m
    np.testing.assert_allclose(of_past(motion)[-1], turned * wide, rtol=1e-9)


@pytest.mark.parametrize("rate", [30, 100])
def test_motion_is_smoothed_as_its_noise_is_reckoned(rate):
    """The response to f Hz is 1/(1 + (f/5.5)⁶), and so the noise of an acceleration what `missing_sigma` says."""
    time, fastest = np.arange(0.0, 8.0, 1 / rate), 5.5
    middle = (time > 2) & (time < 6)
    for f in (2.0, 4.0, 5.5, 8.0):
        wave = np.stack([np.sin(2 * np.pi * f * time), np.cos(2 * np.pi * f * time), 0 * time], axis=1)[:, None]
        left = smoothed(time, wave, time, fastest)[0][middle, 0]
        response = np.mean(np.sum(left * wave[middle, 0], axis=1))
        assert response == pytest.approx(1 / (1 + (f / fastest) ** 6), abs=0.01)
    noise = np.random.default_rng(1).normal(size=(len(time), 60, 3))
    drawn = smoothed(time, noise, time, fastest)[2][middle].std()
    assert drawn == pytest.approx(np.sqrt(2 * (2 * np.pi) ** 4 * fastest**5 * np.pi / 18 / rate), rel=0.06)


def test_a_steady_force_is_looked_for_across_gravity_wherever_that_points():
    seen = motions(count=3)
    assert steady_axes(seen) == "y"  # along x lies the line of the grips
    assert steady_axes([replace(m, gravity=np.array([0.0, -9.81, 0.0])) for m in seen]) == "z"
